"""``viatool verify``: the main job, its reports and the gate."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from viatool.cli import options
from viatool.cli.failures import GATE_FAILED
from viatool.cli.gating import build_gate, gate_options
from viatool.cli.terminal import open_console, show_progress


@click.command()
@options.policy_argument
@options.map_option
@options.eps_option
@options.spec_option
@click.option(
    "--criterion",
    type=click.Choice(["swept", "sampled", "braking"]),
    default="swept",
    show_default=True,
    help="What a state has to fulfil to be safe.",
)
@click.option(
    "--trajectory",
    type=options.READABLE,
    metavar="FILE",
    help="Recorded states (npz or csv) instead of simulated ones.",
)
@options.scenarios_option
@options.seed_option
@options.noise_option
@options.bounds_options
@options.clearance_options
@click.option(
    "--output",
    "-o",
    multiple=True,
    metavar="FORMAT:PATH",
    help="Write a report: json, states (npz) or figure (png, svg, pdf). Repeatable.",
)
@gate_options
@options.threads_option
@options.quiet_option
@click.pass_context
def command(ctx: click.Context, /, **given: Any) -> None:
    """Verify POLICY (ONNX) on a map with bounded sensor error.

    Every visited state becomes safe (proved), unsafe (with a replayable counterexample) or unknown. Without a
    gate option the command passes whatever the rates are.
    """
    from viatool.report import check_outputs, evaluate, parse_output, print_report, read_result, write_outputs

    outputs = tuple(parse_output(text) for text in given["output"])
    check_outputs(outputs)
    gate = build_gate(given)
    with show_progress(quiet=given["quiet"]) as progress:
        result = _verify(given, progress)
    write_outputs(result, outputs)
    document = read_result(result)
    checks = evaluate(gate, document)
    if not given["quiet"]:
        print_report(document, open_console(), checks)
    if not all(check.passed for check in checks) and not given["exit_zero"]:
        ctx.exit(GATE_FAILED)


def _verify(given: dict[str, Any], progress: Any) -> Any:
    raise NotImplementedError(Path)
