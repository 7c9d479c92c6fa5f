"""LiDAR readings, each channel with a LiDAR of its own."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from viatool.arrays import Floats, Indices, Reals
from viatool.channels.channel import Channel
from viatool.channels.fan import Fan
from viatool.channels.quantity import Part, Quantity, observes
from viatool.channels.views import BoxView, Extent, RecordedInstants, View
from viatool.errors import PolicyError
from viatool.sets.forms import Forms
from viatool.sight.scan import enclose_losing, gaps_of, has_gaps
from viatool.sight.windows import Gaps
from viatool.world import Lidar

_SHORTEST = 0.01
"""Metres that a LiDAR sees beyond its least range, however little its network tells apart."""
_LEAST_JUMP = 0.05
"""Metres by which a reading has to jump for its sides to be told apart."""


@observes("lidar")
@dataclass(frozen=True, eq=False)
class LidarReadings(Quantity):
    """The bins of a LiDAR: the channel's own, or the robot's where it describes none.

    Parameters
    ----------
    farthest : float
        Over sets of states it is enclosed as one of this range in metres, if it has more: what is farther is told apart
        by nothing.
    """

    farthest: float = np.inf

    believes = False
    needs = frozenset({"scan"})

    @classmethod
    def check(cls, channel: Channel) -> None:
        """Check that there is a number for each bin."""
        if channel.lidar is not None and channel.lidar.bins != channel.size:
            raise ValueError(
                f"channel '{channel.name}' has size {channel.size} but {channel.lidar.bins} LiDAR bins"
            )

    @property
    def described(self) -> bool:
        """Whether it is known which LiDAR the readings come from."""
        return self.channel.lidar is not None or self.channel.size == self.robot.lidar.bins

    @cached_property
    def fan(self) -> Fan:
        """The rays, with the robot's noise.

        Raises
        ------
        PolicyError
            If the channel describes no LiDAR, and the robot's has another number of bins.
        """
        asked, robot = self.channel.lidar, self.robot
        if self.described:
            return Fan(robot.lidar if asked is None else asked.lidar(robot.lidar.noise))
        raise PolicyError(
            f"observation channel '{self.channel.name}' has {self.channel.size} numbers, "
            f"but the LiDAR of {robot.name} has {robot.lidar.bins} bins",
            "describe the LiDAR in the policy's specification",
        )

    def require(self, part: Part) -> None:
        """Refuse a channel that does not say how its readings are binned."""
        super().require(part)
        if part == "record" and self.channel.lidar is None:
            raise PolicyError(
                f"observation channel '{self.channel.name}' does not say how its readings are binned",
                "describe the LiDAR in the policy's specification",
            )
        if part in ("measure", "enclose"):
            _ = self.fan

    def measure(self, view: View) -> Reals:
        """Return the least range of each bin; in an obstacle and off the map, the least that the LiDAR reads."""
        return self.fan.read(view.eyes(self.fan, view))

    def record(self, recorded: RecordedInstants) -> Floats:
        """Return the bins of the recorded scans."""
        return recorded.scan(self.channel)

    def enclose(self, view: BoxView) -> Forms:
        """Enclose the bins; where the sensor may stand in an obstacle or off the map, by all that it can read."""
        return self.enclose_losing(view, 0)[0]

    def enclose_losing(self, view: BoxView, lost: int) -> tuple[Forms, Floats]:
        """Enclose the bins, and bound what they read at most, (C, bins), when so many rays return nothing."""
        windows = view.windows.get(self.channel.name)
        seen, most = enclose_losing(view.start.poses, view.shapes, self._over_sets, lost, windows)
        if view.submerged.any():
            ends = (np.full_like(seen.centre, end) for end in self._ends)
            seen = Forms.choose(view.submerged, Forms.between(*ends), seen)
            most = np.where(view.submerged[:, None], self._ends[1], most)
        return view.over_states(seen), most

    @property
    def _over_sets(self) -> Lidar:
        """Return the LiDAR as it is enclosed over sets of states."""
        lidar = self.fan.lidar
        return replace(lidar, maximum_range=self.farthest) if self.farthest < lidar.maximum_range else lidar

    def gaps(self, view: BoxView, seen: Forms) -> Gaps:
        """Return what bins never read where they jump, in C sets of which they are enclosed by forms (C, bins).

        Where some rays may be lost nothing is told apart, nor where the sensor may stand in an obstacle or off the map.
        """
        found = Gaps.none(*seen.centre.shape)
        some = np.flatnonzero((seen.rest > _LEAST_JUMP).any(axis=1) & ~view.submerged)
        if some.size and has_gaps(view.shapes, self.fan.lidar):
            gaps = gaps_of(view.start.poses.select(some), view.shapes, self._over_sets)
            wide = (gaps.width > _LEAST_JUMP) & (seen.rest[some] > _LEAST_JUMP)
            found.middle[some], found.width[some] = gaps.middle, np.where(wide, gaps.width, 0.0)
        return found

    def up_to(self, reading: float) -> LidarReadings:
        """Return these readings for a network to which one that is larger is as good as this one.

        Notes
        -----
        Sound: yes, as a ray that is cut off earlier reads less, down to this number; the least and the first ray of a
        bin are then what they would be, or told apart from it by nothing. Means are not, nor what a ray reads that does
        not return.
        """
        lidar = self.sensor
        plain = not self.channel.encoding and lidar.no_return is None and lidar.reduce != "mean"
        return replace(self, farthest=max(reading, lidar.minimum_range + _SHORTEST)) if plain else self

    def bounds(self, extent: Extent) -> tuple[float, float]:
        """Return the limits of the LiDAR, and what it reads where nothing returns."""
        return self._ends

    @property
    def sensor(self) -> Lidar:
        """Return the LiDAR that is meant, without noise of its own."""
        return self.channel.lidar.lidar() if self.channel.lidar else self.robot.lidar

    @property
    def _ends(self) -> tuple[float, float]:
        """Return the least and the largest number that the LiDAR gives."""
        lidar = self.sensor
        readings = (
            lidar.minimum_range,
            lidar.maximum_range,
            *(() if lidar.no_return is None else (lidar.no_return,)),
        )
        return min(readings), max(readings)

    def mirror(self) -> tuple[Indices, Floats]:
        """Return, of each bin, the one that looks where it looks in the mirror image."""
        return mirrored_bins(self.fan.lidar), np.ones(self.channel.size)


def mirrored_bins(lidar: Lidar) -> Indices:
    """Return which bin looks where each bin looks in the mirror image, (bins,).

    Raises
    ------
    PolicyError
        If there is none, as the rays are not symmetric about forward.
    """
    angles = lidar.angles().reshape(lidar.bins, -1)
    here, there = (np.exp(1j * side * angles) for side in (1.0, -1.0))
    bins = []
    for mirrored in there:
        apart = np.abs(np.sort_complex(here.round(9)) - np.sort_complex(mirrored.round(9))).max(axis=1)
        bins.append(int(apart.argmin()))
        if apart.min() > 1e-6:
            raise PolicyError(
                f"the LiDAR with {lidar.words} has no mirror image", "train with `mirror: false`"
            )
    return np.array(bins)
