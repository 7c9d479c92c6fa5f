"""Pictures of the episodes in which a policy fails."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from viatool.policy import Policy
from viatool.policy.specified import specification_of
from viatool.setting.setting import Setting
from viatool.world import Scenario, WorldMap


def draw_failures(
    policy: Policy, failing: Sequence[tuple[WorldMap, Sequence[Scenario]]], folder: Path
) -> list[Path]:
    """Drive scenarios once more and draw their paths, obstacles and goals: one picture for each map.

    Parameters
    ----------
    policy : Policy
        With its specification, which says after how many intervals an episode ends where it was trained here.
    failing : sequence of (WorldMap, sequence of Scenario)
        In what it fails.
    folder : Path
        Receives ``failures-MAP.png``, written whole or not at all.

    Returns
    -------
    list of Path
        The pictures.
    """
    from viatool.report.formats.figure import DPI
    from viatool.report.simulations.figure import draw_simulation
    from viatool.simulate import simulate
    from viatool.whole_file import whole_file

    horizon = specification_of(policy).training.get("configuration", {}).get("horizon")
    pictures = []
    for world_map, scenarios in failing:
        setting = Setting.of(policy, world_map, 0.0, scenarios=scenarios)
        drawn = draw_simulation(simulate(policy, setting, horizon=horizon))
        pictures.append(folder / f"failures-{world_map.name}.png")
        with whole_file(pictures[-1]) as draft:
            drawn.savefig(draft, format="png", dpi=DPI)
    return pictures
