"""Transforms between the frames of a recording, seen from above.

A level frame lies upright in its parent (side 1) or upside down (side -1): rolled by half a turn, its y axis points the
other way, and what turns to the left in it turns to the right seen from above.
"""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field

import numpy as np

from viatool.arrays import Booleans, Floats, Indices
from viatool.errors import TrajectoryError

_TILT = 0.02  # rad from level, 1.1 degrees: over 5 m, a beam then leaves the plane of the scan by 10 cm


@dataclass
class _Edge:
    """How one frame lies in its parent, over time."""

    parent: str
    stamps: array[int] = field(default_factory=lambda: array("q"))
    poses: array[float] = field(default_factory=lambda: array("d"))  # x, y, theta one after the other
    side: int = 1
    static: bool = False
    complaint: TrajectoryError | None = None
    _sorted: tuple[Indices, Floats] | None = None

    def add(self, stamp: int, pose: tuple[float, float, float], *, static: bool) -> None:
        """Add an observation; of a static frame only the last one counts."""
        if static and self.static:
            del self.stamps[:], self.poses[:]
        self.stamps.append(stamp)
        self.poses.extend(pose)
        self.static |= static
        self._sorted = None

    def observed(self) -> tuple[Indices, Floats]:
        """Return when the frame was observed, ascending, and its poses (M, 3) then."""
        if self._sorted is None:
            stamps, poses = np.array(self.stamps), np.array(self.poses).reshape(-1, 3)
            order = np.argsort(stamps, kind="stable")
            self._sorted = stamps[order], poses[order]
        return self._sorted


class Transforms:
    """The tree of frames, each level in its parent, upright or upside down; stamps in nanoseconds."""

    def __init__(self) -> None:
        self._edges: dict[str, _Edge] = {}

    def add(
        self,
        child: str,
        parent: str,
        stamp: int,
        translation: tuple[float, float],
        quaternion: tuple[float, float, float, float],
        *,
        static: bool,
    ) -> None:
        """Add one observed transform; what is wrong with it counts only if the frame is asked for."""
        yaw, side = heading_of(quaternion), side_of(quaternion)
        edge = self._edges.setdefault(child, _Edge(parent, side=side))
        if edge.complaint is None:
            edge.complaint = _complain(edge, child, parent, (*translation, yaw), quaternion)
        edge.add(stamp, (*translation, yaw), static=static)

    def locate(self, child: str, parent: str, stamps: Indices, gap: float) -> tuple[Floats, Booleans, int]:
        """Return how one frame lies in another.

        Parameters
        ----------
        child, parent : str
            Names of frames; any two of one tree.
        stamps : ndarray
            (N,) when, in nanoseconds.
        gap : float
            Seconds between two observations over which a moving transform may be interpolated.

        Returns
        -------
        tuple
            (N, 3) x, y, theta, (N,) bool whether it is known at that time, and the side, 1 or -1.

        Raises
        ------
        TrajectoryError
            If the frames are not connected, or not level in each other.
        """
        up, down = self._between(child, parent)
        inner, inner_known, inner_side = self._climb(up, stamps, gap)
        outer, outer_known, outer_side = self._climb(down, stamps, gap)
        poses = compose(invert(outer, outer_side), inner, outer_side)
        return poses, inner_known & outer_known, inner_side * outer_side

    def mount(self, child: str, parent: str, gap: float) -> tuple[Floats, int]:
        """Return how one frame lay in another whenever a frame between them was observed, (K, 3), and its side.

        Raises
        ------
        TrajectoryError
            As `locate`.
        """
        up, down = self._between(child, parent)
        moving = [
            edge.observed()[0] for edge in map(self._edges.__getitem__, (*up, *down)) if not edge.static
        ]
        stamps = np.unique(np.concatenate([np.zeros(0 if moving else 1, np.int64), *moving]))
        poses, known, side = self.locate(child, parent, stamps, gap)
        return poses[known], side

    def _between(self, child: str, parent: str) -> tuple[list[str], list[str]]:
        """Return the frames that lie below the common ancestor of two frames, from each of them upwards."""
        up, down = self._ancestors(child), self._ancestors(parent)
        common = next((frame for frame in up if frame in down), None)
        if common is None:
            for frame in (*up, *down):
                self._check(frame)
            known = (
                ", ".join(sorted({*self._edges, *(edge.parent for edge in self._edges.values())})) or "none"
            )
            raise TrajectoryError(
                f"the recording has no transform from '{parent}' to '{child}' (its frames: {known})",
                f"record /tf and /tf_static; if '{child}' is the map's frame itself, say --frame {child}",
            )
        return up[: up.index(common)], down[: down.index(common)]

    def _ancestors(self, frame: str) -> list[str]:
        """Return the frame and those in which it lies, innermost first."""
        found = [frame]
        while found[-1] in self._edges:
            parent = self._edges[found[-1]].parent
            if parent in found:
                raise TrajectoryError(
                    f"the frames {', '.join(found)} form a cycle", "record one tree of transforms"
                )
            found.append(parent)
        return found

    def _check(self, frame: str) -> None:
        """Refuse a frame whose transforms are useless."""
        edge = self._edges.get(frame)
        if edge is not None and edge.complaint is not None:
            raise edge.complaint

    def _climb(self, frames: list[str], stamps: Indices, gap: float) -> tuple[Floats, Booleans, int]:
        """Return how the first of the frames lies in the parent of the last, when that is known, and its side."""
        poses, known, side = np.zeros((len(stamps), 3)), np.ones(len(stamps), dtype=bool), 1
        for frame in frames:
            edge = self._edges[frame]
            self._check(frame)
            if edge.static:
                around = np.broadcast_to(np.array(edge.poses[-3:]), poses.shape)
            else:
                around, seen = interpolate(*edge.observed(), stamps, gap)
                known = known & seen
            poses, side = compose(around, poses, edge.side), side * edge.side
        return poses, known, side


