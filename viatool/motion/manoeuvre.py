"""How a robot moves while one command is held, and while it brakes afterwards."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from viatool.arrays import Booleans, Floats, Indices
from viatool.errors import ConfigurationError
from viatool.motion.kinematics import DIFFERENTIAL
from viatool.motion.law import Directions, Kinematics, PathDeviation
from viatool.rounding import CLOCK_ROUNDING, SLIGHTLY_MORE


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
    begins : float
        Seconds since the observation at which the command begins to act.
    passive : bool
        Whether what moves counts only until the robot stands (passive safety).

    Notes
    -----
    The brakes act along the path of the velocity at the end of the interval: all speeds fall in proportion and linearly
    to 0, as fast as no point within `rim` decelerates harder than `deceleration`. That takes ``(speed + rim turn) /
    deceleration`` seconds and covers the way that the full velocity would cover in half of that time. The
    whole path is hence that of a velocity which stays from then on until `seconds`, which makes braking a longer
    interval and nothing else. Steered wheels keep their angle while a car brakes.

    Raises
    ------
    ConfigurationError
        If the deceleration is given and not above 0.
    """

    interval: float
    deceleration: float | None = None
    rim: float = 0.0
    kinematics: Kinematics = DIFFERENTIAL
    begins: float = 0.0
    passive: bool = False

    def __post_init__(self) -> None:
        if self.deceleration is not None and not self.deceleration > 0.0:
            raise ConfigurationError(
                f"a robot that brakes with {self.deceleration:g} m/s^2 never stops",
                "give a deceleration above 0, or choose the criterion swept",
            )

    def seconds(self, speed: Floats, turn: Floats) -> Floats:
        """Return for how long the constant command would take to cover the same path.

        Parameters
        ----------
        speed, turn : ndarray
            (...) m/s and rad/s at the end of the interval, at least 0; the result grows with both.

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
        return self.seconds(*self.kinematics.last_rates(actions, actions, self.interval))

    def stopping(self, actions: Floats) -> Floats:
        """Return how many seconds robots with commands (..., A) brake until they stand, (...); 0 without brakes."""
        return np.asarray(2.0 * (self.duration(actions) - self.interval))

    def braked(self, actions: Floats, intervals: Indices) -> Floats:
        """Return the commands that, held for one interval after the other, brake as the brakes do.

        Parameters
        ----------
        actions : ndarray
            (..., A) commands that are given up, each part a velocity.
        intervals : ndarray
            (...) whole intervals since the brakes took hold.

        Returns
        -------
        ndarray
            (..., A) commands: the share that brakes leave of the velocity, on average over the interval.

        Notes
        -----
        All parts fall in proportion, so the robot stays on the path of the command. When an interval ends it is where
        the brakes would have brought it by then, and it is never beyond where they bring it at last.
        """
        stop, interval = self.stopping(actions), self.interval
        safe = np.where(stop > 0.0, stop, 1.0)
        ends = [np.minimum((intervals + more) * interval / safe, 1.0) for more in (0, 1)]
        covered = [end - 0.5 * np.square(end) for end in ends]
        share = np.where(stop > 0.0, safe / interval * (covered[1] - covered[0]), 0.0)
        return np.asarray(share[..., None] * actions)

    def path(self, poses: Floats, actions: Floats, fractions: Floats) -> Floats:
        """Return the poses at fractions of the path.

        Parameters
        ----------
        poses, actions : ndarray
            (..., 3) and (..., A), behind it the state of the motion if it has one.
        fractions : ndarray
            (...) in [0, 1].

        Returns
        -------
        ndarray
            (..., 3) poses.
        """
        return self.kinematics.drive(poses, actions, self.duration(actions) * fractions, self.interval)

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
        return self._after(*self.kinematics.last_rates(actions, actions, self.interval), fractions)

    def _after(self, speed: Floats, turn: Floats, fractions: Floats) -> Floats:
        at_full_speed = fractions * self.seconds(speed, turn)
        if self.deceleration is None:
            return np.asarray(at_full_speed)
        stop = (speed + self.rim * turn) / self.deceleration
        past = np.maximum(at_full_speed - self.interval, 0.0)
        left = np.sqrt(np.maximum(1.0 - 2.0 * past / np.where(stop > 0.0, stop, 1.0), 0.0))
        return np.where(past > 0.0, self.interval + stop * (1.0 - left), at_full_speed)

    def moves(self, lower: Floats, upper: Floats) -> Booleans:
        """Tell which commands of boxes (..., A) move a point of the footprint: drive it, or turn its corners."""
        speed, turn = self.kinematics.rates(lower, upper, self.interval)
        return np.asarray(~((speed == 0.0) & (self.rim * turn == 0.0)))

    def counted(self, actions: Floats, fractions: Floats) -> Floats:
        """Return for how long things have moved since the observation, where that counts, at fractions; seconds.

        A robot that stands is at no fault: where only what happens while it moves counts, nothing has moved then.
        """
        seconds = self.begins + self.clock(actions, fractions)
        return np.where(self.moves(actions, actions), seconds, 0.0) if self.passive else seconds

    def counted_between(
        self, actions: Floats, lower: Floats, upper: Floats, start: Floats, end: Floats
    ) -> tuple[Floats, Floats]:
        """Bound `counted` of one command from below at a fraction, and of a box from above at a later one.

        Parameters
        ----------
        actions, lower, upper : ndarray
            (C, A) the command, and the ends of the box.
        start, end : ndarray
            (C,) fractions of the path.

        Returns
        -------
        tuple of ndarray
            (C,) seconds: of the command at `start` or later at least, of any command of the box until `end` at most.

        Notes
        -----
        Sound: yes; rounding is counted. `clock` grows with the fraction, with the speed and with the turning speed:
        where brakes act, with ``m = speed + rim turn`` and ``c = 2 interval deceleration``, it is ``interval +
        (m - sqrt((1 - s) (m^2 + c m))) / deceleration``. Brakes act where ``(1 - s) (m + c) <= m``, and there the slope
        in m is at least ``1 - (m + c / 2) / (m + c)`` of ``1 / deceleration``, which is positive.
        """
        speed, turn = self.kinematics.last_rates(lower, upper, self.interval)
        brakes = 0.0 if self.deceleration is None else (speed + self.rim * turn) / self.deceleration
        spare, last = CLOCK_ROUNDING * (self.interval + brakes), self.interval + brakes
        latest = self.begins + np.minimum(self._after(speed, turn, end) + spare, last * SLIGHTLY_MORE)
        earliest = self.begins + np.maximum(self.clock(actions, start) - spare, 0.0)
        if not self.passive:
            return earliest, np.asarray(latest)
        alone, any_of_them = self.moves(actions, actions), self.moves(lower, upper)
        return np.where(alone, earliest, 0.0), np.where(any_of_them, latest, 0.0)

    def longest(self, lower: Floats, upper: Floats) -> Floats:
        """Return a bound of the length of the path over boxes of commands (..., A); metres."""
        speed, _ = self.kinematics.rates(lower, upper, self.interval)
        return np.asarray(speed * self._most_seconds(lower, upper))

    def extent(self, actions: Floats) -> tuple[Floats, Floats]:
        """Return the length in metres and the turn in radians of the paths of commands (..., A) at most, at least 0."""
        speed, turn = self.kinematics.rates(actions, actions, self.interval)
        seconds = self.duration(actions)
        return speed * seconds, turn * seconds

    def sagitta(self, actions: Floats, span: Floats) -> Floats:
        """Bound how far the paths of commands (C, A) leave their chords, see `Kinematics.sagitta`."""
        return self.kinematics.sagitta(actions, self, span)

    def _most_seconds(self, lower: Floats, upper: Floats) -> Floats:
        """Return how long the path of a command of boxes (..., A) lasts at most, (...)."""
        return self.seconds(*self.kinematics.last_rates(lower, upper, self.interval))

    def deviation(self, lower: Floats, upper: Floats, until: Floats, rim: float = 0.0) -> PathDeviation:
        """Bound how far commands of boxes (C, A) lead from where their centres lead, see `Kinematics.deviation`."""
        return self.kinematics.deviation(lower, upper, until, rim, self)

    def directions(self, lower: Floats, upper: Floats) -> Directions:
        """Bound where commands of boxes (C, A) displace the robot, see `Kinematics.directions`."""
        return self.kinematics.directions(lower, upper, self)

    def loss(self, lower: Floats, upper: Floats) -> Floats:
        """Return how far the extent of boxes (C, A) along each axis spreads where the path ends, roughly; (C, A)."""
        speed, _ = self.kinematics.rates(lower, upper, self.interval)
        return self.kinematics.loss(upper - lower, speed, self._most_seconds(lower, upper))
