"""Policies that may say what their numbers mean, and the refusal of one that does not."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from viatool.errors import PolicyError
from viatool.policy.specification import PolicySpecification


class Specified(Protocol):
    """A policy that may say what its numbers mean."""

    @property
    def spec(self) -> PolicySpecification | None:
        """Meaning of the observation and the action."""


def name_of(policy: object) -> str:
    """Return what a message calls a policy: its file, if it has one."""
    path = getattr(policy, "path", None)
    return "the policy" if path is None else f"policy '{path}'"


def specification_of(policy: Specified, hint: str | None = None) -> PolicySpecification:
    """Return the specification of a policy.

    Parameters
    ----------
    policy : Specified
        As loaded.
    hint : str, optional
        How to give one where it is asked for; by default as an option, with the YAML file beside the policy if there
        is one of its name.

    Raises
    ------
    PolicyError
        If it has none.
    """
    if policy.spec is None:
        raise PolicyError(
            f"{name_of(policy)} has no specification, so its numbers have no meaning",
            hint or _described(policy),
        )
    return policy.spec


def _described(policy: object) -> str:
    path = getattr(policy, "path", None)
    beside = None if path is None else Path(path).with_suffix(".yaml")
    if beside is None or not beside.is_file():
        return "describe it with --spec robot.yaml"
    return f"give --spec {beside}, which lies beside it"
