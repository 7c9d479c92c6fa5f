"""All that a policy observes, in the order of its columns."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Booleans, Floats, Indices
from viatool.channels.channel import Channel, Frames
from viatool.channels.erring import Erring
from viatool.channels.inputs import Inputs
from viatool.channels.lidar import LidarReadings
from viatool.channels.part_of_motion import PartOfMotion
from viatool.channels.quantity import Part, Quantity, quantity_of
from viatool.channels.views import BoxView, Extent, RecordedInstants, View
from viatool.errors import PolicyError
from viatool.rounding import SLIGHTLY_MORE, UNIT_ROUNDOFF
from viatool.sets.forms import Forms
from viatool.sets.observations import Few, ObservationSets
from viatool.sight.windows import Gaps, sides_of
from viatool.world import Robot


@dataclass(frozen=True, eq=False)
class Sightings:
    """What is observed anywhere in C sets of states, in R >= C parts.

    Parameters
    ----------
    forms : Forms
        (R, n).
    cell : ndarray
        (R,) which set each part belongs to; first all sets in their order, then again those with a second part.
    few : tuple of Few
        Entries of which some may lie elsewhere than their forms say, of the R parts.
    """

    forms: Forms
    cell: Indices
    few: tuple[Few, ...] = ()

    def select(self, which: Indices) -> Sightings:
        """Return some of the parts."""
        few = tuple(few.select(which) for few in self.few)
        return Sightings(self.forms.select(which), self.cell[which], few)

    @property
    def sets(self) -> ObservationSets:
        """Return what is observed as sets, (R, n)."""
        return ObservationSets(self.forms, self.forms.lower, self.forms.upper, self.few)

    def parts_of(self, which: Indices, count: int) -> Indices:
        """Return the parts of some of C sets, (k,) ascending."""
        among = np.zeros(count, dtype=bool)
        among[which] = True
        return np.flatnonzero(among[self.cell])

    def of_sets(self, which: Indices, count: int) -> Sightings:
        """Return what is observed in some of C sets, (k,) ascending."""
        parts, number = self.parts_of(which, count), np.zeros(count, dtype=np.int64)
        number[which] = np.arange(len(which))
        forms = self.forms
        return Sightings(
            Forms(forms.centre[parts], forms.slope[parts], forms.rest[parts]),
            number[self.cell[parts]],
            tuple(few.select(parts) for few in self.few),
        )

    def choices(self, most: int) -> Iterator[Forms]:
        """Yield forms (R, n) that together hold what is observed: one for each choice of what lies elsewhere.

        Parameters
        ----------
        most : int
            So many choices are told apart; where there are more, a form holds blocks of them.
        """
        if not self.few:
            yield self.forms
            return
        for chosen in self.sets.choices(most):
            yield Sightings(chosen.forms, self.cell, chosen.few).wide

    @property
    def wide(self) -> Forms:
        """Return forms (R, n) that hold every entry, wherever it may be."""
        if not self.few:
            return self.forms
        lower, upper = self.sets.hull
        among = np.zeros(lower.shape, dtype=bool)
        for some in self.few:
            among[:, some.columns] = True
        anywhere, still = Forms.between(lower, upper), np.zeros_like(self.forms.slope)
        return Forms.where(
            among, Forms(anywhere.centre, still, anywhere.rest * SLIGHTLY_MORE), self.forms
        ).checked()


@dataclass(frozen=True, eq=False)
class Quantities:
    """What the channels of a policy observe, each by itself, and what its network takes of that.

    Parameters
    ----------
    each : tuple of Quantity
        In the order of the channels; m readings at one instant in all.
    inputs : Inputs
        Where the readings stand among the n inputs of the network.
    """

    each: tuple[Quantity, ...]
    inputs: Inputs

    @classmethod
    def of(
        cls, channels: Sequence[Channel], robot: Robot | None = None, frames: Frames | None = None
    ) -> Quantities:
        """Return what channels observe on a robot; without one, on the robot of the paper."""
        each = tuple(quantity_of(channel, robot) for channel in channels)
        return cls(each, Inputs.of(channels, frames))

    def __iter__(self) -> Iterator[Quantity]:
        """Go through the quantities in the order of their readings."""
        return iter(self.each)

    @property
    def size(self) -> int:
        """Return n."""
        return self.inputs.size

    @property
    def columns(self) -> tuple[slice, ...]:
        """Return which of the m readings each quantity gives."""
        return self.inputs.places

    @cached_property
    def lidars(self) -> tuple[tuple[LidarReadings, slice], ...]:
        """The LiDARs that are read, each with its place among the readings."""
        pairs = zip(self.each, self.columns, strict=True)
        return tuple((one, columns) for one, columns in pairs if isinstance(one, LidarReadings))

    def up_to(self, readings: Floats) -> Quantities:
        """Return these for a network to which a reading that is larger than one of (m,) is as good as that one."""
        each = list(self.each)
        for number, (quantity, columns) in enumerate(zip(self.each, self.columns, strict=True)):
            if isinstance(quantity, LidarReadings):
                each[number] = quantity.up_to(float(readings[columns].max()))
        return replace(self, each=tuple(each))

    @property
    def outputs(self) -> int:
        """Return how many numbers that the network gave in the step before are observed; 0 for none."""
        observed = [one.channel.size for one in self.each if "outputs" in one.needs]
        return observed[0] if observed else 0

    @property
    def needs(self) -> frozenset[str]:
        """What has to be in a recording, as `Quantity.needs`."""
        return frozenset().union(*(quantity.needs for quantity in self.each))

    @property
    def answer_to_before(self) -> bool:
        """Tell whether anything is observed of the command before, its outputs or the velocity that it gave."""
        observed = (one for one in self.each if one.channel.value is None)
        return any(isinstance(one, PartOfMotion) or "outputs" in one.needs for one in observed)

    def require(self, *parts: Part) -> Quantities:
        """Return these, refusing the first that lacks a part, by name.

        Raises
        ------
        PolicyError
            Names the channel and its kind, or the frames that are not known over a set of poses.
        """
        for part in parts:
            for quantity in self.each:
                quantity.require(part)
        if "enclose" in parts and self.inputs.memory:
            raise PolicyError(
                f"the policy observes frames that are up to {self.inputs.memory} steps old, "
                "which are not known over a set of poses",
                "verify recorded or simulated states",
            )
        return self

    def read(self, view: View) -> Floats:
        """Return what the sensors of B robots read, (B, m) in their units: float64 holding float32 numbers."""
        return self._filled(len(view), lambda quantity: quantity.measure(view))

    def observe(self, readings: Floats, past: Floats | None = None) -> Floats:
        """Return what the networks of B robots take, (B, n): float64 holding float32 numbers; see `Inputs.encode`."""
        return self.inputs.encode(readings, past).astype(np.float32).astype(np.float64)

    def measure(self, view: View) -> Floats:
        """Return what the networks of B robots take at the beginning of an episode, (B, n)."""
        return self.observe(self.read(view))

    def record(self, recorded: RecordedInstants) -> Floats:
        """Return what sensors read at S instants of a recording, (S, m), as `read` does; NaN where unknown."""
        return self._filled(len(recorded.poses), lambda quantity: quantity.record(recorded))

    def enclose(self, view: BoxView, radii: Floats | Erring | None = None, *, jumps: int = 0) -> Sightings:
        """Enclose what the network takes anywhere in C sets of states.

        Parameters
        ----------
        view : BoxView
            C sets of states.
        radii : ndarray or Erring, optional
            (n,) by how much each reading may be off, in the unit of its sensor, or how else; None for perfect sensors.
        jumps : int
            Of how many readings of a LiDAR that jump, the widest, the sides are told apart.

        Returns
        -------
        Sightings
            Of all sets; of those that reach over the half turn of an angle, both sides; of jumps, all choices of sides.

        Notes
        -----
        Sound: yes, for networks that observe the present alone.
        """
        every = np.arange(len(view))
        erring = radii if isinstance(radii, Erring) or radii is None else Erring.within(radii)
        first = self._enclose(view, erring, gaps=jumps > 0)
        rows, found = [every], [first]
        jumping = sides_of(first.gaps, jumps)
        if jumping is not None:
            told = replace(view.select(jumping.row, view.behind), windows=jumping.windows)
            rows.append(jumping.row)
            found.append(self._enclose(told, erring))
        for behind, both in self._other_sides(view if erring is None else erring.believed(view)):
            rows.append(every[both])
            found.append(self._enclose(view.select(every[both], behind), erring))
        seen = Sightings(
            first.forms if len(found) == 1 else Forms.concatenate([part.forms for part in found]),
            np.concatenate(rows),
            tuple(Few.concatenate(some) for some in zip(*(part.few for part in found), strict=True)),
        )
        return seen if jumping is None else seen.select(jumping.in_place_of_sets(len(view), len(seen.cell)))

    def _other_sides(self, view: BoxView) -> Iterator[tuple[frozenset[str], Booleans]]:
        """Give every choice of angles that may be on the other side of the half turn, and in which sets (C,)."""
        angles = {quantity.channel.kind: quantity for quantity in self.each if quantity.wraps}
        over = {}
        for kind, quantity in angles.items():
            here = quantity.enclose(replace(view, behind=frozenset()))
            there = quantity.enclose(replace(view, behind=frozenset({kind})))
            over[kind] = (here.centre != there.centre)[:, 0]
        for chosen in product(*([False, True] for _ in over)):
            behind = frozenset(kind for kind, is_behind in zip(over, chosen, strict=True) if is_behind)
            both = (
                np.logical_and.reduce([over[kind] for kind in behind]) if behind else np.zeros(0, dtype=bool)
            )
            if both.any():
                yield behind, both

    def _enclose(self, view: BoxView, erring: Erring | None, *, gaps: bool = False) -> _Seen:
        """Enclose what the network takes, on the sides of half turns and jumps that the view names."""
        parts, few, never, symbols = [], [], {}, view.states.slope.shape[1]
        believed = view if erring is None else erring.believed(view)
        for quantity, place in zip(self.each, self.columns, strict=True):
            lost: list[Few] = []
            if erring is None:
                seen = quantity.enclose(view)
            elif isinstance(quantity, LidarReadings):
                looking, losing = erring.looking(view, place), erring.losing(place)
                seen, most = quantity.enclose_losing(looking, losing)
                if gaps and not losing:
                    never[quantity.channel.name] = quantity.gaps(looking, seen)
                seen = erring.added(seen, place, symbols)
                lost = erring.lost(seen, place, most)
            else:
                seen = quantity.enclose(believed if quantity.knows_its_pose else view)
                seen = erring.added(seen, place, symbols)
            with quantity.channel.named_in_errors():
                parts.append(quantity.channel.encoding.forms(seen))
                few += [_encoded(some, quantity.channel) for some in lost]
        forms = Forms(
            np.concatenate([part.centre for part in parts], axis=1),
            np.concatenate([part.slope for part in parts], axis=2),
            np.concatenate([part.rest for part in parts], axis=1),
        ).checked()
        return _Seen(forms, few, never)

    def bounds(self, extent: Extent) -> tuple[Floats, Floats]:
        """Return the least and the largest number of each input on a map, (n,) each."""
        ends = []
        for quantity in self.each:
            lower, upper = (np.full(quantity.channel.size, end) for end in quantity.bounds(extent))
            with quantity.channel.named_in_errors():
                ends.append(quantity.channel.encoding.enclose(lower, upper))
        lower, upper = (np.concatenate(side)[self.inputs.reading] for side in zip(*ends, strict=True))
        return lower, upper

    def mirror(self) -> tuple[Indices, Floats]:
        """Return which readings, (m,), times which signs, (m,), are observed in the scene's mirror image."""
        parts = [quantity.mirror() for quantity in self.each]
        columns = [part[0] + place.start for part, place in zip(parts, self.columns, strict=True)]
        return np.concatenate(columns), np.concatenate([signs for _, signs in parts])

    def _filled(self, count: int, read: Callable[[Quantity], NDArray[Any]]) -> Floats:
        table = np.empty((count, self.columns[-1].stop), np.float32)
        for quantity, columns in zip(self.each, self.columns, strict=True):
            table[:, columns] = read(quantity).reshape(count, quantity.channel.size)
        return table.astype(np.float64)


@dataclass(frozen=True, eq=False)
class _Seen:
    """What the network takes in C sets, (C, n), what may be elsewhere, and what bins of LiDARs never read."""

    forms: Forms
    few: list[Few]
    gaps: Mapping[str, Gaps]


def _encoded(some: Few, channel: Channel) -> Few:
    """Return what the network takes of readings that are elsewhere, with its rounding to float32."""
    lower, upper = channel.encoding.enclose(some.lower, some.upper)
    spare = 2.0 * UNIT_ROUNDOFF["float32"] * np.maximum(np.abs(lower), np.abs(upper))
    return replace(some, lower=lower - spare, upper=upper + spare)
