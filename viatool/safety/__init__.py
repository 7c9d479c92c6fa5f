"""Safety: swept footprints against exact obstacles, counterexamples, and the rates that sum them up."""

from __future__ import annotations

from viatool.safety.case import Case
from viatool.safety.judgement import Contested, Judgement, find_contested, judge, prove, sample, settle
from viatool.safety.motion import Manoeuvre, advance
from viatool.safety.rates import Rate, RateByOutcome
from viatool.safety.result import ActionName, Result
from viatool.safety.rules import CRITERIA, Rules
from viatool.safety.situations import Situations
from viatool.safety.witness import Witnesses, search_witnesses

__all__ = [
    "CRITERIA",
    "ActionName",
    "Case",
    "Contested",
    "Judgement",
    "Manoeuvre",
    "Rate",
    "RateByOutcome",
    "Result",
    "Rules",
    "Situations",
    "Witnesses",
    "advance",
    "find_contested",
    "judge",
    "prove",
    "sample",
    "search_witnesses",
    "settle",
]
