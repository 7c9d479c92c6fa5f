"""What is observed beside poses, commands and surroundings: the time that is left, and the outputs of the step before.

Sets of states hold the command before, as it was carried out, and not the outputs of which it was made. Where each
number of a command is one output, scaled, shifted and clipped, the command tells the output, unless it lies at an end
at which it was clipped: then the output may be any beyond, as far as the network gives any. Where rules or a choice
stand in between, the command tells nothing, and the output may be any that the network gives. Before the first step
there was none, and 0 is observed: so it may be wherever the robot may have been told to stand.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Booleans, Floats, Indices
from viatool.policy import Policy
from viatool.policy.action_map import scaling_of
from viatool.policy.command_map import Picked
from viatool.rounding import SIGHT_ROUNDING
from viatool.sets.forms import Forms
from viatool.sets.states import POSE, StateBoxes
from viatool.setting.premises import Premise
from viatool.setting.setting import Setting
from viatool.taylor.outputs import output_range

_TOLD = frozenset({"time", "outputs"})
"""What a channel may need that sets of states do not hold."""


@dataclass(frozen=True, eq=False)
class Told:
    """What is known of C sets of states beside what they hold.

    Parameters
    ----------
    left : ndarray, optional
        (C, 2) ends of the control intervals that are left until the episode ends; None for any of an episode.
    raw : ndarray, optional
        (C, 2, K) ends of what the network gave in the step before; None for what the command before tells.
    """

    left: Floats | None = None
    raw: Floats | None = None

    @classmethod
    def recorded(cls, setting: Setting, observations: Floats) -> Told:
        """Return what was observed in recorded states (C, n)."""
        ends = np.stack(setting.spec.inputs.readings(observations), axis=1)
        columns: dict[str, Indices] = {}
        for quantity in setting.quantities:
            for need in quantity.needs & _TOLD:
                columns[need] = setting.spec.inputs.newest(quantity.channel.name)
        left, raw = (ends[:, :, columns[need]] if need in columns else None for need in ("time", "outputs"))
        return cls(None if left is None else left[:, :, 0], raw)

    def select(self, which: NDArray[Any] | slice) -> Told:
        """Return what is known of some of the sets."""
        left, raw = (None if part is None else part[which] for part in (self.left, self.raw))
        return Told(left, raw)

    def given(self, raw: Floats | None) -> Told:
        """Return the same with outputs (C, K) that were given before, if there were any."""
        return self if raw is None else Told(self.left, np.stack([raw, raw], axis=1))

    def after(self, intervals: int) -> Told:
        """Return what is known some control intervals later; an episode that goes on beyond its end tells 0 or less."""
        if intervals == 0:
            return self
        left = self.left
        if left is not None:
            left = left - intervals
            left = np.stack([left[:, 0], np.maximum(left[:, 1], 0.0)], axis=1)
        return Told(left)


NOTHING = Told()
"""Nothing but what sets of states hold."""


@dataclass(frozen=True, eq=False)
class OutputsBefore:
    """The K outputs of a network, as far as the command that was made of them tells.

    Parameters
    ----------
    lower, upper : ndarray
        (K,) ends of all that the network gives, infinite where nothing limits it.
    entry : ndarray
        (K,) which number of the command an output is; -1 where it is none, or where commands tell nothing.
    scale, offset : ndarray
        (K,) what makes that number of it.
    least, most : ndarray
        (K,) where that number is clipped.
    axes : int
        A, the entries of a command.
    """

    lower: Floats
    upper: Floats
    entry: Indices
    scale: Floats
    offset: Floats
    least: Floats
    most: Floats
    axes: int

    @classmethod
    def of(cls, policy: Policy, setting: Setting) -> OutputsBefore:
        """Return what the commands of a robot tell of the outputs of its policy."""
        lower, upper = output_range(policy.own)
        size, rules = len(lower), setting.rules
        entry, scale, offset = np.full(size, -1), np.ones(size), np.zeros(size)
        least, most = np.full(size, -np.inf), np.full(size, np.inf)
        plain = isinstance(setting.command_map, Picked) and not (setting.overrides or rules.kinematics.state)
        if plain:
            entry[list(setting.command_map.columns)] = np.arange(len(setting.command_map.columns))
            scaling = scaling_of(policy.spec)
            if scaling is not None:
                scale, offset = scaling.scale, scaling.offset
                if scaling.limits is not None:
                    least, most = np.transpose(scaling.limits)
            told = entry >= 0
            least = np.where(told, np.maximum(least, rules.lower[entry]), least)
            most = np.where(told, np.minimum(most, rules.upper[entry]), most)
        entry = np.where(scale == 0.0, -1, entry)
        return cls(lower, upper, entry, scale, offset, least, most, len(rules.lower))

    def enclose(self, cells: StateBoxes, states: Forms) -> Forms:
        """Enclose the outputs before the states of C sets within boxes, (C, K); infinite where nothing is known.

        Notes
        -----
        Sound: yes; rounding is counted.
        """
        first, last = cells.previous_lower[:, self.entry], cells.previous_upper[:, self.entry]
        inner = self._inner(first, last)
        rising = self.scale > 0.0
        below, above = np.where(rising, first, last), np.where(rising, last, first)
        known = np.where(
            rising, inner, inner[::-1]
        )  # whether the lower and the upper end of the output are told
        ends = [self._output(below) - self._slack(below), self._output(above) + self._slack(above)]
        lower, upper = np.where(known[0], ends[0], -np.inf), np.where(known[1], ends[1], np.inf)
        standing = (cells.previous_lower <= 0.0) & (cells.previous_upper >= 0.0)
        still = standing[:, : self.axes].all(axis=1, keepdims=True) | (self.entry < 0)
        lower, upper = np.clip(lower, self.lower, self.upper), np.clip(upper, self.lower, self.upper)
        lower = np.where(still, np.minimum(lower, 0.0), lower)
        upper = np.where(still, np.maximum(upper, 0.0), upper)
        free = _between(lower, upper, states)
        return Forms.where(known.all(axis=0) & ~still, self._forms(states), free)

    def behind(self, commands: Floats) -> Floats:
        """Return outputs (B, K) of which commands (B, A) may have been made; 0 where the robot stood."""
        told = np.where(self.entry >= 0, self._output(commands[:, self.entry]), 0.0)
        stood = (commands == 0.0).all(axis=1)[:, None]
        return np.where(stood, 0.0, np.clip(told, self.lower, self.upper))

    def _inner(self, first: Floats, last: Floats) -> Booleans:
        """Tell whether a command between two ends (C, K) was not clipped from below, nor from above, (2, C, K)."""
        slack = SIGHT_ROUNDING * (1.0 + np.abs(first) + np.abs(last))
        told = self.entry >= 0
        return np.stack([told & (first > self.least + slack), told & (last < self.most - slack)])

    def _output(self, numbers: Floats) -> Floats:
        return np.asarray((numbers - self.offset) / np.where(self.scale == 0.0, 1.0, self.scale))

    def _slack(self, numbers: Floats) -> Floats:
        """Return by how much rounding may have moved the outputs of which numbers of a command were made."""
        steep = np.where(self.scale == 0.0, 1.0, np.abs(self.scale))
        return np.asarray(SIGHT_ROUNDING * (1.0 + (np.abs(numbers) + np.abs(self.offset)) / steep))

    def _forms(self, states: Forms) -> Forms:
        """Return outputs as forms of commands that were not clipped, (C, K)."""
        column = len(POSE) + self.entry
        scale = np.where(self.scale == 0.0, 1.0, self.scale)
        centre, slope = states.centre[:, column], states.slope[:, :, column]
        reach = np.abs(centre) + np.abs(slope).sum(axis=1) + states.rest[:, column]
        rest = states.rest[:, column] / np.abs(scale) + self._slack(reach)
        return Forms(self._output(centre), slope / scale, rest)


def _between(lower: Floats, upper: Floats, states: Forms) -> Forms:
    """Return numbers between two ends (C, K) that no symbol changes; anything where an end is infinite."""
    known = np.isfinite(lower) & np.isfinite(upper)
    free = Forms.between(np.where(known, lower, 0.0), np.where(known, upper, 0.0))
    slope = np.zeros((*states.slope.shape[:2], lower.shape[1]))
    return Forms(free.centre, slope, np.where(known, free.rest, np.inf))


@dataclass(frozen=True, eq=False)
class Recollection:
    """What a policy observes of its time and of itself, in one scenario.

    Parameters
    ----------
    episode : int or None
        Control intervals of an episode; None where it may last however long.
    outputs : OutputsBefore or None
        Of the network, where it observes them.
    """

    episode: int | None = None
    outputs: OutputsBefore | None = None

    @classmethod
    def of(cls, policy: Policy, setting: Setting, episode: int | None) -> Recollection:
        """Return what a policy observes, refusing by name what nothing bounds.

        Raises
        ------
        PolicyError
            Names the channel.
        """
        outputs = None
        for quantity in setting.quantities:
            if "time" in quantity.needs and episode is None:
                quantity.require_limits(np.zeros(1), np.full(1, np.inf))
            if "outputs" in quantity.needs:
                outputs = outputs or OutputsBefore.of(policy, setting)
                quantity.require_limits(outputs.lower, outputs.upper)
        return cls(episode, outputs)

    @property
    def largest(self) -> float:
        """Return the size of the largest number that is recalled of an episode, as far as it is limited."""
        ends = [] if self.outputs is None else [self.outputs.lower, self.outputs.upper]
        sizes = np.abs(np.concatenate([[float(self.episode or 0)], *ends]))
        return float(sizes[np.isfinite(sizes)].max())

    def over(self, told: Told, cells: StateBoxes, states: Forms) -> tuple[Floats | None, Forms | None]:
        """Return the time that is left, (C, 2), and the outputs before, (C, K), of sets of states. Sound: yes."""
        left, raw = told.left, None
        if left is None and self.episode is not None:
            left = np.broadcast_to(np.array([0.0, self.episode]), (len(cells), 2))
        if told.raw is not None:
            raw = _between(told.raw[:, 0], told.raw[:, 1], states)
        elif self.outputs is not None:
            raw = self.outputs.enclose(cells, states)
        return left, raw

    def at(self, told: Told, previous: Floats) -> dict[str, Any]:
        """Return the same for robots (B,) after commands (B, A), as `View` takes it."""
        found: dict[str, Any] = {}
        if self.episode is not None:
            found["horizon"] = self.episode
            if told.left is not None:
                found["steps"] = self.episode - _middle(told.left)
        if told.raw is not None:
            found["raw"] = _middle(told.raw)
        elif self.outputs is not None:
            found["raw"] = self.outputs.behind(previous)
        return found


def told_of_time(setting: Setting, words: str) -> Setting:
    """Return the same, with what is assumed of the time that is left, where the policy observes it."""
    if "time" not in setting.quantities.needs:
        return setting
    return replace(setting, premises=(*setting.premises, Premise("control intervals left", words, "default")))


def _middle(ends: Floats) -> Floats:
    """Return numbers between ends (B, 2, ...): the middle, or an end where the other is infinite."""
    low, high = ends[:, 0], ends[:, 1]
    with np.errstate(invalid="ignore"):
        middle = 0.5 * (low + high)
    return np.where(
        np.isfinite(middle), middle, np.where(np.isfinite(low), low, np.where(np.isfinite(high), high, 0.0))
    )
