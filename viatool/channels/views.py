"""What quantities are measured of: robots in their surroundings, sets of their states, and recordings."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np

from viatool.arrays import Booleans, Floats, Indices, Reals
from viatool.channels.channel import Channel
from viatool.channels.fan import Fan
from viatool.channels.goal_forms import GoalForms
from viatool.rounding import SPARE
from viatool.sets.forms import Forms
from viatool.sets.states import POSE, StateBoxes
from viatool.sight.shapes import Shapes
from viatool.sight.windows import Windows
from viatool.world import Scenes


@dataclass(frozen=True, eq=False)
class Goals:
    """Goals in the robots' frames: distance in metres, cosine and sine of the bearing, (B,) each; 0 on the goal."""

    distance: Floats
    cosine: Floats
    sine: Floats

    @property
    def bearing(self) -> Floats:
        """Return the bearing within a half turn, (B,) rad; 0 on the goal."""
        return np.arctan2(self.sine, self.cosine)

    @property
    def x(self) -> Floats:
        """Return how far ahead the goals are, (B,) metres."""
        return self.distance * self.cosine

    @property
    def y(self) -> Floats:
        """Return how far to the left the goals are, (B,) metres."""
        return self.distance * self.sine

    @classmethod
    def seen_from(cls, poses: Floats, goals: Floats) -> Goals:
        """Return goals (B, 2) or (2,) as seen from poses (B, 3)."""
        dx, dy = (goals - poses[:, :2]).T
        distance = np.sqrt(dx * dx + dy * dy)
        inverse = 1.0 / np.maximum(distance, 1e-12)
        cosine, sine = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        return cls(distance, (dx * cosine + dy * sine) * inverse, (dy * cosine - dx * sine) * inverse)


def see(fan: Fan, view: View) -> Reals:
    """Cast rays in float32: for simulations."""
    return view.scenes.cast(view.poses, view.scene, fan.lidar, directions=fan.quick_directions)


def see_precisely(fan: Fan, view: View) -> Reals:
    """Cast rays in float64: for counterexamples."""
    return view.scenes.cast(view.poses, view.scene, fan.lidar, directions=fan.directions)


Eyes = Callable[[Fan, "View"], Reals]
"""Gives the ranges (B, R) of a fan's rays in the order of its directions; the caller may overwrite them."""


class SharedEyes:
    """What many robots see that stand at a few poses: rays are cast once for each pose.

    Parameters
    ----------
    scenes : Scenes
        The geometry; its first scene.
    poses : ndarray
        (P, 3).
    """

    def __init__(self, scenes: Scenes, poses: Floats) -> None:
        self._scenes, self._poses, self._seen = scenes, poses, dict[Fan, Reals]()

    def of(self, which: Indices) -> Eyes:
        """Return the eyes of B robots, each at one of the poses, (B,) by number."""

        def ranges(fan: Fan, view: View) -> Reals:
            if fan not in self._seen:
                scene = np.zeros(len(self._poses), np.int64)
                self._seen[fan] = self._scenes.cast(self._poses, scene, fan.lidar, directions=fan.directions)
            return self._seen[fan][which]

        return ranges


@dataclass(frozen=True, eq=False)
class View:
    """B robots, what is around them and what they head for.

    Parameters
    ----------
    scenes : Scenes
        The geometry.
    poses : ndarray
        (B, 3) x, y, theta; metres and radians.
    scene : ndarray
        (B,) which scene of the geometry each of them is in.
    goals : ndarray
        (B, 2) metres.
    previous : ndarray
        (B, 2) the command of the step before, m/s and rad/s.
    believed : ndarray, optional
        (B, 3) where the robots think they are, if that differs from where they are; goals are seen from there.
    steps : ndarray, optional
        (B,) control intervals since the beginning of the episode; None where there is no episode.
    horizon : int, optional
        Control intervals after which an episode ends; None where there is none.
    velocity : ndarray, optional
        (B, 3) m/s ahead and to the left, and rad/s; None where it is that of the command before.
    raw : ndarray, optional
        (B, K) what the network gave in the step before; None before the first.
    eyes : callable
        How ranges come about: by exact geometry, unless a simulator gives its own.
    """

    scenes: Scenes
    poses: Floats
    scene: Indices
    goals: Floats
    previous: Floats
    believed: Floats | None = None
    steps: Indices | None = None
    horizon: int | None = None
    velocity: Floats | None = None
    raw: Floats | None = None
    eyes: Eyes = see

    def __len__(self) -> int:
        """Return B."""
        return len(self.poses)

    @cached_property
    def goal(self) -> Goals:
        """The goals in the robots' frames."""
        return Goals.seen_from(self.known_poses, self.goals)

    @property
    def known_poses(self) -> Floats:
        """Return where the robots think they are, (B, 3)."""
        return self.poses if self.believed is None else self.believed


