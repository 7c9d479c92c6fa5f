"""How much error a contested state survives, in words, and whether more would take a finer proof or another policy."""

from __future__ import annotations

from viatool.report.margins.record import ContestedStateRecord, MarginsRecord
from viatool.report.margins.tables import decides
from viatool.report.numbers import down, up

_ENTRIES = 5
"""Entries of the observation that are named."""
_MET = 2.0
"""Resolutions between what is proved and what is refuted, within which both ends have met."""


def explain_margin(called: str, state: ContestedStateRecord, record: MarginsRecord) -> str:
    """Return what is known of a state, in paragraphs; `called` is how it is named."""
    x, y, heading = state.pose
    where = (
        f"{called[0].upper()}{called[1:]}: scenario {state.scenario} at {state.time:.2f} s, x {x:.3f} m, y {y:.3f} m, "
        f"heading {heading:.3f} rad, {state.distance:.3f} m from something."
    )
    told = [_survives(state, record), _then(state, record)]
    if state.decides:
        told.append(f"What decides is {decides(state.decides, _ENTRIES)}")
    return "\n\n".join([where, " ".join(f"{sentence}." for sentence in told)])


def _survives(state: ContestedStateRecord, record: MarginsRecord) -> str:
    unit = f" {record.varied.unit}".rstrip()
    proved = (
        "It is not proved even at an error of 0"
        if state.certified is None
        else f"It is proved up to an error of {down(state.certified)}{unit}"
    )
    if state.refuted is None:
        return f"{proved}, and no counterexample was found up to {record.varied.most:g}{unit}"
    return f"{proved}, and a counterexample within {up(state.refuted)}{unit} was run"


def _then(state: ContestedStateRecord, record: MarginsRecord) -> str:
    """Return whether a finer proof may help, or only another policy."""
    most, resolution = record.varied.most, record.varied.resolution
    proved, failing = state.certified, state.refuted
    if failing == 0.0:
        return (
            "It fails without any error as well: no better sensor helps, the policy has to act otherwise here"
        )
    if proved == most:
        return "That is all that was tried: --most tries more"
    if proved is None:
        return "Nothing was found that fails without an error, so that tighter bounds may prove it: try --refine split"
    if failing is not None and failing - proved <= _MET * resolution:
        return (
            "Both ends have met, as finely as was asked: a finer proof cannot help, only a policy that acts otherwise "
            "or a sensor that errs less"
        )
    return (
        "Between the two nothing is known: tighter bounds (--refine split, --order 2) may raise what is proved, and "
        "the policy need not be at fault"
    )
