"""The options of a command by what they are about, as its help shows them."""

from __future__ import annotations

from collections.abc import Sequence

import click

FEW = 12
"""Options that need no sections."""

SECTIONS = {
    "What is looked at": (
        "--policy", "--vecnormalize", "--spec", "--map", "--unknown", "--origin", "--scan", "--scan-yaw", "--nav2",
        "--environment", "--observation", "--command", "--scenario", "--scenarios", "--episodes", "--start",
        "--start-error", "--goal", "--goal-radius", "--time-limit", "--trajectory", "--poses", "--close",
        "--scan-topic", "--odom-topic", "--cmd-topic", "--frame", "--seed",
    ),
    "What may err": (
        "--eps", "--errors", "--pose-error", "--explain-errors", "--margins", "--noise", "--adversary", "--channel",
        "--term", "--most", "--resolution",
    ),
    "What has to hold": (
        "--criterion", "--horizon", "--steps", "--forever", "--arrive", "--clearance", "--danger",
    ),
    "The robot": (
        "--robot", "--footprint", "--interval", "--delay", "--deceleration", "--prefer",
    ),
    "How hard it is tried": (
        "--order", "--approximation", "--refine", "--arithmetic", "--only-contested", "--widths", "--smallest",
        "--halvings", "--lookahead", "--coarser", "--parts", "--cell", "--finer", "--sample", "--budget-seconds",
        "--budget-cells",
    ),
    "Reports": ("--output", "--quiet", "--verbose"),
    "The gate": (
        "--fail-under", "--max-unsafe", "--max-unknown", "--min-contested", "--baseline", "--accepted", "--exit-zero",
        "--stop-early",
    ),
    "The work": ("--workers", "--scheduler", "--checkpoint", "--resume", "--threads"),
}  # fmt: skip


def write_options(
    options: Sequence[click.Parameter], ctx: click.Context, formatter: click.HelpFormatter
) -> None:
    """Write options in sections if there are many; those that belong to no section come last, as other options."""
    records = (
        (option, option.get_help_record(ctx)) for option in options if isinstance(option, click.Option)
    )
    shown = {option: record for option, record in records if record is not None}
    left = dict(shown)
    if len(shown) > FEW:
        for title, names in SECTIONS.items():
            some = [option for option in shown if set(option.opts) & set(names)]
            _write(title, [left.pop(option) for option in some], formatter)
    _write("Options" if len(left) == len(shown) else "Other options", list(left.values()), formatter)


def _write(title: str, lines: Sequence[tuple[str, str]], formatter: click.HelpFormatter) -> None:
    if lines:
        with formatter.section(title):
            formatter.write_dl(lines)
