"""Which velocities sets of robots with motors and timing may have until they observe next, as seen from their commands.

See `viatool.motion.actuated_sets` for what is derived here.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from viatool.arrays import Floats, Hull
from viatool.motion.actuated import Machine
from viatool.motion.twists import HeldTwist
from viatool.rounding import SLIGHTLY
from viatool.sets.forms import Forms
from viatool.sets.states import POSE, StateBoxes

_STAGES = 4
"""In which the velocity settles within an interval."""


@dataclass(frozen=True, eq=False)
class Parts:
    """Velocities of C sets, (C, 3) ahead, to the left and turning: forms, and bounds beside them."""

    forms: Forms
    lower: Floats
    upper: Floats

    @classmethod
    def of(cls, kinematics: HeldTwist, forms: Forms, lower: Floats, upper: Floats) -> Parts:
        """Return the parts of commands (C, A)."""
        centre, slope, rest, low, high = (
            np.stack(kinematics.parts(array), axis=-1)
            for array in (forms.centre, forms.slope, forms.rest, lower, upper)
        )
        return cls(Forms(centre, slope, rest), low, high)

    def beyond(self, other: Parts) -> Hull:
        """Return the ends (C, 3) of what these are more than others, rounded outward."""
        if other is self:
            return np.zeros_like(self.lower), np.zeros_like(self.lower)
        ours, theirs = self.forms, other.forms
        apart = Forms(ours.centre - theirs.centre, ours.slope - theirs.slope, ours.rest + theirs.rest)
        size = SLIGHTLY * (np.abs(ours.centre) + np.abs(theirs.centre) + np.abs(ours.slope).sum(axis=1))
        low, high = self.lower - other.upper, self.upper - other.lower
        return (
            np.maximum(apart.lower - size, low - SLIGHTLY * np.abs(low)),
            np.minimum(apart.upper + size, high + SLIGHTLY * np.abs(high)),
        )


@dataclass(frozen=True, eq=False)
class KnownVelocities:
    """The commands of C sets, the new one first, and the velocity that they have, if it counts."""

    commands: tuple[Parts, ...]
    velocity: Parts | None

    @classmethod
    def of(
        cls, machine: Machine, states: Forms, command: Forms, cells: StateBoxes, held: Hull
    ) -> KnownVelocities:
        """Take sets apart into what `carried_axes` names."""
        move, more = machine.kinematics, command.slope.shape[1] - states.slope.shape[1]
        axes, first = len(move.axes), len(POSE)

        def column(number: int) -> Parts:
            some = slice(number, number + axes)
            at = slice(first + number, first + number + axes)
            slope = np.pad(states.slope[:, :, at], ((0, 0), (0, more), (0, 0)))
            forms = Forms(states.centre[:, at], slope, states.rest[:, at])
            return Parts.of(move, forms, cells.previous_lower[:, some], cells.previous_upper[:, some])

        older = [column(back * axes) for back in range(machine.timing.commands)]
        last = cells.previous_lower.shape[1] - axes
        return cls(
            (Parts.of(move, command, *held), *older), None if machine.actuation.at_once else column(last)
        )


@dataclass(frozen=True, eq=False)
class Stage:
    """A time between two instants in which the velocity of C sets is bounded.

    Parameters
    ----------
    start, end : float
        Seconds since the observation.
    command : int
        The one from which velocities are seen: 0 for the new one.
    off : tuple of ndarray
        (C, 3) ends of what velocities are beyond it.
    box : tuple of ndarray
        (C, 3) ends of the velocities themselves, without what slips.
    """

    start: float
    end: float
    command: int
    off: Hull
    box: Hull

    @property
    def middle(self) -> Floats:
        """Return the middle of `off`, (C, 3)."""
        return np.asarray(0.5 * (self.off[0] + self.off[1]))

    @property
    def seconds(self) -> float:
        """Return how long it lasts."""
        return self.end - self.start


def _cut(machine: Machine) -> Iterator[tuple[float, float, tuple[int, ...]]]:
    """Yield times between which the same commands may act, cut where the next observation may be."""
    timing = machine.timing
    least, most = timing.observed
    for phase in timing.phases(timing.commands, stops=False):
        start, end = max(phase.start, 0.0), min(phase.end, most)
        if start >= end:  # over by the present observation, or begun after the next one
            continue
        cuts = {at for at in (least, 0.5 * (least + most)) if start < at < end}
        for begin, until in pairwise(sorted({start, end} | cuts)):
            if begin < until:
                yield begin, until, phase.commands


def stages_until_observed(machine: Machine, known: KnownVelocities) -> tuple[list[Stage], Stage]:
    """Follow the velocities of sets until the next observation: its stages, and what they are when that may be."""
    motors, least = machine.actuation, machine.timing.observed[0]
    seen_from, stages = max(range(len(known.commands))), []
    had = known.velocity or known.commands[seen_from]
    off, box = had.beyond(known.commands[seen_from]), (had.lower, had.upper)
    last = None if least > 0.0 else Stage(0.0, 0.0, seen_from, off, box)  # the next one may follow at once
    for start, end, commands in _cut(machine):
        newest = known.commands[min(commands)]
        change, seen_from = known.commands[seen_from].beyond(newest), min(commands)
        off = sum_of(off, change)
        if last is not None:
            last = replace(last, off=sum_of(last.off, change))
        beside, wanted = _targets(machine, [known.commands[number] for number in commands], newest)
        times = _instants(machine, start, end)
        since = (times - start)[:, None, None]
        offs = motors.either_way.extremes(off, beside, since)
        boxes = motors.extremes(box, wanted, since)
        each = [((offs[0][at], offs[1][at]), (boxes[0][at], boxes[1][at])) for at in range(len(times))]
        for (begin, until), pair in zip(pairwise(times.tolist()), pairwise(each), strict=True):
            seen, velocity = (hull_of(list(ends)) for ends in zip(*pair, strict=True))
            stages.append(Stage(begin, until, seen_from, seen, _met(velocity, newest, seen)))
            for at, here in zip((begin, until), pair, strict=True):
                if at >= least:
                    last = Stage(until, until, seen_from, *here) if last is None else _both(last, *here)
        off, box = each[-1]
    assert last is not None
    last = replace(last, command=seen_from)
    return stages, replace(last, box=_met(last.box, known.commands[seen_from], last.off))


def _targets(machine: Machine, commands: list[Parts], newest: Parts) -> tuple[Hull, Hull]:
    """Return what velocities may be drawn to by some commands, (C, 3): beyond the newest one, and by themselves."""
    motors = machine.actuation
    beside = [_around(one.beyond(newest), motors.largest_error(one.lower, one.upper)) for one in commands]
    return hull_of(beside), hull_of([motors.targets(one.lower, one.upper) for one in commands])


def _instants(machine: Machine, start: float, end: float) -> Floats:
    """Return the instants that cut a time into stages, in which velocities settle unless motors are at once."""
    settles = math.ceil(_STAGES * (end - start) / machine.timing.interval[1])
    times = np.linspace(start, end, (1 if machine.actuation.at_once else settles) + 1)
    times[-1] = end
    return times


def _both(last: Stage, off: Hull, box: Hull) -> Stage:
    return replace(last, off=hull_of([last.off, off]), box=hull_of([last.box, box]))


def hull_of(ends: list[Hull]) -> Hull:
    """Return the ends of what lies between some ends or others."""
    return np.minimum.reduce([low for low, _ in ends]), np.maximum.reduce([high for _, high in ends])


def _around(ends: Hull, error: Floats) -> Hull:
    """Return the ends of what is off by an error at most."""
    return ends[0] - error, ends[1] + error


def sum_of(one: Hull, other: Hull) -> Hull:
    """Return the ends of sums."""
    return one[0] + other[0], one[1] + other[1]


def _met(box: Hull, command: Parts, off: Hull) -> Hull:
    """Return the tighter ends of velocities of which both are known."""
    low, high = command.lower + off[0], command.upper + off[1]
    return (
        np.maximum(box[0], low - SLIGHTLY * np.abs(low)),
        np.minimum(box[1], high + SLIGHTLY * np.abs(high)),
    )
