"""Where a differential drive may get under every command of a box, bounded by hulls: nothing of the engine's geometry.

A state is confirmed if every command (v, w) of its box, from every pose of its box, keeps the footprint farther from
everything than the distance, at every instant. A cell is a box of commands, poses and fractions of the path; a command
that counts for T(v, w) seconds is, at its fractions from a to b, at instants within ``[a T_least, b T_most]`` of the
cell. Let (v, w, x, y, h) be the middle of a cell and dv, dw, dx, dy, dh its half-widths, t to u its instants, and
`reach` how far the outline of the footprint is from the robot's origin: 0 of a point or a disc. Whatever the command
and the pose of the cell, no point of the outline is ever farther from the convex hull of the two outlines that the
middle command brings about at t and at u than

    dv u + |v| dw u^2 / 2 + |v| u dh + dx + dy    the origin differs from that of the middle,
    + reach (dw u + dh)                           and so does the heading,
    + (|v| + reach |w|) |w| (u - t)^2 / 8         and a point leaves its chord,

since ``|e(a) - e(b)| <= |a - b|`` for unit vectors, and since a curve leaves a chord by at most an eighth of its second
derivative times the square of the span. A disc adds its radius to the distance. Distances to hulls are those of
shapely, less a slack far above their rounding. A cell that is not clear is halved along what widens it most.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from viatool.recheck.scene import EpisodeScenes, Scene

Floats = NDArray[np.float64]
Booleans = NDArray[np.bool_]

_CELLS = 4096  # of one state at once, above which it is given up
_BOXES = 128  # that are looked at together, so that memory stays flat
_LEVELS = 60
_SLACK = 1e-9  # of the largest coordinate
_V, _W, _X, _Y, _H, _S = range(6)  # the axes of a cell: command, pose and fraction of the path


class Motion:
    """A differential drive that holds a command and, if the criterion asks for it, brakes along its arc.

    Parameters
    ----------
    rules : dict
        Criterion, interval, deceleration and footprint, as the setting of a folder has them.
    """

    def __init__(self, rules: dict[str, Any]) -> None:
        shape = rules["footprint"]
        self.interval, self.brakes = float(rules["interval"]), rules["criterion"] == "braking"
        self.deceleration = float(rules["deceleration"])
        self.radius = float(shape["radius"]) if shape["kind"] == "circle" else 0.0
        self.outline = np.array(shape["polygon"] if shape["kind"] == "polygon" else [[0.0, 0.0]], dtype=float)
        self.reach = float(np.hypot(*self.outline.T).max())

    def seconds(self, speed: Floats, turn: Floats) -> Floats:
        """Return for how long commands count: brakes lengthen the arc by half the time that they take."""
        braking = 0.5 * (speed + self.reach * turn) / self.deceleration if self.brakes else 0.0 * speed
        return np.asarray(self.interval + braking)

    def keeps(
        self,
        scenes: EpisodeScenes,
        episode: NDArray[Any],
        lower: Floats,
        upper: Floats,
        distance: float,
    ) -> Booleans:
        """Tell for which boxes every command from every pose keeps a distance.

        Parameters
        ----------
        scenes : EpisodeScenes
            Of all episodes.
        episode : ndarray
            (N,) which one each box is in.
        lower, upper : ndarray
            (N, 5) ends of v, w, x, y and heading.
        distance : float
            To be exceeded, in metres.

        Returns
        -------
        ndarray
            (N,) bool. **Sound:** yes, as the module says; what is not told is false.
        """
        kept = np.zeros(len(lower), dtype=bool)
        for each in np.unique(episode):
            all_of_it = np.flatnonzero(episode == each)
            for first in range(0, len(all_of_it), _BOXES):
                rows = all_of_it[first : first + _BOXES]
                kept[rows] = self._keeps(scenes.of(int(each)), lower[rows], upper[rows], distance)
        return kept

    def _keeps(self, scene: Scene, lower: Floats, upper: Floats, distance: float) -> Booleans:
        count = len(lower)
        low, high = np.column_stack([lower, np.zeros(count)]), np.column_stack([upper, np.ones(count)])
        owner: NDArray[np.int64] = np.arange(count)
        failed: Booleans = np.asarray(~(lower <= upper).all(axis=1))
        for _ in range(_LEVELS):
            clear, attained, shares = self._enclose(scene, low, high)
            left = ~(clear > distance)
            failed |= np.bincount(owner[left], minlength=count) > _CELLS
            failed[owner[attained < distance]] = True
            failed[owner[left & ~(shares.sum(axis=1) > _SLACK)]] = True  # too thin for a cut to tell anything
            left &= ~failed[owner]
            owner, low, high, shares = owner[left], low[left], high[left], shares[left]
            if not len(owner):
                break
            axis = np.arange(6) == shares.argmax(axis=1)[:, None]
            middle = 0.5 * (low + high)
            owner = np.concatenate([owner, owner])
            low, high = (
                np.concatenate([low, np.where(axis, middle, low)]),
                np.concatenate([np.where(axis, middle, high), high]),
            )
        failed[owner] = True
        return ~failed

    def _enclose(self, scene: Scene, low: Floats, high: Floats) -> tuple[Floats, Floats, Floats]:
        """Bound the clearance of cells (C, 6).

        Returns
        -------
        tuple of ndarray
            What they keep at least, (C,). **Sound:** yes. About how near the command in the middle comes, (C,), by
            which a state is given up. By how much each axis widens the first, (C, 6).
        """
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        most = np.maximum(np.abs(low), np.abs(high))[:, :2]
        least = np.where(low * high > 0.0, np.minimum(np.abs(low), np.abs(high)), 0.0)[:, :2]
        shortest, longest = self.seconds(*least.T), self.seconds(*most.T)
        start, end = low[:, _S] * shortest, high[:, _S] * longest
        by = self._widening(middle, half, end, end - start)
        corners = np.hstack([self.placed(self.after(middle, instant)) for instant in (start, end)])
        hulls = shapely.convex_hull(shapely.linestrings(corners))
        slack = _SLACK * (scene.scale + np.abs(middle).sum(axis=1))
        apart = scene.distances(hulls, corners[:, 0]) - self.radius
        kept, turned = apart - by.sum(axis=1) - slack, self.reach * np.abs(middle[:, _W]) * (end - start)
        # Hulls are longer than any path by what seconds differ, which a cut changes as well.
        between = self.seconds(most[:, _V], least[:, _W])
        longer = 0.5 * np.abs(middle[:, _V]) * np.stack([between - shortest, longest - between])
        by[:, _V] += longer[0]
        by[:, _W] += longer[1]
        return kept, apart + by[:, _S] + 2.0 * longer.sum(axis=0) + turned + slack, by

    def _widening(self, middle: Floats, half: Floats, until: Floats, span: Floats) -> Floats:
        """Return by how much each axis of cells (C, 6) widens a hull, (C, 6): the terms of the module, in metres."""
        speed, turn = np.abs(middle[:, _V]), np.abs(middle[:, _W])
        by = half.copy()
        by[:, _V] *= until
        by[:, _W] *= 0.5 * speed * until**2 + self.reach * until
        by[:, _H] *= speed * until + self.reach
        by[:, _S] = (speed + self.reach * turn) * turn * span**2 / 8.0
        return by

    def after(self, states: Floats, seconds: Floats) -> Floats:
        """Return the poses (C, 3) after commands and poses (C, 5 or more) have been held for so many seconds (C,)."""
        v, w, x, y, heading = states.T[:5]
        half = 0.5 * w * seconds
        chord = v * seconds * np.sinc(half / np.pi)
        return np.column_stack(
            [x + chord * np.cos(heading + half), y + chord * np.sin(heading + half), heading + 2.0 * half]
        )

    def placed(self, poses: Floats) -> Floats:
        """Return the outline at poses (C, 3), as (C, corners, 2)."""
        turn = np.exp(1j * poses[:, 2])[:, None] * (self.outline @ np.array([1.0, 1j]))
        return np.stack([poses[:, :1] + turn.real, poses[:, 1:2] + turn.imag], axis=-1)

    def least_clearance(self, scene: Scene, command: Floats, pose: Floats, instants: int = 2001) -> float:
        """Return the least distance at some instants of the arc of one command from one pose, in metres."""
        seconds = self.seconds(*np.abs(command)[:, None])[0] * np.linspace(0.0, 1.0, instants)
        poses = self.after(np.broadcast_to(np.concatenate([command, pose]), (instants, 5)), seconds)
        rings = self.placed(poses)
        probes = shapely.points(poses[:, :2]) if len(self.outline) == 1 else shapely.polygons(rings)
        return float(scene.distances(probes, rings[:, 0]).min() - self.radius)
