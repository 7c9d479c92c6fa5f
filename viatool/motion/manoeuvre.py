"""How a differential-drive robot moves while one command is held, and while it brakes afterwards.

A command (v, omega) that is held for t seconds moves the robot along a circular arc of length ``l = v t``
that turns it by ``phi = omega t``. With ``e(a) = (cos a, sin a)``, the position after the fraction s of the
arc is

    p(s) = p + s l * int_0^1 e(theta + s phi u) du = p + s l * sinc(s phi / 2) * e(theta + s phi / 2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from viatool.arrays import Floats
from viatool.motion.arcs import advance


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

    Notes
    -----
    The brakes act along the commanded curvature: v and omega fall in proportion and linearly to 0, as fast as
    no point within `rim` decelerates harder than `deceleration`. That takes ``(|v| + rim |omega|) /
    deceleration`` seconds and covers the arc that the full command would cover in half of that time. The
    whole path is hence the arc of the constant command over `seconds`, which makes braking a longer interval
    and nothing else.
    """

    interval: float
    deceleration: float | None = None
    rim: float = 0.0

    def seconds(self, speed: Floats, turn: Floats) -> Floats:
        """Return for how long the constant command would take to cover the same path.

        Parameters
        ----------
        speed, turn : ndarray
            (...) ``|v|`` in m/s and ``|omega|`` in rad/s; the result grows with both.

        Returns
        -------
        ndarray
            (...) seconds.
        """
        if self.deceleration is None:
            return np.full(np.broadcast_shapes(speed.shape, turn.shape), self.interval)
        return np.asarray(self.interval + 0.5 * (speed + self.rim * turn) / self.deceleration)

    def path(self, poses: Floats, actions: Floats, fractions: Floats) -> Floats:
        """Return the poses at fractions of the path.

        Parameters
        ----------
        poses, actions : ndarray
            (..., 3) and (..., 2).
        fractions : ndarray
            (...) in [0, 1].

        Returns
        -------
        ndarray
            (..., 3) poses.
        """
        seconds = self.seconds(np.abs(actions[..., 0]), np.abs(actions[..., 1]))
        return advance(poses, actions, seconds * fractions)

    def clock(self, actions: Floats, fractions: Floats) -> Floats:
        """Return after how many seconds the robot really is at fractions of the path.

        Parameters
        ----------
        actions : ndarray
            (..., 2) commands.
        fractions : ndarray
            (...) in [0, 1].

        Returns
        -------
        ndarray
            (...) seconds since the command began to act; later than at full speed while it brakes.
        """
        speed, turn = np.abs(actions[..., 0]), np.abs(actions[..., 1])
        at_full_speed = fractions * self.seconds(speed, turn)
        if self.deceleration is None:
            return np.asarray(at_full_speed)
        stop = (speed + self.rim * turn) / self.deceleration
        past = np.maximum(at_full_speed - self.interval, 0.0)
        left = np.sqrt(np.maximum(1.0 - 2.0 * past / np.where(stop > 0.0, stop, 1.0), 0.0))
        return np.where(past > 0.0, self.interval + stop * (1.0 - left), at_full_speed)

    def longest(self, lower: Floats, upper: Floats) -> Floats:
        """Return a bound of the length of the path over action boxes (..., 2); metres."""
        speed = np.maximum(np.abs(lower), np.abs(upper))
        return np.asarray(speed[..., 0] * self.seconds(speed[..., 0], speed[..., 1]))
