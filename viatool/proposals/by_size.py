"""A proposal from sizes alone."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from viatool.proposals.layout import Channel, Layout, command, size_of
from viatool.proposals.projects import known_layout
from viatool.proposals.proposal import FILL_IN, Guess, PolicyFacts, Proposal
from viatool.proposals.rays import rays_and_tail

_LIMITS = {"linear": (0.0, 0.5), "lateral": (-0.5, 0.5), "angular": (-1.0, 1.0)}
_UNITS = {"linear": "m/s", "lateral": "m/s", "angular": "rad/s"}
_MOST_COMMANDS = 3
"""More numbers than a robot that moves on the ground is commanded with are scores of a choice."""

_STACKS = (1, 3, 4, 5, 6, 8)
"""How many whole observations are commonly stacked."""

_NO_TANH = Guess(
    "actions come in [-1, 1], though no tanh is the last thing in the file",
    "if they come as commands, remove `scale` and `offset`",
)


def propose_by_size(facts: PolicyFacts) -> Proposal:
    """Propose a specification from how many numbers go in and come out.

    Parameters
    ----------
    facts : PolicyFacts
        The sizes, and what else is known; limits that a file states are taken as they are.

    Returns
    -------
    Proposal
        Of the project whose sizes these are, of a common LiDAR and what follows it, of several frames of one of
        them, or of channels without a meaning.
    """
    for count in _STACKS:
        if facts.inputs % count == 0 and (count == 1 or not facts.ports):
            frame = replace(facts, inputs=facts.inputs // count)
            found = _of_a_project(frame) or _of_rays(frame)
            if found is not None:
                return _stacked(_with_ranges(found, frame), count, facts)
    action, guesses = _action(facts, navigates=False)
    return Proposal(
        _unknown(facts),
        action,
        f"its sizes alone, {facts.inputs} numbers in and {facts.outputs} out",
        (_nothing_known(facts.inputs), *guesses),
        facts.names,
    )


def _of_a_project(facts: PolicyFacts) -> Proposal | None:
    """Return what a project with these sizes does."""
    layout = None if facts.ports else known_layout(facts.inputs, facts.outputs)
    if layout is None:
        return None
    action, guesses = layout.action, layout.about_action
    chooses = action[0]["kind"] == "choice"
    if facts.chooses is not None and facts.chooses != chooses:
        return None
    if facts.chooses:  # of a file that holds a choice, and not its commands
        action, guesses = _choice(facts)
    elif facts.limits is not None:
        names = ", ".join(str(each["kind"]) for each in action)
        action = [_within(*pair) for pair in zip(action, facts.limits, strict=True)]
        guesses = (Guess(f"the outputs command {names}, in this order", "what the robot's driver sends"),)
    elif not facts.squashed and "scale" in action[0]:
        guesses = (*guesses, _NO_TANH)
    return Proposal(
        layout.observation,
        action,
        f"its sizes, {facts.inputs} numbers in and {facts.outputs} out, which are those of {layout.project}",
        (*_of_its_meaning(layout), *guesses),
    )


def _of_its_meaning(layout: Layout) -> tuple[Guess, ...]:
    """Return what has to be true for an observation to be that of a project."""
    told = (Guess(f"it is a policy of {layout.project}", "where it was trained"), *layout.guesses)
    return tuple(replace(guess, meaning=True) for guess in told)


def _within(action: Channel, limits: tuple[float, float]) -> Channel:
    """Return an action that comes as a command within limits."""
    kept = {key: value for key, value in action.items() if key not in ("scale", "offset")}
    return {**kept, "lower": limits[0], "upper": limits[1]}


def _of_rays(facts: PolicyFacts) -> Proposal | None:
    """Return rays and what commonly follows them; of several inputs, the first has to be the rays."""
    common = rays_and_tail(facts.inputs) if facts.outputs > 1 else None
    if common is None or (facts.ports and facts.ports[0][1] != size_of(common[0][0])):
        return None
    observation, guesses = common
    action, more = _action(facts, navigates=True)
    source = f"its sizes alone, {facts.inputs} numbers in and {facts.outputs} out"
    return Proposal(observation, action, source, (*guesses, *more))


def _stacked(proposal: Proposal, count: int, facts: PolicyFacts) -> Proposal:
    """Return a proposal of whole observations that are stacked."""
    if count == 1:
        return replace(proposal, more=facts.names)
    stack = Guess(
        f"{facts.inputs} = {count} x {facts.inputs // count}: {count} whole observations, oldest first, one step apart",
        "the frame stack: `frames`, its `stride` and `order`",
        meaning=True,
    )
    more = {**facts.names, "frames": {"count": count, "order": "oldest_first"}}
    return replace(
        proposal,
        source=f"{proposal.source}, {count} times",
        guesses=(stack, *proposal.guesses),
        more=more,
    )


def _unknown(facts: PolicyFacts) -> list[Channel]:
    ports = facts.ports or (("observation", facts.inputs),)
    return [{"name": name, "size": size, "unit": "?", "kind": "other"} for name, size in ports]


def _nothing_known(size: int) -> Guess:
    from viatool.channels import kinds

    return Guess(
        f"no observation that is known has {size} numbers: channels of kind other stand for them",
        "split them into channels whose sizes add up to it, each of a kind: " + ", ".join(kinds()),
        meaning=True,
    )


def _action(facts: PolicyFacts, *, navigates: bool) -> tuple[list[Channel], tuple[Guess, ...]]:
    """Return action channels for the outputs of a policy."""
    if facts.chooses or (facts.chooses is None and navigates and facts.outputs > _MOST_COMMANDS):
        return _choice(facts)
    names = {1: ["angular"], 2: ["linear", "angular"], 3: ["linear", "lateral", "angular"]}.get(facts.outputs)
    if names is None or not navigates:
        return _unnamed(facts)
    if facts.limits is not None:
        pairs = zip(names, facts.limits, strict=True)
        actions = [command(name, _UNITS[name], limits, scaled=False) for name, limits in pairs]
        return actions, (
            Guess(f"the outputs command {', '.join(names)}, in this order", "what the robot's driver sends"),
        )
    actions = [command(name, _UNITS[name], _LIMITS[name], facts.squashed) for name in names]
    words = ", ".join(f"{name} from {_LIMITS[name][0]} to {_LIMITS[name][1]}" for name in names)
    scaled = "scaled from [-1, 1]" if facts.squashed else "as they come, without `scale` and `offset`"
    return actions, (Guess(f"the outputs command {words}, {scaled}", "the robot's limits, and its driver"),)


def _choice(facts: PolicyFacts) -> tuple[list[Channel], tuple[Guess, ...]]:
    table: list[list[Any]] = [[FILL_IN, FILL_IN] for _ in range(facts.outputs)]
    action = {"name": "command", "kind": "choice", "axes": ["linear", "angular"], "commands": table}
    return [action], (
        Guess(
            f"the largest of {facts.outputs} outputs chooses a command of linear (m/s) and angular (rad/s); which "
            f"commands they are, no file says: fill in all {facts.outputs}",
            "the table of actions in the environment, in its order",
        ),
    )


def _unnamed(facts: PolicyFacts) -> tuple[list[Channel], tuple[Guess, ...]]:
    limits = facts.limits or ((-1.0, 1.0),) * facts.outputs
    actions = [
        {"name": f"action_{index}", "unit": "?", "kind": "other", "lower": lower, "upper": upper}
        for index, (lower, upper) in enumerate(limits)
    ]
    said = "stated by the file" if facts.limits else "from -1 to 1"
    return actions, (
        Guess(
            f"each action is of no kind, {said}",
            "`kind`: linear (m/s), angular (rad/s), ...; `lower`, `upper`; `scale` and `offset` where outputs are "
            "normalised; or one action of kind `choice` with `axes` and `commands`",
        ),
    )


def _with_ranges(proposal: Proposal, facts: PolicyFacts) -> Proposal:
    """Take the largest range of a LiDAR from the observation's limits, where the file states them."""
    if facts.ranges is None:
        return proposal
    channels, place = [], 0
    guesses = list(proposal.guesses)
    for channel in proposal.observation:
        upper = {high for _, high in facts.ranges[place : place + size_of(channel)]}
        place += size_of(channel)
        lidar, plain = channel.get("lidar"), "scale" not in channel
        if lidar and plain and len(upper) == 1 and 0.0 < (most := upper.pop()) < 1e3:
            channel = {**channel, "lidar": {**lidar, "maximum_range": round(float(most), 6)}}
            guesses.append(
                Guess(f"the LiDAR reaches {most:g} m, as the observation's limits say", "range_max")
            )
        channels.append(channel)
    return replace(proposal, observation=channels, guesses=tuple(guesses))
