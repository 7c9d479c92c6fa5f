"""Other readings of what a policy commands: the order of its outputs, their sides, and how they were normalised."""

from __future__ import annotations

from collections.abc import Callable

from viatool.doctor.interpretation import Background, Variants, reads, with_action
from viatool.policy import ActionChannel, PolicySpecification

Scaled = Callable[[ActionChannel], tuple[float, float]]
"""Gives the scale and the offset of an action."""

_TURNS = ("angular", "angular_acceleration", "steering")


@reads("order of the actions")
def actions_swapped(spec: PolicySpecification, around: Background) -> Variants:
    """Yield two actions in the other order."""
    if len(spec.action) == 2:
        rules = [rule.model_copy(update={"command": rule.command[::-1]}) for rule in spec.overrides]
        pairs = zip(
            spec.action[::-1], spec.action, strict=True
        )  # what each output is, which stays where it is
        swapped = [other.model_copy(update={"entry": own.entry}) for other, own in pairs]
        yield "actions swapped", spec.model_copy(update={"action": swapped, "overrides": rules})


@reads("side of turns")
def turns_flipped(spec: PolicySpecification, around: Background) -> Variants:
    """Yield turns to the other side."""
    yield from _flipped(spec, _TURNS, "turns to the other side")


@reads("side of lateral motion")
def lateral_flipped(spec: PolicySpecification, around: Background) -> Variants:
    """Yield lateral motion to the other side."""
    yield from _flipped(spec, ("lateral",), "lateral motion to the other side")


@reads("scale of the actions")
def actions_normalised(spec: PolicySpecification, around: Background) -> Variants:
    """Yield outputs in physical units, in [-1, 1] over the range of each action, and as shares of its upper limit."""
    if spec.choice is not None:
        return

    def physical(action: ActionChannel) -> tuple[float, float]:
        return 1.0, 0.0

    def over_range(action: ActionChannel) -> tuple[float, float]:
        return 0.5 * (action.upper - action.lower), 0.5 * (action.upper + action.lower)

    def shares(action: ActionChannel) -> tuple[float, float]:
        return max(abs(action.lower), abs(action.upper)), 0.0

    for words, scaled in (
        ("outputs in physical units", physical),
        ("outputs normalised to [-1, 1]", over_range),
        ("outputs as shares of the limits", shares),
    ):

        def changed(action: ActionChannel, scaled: Scaled = scaled) -> ActionChannel:
            scale, offset = scaled(action)
            side = -1.0 if action.scale < 0.0 else 1.0
            return action.model_copy(update={"scale": side * scale, "offset": offset}) if scale else action

        yield words, with_action(spec, changed)


def _flipped(spec: PolicySpecification, kinds: tuple[str, ...], words: str) -> Variants:
    """Yield actions of some kinds, and such axes of a choice, with the other sign."""

    def changed(action: ActionChannel) -> ActionChannel:
        if action.kind in kinds:
            return action.model_copy(update={"scale": -action.scale, "offset": -action.offset + 0.0})
        if action.axes is None or action.commands is None:
            return action
        signs = [-1.0 if axis in kinds else 1.0 for axis in action.axes]
        table = tuple(
            tuple(sign * number + 0.0 for sign, number in zip(signs, command, strict=True))
            for command in action.commands
        )
        return action.model_copy(update={"commands": table})

    if any(kind in kinds for action in spec.action for kind in (action.kind, *(action.axes or ()))):
        yield words, with_action(spec, changed)
