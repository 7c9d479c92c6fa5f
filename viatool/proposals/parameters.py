"""Parameter files of ROS packages: ranges, limits and periods by the names that packages give them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from viatool.errors import PolicyError
from viatool.proposals.proposal import Guess, Proposal
from viatool.proposals.terms import is_number

_NAMES: tuple[tuple[str, str], ...] = (
    (r"^max_(lin|linear)\w*$|^(lin|linear)\w*_max$|^max_v(el)?_x$", "linear.upper"),
    (r"^min_(lin|linear)\w*$|^(lin|linear)\w*_min$|^min_v(el)?_x$", "linear.lower"),
    (r"^max_(ang|angular|rot)\w*$|^(ang|angular)\w*_max$|^max_v(el)?_(theta|z)$", "angular.upper"),
    (
        r"^(lidar|laser|scan|max)?_?(max_)?range(_max)?$|^(max_(lidar|laser|scan)_range)$",
        "lidar.maximum_range",
    ),
    (r"^(control_|inference_|policy_)?(dt|period|interval|step_time)$", "interval"),
    (r"^(control_|inference_|policy_|loop_)?(rate|frequency|hz)$", "rate"),
    (r"^(robot|robot_name|robot_model)$", "robot"),
)


def with_parameters(proposal: Proposal, path: Path) -> Proposal:
    """Take what a parameter file states into a proposal.

    Parameters
    ----------
    proposal : Proposal
        What is left out of the file stays as it is.
    path : Path
        YAML, as ``node: {ros__parameters: {...}}`` or plain.

    Raises
    ------
    PolicyError
        If it is no YAML mapping.
    """
    import yaml

    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError, RecursionError) as error:
        raise PolicyError(
            f"cannot read the parameters {path}: {error}", "give a YAML parameter file"
        ) from error
    if not isinstance(content, dict):
        raise PolicyError(
            f"{path} holds no parameters by name", "give a YAML parameter file of a ROS package"
        )
    taken = []
    for name, value in _leaves(content):
        field = next((field for pattern, field in _NAMES if re.search(pattern, name.lower())), None)
        changed = None if field is None else _with(proposal, field, value)
        if changed is not None:
            proposal = changed
            taken.append(f"{field} is {value}, from '{name}'")
    guesses = tuple(Guess(words, f"{path.name} means that") for words in taken)
    return replace(proposal, source=f"{proposal.source}, and {path}", guesses=(*proposal.guesses, *guesses))


def with_limits(proposal: Proposal, limits: Sequence[tuple[float, float]]) -> Proposal:
    """Return a proposal whose commands have these limits, one pair for each; as it was where their number differs."""
    if len(limits) != len(proposal.action) or any("kind" not in action for action in proposal.action):
        return proposal
    actions = []
    for action, (lower, upper) in zip(proposal.action, limits, strict=True):
        for end, value in (("upper", upper), ("lower", lower)):
            action = _limited(action, str(action["kind"]), end, float(value))
        actions.append(action)
    return replace(proposal, action=actions)


def _leaves(content: dict[Any, Any]) -> Iterator[tuple[str, Any]]:
    for name, value in content.items():
        if isinstance(value, dict):
            yield from _leaves(value)
        else:
            yield str(name), value


def _with(proposal: Proposal, field: str, value: Any) -> Proposal | None:
    """Return a proposal in which one thing is as stated; None where that is not possible."""
    more = dict(proposal.more or {})
    if field == "robot":
        return replace(proposal, more={**more, "robot": value}) if isinstance(value, str) else None
    if not is_number(value):
        return None
    if field in ("interval", "rate"):
        if not value > 0:
            return None
        interval = float(value) if field == "interval" else 1.0 / value
        return replace(proposal, more={**more, "control_interval": interval})
    if field == "lidar.maximum_range":
        channels = [
            {**c, "lidar": {**c["lidar"], "maximum_range": float(value)}} if "lidar" in c else c
            for c in proposal.observation
        ]
        return (
            replace(proposal, observation=channels)
            if channels != proposal.observation and value > 0
            else None
        )
    kind, end = field.split(".")
    actions = [_limited(action, kind, end, float(value)) for action in proposal.action]
    return replace(proposal, action=actions) if actions != proposal.action else None


def _limited(action: dict[str, Any], kind: str, end: str, value: float) -> dict[str, Any]:
    """Return an action with another limit; one that is stretched over its limits stays so."""
    if action.get("kind") != kind:
        return action
    limits = {"lower": action["lower"], "upper": action["upper"], end: value}
    if kind == "angular" and end == "upper":
        limits["lower"] = -value
    if limits["lower"] > limits["upper"]:
        return action
    stretched = "scale" in action and action["scale"] == (action["upper"] - action["lower"]) / 2.0
    if stretched:
        limits["scale"] = (limits["upper"] - limits["lower"]) / 2.0
        limits["offset"] = (limits["upper"] + limits["lower"]) / 2.0
    return {**action, **limits}
