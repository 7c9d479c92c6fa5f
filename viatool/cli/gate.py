"""``viatool gate``: the gate on a stored report."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from viatool.cli import options
from viatool.cli.command import Command
from viatool.cli.gating import build_gate, contested_option, gate_options, leave_by_gate
from viatool.cli.terminal import open_console


@click.command(cls=Command)
@click.argument("report", type=options.READABLE)
@gate_options
@contested_option
@options.quiet_option
@click.pass_context
def command(ctx: click.Context, /, report: Path, quiet: bool, **given: Any) -> None:
    """Apply a gate to REPORT, a report in JSON that verify, certify, mission, margin or simulate wrote."""
    from viatool.report import evaluate, load_document, print_checks

    document = load_document(report)
    checks = evaluate(build_gate(given, type(document)), document)
    if not quiet:
        print_checks(checks, open_console())
    leave_by_gate(ctx, checks, quiet=quiet)
