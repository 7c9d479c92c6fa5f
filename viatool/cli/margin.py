"""``viatool margin``: how much error every contested state survives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from viatool.cli import options
from viatool.cli.command import Command
from viatool.cli.gating import build_gate, contested_option, gate_options, leave_by_gate
from viatool.cli.reporting import read_outputs, tell
from viatool.cli.states import bag_settings, choose_scenarios, close_option, sampled_places, state_options
from viatool.cli.terminal import show_progress
from viatool.cli.work import keeping, work_options
from viatool.setting.criteria import PROVING

if TYPE_CHECKING:
    from viatool.margins.result import Margins
    from viatool.report import Output
    from viatool.schedule import Progress

_OF_ONE_POLICY = ("states", "witnesses")
_PASSED_ON = (
    "channels",
    "term",
    "most",
    "resolution",
    "trajectory",
    "criterion",
    *options.BOUNDS,
    *options.CLEARANCES,
    "noise",
    "seed",
    "close",
    "workers",
    "scheduler",
    "resume",
)


@click.command(cls=Command)
@click.argument("policies", type=options.POLICY, nargs=-1, required=True, metavar="POLICY...")
@options.map_option
@options.unknown_option
@click.option(
    "--channel",
    "channels",
    multiple=True,
    metavar="NAME",
    help="A channel that errs, such as lidar, while the others stay at their --eps, or exact; by default all err "
    "together, each by the same number in its own unit. Repeatable.",
)
@click.option(
    "--term",
    metavar="NAME",
    help="A term of the error model instead, such as pose.x; all else stays as --errors and --eps say.",
)
@click.option(
    "--most",
    type=options.QuantityType("error"),
    default=0.5,
    show_default=True,
    help="The largest error that is tried.",
)
@click.option(
    "--resolution",
    type=options.QuantityType("error"),
    help="How close the ends are followed; by default a 256th of the largest error.",
)
@click.option(
    "--eps",
    type=options.EpsType(),
    multiple=True,
    callback=options.collect_eps,
    help="In which proportions channels err, such as lidar=0.03; or, with --channel or --term, what the others stay "
    "at. Repeatable.",
)
@options.errors_option
@options.pose_error_option
@options.spec_option
@click.option(
    "--criterion",
    type=click.Choice(PROVING),
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
    "--output",
    "-o",
    multiple=True,
    metavar="FORMAT:PATH",
    help="Write a report: json, figure (png, svg, pdf: the curve of all policies), html, csv (a row for each contested "
    "state), markdown, junit, sarif or github; of one policy also states (npz) and witnesses (json, for viatool "
    "replay); PATH - is stdout. Repeatable.",
)
@gate_options
@contested_option
@work_options
@options.threads_option
@options.quiet_option
@click.pass_context
def command(ctx: click.Context, /, **given: Any) -> None:
    """Find how much error each contested state survives under POLICY (ONNX; several are compared).

    A state is contested if some command of the robot could endanger it. Of each, the largest error that is proved safe
    and the smallest with a counterexample are found by bisection.
    """
    from viatool.report import evaluate
    from viatool.report.margins.run import MarginsRun

    outputs = read_outputs(given["output"], MarginsRun)
    _check_formats(outputs, given)
    gate = build_gate(given, MarginsRun)
    also = [float(threshold.least) for threshold in gate.thresholds]
    with keeping(given["checkpoint"]), show_progress(quiet=given["quiet"]) as progress:
        margins = [_margins(given, number, also, progress) for number in range(len(given["policies"]))]
    document = MarginsRun(*margins)
    checks = evaluate(gate, document)
    tell(document, outputs, checks, quiet=given["quiet"])
    leave_by_gate(ctx, checks, quiet=given["quiet"])


def _margins(given: Mapping[str, Any], number: int, also: Sequence[float], progress: Progress) -> Margins:
    """Return the margins of one of the policies."""
    from viatool.margins import margin

    world_map = options.open_map(given["map_path"], given["unknown"])
    return margin(
        given["policies"][number],
        world_map,
        spec=given["spec_path"],
        eps=options.plain_eps(given["eps"]),
        scenarios=choose_scenarios(given, world_map),
        bag=bag_settings(given),
        places=sampled_places(given),
        errors=options.stated_errors(given),
        also=also,
        checkpoint=_checkpoint(given, number),
        progress=progress,
        **{name: given[name] for name in _PASSED_ON},
    )


def _checkpoint(given: Mapping[str, Any], number: int) -> Path | None:
    """Return where the work on one of the policies is kept: of several in a folder of its own."""
    folder: Path | None = given["checkpoint"]
    several = len(given["policies"]) > 1
    return folder / f"policy-{number}" if folder is not None and several else folder


def _check_formats(outputs: Sequence[Output], given: Mapping[str, Any]) -> None:
    """Refuse formats that show what was not asked for.

    Raises
    ------
    ConfigurationError
        If a format is about one policy and several are given, or counterexamples would need rules of their own each.
    """
    from viatool.errors import ConfigurationError

    for output in outputs:
        if output.format in _OF_ONE_POLICY and len(given["policies"]) > 1:
            raise ConfigurationError(
                f"the format '{output.format}' is about one policy, and {len(given['policies'])} are given",
                "ask for it with one policy",
            )
        place = given["term"] or ""
        if output.format == "witnesses" and not (
            given["term"] is None or place.startswith(("sensor.", "pose."))
        ):
            raise ConfigurationError(
                f"counterexamples within different {place} are runs under different rules, of which a file has one",
                f"verify with the {place} that is of interest, and --output witnesses:PATH",
            )
