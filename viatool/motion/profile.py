"""Velocities that vary within bounds: where a robot can be whose velocity lies in a known box at every instant.

Whatever keeps a robot from having the velocity that it is told to have (motors that take time, gains that are off,
slip, commands that act late or for another time, brakes that take hold sooner or later) ends as one thing: a box of
velocities for every instant. What follows from there is said here once.

A *profile* cuts the time since the observation into stages, each with a box of velocities in the robot's frame.
Within its box the velocity may vary arbitrarily (measurably), and need not be continuous. The *centre path* has in
each stage the velocity of the box's middle: ``u_c`` (a complex number, x ahead and y to the left) and ``w_c``; it is
one arc after another. Of another path with u and w, ``|w - w_c| <= r_w``, whatever else they do:

1. *Headings* are at most ``Theta(t) = int_0^t r_w`` apart.
2. *Places* follow ``p' = u e(theta)``, ``e(a) = (cos a, sin a)``, and

       u e(theta) - u_c e(theta_c) = (u - u_c) e(theta_c) + u (e(theta) - e(theta_c)).

   The second part is at most ``|u| min(Theta, 2)``. The first is a sum of ``(a + i b) e(theta_c)`` with a and b
   within the half-widths ``r_a`` and ``r_b`` ahead and to the left. The larger one of the two (over the time) points
   nearly the same way all along: turned to a common direction m it is ``a cos(theta_c - m)`` along m, at most ``int
   r_a``, and at most ``int r_a |theta_c - m|`` across. The smaller one counts in every direction.

   So the places of all paths until t lie within the centre path's, a segment of half-length *along* in the direction
   m, and a disc of radius *aside*. A robot that is faster or slower than the centre is ahead of it or behind it, not
   beside it: it is this which keeps corridors passable.
3. *Chords.* A curve of length L whose ends are d apart lies within ``sqrt(L^2 - d^2) / 2`` of its chord, as the
   distances of any of its points from both ends add up to at most L. Both ends of the segment move on such curves, with
   the velocities ``u_c e(theta_c) -+ r_a e(m)``, of sizes up to ``|u_c -+ r_a| + r_a |theta_c - m|``. So a robot that
   drives forward is not taken to fall back behind where it was.

All integrals are sums over stages of closed forms, as boxes are constant in each.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from viatool.arrays import Floats, Indices, Plane
from viatool.motion.arcs import sinc

_FARTHEST_APART = 2.0
"""Of two directions."""
_CHORD_ROUNDING = 2.0**-40
"""Share of the square of a length that covers the rounding of what two squares differ by."""


@dataclass(frozen=True, eq=False)
class VelocityProfile:
    """Boxes of velocities over time, of C cells.

    Parameters
    ----------
    edges : ndarray
        (C, K + 1) seconds since the observation at which stages begin and end, growing from 0 on; a stage may be empty.
        Afterwards the robot stands.
    lower, upper : ndarray
        (C, K, 3) speed ahead and to the left in m/s, and turning speed in rad/s: at every instant of stage k the
        velocity lies between them, and may vary arbitrarily (measurably).
    """

    edges: Floats
    lower: Floats
    upper: Floats

    def __len__(self) -> int:
        """Return C."""
        return len(self.edges)

    @property
    def fastest(self) -> Floats:
        """Return the largest speed of each stage, (C, K) m/s."""
        largest = np.maximum(np.abs(self.lower), np.abs(self.upper))
        return np.asarray(np.hypot(largest[..., 0], largest[..., 1]))

    @property
    def longest(self) -> Floats:
        """Return a bound of the length of all paths, (C,) metres."""
        return np.asarray((self.fastest * np.diff(self.edges, axis=1)).sum(axis=1))

    @property
    def most_turned(self) -> Floats:
        """Return a bound of what all paths turn by to and fro, (C,) radians."""
        fastest = np.maximum(np.abs(self.lower[..., 2]), np.abs(self.upper[..., 2]))
        return np.asarray((fastest * np.diff(self.edges, axis=1)).sum(axis=1))

    @property
    def centre(self) -> tuple[Plane, Floats]:
        """Return the velocity of the centre path in each stage, (C, K): m/s ahead and to the left, and rad/s."""
        middle = 0.5 * (self.lower + self.upper)
        return middle[..., 0] + 1j * middle[..., 1], middle[..., 2]

    def held(self, until: Floats) -> Floats:
        """Return for how much of each stage time has passed, (C, K) seconds, until instants (C,)."""
        begins = self.edges[:, :-1]
        return np.asarray(np.clip(until[:, None], begins, self.edges[:, 1:]) - begins)

    def place(self, at: Floats) -> tuple[Plane, Floats]:
        """Return where the centre path is at instants (C,), in metres and radians from where it begins."""
        velocity, turn = self.centre
        heading = np.cumsum(turn * np.diff(self.edges, axis=1), axis=1)
        heading = np.concatenate([np.zeros((len(self), 1)), heading[:, :-1]], axis=1)  # where stages begin
        held = self.held(at)
        half = 0.5 * turn * held
        moved = velocity * held * sinc(half) * np.exp(1j * (heading + half))
        return np.asarray(moved.sum(axis=1)), np.asarray((turn * held).sum(axis=1))

    def extent(self, start: Floats, end: Floats) -> tuple[Floats, Floats]:
        """Return how long the centre path is between instants (C,), and by how much it turns to and fro."""
        velocity, turn = self.centre
        between = self.held(end) - self.held(start)
        return (np.abs(velocity) * between).sum(axis=1), (np.abs(turn) * between).sum(axis=1)

    def spread(self, start: Floats, end: Floats) -> PathSpread:
        """Bound how far other paths are from the centre path between two instants, (C,); see the module."""
        velocity, turn = self.centre
        radius = 0.5 * (self.upper - self.lower)
        before, until = self.held(start), self.held(end)
        apart, swung = _headings(radius[..., 2], until)
        ahead, left = radius[..., 0] * until, radius[..., 1] * until
        slides = left.sum(axis=1) > ahead.sum(axis=1)
        major = np.where(slides[:, None], radius[..., 1], radius[..., 0])
        along = (major * until).sum(axis=1)
        turned = turn * until
        middle = np.cumsum(turned, axis=1) - 0.5 * turned  # the heading in the middle of each stage
        mean = (major * until * middle).sum(axis=1) / np.where(along > 0.0, along, 1.0)
        across = major * (np.abs(middle - mean[:, None]) + 0.25 * np.abs(turned))
        aside = (self.fastest * swung + across * until).sum(axis=1)
        aside = aside + np.where(slides, ahead.sum(axis=1), left.sum(axis=1))
        forward = np.where(slides[:, None], -1j * velocity, velocity)
        slow, fast = (
            ((np.abs(forward + side * major) + across) * (until - before)).sum(axis=1) for side in (-1.0, 1.0)
        )
        first = (major * before).sum(axis=1)
        return PathSpread(mean + 0.5 * np.pi * slides, first, along, slow, fast, aside, apart)


@dataclass(frozen=True, eq=False)
class PathSpread:
    """How far all paths of C cells are from the centre path, at equal instants between two.

    Parameters
    ----------
    direction : ndarray
        (C,) radians, in the frame in which paths begin: where `along` points.
    first, along : ndarray
        (C,) metres by which they are ahead or behind at most, at the first and at the last instant.
    slow, fast : ndarray
        (C,) metres that the places on either end of these segments move by at most in between.
    aside : ndarray
        (C,) metres by which they are beyond that in any direction.
    apart : ndarray
        (C,) radians by which their headings differ at most.
    """

    direction: Floats
    first: Floats
    along: Floats
    slow: Floats
    fast: Floats
    aside: Floats
    apart: Floats

    def swath(self, start: Plane, end: Plane) -> tuple[Plane, Plane, Floats]:
        """Return segments which, widened by a radius (C,), hold the places that are ahead or behind centres (C,).

        At each instant these lie on a segment. Its ends move from where they are at the first instant to where they are
        at the last one, so they leave the chords in between by a sagitta at most; and both chords lie within the
        segment from the rearmost to the foremost of their four ends, and as far from it as these are.
        """
        unit = np.exp(1j * self.direction)
        rear = np.stack([start - self.first * unit, end - self.along * unit])
        front = np.stack([start + self.first * unit, end + self.along * unit])
        bent = np.maximum(
            sagitta_of(self.slow, np.abs(rear[1] - rear[0])),
            sagitta_of(self.fast, np.abs(front[1] - front[0])),
        )
        every = np.concatenate([rear, front])
        progress = (every * unit.conj()).real
        index = np.arange(every.shape[1])
        tail, head = every[progress.argmin(axis=0), index], every[progress.argmax(axis=0), index]
        chord = head - tail
        length = np.abs(chord)
        share = ((every - tail) * chord.conj()).real / np.where(length > 0.0, np.square(length), 1.0)
        away = np.abs(every - tail - np.clip(share, 0.0, 1.0) * chord).max(axis=0)
        return tail, head, bent + away


def _headings(radius: Floats, held: Floats) -> tuple[Floats, Floats]:
    """Return by how much headings differ at the end, (C,) radians, and what that adds for each m/s, (C, K) seconds."""
    own = radius * held
    apart = np.cumsum(own, axis=1)
    return apart[:, -1], np.minimum((apart - 0.5 * own) * held, _FARTHEST_APART * held)


def sagitta_of(length: Floats, chord: Floats) -> Floats:
    """Bound how far curves of some length leave the chord between their ends, (C,) metres."""
    spare = _CHORD_ROUNDING * np.square(length)
    return np.asarray(0.5 * np.sqrt(np.maximum(np.square(length) - np.square(chord), 0.0) + spare))


class VaryingMotion(ABC):
    """What each of B robots may do from its observation on, whichever command of a box it is given then.

    Whoever says so is in charge of the profile; the geometry asks for nothing else.
    """

    @property
    @abstractmethod
    def end(self) -> Floats:
        """Return after how many seconds all motion that counts is over, whatever the command; (B,)."""

    @property
    @abstractmethod
    def stands(self) -> Floats:
        """Return after how many seconds robots stand, so that what comes near no longer counts; (B,).

        This is time as it passes. A profile may tell what it lets them do last by a clock of its own, see `counted`.
        """

    @abstractmethod
    def counted(self, state: Indices, until: Floats) -> Floats:
        """Return for how many seconds things have moved at most until instants (C,) of the profiles of robots (C,)."""

    @abstractmethod
    def profile(self, state: Indices, lower: Floats, upper: Floats) -> VelocityProfile:
        """Bound the velocities of robots (C,) that are given a command of boxes (C, A).

        Notes
        -----
        Sound: every velocity that the robot can have after any command of the box lies within the profile, at every
        instant since the observation; and what a smaller box gives lies within what a larger one gives, at the same
        instants.
        """

    @abstractmethod
    def shares(self, lower: Floats, upper: Floats, seconds: Floats, rim: float) -> Floats:
        """Return how many metres the extent of boxes (C, A) adds along each axis until then, roughly: which to cut."""
