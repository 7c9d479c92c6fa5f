"""What reports tell of margins in words and tables, of one policy or of several."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from viatool.report.margins.record import (
    ContestedStateRecord,
    DecidingRecord,
    PolicyMarginsRecord,
    VariedRecord,
)
from viatool.report.numbers import MISSING, count, counted, down, significant, up
from viatool.report.sections import Facts, Section, Table

QUANTILES = {
    "least": "weakest",
    "p10": "10 %",
    "p25": "25 %",
    "median": "median",
    "p75": "75 %",
    "p90": "90 %",
}
HEAD = ("state", "x [m]", "y [m]", "heading [rad]", "obstacle at [m]", "proved", "refuted", "decides")
_SHOWN = 10
"""Weakest states in a table for people."""
_ENTRIES = 8
"""Entries of an observation in a table for people."""


def margin_sections(varied: VariedRecord, parts: Mapping[str, PolicyMarginsRecord]) -> list[Section]:
    """Return which errors the contested states of each policy survive, the weakest of them, and what decides."""
    sections: list[Section] = [quantiles_table(varied, parts)]
    for name, part in parts.items():
        of = f" of {name}" if len(parts) > 1 else ""
        if part.tested:
            sections += [
                weakest_table(varied, part, f"Weakest states{of}"),
                deciding(part, f"What decides{of}"),
            ]
    return sections


def quantiles_table(varied: VariedRecord, parts: Mapping[str, PolicyMarginsRecord]) -> Table:
    """Return which errors are proved, and which refuted, of how many of the contested states."""
    rows = []
    for name, part in parts.items():
        proved = (certified(getattr(part.certified, q)) for q in QUANTILES)
        failing = (refuted(getattr(part.refuted, q), varied) for q in QUANTILES)
        rows += [(f"{name}, proved", *proved), (f"{name}, refuted", *failing)]
    title = "Largest error that is proved, smallest that is refuted"
    return Table(("of the contested states", *QUANTILES.values()), tuple(rows), title)


def weakest_table(varied: VariedRecord, part: PolicyMarginsRecord, title: str, most: int = _SHOWN) -> Table:
    """Return a row for each of the states that survive least; half of them survive something, if there are many."""
    states, remark = weakest_states(part, most)
    return Table(HEAD, tuple(weakest_row(state, varied) for state in states), title, remark, texts=1)


def weakest_states(part: PolicyMarginsRecord, most: int) -> tuple[list[ContestedStateRecord], str]:
    """Return the states that survive least, half of them something if there are many, and which part of all it is."""
    bare = [state for state in part.contested_states if state.certified is None]
    rest = part.contested_states[len(bare) :]
    told = min(len(bare), max(most // 2, most - len(rest)))
    states = [*bare[:told], *rest[: most - told]]
    remark = (
        f"{len(states)} of {counted(part.tested, 'contested state')}" if len(states) < part.tested else ""
    )
    if told < len(bare):
        remark += f", {told} of {count(len(bare))} that are not proved even at an error of 0"
    return states, remark


def weakest_row(state: ContestedStateRecord, varied: VariedRecord) -> tuple[str, ...]:
    """Return what the table tells of a state, as `HEAD` says."""
    x, y, heading = state.pose
    return (
        f"close {state.state}" if state.close else str(state.state),
        f"{x:.3f}",
        f"{y:.3f}",
        f"{heading:.3f}",
        f"{state.distance:.3f}",
        certified(state.certified),
        refuted(state.refuted, varied),
        decides(state.decides),
    )


def deciding(part: PolicyMarginsRecord, title: str) -> Facts:
    """Return the channels and the entries that decide, in the mean over the states."""
    channels = ", ".join(f"{name} {100.0 * share:.0f} %" for name, share in part.deciding.channels.items())
    entries = decides(part.deciding.entries, _ENTRIES)
    return Facts(title, (("channels", channels or MISSING), ("entries", entries)))


def decides(entries: Sequence[DecidingRecord], most: int = 2) -> str:
    """Write which entries decide, and how much each counts."""
    if not entries:
        return "none"
    return ", ".join(f"{one.entry} {100.0 * one.weight:.0f} %" for one in entries[:most])


def varied_in_words(varied: VariedRecord) -> str:
    """Write what varies, and how far."""
    unit = varied.unit or "in the unit of each"
    named = [
        name if share == 1.0 else f"{name} (times {significant(share)})"
        for name, share in varied.proportions.items()
    ]
    return f"{', '.join(named)} from 0 to {significant(varied.most, 6)} {unit}".rstrip()


def at_stake(part: PolicyMarginsRecord) -> str:
    """Write in how many states a policy was put to the test."""
    driven = f"{count(part.contested)} of {counted(part.states, 'state')}"
    return driven + (f" and {counted(part.close.contested, 'close place')}" if part.close.contested else "")


def survived(part: PolicyMarginsRecord) -> str:
    """Write what half of the contested states of a policy survive, and the weakest one."""
    if not part.tested:
        return "no verdict depended on it"
    bare = sum(state.certified is None for state in part.contested_states)
    least, median = part.certified.least, part.certified.median
    weakest = (
        f"{count(bare)} {'is' if bare == 1 else 'are'} not proved even at an error of 0"
        if least is None
        else f"all survive an error of {down(least)}"
    )
    return weakest if median is None else f"{weakest}, half survive {down(median)}"


def certified(error: float | None) -> str:
    """Write the largest error that is proved."""
    return "none" if error is None else down(error)


def refuted(error: float | None, varied: VariedRecord) -> str:
    """Write the smallest error that is refuted."""
    return f"> {significant(varied.most)}" if error is None else up(error)
