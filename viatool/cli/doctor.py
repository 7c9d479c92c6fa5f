"""``viatool doctor``: tell whether the specification of a policy is right."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import click

from viatool.cli import options
from viatool.cli.command import Command
from viatool.cli.reporting import read_outputs, tell
from viatool.cli.states import bag_settings, recording_options
from viatool.cli.terminal import show_progress
from viatool.cli.work import WorkersType

if TYPE_CHECKING:
    from viatool.doctor import Diagnosis


@click.command(cls=Command)
@options.policy_argument
@options.map_option
@options.unknown_option
@options.spec_option
@click.option(
    "--scenarios",
    type=click.IntRange(min=1),
    default=60,
    show_default=True,
    metavar="N",
    help="Drive the map's fixed scenarios, and drawn ones up to N in all; where a map draws none, its fixed ones with "
    "starts that are turned.",
)
@options.seed_option
@options.noise_option
@click.option(
    "--time-limit",
    type=options.QuantityType("s"),
    help="Simulated time after which an episode has taken too long; by default the task's 300 control intervals.",
)
@recording_options
@options.clearance_option
@options.interval_option
@options.footprint_option
@options.robot_option
@options.prefer_option
@click.option(
    "--budget-seconds",
    type=options.QuantityType("s"),
    default=60.0,
    show_default="60",
    help="Begin no reading with several changes so long after the start; those with one are always tried.",
)
@click.option(
    "--workers",
    type=WorkersType(),
    default=1,
    show_default=True,
    help="Processes that share the readings; auto takes one for each core. The result is the same.",
)
@click.option(
    "--write-spec",
    type=options.WRITABLE,
    metavar="FILE",
    help="Write the specification of the best reading (YAML), for --spec.",
)
@click.option(
    "--output",
    "-o",
    multiple=True,
    metavar="FORMAT:PATH",
    help="Write a report: json, figure (png, svg, pdf), html (a page that opens offline), csv (a row for each "
    "reading), markdown or github; PATH - is stdout, and png:PATH is figure:PATH. Repeatable.",
)
@options.threads_option
@options.quiet_option
def command(**given: Any) -> None:
    """Tell whether the specification of POLICY (ONNX) is right.

    The policy is driven as specified, and as other readings of its numbers would have it: rays in another order or from
    another start or over another angle, bearings mirrored or in degrees, normalisers that are missing, actions swapped,
    flipped or scaled. A
    reading that is clearly better is named with the keys to change. With a recording, the commands in it are compared
    with the policy's under each reading instead.
    """
    from viatool.report.diagnoses.run import DiagnosisRun

    outputs = read_outputs(map(_named, given["output"]), DiagnosisRun)
    if given["write_spec"] is not None:
        from viatool.report.files import check_writable

        check_writable(given["write_spec"])
    diagnosis = _diagnose(given)
    document = DiagnosisRun(diagnosis)
    if diagnosis.verdict != "specified":
        options.warn(f"{document.finding}\nhint: {document.advice}")
    if given["write_spec"] is not None:
        from viatool.report.files import write_whole

        write_whole(given["write_spec"], [diagnosis.ranking.best.interpretation.spec.to_yaml().encode()])
    tell(document, outputs, (), quiet=given["quiet"])


def _named(text: str) -> str:
    """Return FORMAT:PATH; the suffix of a picture is a name of its format, too."""
    name, colon, path = text.partition(":")
    return f"figure{colon}{path}" if name in ("png", "svg", "pdf") else text


def _diagnose(given: Mapping[str, Any]) -> Diagnosis:
    from viatool.doctor import diagnose, scenarios_of
    from viatool.policy import load_policy
    from viatool.schedule import Deadline
    from viatool.setting.wishes import Wishes

    until = Deadline.after(given["budget_seconds"])
    bag = bag_settings(given)
    policy = load_policy(given["policy"], given["spec_path"])
    world_map = options.open_map(given["map_path"], given["unknown"])
    recorded = given["trajectory"] is not None
    wishes = Wishes(
        **{name: given[name] for name in ("clearance", "interval", "footprint", "robot", "prefer")}
    )
    with show_progress(quiet=given["quiet"]) as progress:
        return diagnose(
            policy,
            world_map,
            () if recorded else scenarios_of(world_map, given["scenarios"], given["seed"]),
            bag=bag,
            wishes=wishes,
            until=until,
            progress=progress,
            **{name: given[name] for name in ("trajectory", "noise", "time_limit", "seed", "workers")},
        )
