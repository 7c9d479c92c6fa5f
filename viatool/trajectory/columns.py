"""Names of the columns of a trajectory table, from the policy's specification."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from viatool.policy import PolicySpecification


MOTION = "motion_"
"""Before the names of what a robot has besides its pose."""


def numbered(name: str, size: int) -> list[str]:
    """Return `name` itself for one column, and name_0, name_1, ... for more."""
    return [name] if size == 1 else [f"{name}_{index}" for index in range(size)]


def observation_columns(specification: PolicySpecification) -> list[str]:
    """Return one column name for each observation entry: lidar_0, lidar_1, ..., goal_distance, ..."""
    return _flat(numbered(channel.name, channel.size) for channel in specification.observation)


def memory_columns(specification: PolicySpecification) -> list[str]:
    """Return the last of the observation's columns, those that hold the policy's memory; none for one without."""
    return _flat(numbered(channel.name, channel.size) for channel in specification.remembered)


def action_columns(specification: PolicySpecification) -> list[str]:
    """Return one column name for each number that the policy gives; `command_` before it if an observation has it."""
    taken = set(observation_columns(specification))
    names = _flat(numbered(channel.name, channel.outputs) for channel in specification.action)
    return [f"command_{name}" if name in taken else name for name in names]


def _flat(groups: Iterable[list[str]]) -> list[str]:
    return [name for group in groups for name in group]
