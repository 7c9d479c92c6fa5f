"""Things that move, as capsules: a segment and everything within a radius of it, somewhere within speed times time.

Nothing is promised of a capsule but its speed, so that after t seconds it may be at any place that is within ``speed
t`` of where it was, and its distance from a robot is at least what it was from where the robot is now, less ``speed
t``. A thing that goes straight at the robot attains that.

What has an inside is given by its rim alone: a robot that is outside at first and whose distance from the rim, grown
or not, never falls to 0 stays outside.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Booleans, Floats, Indices, Plane
from viatool.world.measurement import (
    point_edge_squared,
    segment_edge_squared,
    winding_number,
)

_CHUNK = 160_000
"""Capsules x robots that are measured at once."""
NOWHERE = 1e9 * (1.0 + 1.0j)
"""Where the capsules are that fill the arrays of a place with fewer than another: too far away to be near."""


@dataclass(frozen=True, eq=False)
class Capsules:
    """E capsules around each of S places.

    Parameters
    ----------
    first, second : ndarray
        (E, S) ends of their segments, points x + iy in metres, in the map frame, when they were observed.
    radii : ndarray
        (E, S) metres.
    speeds : ndarray
        (E, S) how fast each may move, in m/s.
    labels : tuple of str
        What they are, in the words of a report.
    named : ndarray, optional
        (E, S) the label of each; None where capsule e has label e everywhere.
    """

    first: Plane
    second: Plane
    radii: Floats
    speeds: Floats
    labels: tuple[str, ...]
    named: Indices | None = None

    def __len__(self) -> int:
        """Return E."""
        return len(self.first)

    @classmethod
    def stacked(cls, parts: Sequence[Capsules]) -> Capsules:
        """Return the capsules of several sets around the same places as one."""
        first, second, radii, speeds = (
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("first", "second", "radii", "speeds")
        )
        return cls(first, second, radii, speeds, tuple(label for part in parts for label in part.labels))

    @classmethod
    def beside(cls, parts: Sequence[Capsules]) -> Capsules:
        """Return several sets of E capsules, each around places of its own, as one."""
        first, second, radii, speeds = (
            np.concatenate([getattr(part, name) for part in parts], axis=1)
            for name in ("first", "second", "radii", "speeds")
        )
        return cls(first, second, radii, speeds, parts[0].labels)

    def filled(self, count: int, label: str) -> Capsules:
        """Return so many capsules with another label, the rest of which are nowhere."""
        shape = (count - len(self), self.first.shape[1])
        nowhere, none = np.full(shape, NOWHERE), np.zeros(shape)
        rest = Capsules(nowhere, nowhere, none, none, ("",) * shape[0])
        return replace(Capsules.stacked([self, rest]), labels=(label,) * count)

    @property
    def extent(self) -> float:
        """Return a bound of all coordinates and radii, in metres."""
        there = np.abs(self.first) < np.abs(NOWHERE)
        ends = np.maximum(np.abs(self.first), np.abs(self.second)) + self.radii
        return float(ends[there].max(initial=0.0))

    def fastest(self, index: Indices) -> Floats:
        """Return the largest speed at places (B,), (B,) m/s."""
        return np.asarray(self._fastest[index])

    @cached_property
    def _fastest(self) -> Floats:
        return np.asarray(self.speeds.max(axis=0, initial=0.0))

    def there(self, index: Indices) -> Booleans:
        """Tell at which places (B,) any capsule is, (B,)."""
        return np.asarray(self._there[index])

    @cached_property
    def _there(self) -> Booleans:
        return np.asarray((np.abs(self.first) < np.abs(NOWHERE)).any(axis=0))

    def within(self, points: Plane, index: Indices, seconds: Floats, limit: Floats) -> Capsules:
        """Return the capsules that may come within distances (B,) of points (B,) until some times (B,).

        They are those around B places, the points. Notes: sound, as what is left out stays farther away all along.
        """
        near = np.zeros((len(self), len(index)), dtype=bool)
        for some in self._chunks(len(index)):
            place = index[some]
            away = np.sqrt(point_edge_squared(points[some], self.first[:, place], self.second[:, place]))
            away = away - self.radii[:, place] - self.speeds[:, place] * seconds[some]
            near[:, some] = ~(away > limit[some])  # NaN is near
        most = int(near.sum(axis=0).max(initial=0))
        order = np.argsort(~near, axis=0, kind="stable")[:most]
        kept = np.take_along_axis(near, order, axis=0)
        first, second, radii, speeds = (
            np.where(kept, table[order, index], filler)
            for table, filler in (
                (self.first, NOWHERE), (self.second, NOWHERE), (self.radii, 0.0), (self.speeds, 0.0),
            )
        )  # fmt: skip
        named = order if self.named is None else self.named[order, index]
        return Capsules(first, second, radii, speeds, self.labels, named)

    def clearance(self, points: Plane, index: Indices, *seconds: Floats) -> list[Floats]:
        """Return the least distances of points (B,) from where capsules may be, for each of several times (B,).

        Parameters
        ----------
        points : ndarray
            (B,).
        index : ndarray
            (B,) at which place each is.
        seconds : ndarray
            (B,) each: for how long things have moved.

        Returns
        -------
        list of ndarray
            (B,) metres, one for each of the times; below 0 where a capsule may hold the point.

        Notes
        -----
        Sound: under rounding only (float64 to nearest); NaN where anything is NaN.
        """

        def measure(here: Indices, place: Indices) -> Floats:
            at = points[here]
            squared = point_edge_squared(at, self.first[:, place], self.second[:, place])
            return np.asarray(np.sqrt(squared))

        return self._least(measure, index, seconds)

    def segment_clearance(self, starts: Plane, ends: Plane, index: Indices, *seconds: Floats) -> list[Floats]:
        """Return the same for the points of segments between ends (B,)."""

        def measure(here: Indices, place: Indices) -> Floats:
            first, second = self.first[:, place], self.second[:, place]
            return np.asarray(np.sqrt(segment_edge_squared(starts[here], ends[here], first, second)))

        return self._least(measure, index, seconds)

    def outline_clearance(self, corners: Plane, index: Indices, *seconds: Floats) -> list[Floats]:
        """Return the same for the insides of counter-clockwise outlines, (n, B) corners."""
        following = np.roll(corners, -1, axis=0)

        def measure(here: Indices, place: Indices) -> Floats:
            first, second = self.first[:, place], self.second[:, place]
            nearest = np.full(first.shape, np.inf)
            for start, end in zip(corners[:, here], following[:, here], strict=True):
                np.minimum(nearest, segment_edge_squared(start, end, first, second), out=nearest)
            for row, ends in enumerate(first):  # a capsule may lie wholly within the outline
                nearest[row, winding_number(ends, corners[:, here], following[:, here]) > 0] = 0.0
            return np.asarray(np.sqrt(nearest))

        return self._least(measure, index, seconds)

    def _least(
        self, measure: Callable[[Indices, Indices], Floats], index: Indices, seconds: Sequence[Floats]
    ) -> list[Floats]:
        """Return the least distance for each of several times, some robots at a time."""
        found = [np.full(len(index), np.inf) for _ in seconds]
        if not len(self):
            return found
        for some in self._chunks(len(index)):
            place = index[some]
            away = measure(some, place) - self.radii[:, place]
            for least, time in zip(found, seconds, strict=True):
                least[some] = (away - self.speeds[:, place] * time[some]).min(axis=0)
        return found

    def _chunks(self, count: int) -> Iterator[Indices]:
        step = max(1, math.ceil(count / max(1, math.ceil(count * len(self) / _CHUNK))))
        for first in range(0, count, step):
            yield np.arange(first, min(first + step, count))

    def nearest(self, corners: Plane, index: Indices, seconds: Floats) -> Nearest:
        """Return which capsule may be nearest to outlines, or to points as outlines of one corner, (n, B)."""
        shape = (len(self), len(index))
        apart, origin, target = np.full(shape, np.inf), np.zeros(shape, complex), np.zeros(shape, complex)
        first, second = self.first[:, index], self.second[:, index]
        for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            for ours, theirs in (
                (start, _foot(start, first, second)),
                (_foot(first, start, end), first),
                (_foot(second, start, end), second),
            ):
                ours = np.broadcast_to(ours, shape)
                nearer = np.abs(ours - theirs) < apart
                apart = np.where(nearer, np.abs(ours - theirs), apart)
                origin, target = np.where(nearer, theirs, origin), np.where(nearer, ours, target)
        left = apart - self.radii[:, index] - self.speeds[:, index] * seconds
        which, rows = left.argmin(axis=0), np.arange(len(index))
        origin, target, left = origin[which, rows], target[which, rows], left[which, rows]
        towards = target - origin
        far = np.abs(towards)
        towards = towards / np.where(far > 0.0, far, 1.0)
        speed, radius = self.speeds[:, index][which, rows], self.radii[:, index][which, rows]
        named = which if self.named is None else self.named[:, index][which, rows]
        labels = np.array(self.labels)[named]
        return Nearest(left, labels, origin + np.minimum(radius, far) * towards, speed * towards)


@dataclass(frozen=True, eq=False)
class Nearest:
    """Which capsule may come nearest to each of B robots.

    Parameters
    ----------
    left : ndarray
        (B,) metres that are then left, as of `Capsules.clearance`.
    labels : ndarray
        (B,) what it is.
    origin, velocity : ndarray
        (B,) the point of it that comes nearest, when it was observed, and how it goes straight at the robot; m and m/s.
    """

    left: Floats
    labels: NDArray[np.str_]
    origin: Plane
    velocity: Plane

    def or_nearer(self, other: Nearest) -> Nearest:
        """Return for each robot what comes nearer."""
        nearer = other.left < self.left
        return Nearest(
            *(
                np.where(nearer, getattr(other, name), getattr(self, name))
                for name in ("left", "labels", "origin", "velocity")
            )
        )


def _foot(points: Plane, first: Plane, second: Plane) -> Plane:
    """Return the points of segments that are nearest to points."""
    edge = second - first
    square = np.square(np.abs(edge))
    share = ((points - first) * np.conj(edge)).real / np.where(square > 0.0, square, 1.0)
    return np.asarray(first + np.clip(share, 0.0, 1.0) * edge)
