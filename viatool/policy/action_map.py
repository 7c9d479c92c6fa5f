"""What the robot's software does after the network: scale, offset and clip, in both."""

from __future__ import annotations

import numpy as np

from viatool.arrays import Floats
from viatool.policy.activations import activation
from viatool.policy.assembly import Assembly, Computed, Term
from viatool.policy.network import Network
from viatool.policy.specification import PolicySpecification


def apply_action_map(actions: Floats, spec: PolicySpecification | None) -> Floats:
    """Apply the action map of a specification to raw outputs ``(B, A)``, in float64."""
    if spec is None or spec.action_map is None:
        return actions
    mapped: Floats = actions * np.array(spec.action_map.scale) + np.array(spec.action_map.offset)
    if spec.action_map.clip:
        mapped = np.clip(mapped, [c.lower for c in spec.action], [c.upper for c in spec.action])
    return mapped


def with_action_map(network: Network, spec: PolicySpecification | None) -> Network:
    """Return the network followed by the action map of a specification, in float64."""
    if spec is None or spec.action_map is None:
        return network
    size = network.output_size
    assembly = Assembly.behind(network)
    raw = Computed(len(network.nodes) - 1, (size,), network.nodes[-1].precision)
    value = assembly.cast(raw, "float64")
    terms = [Term(value, np.diag(np.array(spec.action_map.scale)))]
    mapped = assembly.affine(terms, np.array(spec.action_map.offset), (size,), "float64")
    if spec.action_map.clip:
        mapped = _clipped(assembly, mapped, spec)
    return assembly.network(mapped)


def _clipped(assembly: Assembly, mapped: Computed, spec: PolicySpecification) -> Computed:
    """Clip each action to its own limits: split, clip, join; the copies are exact."""
    limits = [(channel.lower, channel.upper) for channel in spec.action]
    parts = []
    for index, (lower, upper) in enumerate(limits):
        position = np.array([index])
        one = assembly.copies([(mapped, position)], np.zeros(1), (1,), "float64")
        clipped = assembly.activation(one, activation("Clip", min=lower, max=upper))
        parts.append((clipped, np.where(np.arange(len(limits)) == index, 0, -1)))
    return assembly.copies(parts, np.zeros(len(limits)), (len(limits),), "float64")
