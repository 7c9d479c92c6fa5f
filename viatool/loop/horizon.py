"""Where the closed loop may be over several control intervals, and how far that is safe: the record of tubes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from viatool.arrays import Booleans, Floats, Indices
from viatool.errors import ConfigurationError
from viatool.safety.counterexamples import Witnesses
from viatool.uncertainty import ErrorModel

MOST_STEPS = 1000


@dataclass(frozen=True)
class Horizon:
    """What is asked of trajectory tubes.

    Parameters
    ----------
    steps : int
        K control intervals.
    position_error, heading_error : float
        How far x and y (metres, each) and theta (radians) of a recorded pose may be off.
    sector : float
        Radians of heading that a part of a tube spans, if that takes no more than `parts`.
    parts : int
        Most parts of a tube.

    Raises
    ------
    ConfigurationError
        If a number is out of its range.
    """

    steps: int
    position_error: float = 0.0
    heading_error: float = 0.0
    sector: float = 0.004
    parts: int = 32

    def __post_init__(self) -> None:
        if not 1 <= self.steps <= MOST_STEPS:
            raise ConfigurationError(
                f"the horizon is {self.steps} steps", f"give a number from 1 to {MOST_STEPS}"
            )
        for name, value in (("position", self.position_error), ("heading", self.heading_error)):
            if not 0.0 <= value < np.inf:
                raise ConfigurationError(
                    f"the {name} error of a pose is {value}", "give finite numbers of at least 0"
                )
        if not (0.0 < self.sector < np.inf and self.parts >= 1):
            raise ConfigurationError(
                f"a tube is cut into {self.parts} sectors of {self.sector} rad", "give positive numbers"
            )

    def beginning(self, model: ErrorModel) -> Horizon:
        """Return the same from the box of starts that an error model states; of x and y the larger counts for both.

        A recorded pose is one that localisation gave, so the box is no smaller than its error.

        Raises
        ------
        ConfigurationError
            If both state one.
        """
        start, pose = model.start, model.pose
        place = max(start.x or 0.0, start.y or 0.0, pose.x or 0.0, pose.y or 0.0)
        heading = max(start.theta or 0.0, pose.theta or 0.0)
        if (place or heading) and self.pose_error.any():
            raise ConfigurationError(
                f"{model.source} states a box of starts, and so does the horizon", "leave one of them out"
            )
        return replace(self, position_error=place, heading_error=heading) if place or heading else self

    @property
    def pose_error(self) -> Floats:
        """Return half-widths (3,) of the box around a recorded pose."""
        return np.array([self.position_error, self.position_error, self.heading_error])


@dataclass(frozen=True, eq=False)
class Tubes:
    """What is known of the closed loop from N states over K control intervals.

    Parameters
    ----------
    lower, upper : ndarray
        (N, K, 3) a box that holds x, y and theta at the end of each interval, of every run that has neither arrived nor
        collided before; theta is not wrapped, but continues that of the state. NaN where no run is left.
    clearance : ndarray
        (N, K) metres that every run keeps during each interval; infinite where no run is left.
    steps : ndarray
        (N,) intervals, counted from the state, during which every run is proved to keep the collision distance.
    """

    lower: Floats
    upper: Floats
    clearance: Floats
    steps: Indices

    def __len__(self) -> int:
        """Return N."""
        return len(self.steps)

    @property
    def safe(self) -> Booleans:
        """Tell from which states every run keeps the collision distance over the whole horizon, (N,)."""
        return np.asarray(self.steps == self.lower.shape[1])

    @classmethod
    def none(cls, states: int, steps: int) -> Tubes:
        """Return what is known of states that were not followed, because no command can endanger them."""
        unknown = np.full((states, steps, 3), np.nan)
        return cls(
            unknown, unknown.copy(), np.full((states, steps), np.nan), np.full(states, steps, np.int64)
        )


@dataclass(frozen=True, eq=False)
class Crashes:
    """W runs that come too near to something within the horizon, every sensor error within its bound.

    Parameters
    ----------
    state : ndarray
        (W,) index of the state, ascending.
    poses : ndarray
        (W, K, 3) at the beginning of each interval, the first within the error of the recorded pose.
    observations : ndarray
        (W, K, n) float32 numbers that the program receives there.
    actions : ndarray
        (W, K, A) as onnxruntime computed them, clipped by the robot.
    motions : ndarray
        (W, K, S) the state of the motion at the beginning of each interval.
    step : ndarray
        (W,) the interval, counted from 0, in which the run fails.
    seconds : ndarray
        (W,) time from the beginning of that interval to the closest approach in it.
    place : ndarray
        (W, 3) the pose there.
    clearance : ndarray
        (W,) metres that are left there.
    """

    state: Indices
    poses: Floats
    observations: Floats
    actions: Floats
    motions: Floats
    step: Indices
    seconds: Floats
    place: Floats
    clearance: Floats

    def __len__(self) -> int:
        """Return the number of runs."""
        return len(self.state)

    @property
    def last(self) -> Witnesses:
        """Return the intervals that fail as counterexamples by themselves: what follows from the last observation."""
        rows = np.arange(len(self))
        return Witnesses.among_what_stands(
            self.state,
            self.observations[rows, self.step],
            self.actions[rows, self.step],
            self.seconds,
            self.place,
            self.clearance,
            self.poses[rows, self.step],
            self.poses[rows, self.step],
        )

    @classmethod
    def none(cls, steps: int, size: int, axes: int, state: int = 0) -> Crashes:
        """Return no run, of K intervals, n observation entries, A entries of a command and S of the motion's state."""
        index, number, place = np.zeros(0, np.int64), np.zeros(0), np.zeros((0, 3))
        poses, observations, actions, motions = (
            np.zeros((0, steps, width)) for width in (3, size, axes, state)
        )
        return cls(index, poses, observations, actions, motions, index.copy(), number, place, number.copy())

    @classmethod
    def join(cls, parts: Sequence[Crashes]) -> Crashes:
        """Return all parts as one, ordered by state."""
        joined = {
            name: np.concatenate([getattr(part, name) for part in parts]) for name in cls.__dataclass_fields__
        }
        order = np.argsort(joined["state"], kind="stable")
        return cls(**{name: array[order] for name, array in joined.items()})