@dataclass(frozen=True, eq=False)
class BoxView:
    """C sets of states, what is around them and what they head for.

    Parameters
    ----------
    start : StateBoxes
        C boxes around the sets.
    states : Forms
        (C, 5) the sets: x, y, theta and the v and omega before, in S symbols.
    shapes : Shapes
        What there is to be seen.
    goal : ndarray
        (2,) metres.
    submerged : ndarray
        (C,) bool: whether the robot's origin may be inside of an obstacle or off the map somewhere in the set.
    behind : frozenset of str
        Kinds of angles that are meant on the clockwise side of the half turn, near -pi, in sets that reach over it; on
        the other side, near pi, unless named.
    left : ndarray, optional
        (C, 2) ends of the control intervals that are left; None where an episode is not long enough to be known.
    raw : Forms, optional
        (C, K) what the network gave in the step before; None where nothing tells.
    windows : mapping of str to Windows
        Of a LiDAR channel by its name: what its bins read at the poses that count; others count all.
    """

    start: StateBoxes
    states: Forms
    shapes: Shapes
    goal: Floats
    submerged: Booleans
    behind: frozenset[str] = frozenset()
    left: Floats | None = None
    raw: Forms | None = None
    windows: Mapping[str, Windows] = field(default_factory=dict)

    def __len__(self) -> int:
        """Return C."""
        return len(self.start)

    def select(self, which: Indices, behind: frozenset[str]) -> BoxView:
        """Return some of the sets, with some angles on the other side of the half turn."""
        return replace(
            self,
            start=self.start.select(which),
            states=self.states.select(which),
            submerged=self.submerged[which],
            behind=behind,
            left=None if self.left is None else self.left[which],
            raw=None if self.raw is None else self.raw.select(which),
            windows={name: windows.select(which) for name, windows in self.windows.items()},
        )

    @cached_property
    def goal_forms(self) -> GoalForms:
        """The goal in the robots' frames, over the poses of the boxes."""
        return GoalForms.seen_from(self.start.poses, self.goal, self.shapes.scale)

    @cached_property
    def _shares(self) -> Floats:
        """How far each symbol of the states moves the pose, (C, S, 3), in half-widths of its box."""
        radius = self.start.poses.radius[:, None]
        return np.asarray(self.states.slope[:, :, :3] / np.where(radius > 0.0, radius, 1.0))

    def over_states(self, forms: Forms) -> Forms:
        """Return forms over the poses of the boxes, (C, K), in the symbols of the states."""
        return Forms(forms.centre, self._shares @ forms.slope, forms.rest)

    def within_half_turn(self, angles: Forms, kind: str) -> Forms:
        """Return angles (C, 1) that continue beyond a half turn as they are observed: between -pi and pi.

        A set that reaches over the half turn is observed on both of its sides; the forms are of the side that
        `behind` names.

        Notes
        -----
        Sound: yes, for both sides together.
        """
        turns = 2.0 * np.pi * np.ceil((angles.centre - np.pi) / (2.0 * np.pi))
        centre = angles.centre - turns
        slack = SPARE * (1.0 + np.abs(turns))
        angles = Forms(centre, angles.slope, angles.rest + slack)
        lower, upper = angles.lower, angles.upper
        over, under = upper > np.pi, lower < -np.pi
        all_round = (upper - lower >= 2.0 * np.pi) | (over & under)
        if kind in self.behind:
            ends = np.full_like(lower, -np.pi), np.where(over, upper - 2.0 * np.pi, upper)
        else:
            ends = np.where(under, lower + 2.0 * np.pi, lower), np.full_like(lower, np.pi)
        one_side = Forms.between(np.where(all_round, -np.pi, ends[0]), np.where(all_round, np.pi, ends[1]))
        one_side = Forms(one_side.centre, np.zeros_like(angles.slope), one_side.rest + slack)
        return Forms.where(over | under, one_side, angles)

    def state(self, name: str) -> Forms:
        """Return one quantity of the pose as forms (C, 1): x, y or theta."""
        return self._column(POSE.index(name))

    def command(self, axis: int) -> Forms:
        """Return one number of what sets of states hold behind the pose as forms (C, 1), see `Kinematics.before`."""
        return self._column(len(POSE) + axis)

    def _column(self, number: int) -> Forms:
        column, states = [number], self.states
        return Forms(states.centre[:, column], states.slope[:, :, column], states.rest[:, column])

    def between(self, lower: float | Floats, upper: float | Floats) -> Forms:
        """Return one number of which nothing is known but its ends, one or (C,) each, as forms (C, 1)."""
        ends = (
            np.broadcast_to(np.asarray(end, dtype=np.float64), len(self))[:, None] for end in (lower, upper)
        )
        found = Forms.between(*ends)
        return Forms(found.centre, np.zeros((*self.states.slope.shape[:2], 1)), found.rest)

    def constant(self, value: float, size: int) -> Forms:
        """Return `size` equal numbers that no state changes, as forms (C, size)."""
        slope = np.zeros((*self.states.slope.shape[:2], size))
        return Forms(np.full((len(self), size), value), slope, np.zeros((len(self), size)))


@dataclass(frozen=True, eq=False)
class RecordedInstants:
    """S instants of a recording.

    Parameters
    ----------
    poses : ndarray
        (S, 3) x, y, theta in the map frame; metres and radians.
    goal : ndarray or None
        (2,) metres; None where no quantity needs it.
    previous : ndarray
        (S, 3) the command before: m/s ahead and to the left, and rad/s.
    velocities : ndarray
        (S, 3) the velocity that was measured, of the same kind.
    scan : callable
        Gives the bins (S, bins) of a LiDAR channel, NaN where nothing was measured.
    """

    poses: Floats
    goal: Floats | None
    previous: Floats
    velocities: Floats
    scan: Callable[[Channel], Floats]

    @cached_property
    def goals(self) -> Goals:
        """The goal in the robot's frame."""
        assert self.goal is not None  # refused before, by what its quantities need
        return Goals.seen_from(self.poses, self.goal)


@dataclass(frozen=True)
class Extent:
    """How far robots may be and go.

    Parameters
    ----------
    x_min, y_min, x_max, y_max : float
        The bounds of the map, in metres.
    """

    x_min: float
    y_min: float
    x_max: float
    y_max: float

    @property
    def diagonal(self) -> float:
        """Return the largest distance of two places, in metres."""
        return float(np.hypot(self.x_max - self.x_min, self.y_max - self.y_min))

    def along(self, axis: Literal[0, 1]) -> tuple[float, float]:
        """Return the bounds of x or y, in metres."""
        return ((self.x_min, self.x_max), (self.y_min, self.y_max))[axis]
