"""The numbers that a network takes: which reading each of them holds, of how many steps ago, and how it is encoded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from viatool.arrays import Floats, Indices
from viatool.channels.channel import NOW, Channel, Frames


def numbered(name: str, size: int) -> list[str]:
    """Return `name` itself for one number, and name_0, name_1, ... for more."""
    return [name] if size == 1 else [f"{name}_{index}" for index in range(size)]


@dataclass(frozen=True, eq=False)
class Inputs:
    """Where the readings of the channels stand in an observation.

    Parameters
    ----------
    channels : tuple of Channel
        m readings at one instant in all.
    frames : Frames
        Of the whole observation; of a channel that has its own, that one.
    """

    channels: tuple[Channel, ...]
    frames: Frames = NOW

    @classmethod
    def of(cls, channels: Sequence[Channel], frames: Frames | None = None) -> Inputs:
        """Return the inputs of channels in their order."""
        return cls(tuple(channels), frames or NOW)

    @property
    def size(self) -> int:
        """Return n, the number of inputs of the network."""
        return self.frames.count * sum(channel.size * _frames(channel).count for channel in self.channels)

    @cached_property
    def places(self) -> tuple[slice, ...]:
        """Which of the m readings each channel gives."""
        ends = np.cumsum([0, *(channel.size for channel in self.channels)]).tolist()
        return tuple(slice(first, last) for first, last in pairwise(ends))

    @cached_property
    def _table(self) -> tuple[Indices, Indices, Indices]:
        rows = [
            (reading, age + before, number)
            for before in self.frames.ages
            for number, (channel, place) in enumerate(zip(self.channels, self.places, strict=True))
            for age in _frames(channel).ages
            for reading in range(place.start, place.stop)
        ]
        reading, age, number = np.array(rows, dtype=np.int64).T
        return reading, age, number

    @property
    def reading(self) -> Indices:
        """Return which of the m readings stands in each input, (n,)."""
        return self._table[0]

    @property
    def age(self) -> Indices:
        """Return how many control intervals ago each input was read, (n,)."""
        return self._table[1]

    @property
    def channel(self) -> Indices:
        """Return the number of each input's channel, (n,)."""
        return self._table[2]

    @property
    def names(self) -> list[str]:
        """Return a name for each input, (n,): its channel, numbered where that has several, and how long ago it was.

        ``lidar_0``, ``lidar_1``, ..., ``goal_distance``; of earlier frames ``lidar_0_before_1``, one control interval
        before, and so on.
        """
        names = [name for channel in self.channels for name in numbered(channel.name, channel.size)]
        return [
            f"{names[reading]}_before_{age}" if age else names[reading]
            for reading, age in zip(self.reading.tolist(), self.age.tolist(), strict=True)
        ]

    @cached_property
    def memory(self) -> int:
        """Return how many control intervals the oldest reading is old; 0 where the present alone is observed."""
        return int(self.age.max())

    @cached_property
    def is_plain(self) -> bool:
        """Tell whether the network takes the readings as they are."""
        return not any(channel.encoding for channel in self.channels)

    def columns(self, name: str) -> Indices:
        """Return the inputs that hold a channel; none if there is no such channel."""
        names = [channel.name for channel in self.channels]
        return np.flatnonzero(self.channel == names.index(name)) if name in names else np.zeros(0, np.int64)

    def newest(self, name: str) -> Indices:
        """Return the inputs that hold the present reading of a channel; none if there is no such channel."""
        columns = self.columns(name)
        return np.asarray(columns[self.age[columns] == 0])

    def readings(self, inputs: Floats, *, within: bool = False) -> tuple[Floats, Floats]:
        """Return the least and the largest reading that each input (B, n) may stand for; see `Encoding.readings`."""
        if self.is_plain:
            return inputs, inputs
        least, most = inputs.copy(), inputs.copy()
        for number, channel in enumerate(self.channels):
            columns = np.flatnonzero(self.channel == number)
            least[:, columns], most[:, columns] = channel.encoding.readings(inputs[:, columns], within=within)
        return least, most

    def shared(self, inputs: Floats, rows: Indices | Floats) -> Indices:
        """Tell which inputs hold one and the same reading, whose error they then share.

        Parameters
        ----------
        inputs : ndarray
            (B, n) what the network took.
        rows : ndarray
            (B,) how many control intervals came before each state in its episode: a stack that reaches farther back was
            filled with the first reading. NaN where that is not known.

        Returns
        -------
        ndarray
            (B, n) the first of the inputs that hold the reading of each.

        Notes
        -----
        As sure as `rows`: with how many states of an episode are known before each, these *may* be one reading, and a
        counterexample takes them for one; with how many there were, they are. Other numbers are other readings.
        """
        first = np.broadcast_to(np.arange(inputs.shape[1]), inputs.shape).copy()
        for number in range(len(self.channels)):
            columns = np.flatnonzero(self.channel == number)
            order = columns[np.argsort(self.reading[columns], kind="stable")]
            frames = order.reshape(self.places[number].stop - self.places[number].start, -1).T
            for later, earlier in ((i, j) for i in range(len(frames)) for j in reversed(range(i))):
                ages = [np.minimum(self.age[frames[at]], rows[:, None]) for at in (later, earlier)]
                same = (ages[0] == ages[1]) & (inputs[:, frames[later]] == inputs[:, frames[earlier]])
                first[:, frames[later]] = np.where(same, first[:, frames[earlier]], first[:, frames[later]])
        return first

    def encode(self, readings: Floats, past: Floats | None = None) -> Floats:
        """Return what the network takes.

        Parameters
        ----------
        readings : ndarray
            (B, m) in the units of the sensors.
        past : ndarray, optional
            (B, T, m) readings of the T control intervals before, the newest first. Where there are too few of them the
            oldest is repeated, as at the beginning of an episode.

        Returns
        -------
        ndarray
            (B, n).
        """
        encoded = np.concatenate(
            [
                channel.encoding.apply(readings[:, place])
                for channel, place in zip(self.channels, self.places, strict=True)
            ],
            axis=1,
        )
        if not self.memory:
            return encoded[:, self.reading]
        every = readings[:, None] if past is None else np.concatenate([readings[:, None], past], axis=1)
        count, times, size = every.shape
        each = Inputs(self._bare).encode(every.reshape(-1, size)).reshape(count, times, size)
        return np.asarray(each[:, np.minimum(self.age, times - 1), self.reading])

    @cached_property
    def _bare(self) -> tuple[Channel, ...]:
        return tuple(channel.model_copy(update={"frames": None}) for channel in self.channels)

    def box(self, inputs: Floats, radii: Floats, *, within: bool = False) -> tuple[Floats, Floats]:
        """Bound what the network takes when every reading errs.

        Parameters
        ----------
        inputs : ndarray
            (B, n) what it took without an error.
        radii : ndarray
            (n,) by how much the reading in each input may be off, in the unit of its sensor.
        within : bool
            Return a box in which every point is some encoded reading, for counterexamples, instead of one that holds
            all of them.

        Returns
        -------
        tuple of ndarray
            Least and largest input, (B, n) each.

        Notes
        -----
        Sound: yes. A reading that was clipped may have been anything beyond the end of the clip. Frames err each by
        itself, which allows for more than frames of the same reading do (`shared` says which these are): bounds of
        commands leave all but the first of them out.
        """
        least, most = self.readings(inputs, within=within)
        return self.enclosed(least - radii, most + radii, within)

    def around(self, readings: Floats, radii: Floats, *, within: bool = False) -> tuple[Floats, Floats]:
        """Bound what the network takes of present readings (B, m) that err by at most (m,); as `box`."""
        lower, upper = (end[:, self.reading] for end in (readings - radii, readings + radii))
        return self.enclosed(lower, upper, within)

    def enclosed(self, lower: Floats, upper: Floats, within: bool = False) -> tuple[Floats, Floats]:
        """Encode readings between two ends (B, n), each with the encoding of its column; overwrites them."""
        for number, channel in enumerate(self.channels):
            if channel.encoding:
                columns = np.flatnonzero(self.channel == number)
                with channel.named_in_errors():
                    ends = channel.encoding.enclose(lower[:, columns], upper[:, columns], within=within)
                lower[:, columns], upper[:, columns] = ends
        return lower, upper


def _frames(channel: Channel) -> Frames:
    return channel.frames or NOW