def _complain(
    edge: _Edge,
    child: str,
    parent: str,
    pose: tuple[float, float, float],
    quaternion: tuple[float, float, float, float],
) -> TrajectoryError | None:
    """Return what makes a transform useless, if anything does."""
    if edge.parent != parent:
        return TrajectoryError(
            f"frame '{child}' lies in '{edge.parent}' and in '{parent}'", "record one tree of transforms"
        )
    if not np.isfinite(pose).all():
        return TrajectoryError(
            f"a transform from '{parent}' to '{child}' is not finite", "check the node that published it"
        )
    tilt, side = tilt_of(quaternion), side_of(quaternion)
    if not min(tilt, np.pi - tilt) <= _TILT:
        return TrajectoryError(
            f"frame '{child}' is tilted within '{parent}' by {np.degrees(tilt):.1f} degrees, expected 0 (upright) or "
            f"180 (upside down) within {np.degrees(_TILT):.1f}",
            "record the scan of a level LiDAR; others do not see a plane of the map",
        )
    if side != edge.side:
        return TrajectoryError(
            f"frame '{child}' turns over within '{parent}'", "record a LiDAR that is fixed"
        )
    return None


def tilt_of(quaternion: tuple[float, float, float, float]) -> float:
    """Return the angle between the z axes of a frame and its parent, in [0, pi] rad; NaN for what is not a number."""
    x, y, z, w = quaternion
    return float(np.arctan2(2.0 * np.hypot(w * x + y * z, w * y - x * z), w * w + z * z - x * x - y * y))


def side_of(quaternion: tuple[float, float, float, float]) -> int:
    """Return 1 for a frame whose z axis points upwards, -1 for one that lies upside down."""
    return -1 if tilt_of(quaternion) > 0.5 * np.pi else 1


def heading_of(quaternion: tuple[float, float, float, float]) -> float:
    """Return the yaw of a quaternion x, y, z, w, in radians; NaN if it is not a rotation."""
    x, y, z, w = quaternion
    length = x * x + y * y + z * z + w * w
    if not 0.5 < length < 2.0:
        return float("nan")
    return float(np.arctan2(2.0 * (w * z + x * y), length - 2.0 * (y * y + z * z)))


def compose(outer: Floats, inner: Floats, side: int = 1) -> Floats:
    """Return poses (N, 3) given within frames that lie at `outer` (N, 3) on a side, seen from outside."""
    cosine, sine, across = np.cos(outer[:, 2]), np.sin(outer[:, 2]), side * inner[:, 1]
    x = outer[:, 0] + cosine * inner[:, 0] - sine * across
    y = outer[:, 1] + sine * inner[:, 0] + cosine * across
    return np.column_stack([x, y, _wrap(outer[:, 2] + side * inner[:, 2])])


def invert(poses: Floats, side: int = 1) -> Floats:
    """Return the poses (N, 3) of the outer frames within the inner ones, which lie on a side of them."""
    cosine, sine = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x = -cosine * poses[:, 0] - sine * poses[:, 1]
    y = side * (sine * poses[:, 0] - cosine * poses[:, 1])
    return np.column_stack([x, y, -side * poses[:, 2]])


def turns_between(first: Floats, second: Floats) -> Floats:
    """Return the turns from headings to others, in (-pi, pi]."""
    return _wrap(second - first)


def interpolate(stamps: Indices, poses: Floats, at: Indices, gap: float) -> tuple[Floats, Booleans]:
    """Return poses between observed ones, on straight lines and the shorter turn.

    Parameters
    ----------
    stamps : ndarray
        (M,) nanoseconds, ascending.
    poses : ndarray
        (M, 3) x, y, theta.
    at : ndarray
        (N,) nanoseconds.
    gap : float
        Seconds; between observations that are farther apart nothing is known.

    Returns
    -------
    tuple of ndarray
        (N, 3), and (N,) bool whether the pose is known: nothing is extrapolated.
    """
    after = np.clip(np.searchsorted(stamps, at, side="left"), 0, len(stamps) - 1)
    before = np.maximum(np.where(stamps[after] == at, after, after - 1), 0)
    span = (stamps[after] - stamps[before]) * 1e-9
    known = (stamps[before] <= at) & (at <= stamps[after]) & (span <= gap)
    share = np.where(span > 0.0, (at - stamps[before]) * 1e-9 / np.where(span > 0.0, span, 1.0), 0.0)
    step = poses[after] - poses[before]
    step[:, 2] = turns_between(poses[before, 2], poses[after, 2])
    found = poses[before] + share[:, None] * step
    found[:, 2] = _wrap(found[:, 2])
    return found, np.asarray(known, dtype=bool)


def _wrap(angles: Floats) -> Floats:
    """Return angles in (-pi, pi]; those that are there already stay as they are."""
    turns = np.ceil((angles - np.pi) / (2.0 * np.pi))
    return np.asarray(angles - turns * (2.0 * np.pi))
