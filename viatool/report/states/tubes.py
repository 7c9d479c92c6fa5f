"""Trajectory tubes on a map: the places where the closed loop may be within the horizon, by verdict."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from viatool.arrays import Booleans, Floats
from viatool.report.drawing import draw_region
from viatool.report.palette import COLOUR, VERDICTS

if TYPE_CHECKING:
    from viatool.verification.result import Result


ALPHA = 0.55


def draw_tubes(axes: Axes, result: Result, states: Booleans) -> None:
    """Fill what the tubes of some states (N,) cover, those of unsafe and unknown states on top."""
    import shapely

    if result.horizon is None:
        return
    for level, verdict in enumerate(VERDICTS):
        rows = np.flatnonzero(states & (result.horizon.verdict == verdict))
        tubes = result.horizon.tubes
        regions = tube_regions(result.poses[rows], tubes.lower[rows], tubes.upper[rows])
        if len(regions):
            region = shapely.union_all(regions)
            colour = COLOUR[verdict]
            draw_region(
                axes, region, facecolor=colour, edgecolor=colour, alpha=ALPHA, zorder=3.0 + 0.1 * level
            )


def tube_regions(poses: Floats, lower: Floats, upper: Floats) -> NDArray[np.object_]:
    """Return for each interval of tubes the hull of where it begins and where it ends, as shapely polygons.

    Parameters
    ----------
    poses : ndarray
        (R, 3) recorded poses.
    lower, upper : ndarray
        (R, K, 3) their tubes.

    Returns
    -------
    ndarray
        (P,) polygons; intervals without runs have none.

    Notes
    -----
    Sound: no, for drawing: within an interval a run may leave the hull by the sagitta of its arc.
    """
    import shapely

    start = np.repeat(poses[:, None, None, :2], 2, axis=1)  # (R, 2, 1, 2): lower and upper
    ends = np.stack([lower, upper], axis=1)[..., :2]  # (R, 2, K, 2)
    boxes = np.concatenate([start, ends], axis=2)
    low, high = boxes[:, 0], boxes[:, 1]  # (R, K + 1, 2)
    corners = np.stack(
        [low, high, np.stack([low[..., 0], high[..., 1]], -1), np.stack([high[..., 0], low[..., 1]], -1)], 2
    )
    both = np.concatenate([corners[:, :-1], corners[:, 1:]], axis=2)  # (R, K, 8, 2)
    there = np.isfinite(both).all(axis=(2, 3))
    return np.asarray(shapely.convex_hull(shapely.multipoints(both[there])), dtype=object)
