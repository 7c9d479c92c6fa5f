"""Safety: swept footprints against exact obstacles, and counterexamples."""

from __future__ import annotations

from viatool.safety.counterexamples import Witnesses
from viatool.safety.judged_states import JudgedStates
from viatool.safety.judgement import Contested, Judgement, find_contested, judge, prove, sample, settle
from viatool.safety.scene_poses import ScenePoses
from viatool.safety.witness import search_witnesses

__all__ = [
    "Contested",
    "JudgedStates",
    "Judgement",
    "ScenePoses",
    "Witnesses",
    "find_contested",
    "judge",
    "prove",
    "sample",
    "search_witnesses",
    "settle",
]
