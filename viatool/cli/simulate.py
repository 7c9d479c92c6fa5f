"""``viatool simulate``: drive a policy, report how it fared, and record the states."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from viatool.cli import options
from viatool.cli.condition_options import condition_options, engine_options
from viatool.cli.terminal import open_console, show_progress

if TYPE_CHECKING:
    from viatool.report import Output
    from viatool.simulate import Conditions, Simulation


@click.command()
@options.policy_argument
@options.map_option
@options.unknown_option
@options.spec_option
@click.option(
    "--episodes",
    "--scenarios",
    "scenarios",
    type=click.IntRange(min=1),
    metavar="N",
    help="Drive N scenarios drawn by the map's generator instead of the map's fixed ones.",
)
@options.seed_option
@engine_options
@options.noise_option
@condition_options
@options.clearance_option
@options.danger_option
@options.interval_option
@options.footprint_option
@options.prefer_option
@click.option(
    "--horizon",
    type=click.IntRange(min=1),
    metavar="N",
    help="Most steps of an episode; by default the task's 300.",
)
@click.option(
    "--output",
    "-o",
    multiple=True,
    metavar="FORMAT:PATH",
    help="Write a report: json, figure (png, svg, pdf) or trajectory (npz, csv; for verify --trajectory); "
    "PATH - is stdout, and a path alone that ends in .npz or .csv is a trajectory. Repeatable.",
)
@click.option(
    "--record",
    type=options.WRITABLE,
    metavar="FILE",
    help="Write a film (gif, mp4) of the first episodes.",
)
@click.option("--render", is_flag=True, help="Play the first episodes back in a window.")
@click.option(
    "--shown",
    type=click.IntRange(min=1),
    default=3,
    show_default=True,
    metavar="N",
    help="Episodes that a film or the window shows.",
)
@options.threads_option
@options.quiet_option
def command(**given: Any) -> None:
    """Drive POLICY (ONNX) through the scenarios of a map and report how the episodes end."""
    from viatool.report import STDOUT, check_outputs, write_outputs
    from viatool.report.simulation import print_simulation

    outputs = tuple(_output(text) for text in given["output"])
    check_outputs(outputs)
    _check_pictures(given["record"], render=given["render"])
    simulation = _simulate(given)
    write_outputs(simulation, outputs)
    if not given["quiet"]:
        to_stdout = any(output.path == STDOUT for output in outputs)
        print_simulation(simulation, open_console(stderr=to_stdout))
    _show(simulation, given)


def _output(text: str) -> Output:
    """Read FORMAT:PATH; a path alone is that of a trajectory."""
    from viatool.errors import ConfigurationError
    from viatool.report import parse_output
    from viatool.report.simulation import SIMULATION_REPORTERS

    named = text.partition(":")[0] in SIMULATION_REPORTERS
    if named or Path(text).suffix.lower() not in (".npz", ".csv"):
        if ":" not in text:
            raise ConfigurationError(
                f"'{text}' is neither FORMAT:PATH nor a trajectory file (.npz, .csv)",
                f"write for example json:run.json; formats are {', '.join(SIMULATION_REPORTERS)}",
            )
        return parse_output(text, SIMULATION_REPORTERS)
    return parse_output(f"trajectory:{text}", SIMULATION_REPORTERS)


def _simulate(given: Mapping[str, Any]) -> Simulation:
    from viatool.policy import load_policy
    from viatool.setting.setting import Setting
    from viatool.setting.wishes import Wishes
    from viatool.simulate import simulate

    policy = load_policy(given["policy"], given["spec_path"])
    world_map = options.open_map(given["map_path"], given["unknown"])
    scenarios = options.draw_scenarios(world_map, given["scenarios"], given["seed"])
    wishes = Wishes(
        **{name: given[name] for name in ("clearance", "danger", "interval", "footprint", "robot", "prefer")},
        delay=given["delay"] or 0.0,
    )
    setting = Setting.of(policy, world_map, 0.0, wishes, scenarios)
    with show_progress(quiet=given["quiet"]) as progress:
        return simulate(
            policy,
            setting,
            engine=given["engine"],
            conditions=_conditions(given),
            horizon=given["horizon"],
            seed=given["seed"],
            workers=given["workers"],
            lidar=given["lidar"],
            progress=lambda done, total: progress("drive", done, total),
        )


def _conditions(given: Mapping[str, Any]) -> Conditions:
    from viatool.simulate import Conditions

    names = ("noise", "dropout", "lidar_rate", "delay", "drift", "acceleration")
    return Conditions(**{name: given[name] for name in names})


def _check_pictures(record: Path | None, *, render: bool) -> None:
    """Refuse a film or a window that cannot be, before anything is driven."""
    if record is None and not render:
        return
    from viatool.report.files import check_writable
    from viatool.simulate.bullet.playback import check_film, check_window

    if record is not None:
        check_film(record)
        check_writable(record)
    if render:
        check_window()


def _show(simulation: Simulation, given: Mapping[str, Any]) -> None:
    """Write the film and open the window that were asked for."""
    if given["record"] is not None:
        from viatool.report.files import replacing
        from viatool.simulate.bullet.playback import write_film

        with show_progress(quiet=given["quiet"]) as progress, replacing(given["record"]) as draft:
            write_film(simulation, draft, given["shown"], lambda done, all: progress("film", done, all))
    if given["render"]:
        from viatool.simulate.bullet.playback import play_in_window

        play_in_window(simulation, given["shown"])
