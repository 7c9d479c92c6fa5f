"""All that a policy observes, in the order of its columns."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Floats, Indices
from viatool.channels.channel import Channel
from viatool.channels.lidar import LidarReadings
from viatool.channels.quantity import Part, Quantity, quantity_of
from viatool.channels.views import BoxView, Extent, RecordedInstants, View
from viatool.sets.forms import Forms
from viatool.world import Robot


@dataclass(frozen=True, eq=False)
class Quantities:
    """What the channels of a policy observe, each by itself.

    Parameters
    ----------
    each : tuple of Quantity
        In the order of the columns; n numbers in all.
    """

    each: tuple[Quantity, ...]

    @classmethod
    def of(cls, channels: Sequence[Channel], robot: Robot | None = None) -> Quantities:
        """Return what channels observe on a robot; without one, on the robot of the paper."""
        return cls(tuple(quantity_of(channel, robot) for channel in channels))

    def __iter__(self) -> Iterator[Quantity]:
        """Go through the quantities in the order of their columns."""
        return iter(self.each)

    @property
    def size(self) -> int:
        """Return n."""
        return sum(quantity.channel.size for quantity in self.each)

    @cached_property
    def columns(self) -> tuple[slice, ...]:
        """The columns of each quantity."""
        ends = np.cumsum([0, *(quantity.channel.size for quantity in self.each)]).tolist()
        return tuple(slice(first, last) for first, last in pairwise(ends))

    @cached_property
    def lidars(self) -> tuple[tuple[LidarReadings, slice], ...]:
        """The LiDARs that are read, with their columns."""
        pairs = zip(self.each, self.columns, strict=True)
        return tuple((one, columns) for one, columns in pairs if isinstance(one, LidarReadings))

    @property
    def needs(self) -> frozenset[str]:
        """What has to be in a recording, as `Quantity.needs`."""
        return frozenset().union(*(quantity.needs for quantity in self.each))

    def require(self, *parts: Part) -> Quantities:
        """Return these, refusing the first that lacks a part, by name.

        Raises
        ------
        PolicyError
            Names the channel and its kind.
        """
        for part in parts:
            for quantity in self.each:
                quantity.require(part)
        return self

    def measure(self, view: View) -> Floats:
        """Return what B robots observe, (B, n): float64 holding float32 numbers, as a float32 policy receives."""
        return self._filled(len(view), lambda quantity: quantity.measure(view))

    def record(self, recorded: RecordedInstants) -> Floats:
        """Return what was observed at S instants of a recording, (S, n), as `measure` does; NaN where unknown."""
        return self._filled(len(recorded.poses), lambda quantity: quantity.record(recorded))

    def enclose(self, view: BoxView) -> Forms:
        """Enclose what perfect sensors observe anywhere in C sets of states, (C, n). Sound: yes."""
        parts = [quantity.enclose(view) for quantity in self.each]
        return Forms(
            np.concatenate([part.centre for part in parts], axis=1),
            np.concatenate([part.slope for part in parts], axis=2),
            np.concatenate([part.rest for part in parts], axis=1),
        ).checked()

    def bounds(self, extent: Extent) -> tuple[Floats, Floats]:
        """Return the least and the largest number of each column on a map, (n,) each."""
        ends = [quantity.bounds(extent) for quantity in self.each]
        sizes = [quantity.channel.size for quantity in self.each]
        lower, upper = (np.repeat(np.array(side), sizes) for side in zip(*ends, strict=True))
        return lower, upper

    def mirror(self) -> tuple[Indices, Floats]:
        """Return which columns, (n,), times which signs, (n,), are observed in the scene's mirror image."""
        parts = [quantity.mirror() for quantity in self.each]
        columns = [part[0] + place.start for part, place in zip(parts, self.columns, strict=True)]
        return np.concatenate(columns), np.concatenate([signs for _, signs in parts])

    def _filled(self, count: int, read: Callable[[Quantity], NDArray[Any]]) -> Floats:
        table = np.empty((count, self.size), np.float32)
        for quantity, columns in zip(self.each, self.columns, strict=True):
            table[:, columns] = read(quantity).reshape(count, quantity.channel.size)
        return table.astype(np.float64)
