"""What became of counterexamples that were run again, for the console."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from viatool.report.foreign import shown
from viatool.report.numbers import count
from viatool.report.palette import COLOUR

if TYPE_CHECKING:
    from viatool.verification.witness_file import Replay, WitnessFile


def state_of(entry: Mapping[str, Any], row: int) -> str:
    """Return which state a counterexample is of, close places told apart."""
    return f"{'close ' if entry.get('close') else ''}{entry.get('state', row)}"


def print_replay(file: WitnessFile, found: Replay, console: Console) -> None:
    """Print one line for each counterexample, and how many still violate."""
    limit = file.rules.clearance.collision
    table = Table(box=box.SIMPLE_HEAD, show_edge=False)
    commands = [f"{axis.name} [{axis.unit}]" for axis in file.rules.kinematics.axes]
    for name in ("state", "violates", "clearance [m]", "after [s]", *commands):
        table.add_column(name, justify="right")
    table.add_column("nearest obstacle")
    for row, entry in enumerate(file.entries):
        violates, where = bool(found.violates[row]), shown(found.nearest[row])
        table.add_row(
            shown(state_of(entry, row)),
            Text("yes" if violates else "NO", style=COLOUR["unsafe" if violates else "safe"]),
            f"{found.clearance[row]:.6f}",
            f"{found.seconds[row]:.3f}",
            *(f"{value:.6f}" for value in found.actions[row]),
            Text(f"does not arrive; {where}" if row in file.late else where),
        )
    if len(file):
        console.print(table)
    still = int(found.violates.sum())
    fails = f"violate the clearance of {limit:g} m (criterion {file.rules.criterion})"
    if file.late:
        fails = (
            "are still on their way" if len(file.late) == len(file) else f"{fails} or are still on their way"
        )
    console.print(
        f"{count(still)} of {count(len(file))} witnesses {fails} when they are run again through onnxruntime"
    )
