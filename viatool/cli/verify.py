"""``viatool verify``: the main job, its reports and the gate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from viatool.cli import options
from viatool.cli.command import Command
from viatool.cli.gating import (
    build_gate,
    contested_option,
    gate_options,
    leave_by_gate,
    stop_early_option,
)
from viatool.cli.reporting import read_outputs, tell
from viatool.cli.started import seconds_since_start
from viatool.cli.states import bag_settings, choose_scenarios, close_option, sampled_places, state_options
from viatool.cli.stopping import (
    WITHOUT,
    asks_for_close_places,
    certain,
    require_stoppable,
    without_close_places,
)
from viatool.cli.terminal import show_progress
from viatool.cli.work import keeping, work_options
from viatool.setting.criteria import CRITERIA, PROVING

if TYPE_CHECKING:
    from viatool.loop.horizon import Horizon
    from viatool.margins.result import Margins
    from viatool.report import Gate
    from viatool.schedule import Progress
    from viatool.verification.result import Result

_PASSED_ON = (
    "trajectory",
    "criterion",
    *options.BOUNDS,
    *options.CLEARANCES,
    "only_contested",
    "widths",
    "explain_errors",
    "noise",
    "seed",
    "close",
    "workers",
    "scheduler",
    "checkpoint",
    "resume",
)

_OF_MARGINS = (
    "criterion",
    *options.BOUNDS,
    *options.CLEARANCES,
    "seed",
    "close",
    "workers",
    "scheduler",
)


@click.command(cls=Command)
@options.policy_argument
@options.map_option
@options.unknown_option
@options.eps_option
@options.errors_option
@options.pose_error_option
@options.spec_option
@click.option(
    "--criterion",
    type=click.Choice(list(CRITERIA)),
    default="swept",
    show_default=True,
    help="What a state has to fulfil to be safe.",
)
@state_options
@options.scenario_options
@options.seed_option
@options.noise_option
@close_option
@options.bounds_options
@options.clearance_options
@click.option(
    "--horizon",
    type=click.IntRange(min=1, max=1000),
    metavar="K",
    help="Also follow the closed loop from every state over K control intervals, LiDAR in the loop: where it may be, "
    "and from how many states it stays safe.",
)
@click.option(
    "--only-contested",
    is_flag=True,
    help="Bound the actions only where some command could endanger the robot: the same verdicts, faster.",
)
@click.option(
    "--widths",
    is_flag=True,
    help="Bound the actions of every state; of more than 20,000, else those of an even sample and of contested ones "
    "are, and widths are those of the sample. Output states does so as well.",
)
@options.explain_errors_option
@click.option(
    "--margins",
    is_flag=True,
    help="Also find how much error each contested state survives, as viatool margin does: --eps says in which "
    "proportions.",
)
@click.option(
    "--output",
    "-o",
    multiple=True,
    metavar="FORMAT:PATH",
    help="Write a report: html (to explore), json, states (npz), witnesses (json, for viatool replay), mcap (ROS "
    "messages, for Foxglove and RViz), csv, figure (png, svg, pdf), markdown, junit, sarif, github or evidence (a "
    "folder, for viatool check); PATH - is "
    "stdout. Repeatable.",
)
@gate_options
@contested_option
@stop_early_option
@work_options
@options.threads_option
@options.quiet_option
@click.pass_context
def command(ctx: click.Context, /, **given: Any) -> None:
    """Verify POLICY (ONNX) on a map with bounded sensor error.

    Every visited state becomes safe (proved), unsafe (with a replayable counterexample) or unknown. Without a
    gate option the command passes whatever the rates are.
    """
    from viatool.report import evaluate
    from viatool.report.states.run import StatesRun

    if given["margins"] and given["criterion"] not in PROVING:
        raise click.UsageError(f"--margins need a criterion that proves something: {' or '.join(PROVING)}")
    if given["stop_early"]:
        require_stoppable(given)
    outputs = read_outputs(given["output"], StatesRun)
    given["widths"] |= any(output.format in ("states", "evidence") for output in outputs)
    gate = build_gate(given, StatesRun)
    with keeping(given["checkpoint"]), show_progress(quiet=given["quiet"]) as progress:
        result = _verify(given, gate, progress)
        margins = _margins(given, result, progress) if given["margins"] else None
    for found in result.recording:
        if found.doubtful:
            options.warn(found.warning)
    document = StatesRun(result, margins, _files(given))
    checks = evaluate(gate, document)
    tell(document, outputs, checks, quiet=given["quiet"])
    leave_by_gate(ctx, checks, quiet=given["quiet"])


def _margins(given: Mapping[str, Any], result: Result, progress: Progress) -> Margins:
    """Return how much error the states of a result survive; the same states, and the same close places."""
    from viatool.margins import margin

    return margin(
        given["policy"],
        options.open_map(given["map_path"], given["unknown"]),
        spec=given["spec_path"],
        eps=options.plain_eps(given["eps"]),
        errors=options.stated_errors(given),
        progress=progress,
        **{name: given[name] for name in _OF_MARGINS},
        trajectory=result.trajectory,
    )


def _files(given: Mapping[str, Any]) -> dict[str, Path]:
    """Return what was read besides policy and map, by its role."""
    from viatool.samples import ERRORS

    read = {
        "specification": given["spec_path"],
        "errors": given["errors"] and ERRORS.find(given["errors"]),
        "recording": given["trajectory"],
    }
    return {role: Path(path) for role, path in read.items() if path}


def _horizon(given: Mapping[str, Any]) -> Horizon | None:
    """Return what is asked of the intervals after each state.

    Raises
    ------
    ConfigurationError
        If an option makes sense with a horizon alone.
    """
    from viatool.errors import ConfigurationError
    from viatool.loop.horizon import Horizon

    if given["horizon"] is not None:
        return Horizon(given["horizon"])
    about_it = [f"--fail-under {text}" for text in given["fail_under"] if text.startswith("horizon=")]
    if about_it:
        raise ConfigurationError(f"{about_it[0]} is about a horizon", "add --horizon K, such as --horizon 10")
    return None


def _verify(given: Mapping[str, Any], gate: Gate, progress: Progress) -> Result:
    from viatool.report.states.so_far import StatesSoFar
    from viatool.verification import verify

    bag, places = bag_settings(given), sampled_places(given)
    world_map = options.open_map(given["map_path"], given["unknown"])
    stopping = given["stop_early"]
    without_close = stopping and not asks_for_close_places(gate)
    passed_on = {name: given[name] for name in _PASSED_ON} | ({"close": 0} if without_close else {})
    begun = seconds_since_start()
    result = verify(
        given["policy"],
        world_map,
        spec=given["spec_path"],
        eps=options.plain_eps(given["eps"]),
        scenarios=choose_scenarios(given, world_map),
        bag=bag,
        places=places,
        horizon=_horizon(given),
        errors=options.stated_errors(given),
        progress=progress,
        enough=certain(without_close_places(gate), StatesSoFar) if stopping else None,
        **passed_on,
    )
    if without_close and given["close"]:
        result = replace(result, no_close=WITHOUT)
    return replace(result, seconds={"start": begun, **result.seconds})
