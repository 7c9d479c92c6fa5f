"""Rules that a robot's software wraps around its policy: where they apply, their command counts in its place.

A rule looks at what the sensors read, as it stands, encoded, in the observation. Of one observation it holds or does
not; over a box of observations it surely holds, surely does not, or may.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from viatool.arrays import Booleans, Floats, Indices
from viatool.channels.channel import Channel
from viatool.channels.inputs import Inputs
from viatool.errors import ConfigurationError
from viatool.policy.action_channels import Bound
from viatool.policy.command_map import CommandMap
from viatool.policy.specification import PolicySpecification

_FEW_ROUNDINGS = 2.0**-21
"""By how much, relative to a threshold and to 1, a reading may be off as the robot's software computes it."""


@dataclass(frozen=True, eq=False)
class Condition:
    """One of some readings is above one number and below another.

    Parameters
    ----------
    columns : ndarray
        (C,) the inputs that hold the readings.
    above, below : float
        In the unit of the sensor; infinite where there is no such end.
    """

    columns: Indices
    above: float
    below: float

    @classmethod
    def of(cls, columns: Indices, bound: Bound) -> Condition:
        """Return what a specification says."""
        return cls(
            columns,
            -np.inf if bound.above is None else bound.above,
            np.inf if bound.below is None else bound.below,
        )

    def surely(self, least: Floats, most: Floats, margin: float = 0.0) -> Booleans:
        """Tell where one of the readings, between two ends (B, n), is there wherever it is between them, (B,)."""
        least, most = least[:, self.columns], most[:, self.columns]
        there = np.ones(least.shape, dtype=bool)
        if np.isfinite(self.above):
            there &= least > self.above + self._spare(self.above, margin)
        if np.isfinite(self.below):
            there &= most < self.below - self._spare(self.below, margin)
        return np.asarray(there.any(axis=1))

    def possibly(self, least: Floats, most: Floats, margin: float = 0.0) -> Booleans:
        """Tell where one of the readings, between two ends (B, n), may be there, (B,); one that is NaN may."""
        least, most = least[:, self.columns], most[:, self.columns]
        elsewhere = np.zeros(least.shape, dtype=bool)
        if np.isfinite(self.above):
            elsewhere |= most <= self.above - self._spare(self.above, margin)
        if np.isfinite(self.below):
            elsewhere |= least >= self.below + self._spare(self.below, margin)
        return np.asarray(~elsewhere.all(axis=1))

    @staticmethod
    def _spare(threshold: float, margin: float) -> float:
        return margin * (1.0 + abs(threshold))


@dataclass(frozen=True, eq=False)
class Rule:
    """All of some conditions, and the command (A,) that counts where they hold."""

    conditions: tuple[Condition, ...]
    command: Floats


class Standing(NamedTuple):
    """Over B boxes, which of R rules count: the first that applies does.

    Parameters
    ----------
    counts : ndarray
        (B, R) bool: the rule may be the first that applies.
    policy : ndarray
        (B,) bool: it may be that none applies, so that the policy commands.
    """

    counts: Booleans
    policy: Booleans


