"""What a LiDAR reads from many poses that are near to each other: the school formulas, of the rays that meet anything.

Every shape is met by the rays between its ends alone, as seen from any of the poses, which are a few of a scan. Shares
no code with the world's casting or what encloses readings; tests/sight/test_bunch_oracle.py compares it with
`ray_oracle`, which casts every ray against every shape.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from viatool.world import Lidar

Floats = np.ndarray
_TURN = 2.0 * np.pi


def scan_bunch(poses: Floats, lidar: Lidar, shapes: tuple[Floats, Floats], most: int = 256) -> Floats:
    """What a perfect LiDAR reports from poses (B, 3), (B, bins), by `outlines` of what is solid."""
    found = [_ranges(poses[first : first + most], lidar, shapes) for first in range(0, len(poses), most)]
    least = np.concatenate(found).reshape(len(poses), lidar.bins, -1).min(axis=2)
    return np.clip(least, lidar.minimum_range, lidar.maximum_range)


def _ranges(poses: Floats, lidar: Lidar, shapes: tuple[Floats, Floats]) -> Floats:
    """How far rays get from poses (B, 3), (B, rays)."""
    circles, segments = shapes
    angles = lidar.angles()
    x, y, theta = poses[:, 0, None], poses[:, 1, None], poses[:, 2, None]
    cosine = np.cos(theta) * np.cos(angles) - np.sin(theta) * np.sin(angles)
    sine = np.sin(theta) * np.cos(angles) + np.cos(theta) * np.sin(angles)
    nearest = np.full(cosine.shape, lidar.maximum_range)
    for cx, cy, radius in circles:
        dx, dy = cx - x, cy - y
        away = np.hypot(dx, dy)
        if away.min() - radius > lidar.maximum_range:
            continue
        half = np.where(away > radius, np.arcsin(np.minimum(radius / away, 1.0)), np.pi)
        seen = np.arctan2(dy, dx) - theta
        for some in _between(angles, _near(seen, seen[0]), half):
            along = dx * cosine[:, some] + dy * sine[:, some]
            rest = along * along - (away * away - radius * radius)
            met = np.where(
                (rest >= 0.0) & (along > 0.0), along - np.sqrt(np.maximum(rest, 0.0)), lidar.maximum_range
            )
            np.minimum(nearest[:, some], met, out=nearest[:, some])
    for x1, y1, x2, y2 in segments:
        ex, ey, px, py = x2 - x1, y2 - y1, x1 - x, y1 - y
        begin = _near(np.arctan2(py, px) - theta, (np.arctan2(py, px) - theta)[0])
        end = _near(np.arctan2(y2 - y, x2 - x) - theta, begin)
        for some in _between(angles, 0.5 * (begin + end), 0.5 * np.abs(end - begin)):
            across = cosine[:, some] * ey - sine[:, some] * ex
            with np.errstate(divide="ignore", invalid="ignore"):
                far = (px * ey - py * ex) / across
                share = (px * sine[:, some] - py * cosine[:, some]) / across
            met = (far >= 0.0) & (share >= 0.0) & (share <= 1.0)
            np.minimum(nearest[:, some], np.where(met, far, lidar.maximum_range), out=nearest[:, some])
    return nearest


def _near(angle: Floats, other: Floats) -> Floats:
    """Return angles less whole turns, so that they are at most half a turn from others."""
    return other + (angle - other + np.pi) % _TURN - np.pi


def _between(angles: Floats, middle: Floats, half: Floats) -> Iterator[slice]:
    """Yield which of the ascending angles are within `half` of the middle for any pose, whole turns aside."""
    low, high = (middle - half).min() - 1e-9, (middle + half).max() + 1e-9
    if high - low >= _TURN:
        yield slice(None)
        return
    low, high = low - _TURN * np.floor((low + np.pi) / _TURN), high - _TURN * np.floor((low + np.pi) / _TURN)
    for turns in (-2, -1, 0, 1):
        first, last = np.searchsorted(angles, [low + turns * _TURN, high + turns * _TURN])
        if first < last:
            yield slice(int(first), int(last))
