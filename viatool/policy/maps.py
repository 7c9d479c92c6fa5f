"""What is done to the numbers before the first layer and after the last one, in words.

A policy that was exported without its normaliser, or whose actions still wait for a scaling, is verified for
numbers that it never sees: no tool can tell, but every report says which maps were applied.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from viatool.arrays import Floats
from viatool.policy.action_map import Scaling, scaling_of
from viatool.policy.model_file import Ports
from viatool.policy.network import Activation, Affine, Cast, Input, Maximum, Minimum, Network, Node, Product
from viatool.policy.specification import PolicySpecification
from viatool.policy.weights import copies, scale_of, terms

_LISTED = 6
"""Most numbers that are written one by one; of more, the least and the largest are."""

_BEFORE = ("Clip",)
_AFTER = ("Clip", "Tanh", "Sigmoid", "HardSigmoid", "Softsign")
NOTHING_BEFORE = (
    "nothing: the observation enters the first layer as it is, so it has to come as it did in training"
)
NOTHING_AFTER = "nothing: the output of the model is the command"


@dataclass(frozen=True)
class Maps:
    """Sentences on the maps before and after the layers of a network."""

    before: str = NOTHING_BEFORE
    after: str = NOTHING_AFTER


@dataclass(frozen=True, eq=False)
class ScalingStep:
    """``factor * x + offset``, element by element."""

    factor: Floats
    offset: Floats


Step = ScalingStep | Activation


def maps_of(network: Network, spec: PolicySpecification | None, ports: Ports | None = None) -> Maps:
    """Return the maps of a network as it stands in the model file, without the action map of a specification."""
    after = trailing_steps(network)
    parts = [f"inside the model: {_in_words(after)}"] if after else []
    if spec is None:
        parts.append("what the robot makes of the output is not known: there is no specification")
    elif (words := _scaling_in_words(scaling_of(spec))) is not None:
        parts.append(f"by the specification: {words}")
    entries = (
        [] if spec is None else [str(action.entry) for action in spec.action if action.entry is not None]
    )
    if entries:
        parts.insert(
            0, f"by the specification: entries {', '.join(entries)} of the output, the others are dropped"
        )
    if spec is not None and spec.choice is not None:
        parts.append(
            f"by the specification: the largest of {spec.choice.outputs} outputs, of equal ones the first, names "
            "the command of its table"
        )
    if spec is not None and spec.overrides:
        parts.append(
            f"by the specification: the first of {len(spec.overrides)} rules that applies, if one does"
        )
    return Maps(_before_in_words(network, ports), "; ".join(parts) or NOTHING_AFTER)


def _before_in_words(network: Network, ports: Ports | None) -> str:
    starts = entries(network)
    names = {} if ports is None else {place.start: name for name, place in ports.places.items()}
    scaled = {names.get(first, ""): leading_steps(network, start) for first, start in starts.items()}
    if not any(scaled.values()):
        return NOTHING_BEFORE
    if len(scaled) == 1:
        return f"inside the model: {_in_words(*scaled.values())}"
    return "inside the model: " + "; ".join(
        f"{name}: {_in_words(steps) or 'nothing'}" for name, steps in scaled.items()
    )


def entries(network: Network) -> dict[int, int]:
    """Return the nodes at which an observation enters: its first entry and the node, for each input of several.

    A network of several inputs copies its part of the observation for each; one input is the observation itself.
    """
    starts: dict[int, int] = {}
    for index, node in enumerate(network.nodes[1:], start=1):
        if 0 not in node.sources:
            continue
        place = _part(node)
        if place is None:
            return {0: 0}
        starts[place] = index
    return starts


def _part(node: Node) -> int | None:
    """Return the first entry of the part of the observation that a node copies, None where it is no such copy."""
    if not isinstance(node, Affine) or len(node.sources) != 1 or node.bias.any() or node.roundings:
        return None
    rows, columns = node.weights[0].shape
    taken = np.arange(columns)[None, :].astype(np.float64) @ node.weights[0].T  # which entry each row copies
    first = int(taken[0, 0])
    is_copy = bool((terms(node.weights[0]) == 1).all() and copies(node.weights[0]).all())
    if rows == columns or not is_copy:
        return None
    return first if np.array_equal(taken[0], first + np.arange(rows)) else None


def leading_steps(network: Network, start: int = 0) -> list[Step]:
    """Return the scalings and clips that every entry of a node passes before it meets another."""
    steps: list[Step] = []
    while True:
        readers = [index for index, node in enumerate(network.nodes) if start in node.sources]
        step = _step(network.nodes[readers[0]], _BEFORE) if len(readers) == 1 else None
        if step is None:
            return steps
        (start,) = readers
        steps = _joined(steps, step)


def normaliser(network: Network) -> ScalingStep | None:
    """Return what the model makes of every entry of the observation before anything else, None where it is nothing."""
    factor, offset = np.ones(network.input_size), np.zeros(network.input_size)
    for first, start in entries(network).items():
        step = next(iter(leading_steps(network, start)), None)
        if isinstance(step, ScalingStep):
            place = slice(first, first + network.nodes[start].size)
            factor[place], offset[place] = step.factor, step.offset
    if (factor == 1).all() and not offset.any():
        return None
    return ScalingStep(factor, offset)


def trailing_steps(network: Network) -> list[Step]:
    """Return what every action passes by itself after the last layer that mixes values."""
    index = len(network.nodes) - 1
    found: list[Step] = []
    while not isinstance(node := network.nodes[index], Input):
        step = _step(node, _AFTER)
        if step is None:
            break
        found.append(step)
        (index,) = node.sources
    else:
        return []  # the whole model is one such chain; it stands before the first layer
    steps: list[Step] = []
    for step in reversed(found):
        steps = _joined(steps, step)
    return steps


def _step(node: Node, functions: Sequence[str]) -> Step | None:
    match node:
        case Activation():
            return node if node.function.name in functions else None
        case Cast():
            return ScalingStep(np.ones(node.size), np.zeros(node.size))
        case Affine():
            factor = scale_of(node.weights[0]) if len(node.sources) == 1 else None
            return None if factor is None else ScalingStep(factor, node.bias)
        case Input() | Product() | Maximum() | Minimum():
            return None


def _joined(steps: list[Step], step: Step) -> list[Step]:
    """Append a step; two scalings in a row become one, and one that changes nothing is dropped."""
    if isinstance(step, ScalingStep):
        if steps and isinstance(steps[-1], ScalingStep):
            first = steps.pop()
            assert isinstance(first, ScalingStep)
            step = ScalingStep(step.factor * first.factor, step.factor * first.offset + step.offset)
        if (step.factor == 1).all() and not step.offset.any():
            return steps
    return [*steps, step]


def _in_words(steps: Sequence[Step]) -> str:
    return ", then ".join(_one_in_words(step) for step in steps)


def _one_in_words(step: Step) -> str:
    if isinstance(step, ScalingStep):
        return _scaled_in_words("value", step.factor, step.offset)
    parameters = dict(step.function.parameters)
    if step.function.name == "Clip":
        return f"clipped to [{parameters['min']:g}, {parameters['max']:g}]"
    return step.function.name


def _scaling_in_words(scaling: Scaling | None) -> str | None:
    """Return what a specification does with the outputs; None where that is nothing."""
    if scaling is None:
        return None
    text = f"command = {_scaled_in_words('output', scaling.scale, scaling.offset)}"
    if scaling.limits is not None:
        text += ", clipped to " + ", ".join(f"[{lower:g}, {upper:g}]" for lower, upper in scaling.limits)
    return text


def _scaled_in_words(name: str, factor: Floats, offset: Floats) -> str:
    scaled = name if (factor == 1).all() else f"{_numbers(factor)} * {name}"
    return f"{scaled} + {_numbers(offset)}" if offset.any() else scaled


def _numbers(array: Floats) -> str:
    if (array == array[0]).all():
        return f"{array[0]:.6g}"
    if len(array) <= _LISTED:
        return f"({', '.join(f'{value:.6g}' for value in array)})"
    return f"({array.min():.6g} to {array.max():.6g})"
