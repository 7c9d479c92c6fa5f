"""One reading of a policy's numbers: its specification, and what was changed in it to get there."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from viatool.channels import Extent
from viatool.policy import ActionChannel, PolicySpecification
from viatool.policy.specification import ObservationChannel
from viatool.world import Robot

_DIGITS = 9  # to which directions and scales are told apart


@dataclass(frozen=True)
class Background:
    """What may have been used to scale numbers: the robot's sensors and limits, and how large the map is."""

    robot: Robot
    extent: Extent


@dataclass(frozen=True)
class Change:
    """One thing that is read in another way.

    Parameters
    ----------
    family : str
        What it is about; a reading has at most one change of each family.
    words : str
        How it is read, for people.
    """

    family: str
    words: str


@dataclass(frozen=True, eq=False)
class Interpretation:
    """A reading of what a policy observes and commands.

    Parameters
    ----------
    spec : PolicySpecification
        That says so.
    changes : tuple of Change
        What is read in another way than the policy's own specification says.
    """

    spec: PolicySpecification
    changes: tuple[Change, ...] = ()

    @property
    def name(self) -> str:
        """Return what is read in another way, in words."""
        return ", ".join(change.words for change in self.changes) or "as specified"

    def others(self, around: Background) -> Iterator[Interpretation]:
        """Yield the readings with one more change."""
        taken = {change.family for change in self.changes}
        told = as_version_2(self.spec)
        for family, read in FAMILIES.items():
            if family not in taken:
                for words, spec in read(told, around):
                    yield Interpretation(spec, (*self.changes, Change(family, words)))

    @property
    def meaning(self) -> str:
        """Return what is the same for two readings that mean the same, however they came about."""
        told = as_version_2(self.spec)
        observed = [_meaning_of(channel) for channel in told.observation]
        commanded = [action.model_dump(mode="json", exclude_none=True) for action in told.action]
        for action in commanded:
            action |= {key: round(action[key], _DIGITS) for key in ("scale", "offset")}
        return json.dumps([observed, commanded], sort_keys=True)


Variants = Iterator[tuple[str, PolicySpecification]]
Family = Callable[[PolicySpecification, Background], Variants]
_Family = TypeVar("_Family", bound=Family)

FAMILIES: dict[str, Family] = {}
"""Plausible other readings by what they are about, each a function of a specification of version 2 and the surroundings
that yields what is read in another way, in words, and the specification that says so."""


def reads(family: str) -> Callable[[_Family], _Family]:
    """Register a function that yields other readings.

    Raises
    ------
    ValueError
        If the name is taken.
    """

    def register(read: _Family) -> _Family:
        if family in FAMILIES:
            raise ValueError(f"the family of readings '{family}' is registered twice")
        FAMILIES[family] = read
        return read

    return register


def as_version_2(spec: PolicySpecification) -> PolicySpecification:
    """Return a specification in the terms of version 2, in which every other reading can be said.

    An action map becomes the scale and offset of each action.
    """
    if spec.schema_version == 2:
        return spec
    action = spec.action
    if spec.action_map is not None:
        pairs = zip(spec.action, spec.action_map.scale, spec.action_map.offset, strict=True)
        action = [
            channel.model_copy(update={"scale": scale, "offset": offset}) for channel, scale, offset in pairs
        ]
    return spec.model_copy(update={"schema_version": 2, "action": action, "action_map": None})


def with_observation(
    spec: PolicySpecification, change: Callable[[ObservationChannel], ObservationChannel]
) -> PolicySpecification:
    """Return a specification whose channels that are not fixed are changed."""
    channels = [channel if channel.value is not None else change(channel) for channel in spec.observation]
    return spec.model_copy(update={"observation": channels})


def with_action(
    spec: PolicySpecification, change: Callable[[ActionChannel], ActionChannel]
) -> PolicySpecification:
    """Return a specification whose actions are changed."""
    return spec.model_copy(update={"action": [change(action) for action in spec.action]})


def _meaning_of(channel: ObservationChannel) -> dict[str, Any]:
    """Return what a channel means, its rays by their directions."""
    told = channel.model_dump(mode="json", exclude_none=True, exclude={"lidar"})
    told |= {key: round(told[key], _DIGITS) for key in ("scale", "offset")}
    lidar = channel.lidar
    if lidar is not None:
        turned = np.mod(lidar.lidar().angles() + 0.5 * 10.0**-_DIGITS, 2.0 * np.pi)
        told["rays"] = np.round(turned, _DIGITS - 2).tolist()
        told["sensor"] = [lidar.bins, lidar.reduce, lidar.minimum_range, lidar.maximum_range, lidar.no_return]
    return told
