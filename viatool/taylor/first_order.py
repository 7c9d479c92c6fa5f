"""What models of order 1 say of the actions over boxes: by the compiled kernel where it covers them, else by numpy.

Both answer the same questions, with bounds that differ by their rounding and in favour of the tighter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from viatool.arrays import Booleans, Floats, Hull, Indices
from viatool.policy.network import Activation, Network
from viatool.taylor.approximation import Approximation
from viatool.taylor.attained import attained_actions
from viatool.taylor.backwards import hull_backwards
from viatool.taylor.kernel import EFFORT, Bounded, Kernel, kernel_of
from viatool.taylor.propagation import Box, is_curved, propagate
from viatool.taylor.refinement import (
    ROUNDS,
    Extrema,
    effort_in_passing,
    extrema_of,
    refine_by_pieces,
    refine_by_squares,
    refine_monotone,
    sees_squares,
)
from viatool.taylor.splitting import SplittingEffort

_WIDE, _WIDE_BACKWARDS = 128, 64
"""Neurons of a layer from which on the dual bound, and back-substitution, cost little beside the pass itself."""

_LEAST_PARTS = 8
"""Parts that the kernel examines in any case of a box that stays loose, as they cost it little."""


@dataclass(frozen=True)
class Effort:
    """How the bounds of one pass are tightened.

    Parameters
    ----------
    rule : str
        How activations are approximated.
    refined : bool
        Whether they are at all, but for what costs little beside the pass.
    one_by_one : bool
        Whether each extremum gets passes of its own.
    splitting : SplittingEffort
        When to stop splitting boxes; the kernel does so itself where it finds the core of the network.
    """

    rule: Approximation
    refined: bool
    one_by_one: bool
    splitting: SplittingEffort

    @property
    def climbs(self) -> int:
        """Return the corners that the search for attained actions tries."""
        return 4 if self.refined else 1


@dataclass(frozen=True, eq=False)
class FirstOrder:
    """Bounds of B boxes by models of order 1, and what is attained.

    Parameters
    ----------
    hulls : list of (lower, upper)
        Of every node of the trunk, (B, size) each.
    extrema : Extrema
        ``2 A B`` questions, as `extrema_of` asks them, with their bounds.
    points, found : ndarray
        ``(2 A B, n)`` observations in the boxes and ``(2 A B,)`` the values of ``seed . actions`` there.
    settled : ndarray
        ``(B,)`` bool: whether bounds that were loose have been split.
    """

    hulls: list[Hull]
    extrema: Extrema
    points: Floats
    found: Floats
    settled: Booleans

    def with_rows(self, rows: Indices, other: FirstOrder) -> FirstOrder:
        """Return the same with what else is known put in the place of some of the boxes."""
        batch = self.hulls[0][0].shape[0]
        questions = np.arange(self.found.size).reshape(-1, batch)[:, rows].ravel()
        for mine, theirs in zip(self.hulls, other.hulls, strict=True):
            for side in (0, 1):
                mine[side][rows] = theirs[side]
        ours, new = self.extrema, other.extrema
        for kept, found in (
            (ours.box.lower, new.box.lower), (ours.box.upper, new.box.upper), (ours.bound, new.bound),
            (self.points, other.points), (self.found, other.found),
        ):  # fmt: skip
            kept[questions] = found
        return self


def enclose_first_order(network: Network, trunk: Network, box: Box, effort: Effort) -> FirstOrder:
    """Enclose the actions of the trunk of a network over B boxes.

    Parameters
    ----------
    network, trunk : Network
        The whole, and its first nodes, of A outputs.
    box : Box
        ``(B, n)``.
    effort : Effort
        What is done besides one pass.

    Raises
    ------
    EnclosureError
        If an activation has no finite enclosure.

    Notes
    -----
    **Sound:** yes, for the exact network, by either engine.
    """
    kernel = kernel_of(network, len(trunk.nodes))
    if kernel is None or effort.rule != "chebyshev" or (effort.refined and sees_squares(trunk, box).size):
        return _by_numpy(trunk, box, effort)
    bounded = kernel.bound(box.lower, box.upper, **_of_the_kernel(trunk, effort))
    found = _read(kernel, trunk, box, bounded)
    left = np.flatnonzero(~bounded.done)
    return found.with_rows(left, _by_numpy(trunk, box.rows(left), effort)) if left.size else found


def _by_numpy(trunk: Network, box: Box, effort: Effort) -> FirstOrder:
    passes = propagate(trunk, box, rule=effort.rule)
    hulls = [enclosure.hull for enclosure in passes]
    if goes_backwards(trunk):
        back = hull_backwards(trunk, hulls)
        hulls[-1] = (np.fmax(hulls[-1][0], back[0]), np.fmin(hulls[-1][1], back[1]))
    extrema = extrema_of(box, *hulls[-1])
    if is_wide(trunk):
        extrema = refine_by_pieces(trunk, extrema, passes)
    if effort.refined:
        extrema = refine_by_squares(trunk, extrema, passes, rule=effort.rule)
    if effort.one_by_one:
        extrema = refine_monotone(trunk, extrema, passes, rule=effort.rule)
    points, found = attained_actions(trunk, box, extrema, steps=effort.climbs)
    return FirstOrder(hulls, extrema, points, found, np.zeros(box.lower.shape[0], dtype=bool))


def _of_the_kernel(trunk: Network, effort: Effort) -> dict[str, float]:
    """Return how hard the kernel tries."""
    backwards: dict[str, float] = {"backwards": goes_backwards(trunk)}
    if effort.one_by_one:
        thorough = {"rounds": ROUNDS, "sweeps": EFFORT.sweeps, "neurons": EFFORT.neurons}
        parts = max(effort.splitting.parts, _LEAST_PARTS)
        until = {"parts": parts, "exactly": effort.splitting.exact, "tolerance": effort.splitting.tolerance}
        return {**thorough, **backwards, **until, "whole": is_wide(trunk), "climbs": effort.climbs}
    if is_wide(trunk):
        light = effort_in_passing(1, 2 * trunk.output_size)
        return {"sweeps": 2 * light.sweeps, "neurons": light.neurons, **backwards}
    return backwards


def is_wide(network: Network) -> bool:
    """Tell whether a layer is so wide that the dual bound costs little beside the pass."""
    return max(node.size for node in network.nodes) >= _WIDE


def goes_backwards(network: Network) -> bool:
    """Tell whether a layer of activations is so wide that back-substitution costs little beside the pass."""
    return any(isinstance(node, Activation) and node.size >= _WIDE_BACKWARDS for node in network.nodes)


def _read(kernel: Kernel, trunk: Network, box: Box, bounded: Bounded) -> FirstOrder:
    """Return what the kernel found in the terms of the engine; what is attained is the float64 value of the network."""
    batch, actions = box.lower.shape[0], trunk.output_size
    seed = np.repeat(np.concatenate([np.eye(actions), -np.eye(actions)]), batch, axis=0)
    for filled in (bounded.lower, bounded.upper, bounded.face_lower, bounded.face_upper, bounded.points):
        _clear(filled, bounded.done)
    extrema = Extrema(Box(bounded.face_lower, bounded.face_upper), seed, bounded.bound)
    hulls = kernel.hulls(bounded.lower, bounded.upper)
    found = bounded.found if not is_curved(trunk) else (trunk(bounded.points) * seed).sum(axis=1)
    return FirstOrder(hulls, extrema, bounded.points, found, bounded.settled)


def _clear(values: Floats, done: Booleans) -> None:
    """Put numbers where nothing is known yet."""
    if not done.all():
        values.reshape(-1, done.size, values.shape[1])[:, ~done] = 0.0
