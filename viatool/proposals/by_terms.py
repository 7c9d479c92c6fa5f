"""A proposal from what an exporter states: terms of the observation by name, scales, histories."""

from __future__ import annotations

import re

from viatool.channels import kinds
from viatool.errors import PolicyError
from viatool.proposals.by_size import propose_by_size
from viatool.proposals.layout import VECTORS, Channel, one, scan
from viatool.proposals.proposal import Guess, PolicyFacts, Proposal
from viatool.proposals.terms import CONTRACT, ObservationTerm, Stated

_LARGEST = 1e9
"""Stands for an open end of a clip, for the ends are finite in a specification."""

_SIZES: dict[str, int] = {**{name: len(parts) for name, parts in VECTORS.items()}, "velocity_commands": 3}

_KINDS: tuple[tuple[str, str], ...] = (
    (r"lidar|laser|scan|ranges|rays", "lidar"),
    (r"goal_?dist|dist\w*_?(to_?)?goal", "goal_distance"),
    (r"goal_?(angle|bearing|heading)|heading_error|bearing", "goal_bearing"),
    (r"goal_?cos", "goal_cosine"),
    (r"goal_?sin", "goal_sine"),
    (r"^(last_|previous_|prev_)?actions?$", "previous_raw"),
    (r"(last|prev\w*)_(lin|v)", "previous_linear"),
    (r"(last|prev\w*)_(ang|w|omega)", "previous_angular"),
)


def propose_by_terms(stated: Stated, facts: PolicyFacts) -> Proposal:
    """Propose a specification from what an exporter states, checked against the graph.

    Raises
    ------
    PolicyError
        If what is stated contradicts the graph: names both.
    """
    sizes = _sizes(stated, facts)
    observation: list[Channel] = []
    guesses: list[Guess] = []
    for term, size in zip(stated.terms, sizes, strict=True):
        channels, found = _channels(term, size)
        observation += channels
        guesses += found
    action, found = _actions(stated, facts)
    more = facts.names | ({} if stated.interval is None else {"control_interval": stated.interval})
    return Proposal(_named_once(observation), action, stated.where, (*guesses, *found), more)


def _sizes(stated: Stated, facts: PolicyFacts) -> list[int]:
    """Return the size of each term's frame; one that nothing says is what is left of the input."""
    joints = len(stated.joints) or None
    known = {**_SIZES, "actions": facts.outputs, "last_action": facts.outputs}
    if joints is not None:
        known |= {"joint_pos": joints, "joint_vel": joints}
    sizes = [known.get(term.name) if term.size is None else term.size for term in stated.terms]
    terms = list(zip(stated.terms, sizes, strict=True))
    total = sum(size * term.history for term, size in terms if size is not None)
    open_terms = [term for term, size in terms if size is None]
    if len(open_terms) > 1:
        names = ", ".join(term.name for term in open_terms)
        raise PolicyError(
            f"{stated.where}: nothing says how long the terms {names} are; together they are {facts.inputs - total}",
            f"write {CONTRACT} beside the model: "
            '{"observations": [{"name": ..., "size": ..., "scale": ..., "history_length": ...}, ...]}',
        )
    rest = facts.inputs - total
    fits = rest == 0
    if open_terms:
        fits = rest > 0 and rest % open_terms[0].history == 0
        sizes = [rest // open_terms[0].history if size is None else size for size in sizes]
    if not fits:
        words = ", ".join(
            f"{term.name} {'?' if size is None else size}"
            + (f" x {term.history} frames" if term.history > 1 else "")
            for term, size in terms
        )
        raise PolicyError(
            f"{stated.where}: the observation is {words} = {total}{' and more' if open_terms else ''}, "
            f"but the model takes {facts.inputs}",
            "export the policy again with its metadata, or write the specification by hand",
        )
    return [size for size in sizes if size is not None]


def _channels(term: ObservationTerm, size: int) -> tuple[list[Channel], list[Guess]]:
    """Return the channels of one term."""
    encoding: Channel = {} if term.scale == 1.0 else {"scale": term.scale}
    if term.clip is not None:  # exporters clip first and scale then
        encoding["clip"] = sorted(max(-_LARGEST, min(_LARGEST, end * term.scale)) for end in term.clip)
    frames = {"frames": {"count": term.history, "order": "oldest_first"}} if term.history > 1 else {}
    parts = VECTORS.get(term.name)
    if parts is not None and len(parts) == size and not frames:
        words = ", ".join(part["name"] for part in parts)
        return [{**part, **encoding} for part in parts], [
            Guess(
                f"{term.name} is {words}, of a robot upright on flat ground",
                "the order, and the frame of each",
            )
        ]
    kind = kind_of_term(term.name)
    guess = [Guess(f"{term.name} is of kind {kind}", "the term's function in the environment")]
    if frames:
        guess.append(
            Guess(f"the {term.history} frames of {term.name} come oldest first", "the history buffer")
        )
    if kind == "lidar":
        lidar = {"field_of_view": 3.141592654, "rays": size, "maximum_range": 10.0}
        guess.append(
            Guess(f"the {size} rays are over 180 degrees, to 10 m", "the sensor's pattern and range")
        )
        return [{**scan(size, lidar), "name": term.name, **encoding, **frames}], guess
    if kind not in ("other", "previous_raw") and size > 1:
        kind = "other"
    return [one(term.name, kind, size=size, **encoding, **frames)], guess


def kind_of_term(name: str) -> str:
    """Return the kind of channel that the name of a term tells; "other" where it tells none."""
    if name in kinds():
        return name
    return next((kind for pattern, kind in _KINDS if re.search(pattern, name)), "other")


def _actions(stated: Stated, facts: PolicyFacts) -> tuple[list[Channel], list[Guess]]:
    if stated.actions and len(stated.actions) != facts.outputs:
        raise PolicyError(
            f"{stated.where}: {len(stated.actions)} actions are stated, but the model gives {facts.outputs} numbers",
            "export the policy again with its metadata, or choose its output with --graph-output",
        )
    found = propose_by_size(facts)
    stated_keys = ("name", "unit", "kind", "lower", "upper", "scale", "offset")
    actions = [dict(action) for action in found.action]
    guesses = list(found.guesses[-1:])
    if len(actions) != len(stated.actions):
        return actions, guesses
    for action, said in zip(actions, stated.actions, strict=True):
        if said.keys() & {"scale", "offset"}:
            action.pop("scale", None)
            action.pop("offset", None)
        action.update({key: said[key] for key in stated_keys if key in said})
    if any("scale" in said for said in stated.actions):
        guesses.append(Guess("scales of the actions are as stated, around an offset of 0", "the action term"))
    return actions, guesses


def _named_once(channels: list[Channel]) -> list[Channel]:
    """Return channels of which each has its own name."""
    seen: dict[str, int] = {}
    named = []
    for channel in channels:
        name = channel["name"]
        seen[name] = seen.get(name, 0) + 1
        named.append(channel if seen[name] == 1 else {**channel, "name": f"{name}_{seen[name]}"})
    return named
