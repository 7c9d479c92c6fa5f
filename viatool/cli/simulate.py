"""``viatool simulate``: drive a policy, report how it fared, and record the states."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from viatool.cli import options
from viatool.cli.command import Command
from viatool.cli.condition_options import condition_options, engine_options
from viatool.cli.gating import build_gate, gate_options, leave_by_gate
from viatool.cli.reporting import read_outputs, tell
from viatool.cli.terminal import show_progress

if TYPE_CHECKING:
    from viatool.simulate import Conditions, Simulation


@click.command(cls=Command)
@options.policy_argument
@options.map_option
@options.unknown_option
@options.spec_option
@options.scenario_options
@click.option("--episodes", type=click.IntRange(min=1), metavar="N", help="The same as --scenarios.")
@options.seed_option
@engine_options
@options.noise_option
@condition_options
@options.errors_option
@click.option(
    "--adversary",
    is_flag=True,
    help="Let an adversary choose the errors of --errors: as large as they may be, and of some those that lead nearest "
    "to an obstacle. Without it chance draws them evenly.",
)
@click.option(
    "--monitor",
    is_flag=True,
    help="Drive the same scenarios once more under the run-time monitor, which lets a command pass only if the stop "
    "after it is proved, and report what that changes.",
)
@options.clearance_option
@options.danger_option
@options.interval_option
@options.footprint_option
@options.prefer_option
@click.option(
    "--time-limit",
    type=options.QuantityType("s"),
    help="Simulated time after which an episode has taken too long; by default the task's 300 control intervals.",
)
@click.option(
    "--output",
    "-o",
    multiple=True,
    metavar="FORMAT:PATH",
    help="Write a report: json, figure (png, svg, pdf), trajectory (npz, csv; for verify --trajectory), csv (a row for "
    "each episode), html, markdown, junit, sarif or github; PATH - is stdout, and a path alone that ends in .npz or "
    ".csv is a trajectory. Repeatable.",
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
@gate_options
@options.threads_option
@options.quiet_option
@click.pass_context
def command(ctx: click.Context, /, **given: Any) -> None:
    """Drive POLICY (ONNX) through the scenarios of a map and report how the episodes end."""
    from viatool.report import evaluate
    from viatool.report.simulations.run import SimulationRun

    outputs = read_outputs(map(_named, given["output"]), SimulationRun)
    gate = build_gate(given, SimulationRun)
    _check_pictures(given["record"], render=given["render"])
    simulation = _simulate(given)
    document = SimulationRun(simulation)
    checks = evaluate(gate, document)
    tell(document, outputs, checks, quiet=given["quiet"])
    _show(simulation, given)
    leave_by_gate(ctx, checks, quiet=given["quiet"])


def _named(text: str) -> str:
    """Return FORMAT:PATH; a path alone that ends so is that of a trajectory."""
    from viatool.report import FORMATS

    plain = text.partition(":")[0] not in FORMATS and Path(text).suffix.lower() in (".npz", ".csv")
    return f"trajectory:{text}" if plain else text


def _simulate(given: Mapping[str, Any]) -> Simulation:
    from viatool.policy import load_policy
    from viatool.setting.setting import Setting
    from viatool.setting.wishes import Wishes
    from viatool.simulate import simulate
    from viatool.simulate.engines import job_of
    from viatool.uncertainty import as_error_model

    errors = as_error_model(given["errors"])
    if given["adversary"] and not errors:
        raise click.UsageError("--adversary chooses errors within a model: give it with --errors")
    if (given["record"] or given["render"]) and errors.obstacles != type(errors.obstacles)():
        raise click.UsageError(
            f"--record and --render show obstacles where the map has them, and {errors.source} lets them move"
        )
    policy = load_policy(given["policy"], given["spec_path"])
    world_map = options.open_map(given["map_path"], given["unknown"])
    if given["episodes"] and given["scenarios"]:
        raise click.UsageError("--episodes is the same as --scenarios: leave one out")
    drawn = given["episodes"] or given["scenarios"]
    scenarios = options.draw_scenarios(world_map, drawn, given["seed"], given["chosen"])
    wishes = Wishes(
        **{name: given[name] for name in ("clearance", "danger", "interval", "footprint", "robot", "prefer")},
        delay=given["delay"] or 0.0,
        errors=errors,
    )
    setting = Setting.of(
        policy, world_map, 0.0, wishes, scenarios, job=job_of(given["engine"], given["lidar"])
    )
    asked = {"engine": given["engine"], "conditions": _conditions(given)}
    asked |= {name: given[name] for name in ("seed", "workers", "lidar", "adversary")}
    if asked["workers"] == "auto":
        from viatool.schedule.processes import available_cores

        asked["workers"] = available_cores()
    if given["time_limit"] is not None:
        asked["horizon"] = setting.rules.intervals_within(given["time_limit"])
    with show_progress(quiet=given["quiet"]) as progress:
        if not given["monitor"]:
            return simulate(policy, setting, **asked, progress=progress)
        from viatool.monitoring.simulated import simulate_monitored

        braking = replace(wishes, criterion="braking")
        monitor = Setting.of(policy, world_map, 0.0, braking, scenarios, job="monitor")
        return simulate_monitored(policy, setting, monitor, **asked, progress=progress)


def _conditions(given: Mapping[str, Any]) -> Conditions:
    from viatool.simulate import Conditions

    names = ("noise", "dropout", "lidar_rate", "delay", "drift", "acceleration", "people")
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
            write_film(simulation, draft, given["shown"], progress)
    if given["render"]:
        from viatool.simulate.bullet.playback import play_in_window

        play_in_window(simulation, given["shown"])
