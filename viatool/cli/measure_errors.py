"""``viatool measure-errors``: from a recording to an error model."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import click

from viatool.cli import options
from viatool.cli.command import Command
from viatool.cli.states import topic_options
from viatool.cli.terminal import open_console

if TYPE_CHECKING:
    from viatool.identification import Identification
    from viatool.policy import PolicySpecification


@click.command("measure-errors", cls=Command)
@click.argument("recording", type=options.READABLE)
@options.map_option
@options.unknown_option
@click.option(
    "--policy",
    type=options.POLICY,
    metavar="FILE",
    help="The policy that the error model is for (ONNX); its specification names the channel of the LiDAR.",
)
@options.spec_option
@topic_options
@click.option(
    "--quantile",
    type=click.FloatRange(0.5, 1.0, min_open=True),
    default=0.999,
    show_default=True,
    help="Share of the samples that a bound holds.",
)
@click.option(
    "--margin",
    type=click.FloatRange(0.0),
    default=0.1,
    show_default=True,
    help="Share of a bound that is added to it; of its width, where it has two ends.",
)
@click.option(
    "--output",
    "-o",
    type=options.WRITABLE,
    metavar="FILE",
    help="The error model to write (YAML), for --errors.",
)
@options.threads_option
@options.quiet_option
def command(**given: Any) -> None:
    """Measure the errors of a robot from RECORDING, a ROS 1 or 2 bag.

    Readings of the LiDAR are compared with the map, velocities with the commands before them, and stamps with each
    other. What is written is an error model with bounds that hold a quantile of the samples; it says how many samples
    each term has, and which terms a recording does not tell.
    """
    from viatool.report.files import check_writable, write_whole

    if given["output"] is not None:
        check_writable(given["output"])
    found = _measure(given)
    if given["output"] is not None:
        write_whole(given["output"], [found.to_yaml().encode()])
    if not given["quiet"]:
        print_findings(found)


def _measure(given: Mapping[str, Any]) -> Identification:
    from viatool.identification import Bounding, measure_errors
    from viatool.trajectory import BagSettings, Topics

    topics = Topics(given["scan_topic"], given["odom_topic"], given["cmd_topic"])
    return measure_errors(
        given["recording"],
        options.open_map(given["map_path"], given["unknown"]),
        spec=_specification(given),
        bag=BagSettings(topics=topics, frame=given["frame"]),
        bounding=Bounding(given["quantile"], given["margin"]),
    )


def _specification(given: Mapping[str, Any]) -> PolicySpecification | None:
    """Return the specification that names the LiDAR's channel, if one was given."""
    from viatool.policy import load_policy, load_specification

    if given["policy"] is not None:
        return load_policy(given["policy"], given["spec_path"]).spec
    return None if given["spec_path"] is None else load_specification(given["spec_path"])


def print_findings(found: Identification) -> None:
    """Print the terms that were measured, and those that were not."""
    from rich.table import Table
    from rich.text import Text

    console = open_console()
    table = Table(title=f"Measured from {found.recording}: {found.bounding.words}", title_justify="left")
    for heading in ("term", "value", "samples"):
        table.add_column(heading, no_wrap=heading != "samples")
    for term in found.measured:
        table.add_row(term.place, term.number, Text(term.words))
    console.print(table)
    for note in found.notes:
        console.print(Text(f"note: {note}"))
    for one in found.unmeasured:
        console.print(Text(f"not measured: {one.place}: {one.reason}"))
