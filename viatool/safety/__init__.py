"""Safety: swept footprints against exact obstacles, counterexamples, and the rates that sum them up."""

from __future__ import annotations

from viatool.safety.case import Case
from viatool.safety.horizon import Crashes, Horizon, HorizonResult, Tubes
from viatool.safety.judgement import Contested, Judgement, find_contested, judge, prove, sample, settle
from viatool.safety.layout import ActionName, Layout
from viatool.safety.motion import Manoeuvre
from viatool.safety.rates import Rate, RateByOutcome
from viatool.safety.result import Result
from viatool.safety.rules import CRITERIA, Rules
from viatool.safety.situations import Situations
from viatool.safety.witness import Witnesses, search_witnesses
from viatool.safety.witness_file import (
    Replay,
    WitnessFile,
    compose_witnesses,
    load_witnesses,
    replay,
    witness_document,
    write_witnesses,
)

__all__ = [
    "CRITERIA",
    "ActionName",
    "Case",
    "Contested",
    "Crashes",
    "Horizon",
    "HorizonResult",
    "Judgement",
    "Layout",
    "Manoeuvre",
    "Rate",
    "RateByOutcome",
    "Replay",
    "Result",
    "Rules",
    "Situations",
    "Tubes",
    "WitnessFile",
    "Witnesses",
    "compose_witnesses",
    "find_contested",
    "judge",
    "load_witnesses",
    "prove",
    "replay",
    "sample",
    "search_witnesses",
    "settle",
    "witness_document",
    "write_witnesses",
]
