"""What the robot's software does with each output after the network: scale, offset and clip, in both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from viatool.arrays import Floats
from viatool.policy.activations import activation
from viatool.policy.assembly import Assembly, Computed, Term
from viatool.policy.network import Network
from viatool.policy.specification import PolicySpecification

Limits = tuple[tuple[float, float], ...]


@dataclass(frozen=True, eq=False)
class Scaling:
    """``scale * output + offset`` of each of A outputs, then perhaps a clip to the limits of each.

    Parameters
    ----------
    scale, offset : ndarray
        (A,).
    limits : tuple of pairs, optional
        A of them; None where nothing is clipped.
    """

    scale: Floats
    offset: Floats
    limits: Limits | None


def scaling_of(spec: PolicySpecification | None) -> Scaling | None:
    """Return what a specification says of the outputs; None if they are the actions as they are.

    Notes
    -----
    Version 1 says it once, in its action map; in version 2 each action has its own scale and offset, and is always
    clipped. The numbers among which a choice is made are left alone.
    """
    if spec is None:
        return None
    limits = tuple((action.lower, action.upper) for action in spec.action)
    if spec.action_map is not None:
        scale, offset = np.array(spec.action_map.scale), np.array(spec.action_map.offset)
        return Scaling(scale, offset, limits if spec.action_map.clip else None)
    if spec.schema_version == 1 or spec.choice is not None:
        return None
    scale, offset = (np.array([getattr(a, name) for a in spec.action]) for name in ("scale", "offset"))
    return Scaling(scale, offset, limits)


def apply_action_map(actions: Floats, spec: PolicySpecification | None) -> Floats:
    """Apply what a specification says of raw outputs ``(B, A)``, in float64."""
    scaling = scaling_of(spec)
    if scaling is None:
        return actions
    mapped: Floats = actions * scaling.scale + scaling.offset
    return mapped if scaling.limits is None else np.clip(mapped, *np.transpose(scaling.limits))


def with_action_map(network: Network, spec: PolicySpecification | None) -> Network:
    """Return the network followed by what a specification says of its outputs, in float64."""
    scaling = scaling_of(spec)
    if scaling is None:
        return network
    assembly, value = behind(network)
    mapped = assembly.affine([Term(value, np.diag(scaling.scale))], scaling.offset, value.shape, "float64")
    if scaling.limits is not None:
        mapped = clipped(assembly, mapped, scaling.limits)
    return assembly.network(mapped)


def behind(network: Network) -> tuple[Assembly, Computed]:
    """Return what goes on behind the nodes of a network, and its output in float64."""
    assembly = Assembly.behind(network)
    raw = Computed(len(network.nodes) - 1, (network.output_size,), network.nodes[-1].precision)
    return assembly, assembly.cast(raw, "float64")


def clipped(assembly: Assembly, values: Computed, limits: Limits) -> Computed:
    """Clip each number to its own limits: split, clip, join; the copies are exact. Equal limits clip all at once."""
    if len(set(limits)) == 1:
        lower, upper = limits[0]
        return assembly.activation(values, activation("Clip", min=lower, max=upper))
    return joined(
        assembly,
        [
            assembly.activation(picked(assembly, values, (index,)), activation("Clip", min=lower, max=upper))
            for index, (lower, upper) in enumerate(limits)
        ],
    )


def picked(assembly: Assembly, values: Computed, which: Sequence[int]) -> Computed:
    """Return some of several numbers; exact copies."""
    count = len(which)
    return assembly.copies([(values, np.array(which))], np.zeros(count), (count,), "float64")


def joined(assembly: Assembly, numbers: list[Computed]) -> Computed:
    """Return single numbers as one vector; exact copies."""
    count = len(numbers)
    parts = [(number, np.where(np.arange(count) == index, 0, -1)) for index, number in enumerate(numbers)]
    return assembly.copies(parts, np.zeros(count), (count,), "float64")
