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
3. *Chords.* Between two instants the centre path has a length L and ends that are d apart. Any point of such a curve
   has distances from both ends that add up to at most L, so it lies within ``sqrt(L^2 - d^2) / 2`` of the chord.

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

    def spread(self, until: Floats) -> PathSpread:
        """Bound how far other paths are from the centre path at all instants until some, (C,); see the module."""
        held, (_, turn) = self.held(until), self.centre
        radius = 0.5 * (self.upper - self.lower)
        own = radius[..., 2] * held
        apart = np.cumsum(own, axis=1)
        swung = np.minimum(
            (apart - 0.5 * own) * held, _FARTHEST_APART * held
        )  # of the heading, over the stage
        aside = (self.fastest * swung).sum(axis=1)
        ahead, left = radius[..., 0] * held, radius[..., 1] * held
        slides = left.sum(axis=1) > ahead.sum(axis=1)
        major = np.where(slides[:, None], left, ahead)
        along = major.sum(axis=1)
        turned = turn * held
        middle = np.cumsum(turned, axis=1) - 0.5 * turned  # the heading in the middle of each stage
        mean = (major * middle).sum(axis=1) / np.where(along > 0.0, along, 1.0)
        across = major * (np.abs(middle - mean[:, None]) + 0.25 * np.abs(turned))
        aside = aside + np.where(slides, ahead.sum(axis=1), left.sum(axis=1)) + across.sum(axis=1)
        return PathSpread(mean + 0.5 * np.pi * slides, along, aside, apart[:, -1])


@dataclass(frozen=True, eq=False)
class PathSpread:
    """How far all paths of C cells are from the centre path, at equal instants.

    Parameters
    ----------
    direction : ndarray
        (C,) radians, in the frame in which paths begin: where `along` points.
    along, aside : ndarray
        (C,) metres by which they are ahead or behind at most, and beyond that in any direction.
    apart : ndarray
        (C,) radians by which their headings differ at most.
    """

    direction: Floats
    along: Floats
    aside: Floats
    apart: Floats


def sagitta_of(length: Floats, chord: Floats) -> Floats:
    """Bound how far curves of some length leave the chord between their ends, (C,) metres."""
    spare = _CHORD_ROUNDING * np.square(length)
    return np.asarray(0.5 * np.sqrt(np.maximum(np.square(length) - np.square(chord), 0.0) + spare))


def swath(first: Plane, last: Plane, spread: PathSpread) -> tuple[Plane, Plane, Floats]:
    """Return segments which, widened by a radius (C,), hold chords that are moved to and fro by `along`.

    The four ends of the moved chord are the corners of a parallelogram of which the segment is a diagonal. With the
    chord's part d along the direction and h across, the other two corners are ``2 along h / (d + 2 along)`` away.
    """
    unit = np.exp(1j * spread.direction)
    chord = (last - first) * unit.conj()
    shift = np.where(chord.real >= 0.0, 1.0, -1.0) * spread.along * unit
    both = 2.0 * spread.along
    reach = np.abs(chord.real) + both
    away = both * np.abs(chord.imag) / np.where(reach > 0.0, reach, 1.0)
    return first - shift, last + shift, away


class VaryingMotion(ABC):
    """What each of B robots may do from its observation on, whichever command of a box it is given then.

    Whoever says so is in charge of the profile; the geometry asks for nothing else.
    """

    @property
    @abstractmethod
    def end(self) -> Floats:
        """Return after how many seconds all motion that counts is over, whatever the command; (B,)."""

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
