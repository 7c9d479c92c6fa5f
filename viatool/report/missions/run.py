"""The report on missions while they are at hand: pictures, tubes, and runs to be driven again."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from viatool.report.document import Drawn, Explorable, Playable, Replayable, TubeTabled
from viatool.report.missions.document import MissionsDocument
from viatool.report.sections import Check

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from viatool.loop.horizon import Crashes
    from viatool.missions import Mission, Missions
    from viatool.report.playback.messages import RosMessage


class MissionsRun(MissionsDocument, Drawn, Explorable, Replayable, Playable, TubeTabled):
    """The report of missions."""

    def __init__(self, missions: Missions) -> None:
        super().__init__(missions.to_json())
        self.missions = missions

    def draw(self) -> Figure:
        """Return every mission with its tube and the runs that were driven against it."""
        from viatool.report.missions.figure import draw_missions

        return draw_missions(self.missions, self.headline)

    def page(self, checks: Sequence[Check]) -> str:
        """Return the page on which tubes are played beside the driven runs."""
        from viatool.report.missions.html.page import render_page

        return render_page(self, checks)

    def play(self) -> Iterator[RosMessage]:
        """Yield the tubes of all missions, with the runs that refute them."""
        from viatool.report.missions.playback import play_missions

        return play_missions(self.missions)

    def tube_table(self) -> Mapping[str, NDArray[Any]]:
        """Return the parts of all tubes."""
        return self.missions.tube_table()

    def witness_file(self) -> Mapping[str, Any]:
        """Return the runs that collide or do not arrive, each with the intervals before."""
        from viatool.verification.witness_file import compose_witnesses

        missions = self.missions
        entries = [entry for mission in missions for entry in _entries(mission, missions)]
        return compose_witnesses(
            missions.policy.path,
            missions.policy.sha256,
            missions.world_map,
            missions.setting.command_map,
            missions.rules,
            entries,
        )


def _entries(mission: Mission, missions: Missions) -> Iterator[dict[str, Any]]:
    from viatool.verification.run_entries import arrival_document

    for row in range(len(mission.crashes)):
        yield _entry(mission, mission.crashes, row, missions)
    if not len(mission.crashes):
        for row in range(len(mission.late)):
            late = {"late": arrival_document(missions.destination(mission.scenario))}
            yield _entry(mission, mission.late, row, missions) | late


def _entry(mission: Mission, found: Crashes, row: int, missions: Missions) -> dict[str, Any]:
    from viatool.trajectory import write_scenario
    from viatool.verification.run_entries import motion_begun, run_before

    step, rules = int(found.step[row]), missions.rules
    return {
        "state": 0,
        "episode": 0,
        "time": step * rules.interval,
        "pose": found.poses[row, step].tolist(),
        "previous": None,
        **motion_begun(found, row),
        "before": run_before(found, row),
        **found.last.violation(row, missions.world_map, mission.scenario, rules.footprint),
        "scenario": json.loads(write_scenario(mission.scenario) or "null"),
    }
