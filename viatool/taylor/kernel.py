"""Calls of the compiled engine, where it covers a network; numpy is its reference and takes over everywhere else."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import accumulate, pairwise

import numpy as np

from viatool.arrays import Booleans, Floats, Hull, Indices
from viatool.engine import Engine, chosen_engine
from viatool.engine.calls import call, floats, integers
from viatool.policy.network import Network
from viatool.taylor.duality import DualEffort
from viatool.taylor.packed import PackedNetwork, packed


def engine_of(network: Network) -> Engine:
    """Return which engine bounds a network at order 1."""
    return "numpy" if kernel_of(network, len(network.nodes)) is None else "compiled"


def kernel_of(network: Network, trunk: int) -> Kernel | None:
    """Return the kernel of a network of which the first `trunk` nodes are enclosed; None where numpy does it."""
    return _packed_once(network, trunk) if chosen_engine() == "compiled" else None


@lru_cache(maxsize=64)
def _packed_once(network: Network, trunk: int) -> Kernel | None:
    network_as_read = packed(network, trunk)
    return None if network_as_read is None else Kernel(network, trunk, network_as_read)


@dataclass(frozen=True, eq=False)
class Bounded:
    """What the kernel knows of B boxes; nothing of those that are not `done`, which numpy takes on.

    Parameters
    ----------
    done, settled : ndarray
        ``(B,)`` bool; where settled, loose bounds were split as well.
    lower, upper : ndarray
        ``(B, N)``: hulls of all N neurons of the trunk.
    face_lower, face_upper : ndarray
        ``(2 A B, n)``: what is left of the box of each one-sided question, as `extrema_of` asks them.
    bound, found : ndarray
        ``(2 A B,)``: proved upper bounds, and what is attained.
    points : ndarray
        ``(2 A B, n)``: where.
    """

    done: Booleans
    settled: Booleans
    lower: Floats
    upper: Floats
    face_lower: Floats
    face_upper: Floats
    bound: Floats
    found: Floats
    points: Floats


class KernelEffort(ctypes.Structure):
    """How hard the kernel tries to bound the actions over a box.

    Parameters
    ----------
    rounds : int
        How often the box of a question is shrunk where the action is monotone.
    sweeps, neurons : int
        How often each multiplier of the dual bound is improved, 0 for no dual bound; and how many neurons of a
        layer have conditions in it.
    whole : int
        Whether there is a dual bound over the whole box as well, before it is shrunk.
    backwards : int
        Whether the actions, and arguments that lie around a kink, are followed back to the inputs as well.
    climbs : int
        Corners that the search for attained actions tries, from the middle of the box that is left, or without
        `rounds` from the corner where the model of the action alone is largest.
    parts, exactly : int
        Parts of the box of one question at most, where the core of the network is found; and whether the best
        multipliers are looked for where nothing is left to split.
    tolerance : float
        Share of what an action attains within which a bound is not split any more.
    """

    _fields_ = (
        *((name, ctypes.c_int64) for name in ("rounds", "sweeps", "neurons", "whole", "backwards", "climbs")),
        ("parts", ctypes.c_int64),
        ("exactly", ctypes.c_int64),
        ("tolerance", ctypes.c_double),
    )

    @classmethod
    def of(cls, fields: Mapping[str, float]) -> KernelEffort:
        """Return an effort of one pass, but for these fields."""
        return cls(**{"neurons": 1, **fields})


EFFORT = DualEffort(sweeps=4)
"""How hard the kernel looks for multipliers, where numpy takes fewer sweeps, since they cost it more."""

_SOLVED = 2

Conditions = tuple[Indices, Indices, Indices, Floats]


@dataclass(frozen=True, eq=False)
class ExaminedParts:
    """What the kernel knows of K parts of boxes; nothing of those that are not `done`.

    Parameters
    ----------
    done, solved : ndarray
        ``(K,)`` bool; where solved, no multipliers prove more.
    bound : ndarray
        ``(K,)``: proved upper bounds; minus infinity where no point meets the conditions.
    points : ndarray
        ``(K, n)``: where the relaxation is largest.
    node, neuron, threshold : ndarray
        ``(K,)``: where to split next; node 0 where nothing is left to split.
    """

    done: Booleans
    solved: Booleans
    bound: Floats
    points: Floats
    node: Indices
    neuron: Indices
    threshold: Floats


@dataclass(frozen=True, eq=False)
class LinearModels:
    """What the kernel knows of B sets of inputs that move together; nothing of those that are not `done`.

    Parameters
    ----------
    done : ndarray
        ``(B,)`` bool.
    lower, upper : ndarray
        ``(B, N)``: hulls of all N neurons of the trunk.
    centre, slope : ndarray
        ``(B, A)`` and ``(B, V, A)``: the actions' model in the V symbols that inputs share.
    others, size : ndarray
        ``(B, A)``: what all else adds at most, and a bound of the model and of every partial sum of it.
    """

    done: Booleans
    lower: Floats
    upper: Floats
    centre: Floats
    slope: Floats
    others: Floats
    size: Floats


@dataclass(frozen=True, eq=False)
class Kernel:
    """One network in the compiled engine.

    **Sound:** as docs/kernel.md derives; every state by itself, so that batches give what single states give.
    """

    network: Network
    trunk: int
    packed: PackedNetwork

    @cached_property
    def _ends(self) -> list[int]:
        return list(accumulate(node.size for node in self.network.nodes))

    def hulls(self, lower: Floats, upper: Floats) -> list[Hull]:
        """Cut what is known of all neurons of the trunk into the hulls of its nodes."""
        ends = [0, *self._ends[: self.trunk]]
        return [(lower[:, first:last], upper[:, first:last]) for first, last in pairwise(ends)]

    def bound(self, lower: Floats, upper: Floats, **effort: float) -> Bounded:
        """Bound every action of the trunk over boxes (B, n).

        Parameters
        ----------
        lower, upper : ndarray
            ``(B, n)``.
        **effort : float
            Fields of `KernelEffort` that are not as it has them.
        """
        (batch, inputs), actions = lower.shape, self.network.nodes[self.trunk - 1].size
        size, questions = self._ends[self.trunk - 1], 2 * actions * batch
        faces, values = (questions, inputs), (questions,)
        shapes = ((batch, size), (batch, size), faces, faces, values, values, faces)
        done, settled = np.zeros((2, batch), dtype=bool)
        result = Bounded(done, settled, *map(np.empty, shapes))
        call(
            "viatool_bound", self.packed, KernelEffort.of(effort), batch, floats(lower), floats(upper), result.lower,
            result.upper, result.face_lower, result.face_upper, result.bound, result.points, result.found, done,
            settled,
        )  # fmt: skip
        return result

    def linear(
        self, constant: Floats, shared: Floats, own: Floats, rest: Floats, norm: Floats, hull: Hull
    ) -> LinearModels:
        """Enclose the actions of the trunk over inputs ``constant + shared . z + own e + rest [-1, 1]``.

        Parameters
        ----------
        constant, own, rest, norm : ndarray
            ``(B, n)``; norm bounds the sum of the absolute values of what z and e add.
        shared : ndarray
            ``(B, V, n)``.
        hull : tuple of ndarray
            ``(B, n)`` twice, what the inputs lie between.
        """
        (batch, symbols, _), actions = shared.shape, self.network.nodes[self.trunk - 1].size
        neurons, pair = self._ends[self.trunk - 1], (batch, actions)
        shapes = ((batch, neurons), (batch, neurons), pair, (batch, symbols, actions), pair, pair)
        found = LinearModels(np.zeros(batch, dtype=bool), *map(np.empty, shapes))
        given = map(floats, (constant, shared, own, rest, norm, *hull))
        call(
            "viatool_linear", self.packed, batch, symbols, *given, found.lower, found.upper, found.centre, found.slope,
            found.others, found.size, found.done,
        )  # fmt: skip
        return found

    def examine(
        self,
        lower: Floats,
        upper: Floats,
        action: Indices,
        sign: Floats,
        conditions: Conditions,
        *,
        exactly: bool = False,
    ) -> ExaminedParts:
        """Bound ``sign action`` of the trunk from above over K boxes (K, n), as far as conditions on arguments hold.

        Parameters
        ----------
        lower, upper : ndarray
            ``(K, n)``.
        action, sign : ndarray
            ``(K,)``.
        conditions : tuple of ndarray
            ``(K, D)`` each: activation node, neuron, side -1 below and +1 above (0: no condition), threshold.
        exactly : bool
            Whether the best multipliers are looked for where nothing is left to split.
        """
        count, inputs = lower.shape
        nodes, neurons, sides, thresholds = conditions
        node, neuron = np.zeros((2, count), dtype=np.int64)
        values, points = np.zeros((2, count)), np.empty((count, inputs))
        done = np.zeros(count, dtype=np.uint8)
        call(
            "viatool_examine", self.packed, count, nodes.shape[1], floats(lower), floats(upper), integers(action),
            floats(sign), integers(nodes), integers(neurons), integers(sides), floats(thresholds), EFFORT.sweeps,
            EFFORT.neurons, int(exactly), values[0], points, node, neuron, values[1], done,
        )  # fmt: skip
        return ExaminedParts(done > 0, done == _SOLVED, values[0], points, node, neuron, values[1])

    def deviation(self, hulls: Sequence[Hull], last_sum: int | None) -> tuple[Floats, ...] | None:
        """Bound by norms what the deployed program makes of boxes, given hulls of all nodes.

        Returns
        -------
        tuple of ndarray or None
            Lower and upper bounds of the program's actions and its deviation, (B, A) each; what the node `last_sum`
            errs by itself, and its deviation, (B, K) each. None where a precision may not hold an intermediate result.
        """
        batch = hulls[0][0].shape[0]
        actions = self.network.output_size
        sums = 0 if last_sum is None else self.network.nodes[last_sum].size
        lower, upper = (floats(np.concatenate([hull[side] for hull in hulls], axis=1)) for side in (0, 1))
        found = [np.empty((batch, size)) for size in (actions, actions, actions, sums, sums)]
        place = -1 if last_sum is None else last_sum
        return (
            tuple(found) if call("viatool_deviate", self.packed, batch, lower, upper, *found, place) else None
        )
