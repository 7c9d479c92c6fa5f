"""Calls of the compiled engine for how near a disc comes to what stands around it; numpy is its reference.

The layout is that of engine/clear.h; why roundings are covered is derived in docs/kernel.md.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Booleans, Floats, Indices
from viatool.engine import chosen_engine
from viatool.engine.calls import call, floats, integers
from viatool.motion.manoeuvre import Manoeuvre
from viatool.motion.profile import VaryingMotion
from viatool.motion.twists import PARTS, HeldTwist
from viatool.rounding import DISTANCE_ROUNDING
from viatool.safety.scene_poses import ScenePoses
from viatool.world import Footprint

if TYPE_CHECKING:
    from viatool.safety.proof import ProofEffort


class Deviations(ctypes.Structure):
    """Factors of what keeps a path from where its centre leads, all 1; a test shows that each is needed."""

    _fields_ = tuple(
        (name, ctypes.c_double)
        for name in ("speeds", "turns", "sideways", "sagitta", "places", "headings", "way")
    )


WHOLE = Deviations(*(1.0 for _ in Deviations._fields_))


class Around(ctypes.Structure):
    """What stands around, as the compiled engine reads it."""

    _fields_ = (
        *((name, ctypes.c_int64) for name in ("circles", "edges", "walls", "convex")),
        *((name, ctypes.c_void_p) for name in ("circle", "edge", "wall", "normal")),
    )


class PackedQuestion(ctypes.Structure):
    """What is asked of a robot among what stands, as the compiled engine reads it; it keeps alive what it points to."""

    _fields_ = (
        ("around", Around),
        *((name, ctypes.c_int64) for name in ("axes", "ahead", "left", "turn", "levels", "cells")),
        *(
            (name, ctypes.c_double)
            for name in (
                "tolerance", "threshold", "radius", "scale", "interval", "deceleration", "rim", "rounding",
            )
        ),
        ("deviations", ctypes.POINTER(Deviations)),
    )  # fmt: skip
    kept: Sequence[NDArray[np.float64]]


def question_of(
    placed: ScenePoses,
    manoeuvre: Manoeuvre | VaryingMotion,
    footprint: Footprint,
    threshold: float = 0.0,
    effort: ProofEffort | None = None,
) -> PackedQuestion | None:
    """Return what the compiled engine is asked; None where numpy does it.

    It covers discs and points that hold a twist, among circles, edges and walls that stand. An obstacle that is no
    number, or a distance below 0, is left to numpy.
    """
    if chosen_engine() != "compiled" or not isinstance(manoeuvre, Manoeuvre) or footprint.kind == "polygon":
        return None
    move, found = manoeuvre.kinematics, placed.still.flat
    if not isinstance(move, HeldTwist) or placed.movers or found is None or not threshold >= 0.0:
        return None
    kept = [
        np.ascontiguousarray(part, np.float64)
        for part in (found.circles, found.edges, found.walls, found.normals)
    ]
    if not all(np.isfinite(part).all() for part in kept):
        return None
    sizes = found.circles.shape[1], found.edges.shape[1], len(found.walls), int(found.convex)
    places = [move.velocity.index(part) if part in move.velocity else -1 for part in PARTS]
    limits = (0, 0, 0.0) if effort is None else (effort.levels, effort.cells, effort.tolerance)
    question = PackedQuestion(
        Around(*sizes, *(part.ctypes.data for part in kept)), len(move.axes), *places, *limits, threshold,
        footprint.radius, placed.scale, manoeuvre.interval, manoeuvre.deceleration or 0.0, manoeuvre.rim,
        DISTANCE_ROUNDING, ctypes.pointer(WHOLE),
    )  # fmt: skip
    question.kept = kept
    return question


def decide(
    question: PackedQuestion, placed: ScenePoses, lower: Floats, upper: Floats
) -> tuple[Booleans, Booleans]:
    """Tell of B states what is proved, and what is refuted, (B,) each, as `prove_clearance`.

    Notes
    -----
    **Sound:** yes, by the derivation of `viatool.safety.enclosure`. Of what is not a number nothing is told.
    """
    proved, refuted = np.zeros((2, len(lower)), np.uint8)
    radii = None if placed.radii is None else floats(placed.radii)
    given = floats(placed.poses), radii, integers(placed.scene), floats(lower), floats(upper)
    call("viatool_clear", question, len(lower), *given, proved, refuted)
    return proved > 0, refuted > 0


def nearest(
    question: PackedQuestion, placed: ScenePoses, actions: Floats, steps: int
) -> tuple[Floats, Indices]:
    """Return the least clearance after equal steps of the paths of commands (B, K, A), and after how many, (B, K).

    What is not a number has come as near as can be; nothing is proved by it.
    """
    found, step = np.zeros(actions.shape[:2]), np.zeros(actions.shape[:2], np.int64)
    given = floats(placed.poses), integers(placed.scene), floats(actions)
    call("viatool_nearest", question, *actions.shape[:2], *given, steps, found, step)
    return found, step
