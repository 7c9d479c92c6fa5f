"""Calls of the compiled engine for what LiDARs read over boxes of poses; numpy is its reference.

The layout is that of engine/scan.h; why roundings are covered is derived in docs/kernel.md.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Booleans
from viatool.engine import chosen_engine
from viatool.engine.calls import call, floats
from viatool.sets.forms import Forms, PoseBoxes
from viatool.sight.shapes import Shapes
from viatool.sight.windows import Gaps, Windows
from viatool.world import Lidar


class Leeway(ctypes.Structure):
    """Factors of what forms leave out, all 1; a test shows that each is needed."""

    _fields_ = tuple(
        (name, ctypes.c_double)
        for name in (
            "turning", "sideways", "tangent", "chord", "curvature", "mixed", "bearings", "apart",
        )
    )  # fmt: skip


_NUMBERS = ("circles", "edges", "rays", "bins", "each")
_ARRAYS = (
    "centre", "radius", "first", "second", "circle_passed", "edge_passed", "bearing", "order", "direction",
)  # fmt: skip


class PackedFan(ctypes.Structure):
    """What is around, and the rays of a LiDAR, as the compiled engine reads them; it keeps alive what it points to."""

    _fields_ = (
        *((name, ctypes.c_int64) for name in _NUMBERS),
        *((name, ctypes.c_void_p) for name in _ARRAYS),
        ("minimum", ctypes.c_double),
        ("maximum", ctypes.c_double),
        ("leeway", ctypes.POINTER(Leeway)),
    )

    @classmethod
    def of(cls, shapes: Shapes, lidar: Lidar, leeway: Leeway | None = None) -> PackedFan:
        """Pack them."""
        bearing, order = lidar.around
        circle_passed, edge_passed = shapes.passed
        points = (shapes.centres, shapes.radii, shapes.first, shapes.second)
        complexes = [
            np.ascontiguousarray(part, complex if np.iscomplexobj(part) else float) for part in points
        ]
        kept: Sequence[NDArray[Any]] = [
            *complexes,
            *(np.ascontiguousarray(part, np.uint8) for part in (circle_passed, edge_passed)),
            np.ascontiguousarray(bearing, float),
            np.ascontiguousarray(order, np.int64),
            np.ascontiguousarray(lidar.directions().T, float),
        ]
        sizes = len(shapes.radii), len(shapes.first), lidar.rays, lidar.bins, lidar.each
        limits = lidar.minimum_range, lidar.maximum_range
        whole = Leeway(*(1.0 for _ in Leeway._fields_))
        fan = cls(*sizes, *(part.ctypes.data for part in kept), *limits, ctypes.pointer(leeway or whole))
        fan.kept = kept
        return fan


def fan_of(shapes: Shapes, lidar: Lidar) -> PackedFan | None:
    """Return what the compiled engine is given; None where numpy does it."""
    return _packed_once(shapes, lidar) if chosen_engine() == "compiled" else None


@lru_cache(maxsize=32)
def _packed_once(shapes: Shapes, lidar: Lidar) -> PackedFan | None:
    """Pack them once; what is nowhere is left to numpy, whose bounds are then NaN, as C's comparisons pass it by."""
    fan = PackedFan.of(shapes, lidar)
    return fan if all(np.isfinite(part).all() for part in fan.kept) else None


def scan(fan: PackedFan, boxes: PoseBoxes, slack: float, windows: Windows | None) -> tuple[Forms, Booleans]:
    """Enclose bins over C boxes, (C, bins), and tell of which boxes that is done, (C,).

    Parameters
    ----------
    fan : PackedFan
        Of a LiDAR whose bins read the least of their rays, and what rays without a return read at its maximum range.
    boxes : PoseBoxes
        C boxes.
    slack : float
        What covers the rounding of ranges, in metres.
    windows : Windows, optional
        Which poses count.

    Notes
    -----
    **Sound:** yes, of boxes that are done, by the derivation of `viatool.sight.scan`.
    """
    count, bins = len(boxes), fan.bins
    forms = Forms(np.empty((count, bins)), np.empty((count, 3, bins)), np.empty((count, bins)))
    done = np.zeros(count, np.uint8)
    among = (None, None) if windows is None else (floats(windows.lower), floats(windows.upper))
    given = map(floats, (boxes.centre, boxes.radius))
    call("viatool_scan", fan, count, *given, slack, *among, forms.centre, forms.slope, forms.rest, done)
    return forms, done > 0


def gaps(fan: PackedFan, boxes: PoseBoxes, slack: float) -> tuple[Gaps, Booleans]:
    """Return the widest gaps of bins over C boxes, (C, bins), and tell of which boxes that is done, (C,)."""
    found, done = Gaps.none(len(boxes), fan.bins), np.zeros(len(boxes), np.uint8)
    given = map(floats, (boxes.centre, boxes.radius))
    call("viatool_gaps", fan, len(boxes), *given, slack, found.middle, found.width, done)
    return found, done > 0
