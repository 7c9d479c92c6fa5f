"""Names of the columns of a trajectory table, from the policy's specification."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from viatool.channels.inputs import numbered

if TYPE_CHECKING:
    from viatool.policy import PolicySpecification


MOTION = "motion_"
"""Before the names of what a robot has besides its pose."""


RESERVED = frozenset(("episode", "time", "x", "y", "theta", "outcome", "cost", "scenario"))
"""Columns that a table has of its own."""


def observation_columns(specification: PolicySpecification) -> list[str]:
    """Return one column name for each observation entry: lidar_0, lidar_1, ..., goal_distance, ...

    Those of earlier frames end in ``_before_1``, ..., the control intervals before; ``observed_`` stands before a name
    that a table has of its own, such as x.
    """
    return [f"observed_{name}" if name in RESERVED else name for name in specification.inputs.names]


def memory_columns(specification: PolicySpecification) -> list[str]:
    """Return the last of the observation's columns, those that hold the policy's memory; none for one without."""
    size = sum(channel.size for channel in specification.remembered)
    return observation_columns(specification)[specification.observation_size - size :]


def action_columns(specification: PolicySpecification) -> list[str]:
    """Return one column name for each number that the policy gives; `command_` before it if that is taken."""
    taken = {*observation_columns(specification), *RESERVED}
    names = _flat(numbered(channel.name, channel.outputs) for channel in specification.action)
    return [f"command_{name}" if name in taken else name for name in names]


def _flat(groups: Iterable[list[str]]) -> list[str]:
    return [name for group in groups for name in group]
