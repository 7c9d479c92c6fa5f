"""What a LiDAR saw as things that may move, and where things may be that it could not see.

The fan is cut into *wedges*: around every ray half of the way to the next ones, where nothing is taken to hide nearer
than the ray reads; neighbours that share a reading are one wedge, and wide ones are cut again. Where neighbours are
much farther apart than most, the LiDAR does not look: those wedges are *blind*.

A wedge that reads r holds

1. of one ray, something at r, within the sensor's error: the chord of the arc, widened by the error and by how far
   the arc leaves its chord;
2. of several rays of which the least counts, something anywhere from r on; and the same of what cannot be seen: behind
   r, or from a given distance on in a blind wedge. The free region, the union of all triangles between the sensor and
   chords, then has nothing in it. Its rim are the chords, and the *jumps* between the readings of neighbours.

Chords lie on the sensor's side of their arcs, so that the free region is smaller than what was seen to be free.

Where the whole scan may be *turned* by up to a, a ray looks anywhere within a of where it is said to look. Then what
one ray saw is in a wedge that is wider by a on both sides, and a direction is free only as far as every wedge reads
that begins within a of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from viatool.arrays import Booleans, Floats, Indices, Plane
from viatool.world.capsules import NOWHERE, Capsules
from viatool.world.lidar import Lidar
from viatool.world.measurement import as_plane

_WIDEST = 0.2
"""Radians of a wedge, so that its chord is hardly nearer than its arc."""
_BLIND = 1.5
"""Times the usual gap between neighbouring rays from which on the LiDAR does not look in between."""
_LONE = 0.01
"""Radians to either side of a ray without neighbours."""
_FAR = 1e3
"""Metres that jumps reach into what nobody looks at."""

RETURN, HIDDEN = "something that the LiDAR saw", "something that the LiDAR could not see"


@dataclass(frozen=True, eq=False)
class Wedges:
    """The whole turn around a LiDAR as K wedges, counter-clockwise.

    Parameters
    ----------
    right, left : ndarray
        (K,) radians from the forward axis.
    bin : ndarray
        (K,) whose reading it is; -1 for blind ones.
    """

    right: Floats
    left: Floats
    bin: Indices

    @classmethod
    def of(cls, lidar: Lidar) -> Wedges:
        """Cut the turn around a LiDAR; of bins of which the first ray counts alone, the others are not there."""
        lidar = lidar.unreduced if lidar.reduce == "first" else lidar
        bearing, ray = lidar.around
        each = ray // lidar.each
        gaps = np.diff(bearing, append=bearing[:1] + 2.0 * np.pi)
        usual = float(np.median(gaps)) if len(gaps) > 1 else 2.0 * _LONE
        after = np.where(gaps > _BLIND * usual, 0.5 * usual, 0.5 * gaps)  # radians to the left of each ray
        parts: list[tuple[float, float, int]] = []
        begin = float(bearing[0] - after[-1])
        for number in range(len(bearing)):
            end = float(bearing[number] + after[number])
            ends = number + 1 == len(bearing) or each[number + 1] != each[number]
            if ends or gaps[number] > _BLIND * usual:
                parts.append((begin, end, int(each[number])))
                begin = end
                if gaps[number] > _BLIND * usual:
                    begin = float(bearing[number] + gaps[number] - 0.5 * usual)
                    parts.append((end, begin, -1))
        fine = [
            (low + (high - low) * k / count, low + (high - low) * (k + 1) / count, which)
            for low, high, which in parts
            for count in [max(1, int(np.ceil((high - low) / _WIDEST)))]
            for k in range(count)
        ]
        right, left, bins = (np.array(column) for column in zip(*fine, strict=True))
        return cls(right, left, bins)

    @property
    def blind(self) -> Booleans:
        """Tell in which wedges the LiDAR does not look, (K,)."""
        return np.asarray(self.bin < 0)

    def of_bins(self, readings: Floats, otherwise: float) -> Floats:
        """Return (B, K) of what belongs to bins (B, bins), and a number for blind wedges."""
        return np.where(self.blind, otherwise, readings[:, np.maximum(self.bin, 0)])

    def of_half(self, half: Floats) -> Wedges:
        """Return wedges around the same directions, to (K,) radians on either side of them."""
        middle = 0.5 * (self.right + self.left)
        return Wedges(middle - half, middle + half, self.bin)

    def least_around(self, ranges: Floats, turn: float) -> Floats:
        """Return the least of what wedges that come within `turn` radians of each read, (B, K) as their ranges."""
        least, width = ranges, self.left - self.right
        between = np.zeros(len(width))  # radians from each wedge to the next one that is looked at
        for shift in range(1, len(width)):
            met = between < turn
            if not met.any():
                break
            left = np.where(met, np.roll(ranges, -shift, axis=1), np.inf)
            right = np.where(np.roll(met, shift), np.roll(ranges, shift, axis=1), np.inf)
            least = np.minimum(least, np.minimum(left, right))
            between = between + np.roll(width, -shift)
        return least


@dataclass(frozen=True)
class Unseen:
    """How fast things are that a LiDAR saw, or could not see.

    Parameters
    ----------
    returns, hidden : float or None
        m/s; None where no such thing is there.
    behind : float or None
        Metres within which nothing was where the LiDAR does not look; None where nothing is there at all.
    """

    returns: float | None
    hidden: float | None
    behind: float | None


def things_around(
    lidar: Lidar, least: Floats, most: Floats, poses: Floats, unseen: Unseen, turn: float = 0.0
) -> Capsules:
    """Return what may come from where a LiDAR looked.

    Parameters
    ----------
    lidar : Lidar
        What its bins are; of several rays the least or the first counts.
    least, most : ndarray
        (B, bins) metres between which the true range of each bin is, at most the maximum range.
    poses : ndarray
        (B, 3) where it stood.
    unseen : Unseen
        What is asked.
    turn : float
        Radians by which the whole scan may be turned, either way.

    Returns
    -------
    Capsules
        Around each of B poses.

    Notes
    -----
    Sound: everything that was beyond the readings, and with `hidden` everything that was not seen to be free, was in
    one of the capsules or farther from every place that can be reached without touching one.
    """
    wedges = Wedges.of(lidar)
    several = lidar.each > 1 and lidar.reduce == "minimum"
    origin, ahead = as_plane(poses)[:, None], np.exp(1j * poses[:, 2])[:, None]
    absent = np.inf if unseen.behind is None or unseen.hidden is None else unseen.behind
    if unseen.hidden is None and not several:
        low, high = wedges.of_bins(least, 0.0), wedges.of_bins(most, 0.0)
        seen = np.broadcast_to(~wedges.blind, low.shape)
        middle = 0.5 * (low + high)
        half = np.minimum(0.5 * (wedges.left - wedges.right) + turn, np.pi)
        bulge = middle * (1.0 - np.cos(half))
        chords = _chords(wedges.of_half(half), middle, origin, ahead, seen)
        return _capsules(chords, 0.5 * (high - low) + bulge, unseen.returns or 0.0, RETURN)
    low = wedges.least_around(wedges.of_bins(least, absent), turn)
    fastest = max(unseen.returns or 0.0, unseen.hidden or 0.0)
    chords = _chords(wedges, np.where(np.isfinite(low), low, 0.0), origin, ahead, np.isfinite(low))
    rim = _capsules(chords, np.zeros(low.shape), fastest, HIDDEN if unseen.returns is None else RETURN)
    jumps = _jumps(wedges, low, origin, ahead)
    speed = fastest if several else unseen.hidden or 0.0
    label = RETURN if unseen.hidden is None else HIDDEN
    return Capsules.stacked([rim, _capsules(jumps, np.zeros(jumps[0].shape), speed, label)])


def _chords(
    wedges: Wedges, ranges: Floats, origin: Plane, ahead: Plane, there: Booleans
) -> tuple[Plane, Plane]:
    """Return both ends (B, K) of the chords of arcs at ranges (B, K), in the map frame."""
    right, left = (origin + ahead * ranges * np.exp(1j * angle) for angle in (wedges.right, wedges.left))
    return np.where(there, right, NOWHERE), np.where(there, left, NOWHERE)


def _jumps(wedges: Wedges, ranges: Floats, origin: Plane, ahead: Plane) -> tuple[Plane, Plane]:
    """Return both ends (B, K) of what is between the ranges (B, K) of neighbours, at the left of each wedge."""
    other = np.roll(ranges, -1, axis=1)
    near, far = np.minimum(ranges, other), np.minimum(np.maximum(ranges, other), _FAR)
    there = near < far
    along = ahead * np.exp(1j * wedges.left)
    near, far = np.where(there, near, 0.0), np.where(there, far, 0.0)
    return (
        np.where(there, origin + near * along, NOWHERE),
        np.where(there, origin + far * along, NOWHERE),
    )


def _capsules(ends: tuple[Plane, Plane], radii: Floats, speed: float, label: str) -> Capsules:
    first, second = ends
    count = first.shape[1]
    return Capsules(first.T, second.T, radii.T, np.full(radii.T.shape, speed), (label,) * count)
