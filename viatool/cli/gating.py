"""The options of the gate, shared by every command that has one."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

import click

from viatool.cli.failures import GATE_FAILED
from viatool.cli.options import READABLE

if TYPE_CHECKING:
    from viatool.report import Check, Document, Gate

Command = TypeVar("Command", bound=Callable[..., Any])


def gate_options(command: Command) -> Command:
    """Add the conditions of the gate."""
    for option in reversed(
        (
            click.option(
                "--fail-under",
                multiple=True,
                metavar="[NAME=]RATE",
                help="Exit 1 if the overall rate, or a rate such as danger=0.95, is below RATE; of margins, if a "
                "contested state does not survive margin=ERROR. Repeatable.",
            ),
            click.option(
                "--max-unsafe",
                type=click.IntRange(min=0),
                metavar="N",
                help="Exit 1 if more than N driven states are unsafe (missions or cells refuted, episodes in collision)"
                "; of close places --fail-under close=RATE decides.",
            ),
            click.option(
                "--max-unknown",
                type=click.IntRange(min=0),
                metavar="N",
                help="Exit 1 if more than N driven states, missions or cells are unknown.",
            ),
            click.option(
                "--baseline",
                type=READABLE,
                metavar="FILE",
                help="Exit 1 if a rate is below that of this older report (json), or a state is unsafe that was not.",
            ),
            click.option(
                "--accepted",
                type=READABLE,
                metavar="FILE",
                help="Accepted findings (TOML), which the gate does not count until they expire; see docs/project.md.",
            ),
            click.option("--exit-zero", is_flag=True, help="Report a failed gate, but exit 0."),
        )
    ):
        command = option(command)
    return command


def contested_option(command: Command) -> Command:
    """Add the condition that enough verdicts depend on the policy."""
    return click.option(
        "--min-contested",
        type=click.IntRange(min=0),
        metavar="N",
        help="Exit 5, as nothing was evaluated, if the verdict of fewer than N driven states depends on the policy.",
    )(command)


def stop_early_option(command: Command) -> Command:
    """Add the wish to stop once the gate cannot end in another way."""
    return click.option(
        "--stop-early",
        is_flag=True,
        help="Stop once no later verdict can change whether the gate passes: the same exit code, sooner. The report "
        "says how much was not judged, and is of the rest.",
    )(command)


def leave_by_gate(ctx: click.Context, checks: Sequence[Check], *, quiet: bool) -> None:
    """End a command by the decided conditions of its gate; one that is quiet says in a line what does not hold.

    Raises
    ------
    ConfigurationError
        If something is accepted that was not found, whatever ``--exit-zero`` says.
    EmptyEvaluationError
        If a condition had nothing to decide on, whatever ``--exit-zero`` says.
    click.exceptions.Exit
        If a condition failed.
    """
    from viatool.errors import ConfigurationError, EmptyEvaluationError
    from viatool.report import Ruling

    match Ruling(checks).outcome:
        case "unfounded":
            check = next(check for check in checks if check.unfounded)
            raise ConfigurationError(f"{check.condition}: {check.figures}", check.hint)
        case "empty":
            check = next(check for check in checks if check.empty)
            raise EmptyEvaluationError(f"{check.condition}: {check.figures}", check.hint)
        case outcome:
            broken = [check for check in checks if not check.passed]
            if quiet and broken:
                click.echo(_in_a_line(broken), err=True)
            if outcome == "failed":
                ctx.exit(GATE_FAILED)


def _in_a_line(broken: Sequence[Check]) -> str:
    from viatool.report.foreign import shown
    from viatool.report.numbers import counted

    first = f"{broken[0].word}: {broken[0].condition}: {broken[0].figures}"
    others = f" (and {counted(len(broken) - 1, 'other condition')})" if len(broken) > 1 else ""
    return shown(f"gate {first}{others}")


def build_gate(given: Mapping[str, Any], kind: type[Document]) -> Gate:
    """Read the conditions of the gate on a kind of document from the options of a command."""
    from viatool.report import Gate, load_accepted, load_document, parse_threshold

    baseline, accepted = given["baseline"], given["accepted"]
    return Gate(
        thresholds=tuple(parse_threshold(text, kind) for text in given["fail_under"]),
        max_unsafe=given.get("max_unsafe"),
        max_unknown=given.get("max_unknown"),
        baseline=None if baseline is None else load_document(baseline),
        min_contested=given.get("min_contested"),
        accepted=() if accepted is None else load_accepted(accepted),
        exit_zero=given["exit_zero"],
    )