@dataclass(frozen=True, eq=False)
class Overrides:
    """R rules, in their order.

    Parameters
    ----------
    rules : tuple of Rule
        The first that applies counts.
    inputs : Inputs
        What the entries of an observation are.
    """

    rules: tuple[Rule, ...]
    inputs: Inputs

    @classmethod
    def of(cls, spec: PolicySpecification, command_map: CommandMap) -> Overrides:
        """Return the rules of a specification.

        Raises
        ------
        ConfigurationError
            If a rule looks beyond the clip of a channel, where the policy's input does not tell whether it holds.
        """
        inputs = spec.inputs
        rules = []
        for number, told in enumerate(spec.overrides):
            conditions = []
            for name, bound in told.when.items():
                channels = [channel for channel in spec.observation if name in (channel.name, channel.kind)]
                columns = np.concatenate([inputs.newest(channel.name) for channel in channels])
                conditions.append(Condition.of(columns, bound))
                for channel in channels:
                    _require_told(channel, bound, f"overrides.{number}.when.{name}")
            rules.append(Rule(tuple(conditions), command_map.of_axes(np.array(told.command))))
        return cls(tuple(rules), inputs)

    def __bool__(self) -> bool:
        """Tell whether there is any."""
        return bool(self.rules)

    def apply(self, observations: Floats, commands: Floats) -> Floats:
        """Return what is sent after observations (B, n) of which the policy commands (B, A)."""
        if not self.rules:
            return commands
        commands = commands.copy()
        least, most = self.inputs.readings(observations)
        for rule in reversed(self.rules):
            commands[_all(c.surely(least, most) for c in rule.conditions)] = rule.command
        return commands

    def over(self, lower: Floats, upper: Floats) -> Standing:
        """Tell which rules may count over boxes of observations, (B, n) each. **Sound:** yes, a rule that may does."""
        least, most = self._decoded(lower, upper)
        open_ = np.ones(len(lower), dtype=bool)
        counts = np.zeros((len(lower), len(self.rules)), dtype=bool)
        for number, rule in enumerate(self.rules):
            counts[:, number] = open_ & _all(c.possibly(least, most, _FEW_ROUNDINGS) for c in rule.conditions)
            open_ = open_ & ~_all(c.surely(least, most, _FEW_ROUNDINGS) for c in rule.conditions)
        return Standing(counts, open_)

    def around(self, observations: Floats, lower: Floats, upper: Floats) -> list[Floats]:
        """Return observations in boxes, (B, n) each, at which rules rather apply, or rather do not: where to search."""
        found = []
        for rule in self.rules:
            ends = [self._pushed(rule, observations, lower, upper, inside) for inside in (True, False)]
            found += ends
        return found

    def _pushed(self, rule: Rule, observations: Floats, lower: Floats, upper: Floats, inside: bool) -> Floats:
        """Move what a rule looks at to the end of the box where it rather holds, or to the other one."""
        least, most = (self.inputs.readings(end)[0] for end in (lower, upper))
        pushed = observations.copy()
        for condition in rule.conditions:
            columns = condition.columns
            rising = most[:, columns] >= least[:, columns]
            down = np.isfinite(condition.below) == inside
            pushed[:, columns] = np.where(rising == down, lower[:, columns], upper[:, columns])
        return pushed

    def _decoded(self, lower: Floats, upper: Floats) -> tuple[Floats, Floats]:
        """Return the least and the largest reading in boxes of inputs, (B, n) each."""
        ends = [*self.inputs.readings(lower), *self.inputs.readings(upper)]
        least, most = np.minimum.reduce(ends), np.maximum.reduce(ends)
        for number, channel in enumerate(self.inputs.channels):
            if channel.encoding.reciprocal:
                columns = np.flatnonzero(self.inputs.channel == number)
                scaled = [(end[:, columns] - channel.offset) / channel.scale for end in (lower, upper)]
                one_sign = np.minimum(*scaled) * np.maximum(*scaled) > 0.0
                least[:, columns] = np.where(one_sign, least[:, columns], -np.inf)
                most[:, columns] = np.where(one_sign, most[:, columns], np.inf)
        return least, most


def _all(conditions: Iterable[Booleans]) -> Booleans:
    return np.asarray(np.logical_and.reduce(list(conditions)))


def _require_told(channel: Channel, bound: Bound, where: str) -> None:
    """Refuse a threshold at or beyond the end of a clip: there every reading beyond is one and the same input."""
    if channel.clip is None:
        return
    ends = np.array(channel.clip)[:, None]
    least, most = channel.encoding.readings(ends)
    there = Condition.of(np.zeros(1, dtype=np.int64), bound)
    if (there.surely(least, most) != there.possibly(least, most)).any():
        raise ConfigurationError(
            f"{where}: channel '{channel.name}' is clipped to [{channel.clip[0]:g}, {channel.clip[1]:g}] before the "
            "policy takes it, so its input does not tell whether the rule applies",
            "widen the channel's `clip`, or move the rule's number",
        )
