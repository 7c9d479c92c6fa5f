"""Where the robot thinks it is: dead reckoning from its wheels, each of which errs by a constant share."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from viatool.arrays import Booleans, Floats, Indices
from viatool.motion.arcs import drive_arc, wrap_angle
from viatool.motion.dead_time import DeadTime


class Odometry:
    """E dead-reckoned poses.

    Parameters
    ----------
    robots : int
        E.
    drift : float
        Standard deviation of the relative error of each wheel, drawn anew for every episode.
    track : float
        Distance between the wheels, in metres; not used without drift.
    seed : numpy.random.SeedSequence
        Of the errors.
    """

    def __init__(self, robots: int, drift: float, track: float, seed: np.random.SeedSequence) -> None:
        self.poses = np.zeros((robots, 3))
        self._drift, self._track = drift, track
        self.reseed(seed)
        self._scale = np.ones((robots, 2))

    def reseed(self, seed: np.random.SeedSequence) -> None:
        """Draw later errors from a new source."""
        self._rng = np.random.default_rng(seed)

    def reset(self, index: Indices, poses: Floats) -> None:
        """Start from true poses, (W, 3), of some robots."""
        self.poses[index] = poses
        if self._drift > 0.0:
            self._scale[index] = 1.0 + self._drift * self._rng.standard_normal((len(index), 2))

    def follow(self, before: Floats, after: Floats) -> None:
        """Take in how the robots moved, (E, 3) each, through what their wheels measured."""
        if self._drift == 0.0:
            self.poses = after
            return
        turned = wrap_angle(after[:, 2] - before[:, 2])
        chord = after[:, :2] - before[:, :2]
        middle = before[:, 2] + 0.5 * turned
        along = chord[:, 0] * np.cos(middle) + chord[:, 1] * np.sin(middle)
        half = 0.5 * turned
        travelled = along / np.sinc(half / np.pi)  # the arc over this chord
        left, right = (
            (travelled + side * 0.5 * self._track * turned) * self._scale[:, wheel]
            for wheel, side in enumerate((-1.0, 1.0))
        )
        speed, turn = 0.5 * (left + right), (right - left) / self._track
        self.poses = drive_arc(self.poses, speed, turn, 1.0)

    def keep(self, which: Booleans) -> None:
        """Go on with some of the robots only."""
        self.poses, self._scale = self.poses[which], self._scale[which]


class DelayLine:
    """The commands that are on their way to the motors of E robots.

    Parameters
    ----------
    robots : int
        E.
    delay : float
        Seconds on the way.
    interval : float
        Seconds between two commands.
    axes : int
        A, of a command.
    """

    def __init__(self, robots: int, delay: float, interval: float, axes: int = 2) -> None:
        self._dead_time = DeadTime(delay, interval)
        self._sent = np.zeros((self._dead_time.whole + 2, robots, axes))  # the newest first

    def reset(self, index: Indices) -> None:
        """Forget what was sent to some robots; they stand still until a new command arrives."""
        self._sent[:, index] = 0.0

    def send(self, commands: Floats) -> Sequence[tuple[float, Floats]]:
        """Send commands (E, A) and return what arrives in this interval: seconds and commands (E, A)."""
        rest, interval = self._dead_time.rest, self._dead_time.interval
        self._sent = np.concatenate([commands[None], self._sent[:-1]])
        if rest == 0.0:
            return [(interval, self._sent[-2])]
        return [(rest, self._sent[-1]), (interval - rest, self._sent[-2])]

    def keep(self, which: Booleans) -> None:
        """Go on with some of the robots only."""
        self._sent = self._sent[:, which]
