"""When commands come: the time between two of them, and how old the scan is that each was computed from."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from viatool.arrays import Indices
from viatool.identification.findings import Bounding, Finding, MeasuredTerm, UnmeasuredTerm, spread_of
from viatool.trajectory.bag import RecordedCommands

_PAUSE = 5.0
"""Times the usual interval from which on the policy paused."""
_LEAST = 20


def interval_findings(commands: RecordedCommands, bounding: Bounding) -> Iterator[Finding]:
    """Yield what the stamps of commands tell of the interval between them."""
    apart = np.diff(commands.stamps) * 1e-9
    if len(apart) < _LEAST or not np.median(apart) > 0.0:
        yield UnmeasuredTerm(
            "timing.interval", f"only {len(apart):,} intervals between commands, or all of 0 s"
        )
        return
    going = apart[apart <= _PAUSE * np.median(apart)]
    low, high = bounding.span(going, least=float(going.min()) / (1.0 + bounding.margin))
    told = f"{spread_of(going, 's')}; {len(apart) - len(going):,} pauses left out"
    if commands.received:
        told += "; by the recorder's clock"
    yield MeasuredTerm("timing.interval", (low, high), len(going), told)


def sensing_findings(
    commands: RecordedCommands, measured: Indices, received: Indices, bounding: Bounding
) -> Iterator[Finding]:
    """Yield how old the newest scan was when commands came; scans were measured and received at (S,) ns."""
    clock = received if commands.received else measured
    last = np.searchsorted(clock, commands.stamps, side="right") - 1
    some = last >= 0
    ages = np.asarray((commands.stamps[some] - measured[last[some]]) * 1e-9, dtype=np.float64)
    usual = (
        ages[ages <= _PAUSE * max(float(np.median(np.diff(measured))) * 1e-9, 1e-3)] if some.any() else ages
    )
    if len(usual) < _LEAST:
        yield UnmeasuredTerm("timing.sensing", f"only {len(usual):,} commands follow a scan")
    elif usual.min() < 0.0:
        yield UnmeasuredTerm(
            "timing.sensing",
            f"scans are stamped up to {-usual.min():.3g} s after the commands that follow them: clocks differ",
        )
    else:
        told = f"{spread_of(usual, 's')}, from the stamp of the newest scan to the command"
        yield MeasuredTerm("timing.sensing", bounding.largest(usual), len(usual), told)
