"""How a robot moves while one command is held, and while it brakes afterwards."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from viatool.arrays import Floats
from viatool.motion.kinematics import DIFFERENTIAL
from viatool.motion.law import Directions, Kinematics, PathDeviation


@dataclass(frozen=True)
class Manoeuvre:
    """One command held for an interval and, if the robot shall be able to stop, braking after it.

    Parameters
    ----------
    interval : float
        Seconds for which the command is held.
    deceleration : float or None
        m/s^2 of the braking; None when nothing is asked after the interval.
    rim : float
        Distance from the robot's origin to the outermost point whose deceleration counts, in metres; 0 when
        the footprint looks the same in every heading.
    kinematics : Kinematics
        How a held command moves the robot.

    Notes
    -----
    The brakes act along the commanded path: all speeds fall in proportion and linearly to 0, as fast as
    no point within `rim` decelerates harder than `deceleration`. That takes ``(speed + rim turn) /
    deceleration`` seconds and covers the way that the full command would cover in half of that time. The
    whole path is hence that of the constant command over `seconds`, which makes braking a longer interval
    and nothing else.
    """

    interval: float
    deceleration: float | None = None
    rim: float = 0.0
    kinematics: Kinematics = DIFFERENTIAL

    def seconds(self, speed: Floats, turn: Floats) -> Floats:
        """Return for how long the constant command would take to cover the same path.

        Parameters
        ----------
        speed, turn : ndarray
            (...) m/s and rad/s, at least 0; the result grows with both.

        Returns
        -------
        ndarray
            (...) seconds.
        """
        if self.deceleration is None:
            return np.full(np.broadcast_shapes(speed.shape, turn.shape), self.interval)
        return np.asarray(self.interval + 0.5 * (speed + self.rim * turn) / self.deceleration)

    def duration(self, actions: Floats) -> Floats:
        """Return `seconds` of commands (..., A), as (...)."""
        return self.seconds(*self.kinematics.rates(actions, actions))

    def path(self, poses: Floats, actions: Floats, fractions: Floats) -> Floats:
        """Return the poses at fractions of the path.

        Parameters
        ----------
        poses, actions : ndarray
            (..., 3) and (..., A).
        fractions : ndarray
            (...) in [0, 1].

        Returns
        -------
        ndarray
            (..., 3) poses.
        """
        return self.kinematics.advance(poses, actions, self.duration(actions) * fractions)

    def clock(self, actions: Floats, fractions: Floats) -> Floats:
        """Return after how many seconds the robot really is at fractions of the path.

        Parameters
        ----------
        actions : ndarray
            (..., A) commands.
        fractions : ndarray
            (...) in [0, 1].

        Returns
        -------
        ndarray
            (...) seconds since the command began to act; later than at full speed while it brakes.
        """
        speed, turn = self.kinematics.rates(actions, actions)
        at_full_speed = fractions * self.seconds(speed, turn)
        if self.deceleration is None:
            return np.asarray(at_full_speed)
        stop = (speed + self.rim * turn) / self.deceleration
        past = np.maximum(at_full_speed - self.interval, 0.0)
        left = np.sqrt(np.maximum(1.0 - 2.0 * past / np.where(stop > 0.0, stop, 1.0), 0.0))
        return np.where(past > 0.0, self.interval + stop * (1.0 - left), at_full_speed)

    def longest(self, lower: Floats, upper: Floats) -> Floats:
        """Return a bound of the length of the path over boxes of commands (..., A); metres."""
        speed, turn = self.kinematics.rates(lower, upper)
        return np.asarray(speed * self.seconds(speed, turn))

    def extent(self, actions: Floats) -> tuple[Floats, Floats]:
        """Return the length in metres and the turn in radians of the paths of commands (..., A), at least 0."""
        speed, turn = self.kinematics.rates(actions, actions)
        seconds = self.seconds(speed, turn)
        return speed * seconds, turn * seconds

    def deviation(self, lower: Floats, upper: Floats, until: Floats, rim: float = 0.0) -> PathDeviation:
        """Bound how far commands of boxes (C, A) lead from where their centres lead, see `Kinematics.deviation`."""
        return self.kinematics.deviation(lower, upper, until, rim, self.seconds)

    def directions(self, lower: Floats, upper: Floats) -> Directions:
        """Bound where commands of boxes (C, A) displace the robot, see `Kinematics.directions`."""
        return self.kinematics.directions(lower, upper, self.seconds)

    def loss(self, lower: Floats, upper: Floats) -> Floats:
        """Return how far the extent of boxes (C, A) along each axis spreads where the path ends, roughly; (C, A)."""
        speed, turn = self.kinematics.rates(lower, upper)
        return self.kinematics.loss(upper - lower, speed, self.seconds(speed, turn))
