"""Transforms between the frames of a recording, seen from above."""

from __future__ import annotations

from array import array
from dataclasses import dataclass, field

import numpy as np

from viatool.arrays import Booleans, Floats, Indices
from viatool.errors import TrajectoryError

_TILT = 0.02  # how far from upright a frame may be, as the sine of the angle


@dataclass
class _Edge:
    """How one frame lies in its parent, over time."""

    parent: str
    stamps: array[int] = field(default_factory=lambda: array("q"))
    poses: array[float] = field(default_factory=lambda: array("d"))  # x, y, theta one after the other
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
    """The tree of frames, each planar in its parent; stamps in nanoseconds."""

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
        edge = self._edges.setdefault(child, _Edge(parent))
        yaw = heading_of(quaternion)
        if edge.complaint is None:
            edge.complaint = _complain(edge, child, parent, (*translation, yaw), quaternion)
        edge.add(stamp, (*translation, yaw), static=static)

    def locate(self, child: str, parent: str, stamps: Indices, gap: float) -> tuple[Floats, Booleans]:
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
        tuple of ndarray
            (N, 3) x, y, theta, and (N,) bool whether it is known at that time.

        Raises
        ------
        TrajectoryError
            If the frames are not connected, or not upright in each other.
        """
        up, down = self._between(child, parent)
        inner, inner_known = self._climb(up, stamps, gap)
        outer, outer_known = self._climb(down, stamps, gap)
        return compose(invert(outer), inner), inner_known & outer_known

    def mount(self, child: str, parent: str, gap: float) -> Floats:
        """Return how one frame lay in another whenever a frame between them was observed, (K, 3).

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
        poses, known = self.locate(child, parent, stamps, gap)
        return poses[known]

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
                    f"the frames {', '.join(found)} lie in a circle", "record one tree of transforms"
                )
            found.append(parent)
        return found

    def _check(self, frame: str) -> None:
        """Refuse a frame whose transforms are useless."""
        edge = self._edges.get(frame)
        if edge is not None and edge.complaint is not None:
            raise edge.complaint

    def _climb(self, frames: list[str], stamps: Indices, gap: float) -> tuple[Floats, Booleans]:
        """Return how the first of the frames lies in the parent of the last."""
        poses, known = np.zeros((len(stamps), 3)), np.ones(len(stamps), dtype=bool)
        for frame in frames:
            edge = self._edges[frame]
            self._check(frame)
            if edge.static:
                around = np.broadcast_to(np.array(edge.poses[-3:]), poses.shape)
            else:
                around, seen = interpolate(*edge.observed(), stamps, gap)
                known = known & seen
            poses = compose(around, poses)
        return poses, known


def _complain(
    edge: _Edge,
    child: str,
    parent: str,
    pose: tuple[float, float, float],
    quaternion: tuple[float, float, float, float],
) -> TrajectoryError | None:
    """Return what makes a transform useless, if anything does."""
    x, y, z, w = quaternion
    if edge.parent != parent:
        return TrajectoryError(
            f"frame '{child}' lies in '{edge.parent}' and in '{parent}'", "record one tree of transforms"
        )
    if not np.isfinite(pose).all():
        return TrajectoryError(
            f"a transform from '{parent}' to '{child}' is not finite", "check the node that published it"
        )
    if 2.0 * np.hypot(w * x + y * z, w * y - x * z) > _TILT or x * x + y * y >= 0.5:
        return TrajectoryError(
            f"frame '{child}' is tilted within '{parent}'",
            "record the scan of a level LiDAR; others do not see a plane of the map",
        )
    return None


def heading_of(quaternion: tuple[float, float, float, float]) -> float:
    """Return the yaw of a quaternion x, y, z, w, in radians; NaN if it is no rotation."""
    x, y, z, w = quaternion
    length = x * x + y * y + z * z + w * w
    if not 0.5 < length < 2.0:
        return float("nan")
    return float(np.arctan2(2.0 * (w * z + x * y), length - 2.0 * (y * y + z * z)))


def compose(outer: Floats, inner: Floats) -> Floats:
    """Return poses (N, 3) given within frames that lie at `outer` (N, 3), seen from outside."""
    cosine, sine = np.cos(outer[:, 2]), np.sin(outer[:, 2])
    x = outer[:, 0] + cosine * inner[:, 0] - sine * inner[:, 1]
    y = outer[:, 1] + sine * inner[:, 0] + cosine * inner[:, 1]
    return np.column_stack([x, y, _wrap(outer[:, 2] + inner[:, 2])])


def invert(poses: Floats) -> Floats:
    """Return the poses (N, 3) of the outer frames within the inner ones."""
    cosine, sine = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x = -cosine * poses[:, 0] - sine * poses[:, 1]
    y = sine * poses[:, 0] - cosine * poses[:, 1]
    return np.column_stack([x, y, -poses[:, 2]])


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
    step[:, 2] = _wrap(step[:, 2])
    found = poses[before] + share[:, None] * step
    found[:, 2] = _wrap(found[:, 2])
    return found, np.asarray(known, dtype=bool)


def _wrap(angles: Floats) -> Floats:
    """Return angles in (-pi, pi]; those that are there already stay as they are."""
    turns = np.ceil((angles - np.pi) / (2.0 * np.pi))
    return np.asarray(angles - turns * (2.0 * np.pi))
