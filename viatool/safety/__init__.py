"""Safety: swept footprints against exact obstacles, and counterexamples."""

from __future__ import annotations

from viatool.safety.case import Case
from viatool.safety.judgement import Contested, Judgement, find_contested, judge, prove, sample, settle
from viatool.safety.situations import Situations
from viatool.safety.witness import Witnesses, search_witnesses

__all__ = [
    "Case",
    "Contested",
    "Judgement",
    "Situations",
    "Witnesses",
    "find_contested",
    "judge",
    "prove",
    "sample",
    "search_witnesses",
    "settle",
]
