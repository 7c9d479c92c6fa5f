"""``viatool explain``: why something is not safe, from a stored report."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from viatool.cli import options
from viatool.cli.command import Command
from viatool.cli.shapes import PoseType
from viatool.cli.terminal import open_console


@click.command(cls=Command)
@click.argument("report", type=options.READABLE)
@click.option(
    "--state", type=int, metavar="N", help="Of a report of verify or margin: the state of this number."
)
@click.option(
    "--close", type=int, metavar="N", help="Of a report of verify or margin: the close place of this number."
)
@click.option(
    "--place",
    type=PoseType(),
    help="Of a report of certify: the nearest to this place of its worst counterexamples; of its cells (npz) every "
    "cell that holds this place.",
)
@click.option("--scenario", metavar="NAME", help="Of a report of mission: the mission of this name.")
def command(report: Path, **given: Any) -> None:
    """Say why a state, place or mission of REPORT is not safe, in words and numbers.

    REPORT is one that verify, certify, mission or margin wrote, in JSON or as an archive of arrays; nothing else is
    read. Without an option everything that is not safe is listed, each in a line.
    """
    from viatool.report import load_shown, print_explanation, print_failing
    from viatool.report.document import Explained

    document = load_shown(report)
    if not isinstance(document, Explained):
        raise click.UsageError(
            f"{document.WHAT} does not say why: give one that verify, certify, mission or margin wrote"
        )
    named = {option: value for option, value in given.items() if value is not None}
    for option in named:
        if option not in document.ASKED:
            takes = " or ".join(f"--{one}" for one in document.ASKED)
            raise click.UsageError(f"--{option} is not for {document.WHAT}: it takes {takes}")
    if not named:
        print_failing(document, open_console())
    for option, value in named.items():
        print_explanation(document.explain(option, value), open_console())
