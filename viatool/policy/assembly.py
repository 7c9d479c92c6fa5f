"""A network under construction: operator readers add nodes to it, tensors become flat vectors.

A tensor of the model at batch size 1 is a vector of its elements in C order, so reshaping costs nothing and
moving elements about is an affine node with one 1 in each row, which copies exactly.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, cast

import numpy as np

from viatool.arrays import Floats, Indices
from viatool.policy.activations import ActivationFunction, activation
from viatool.policy.network import (
    Activation,
    Affine,
    Cast,
    Input,
    Maximum,
    Minimum,
    Network,
    Node,
    Precision,
    Product,
)
from viatool.policy.weights import (
    Weights,
    absolute,
    added,
    contiguous,
    diagonal,
    is_scaling,
    is_zero,
    overlap,
    placed,
    same,
    scale_of,
    terms,
)
from viatool.rounding import UNIT_ROUNDOFF

Shape = tuple[int, ...]

MAX_ENTRIES = 2**24
"""Most entries of one dense weight matrix."""

MAX_TOTAL_ENTRIES = 2**26
"""Most entries of all weight matrices of a network together."""


LARGEST_SHARE = 0.25
"""A number that may be off by more than this share of itself has no useful bound."""


class Refusal(Exception):  # noqa: N818  # not an error of the program: what the reader collects and reports
    """One node cannot be read.

    Parameters
    ----------
    reason : str
        Follows the name of the node, for example "is recurrent".
    hint : str
        One imperative, empty for the general one.
    """

    def __init__(self, reason: str, hint: str = "") -> None:
        super().__init__(reason)
        self.reason = reason
        self.hint = hint


@dataclass(frozen=True)
class Computed:
    """A tensor that depends on the observation: the elements of one network node, in C order."""

    node: int
    shape: Shape
    precision: Precision

    @property
    def size(self) -> int:
        """Return the number of elements."""
        return math.prod(self.shape)

    def reshaped(self, shape: Shape) -> Computed:
        """Return the same elements in another shape."""
        return replace(self, shape=shape)


@dataclass(frozen=True)
class UniformScaling:
    """``factor * source + offset``, the same numbers for every element."""

    source: Computed
    factor: float
    offset: float
    roundings: int


class Counted(NamedTuple):
    """Constant numbers, and how far those of the program may be from them.

    Parameters
    ----------
    values : ndarray
        The numbers, float64.
    magnitudes : ndarray
        What their roundings are relative to: their absolute values, or more where they are what is left of a sum.
    roundings : int
        How many roundings, of its magnitude, each number may be off.
    unit : float
        What one rounding of a program is.
    """

    values: Floats
    magnitudes: Floats
    roundings: int = 0
    unit: float = UNIT_ROUNDOFF["float32"]

    def relative_roundings(self) -> int:
        """Return how many roundings of itself each number may be off.

        Raises
        ------
        Refusal
            If there is no useful bound, as of what is left of a sum that cancels.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where(self.magnitudes == 0, 0.0, self.magnitudes / np.abs(self.values))
        most = self.roundings * float(share.max(initial=0.0)) if self.roundings else 0.0
        if not most * self.unit <= LARGEST_SHARE:
            raise Refusal(
                "uses a constant that runtimes compute differently, in a way that has no bound",
                "let the exporter fold constants, or simplify the model (onnxsim) before it is verified",
            )
        return math.ceil(most)


class Term(NamedTuple):
    """``weights @ source``, with what the roundings of the weights are relative to; None for their absolute values."""

    source: Computed
    weights: Weights
    magnitudes: Weights | None = None


class Assembly:
    """Collects network nodes.

    Parameters
    ----------
    input_size : int
        Length of the observation.
    precision : str
        Element type of the model's input.
    """

    def __init__(self, input_size: int, precision: Precision) -> None:
        self.nodes: list[Node] = [Input(input_size, precision)]
        self.call = ""
        """What is being read, as messages name it: the call that the next nodes come from."""
        self._calls = [""]
        self._entries = 0

    @classmethod
    def behind(cls, network: Network) -> Assembly:
        """Return one that goes on behind the nodes of a network."""
        assembly = cls(network.input_size, network.nodes[0].precision)
        assembly.nodes = list(network.nodes)
        unnamed = len(network.nodes) - len(network.calls)
        assembly._calls = [*network.calls, *[""] * unnamed]
        return assembly

    def affine(
        self,
        terms: Sequence[Term],
        bias: Floats,
        shape: Shape,
        precision: Precision,
        roundings: int = 0,
        *,
        bias_magnitude: Floats | None = None,
    ) -> Computed:
        """Add ``sum_k weights_k @ x_k + bias``; terms of one source are merged.

        Parameters
        ----------
        terms : sequence of Term
            Those of one source are merged; their magnitudes add up, so that what cancels still counts as it rounds.
        bias : ndarray
            What is added, of as many numbers as the shape has.
        shape, precision
            Of the result.
        roundings : int
            Of each term, beyond those of a sum of as many terms as there are.
        bias_magnitude : ndarray, optional
            The sum of the absolute values of what was added up in the bias; None where that is one number each.
        """
        merged: dict[int, Term] = {}
        for term in terms:
            known = merged.get(term.source.node)
            if known is not None:
                roundings += int(overlap(known.weights, term.weights))
                size = added(_magnitude(known), _magnitude(term))
                term = Term(term.source, added(known.weights, term.weights), size)
            merged[term.source.node] = term
        merged = {node: term for node, term in merged.items() if not is_zero(_magnitude(term))}
        offset = np.asarray(bias, dtype=np.float64).ravel()
        merged_bias = None
        if bias_magnitude is not None and _beyond(bias_magnitude.ravel(), offset) is not None:
            merged_bias = np.asarray(bias_magnitude, dtype=np.float64).ravel()
        sources = tuple(sorted(merged))
        weights = tuple(contiguous(merged[node].weights) for node in sources)
        magnitudes = [_beyond(merged[node].magnitudes, merged[node].weights) for node in sources]
        alone = merged_bias is None and all(magnitude is None for magnitude in magnitudes)
        if alone and not roundings and len(sources) == 1 and not offset.any() and is_scaling(weights[0]):
            return Computed(sources[0], shape, precision)
        merged_weights = None
        if any(magnitude is not None for magnitude in magnitudes):
            merged_weights = tuple(contiguous(_magnitude(merged[node])) for node in sources)
        return self._append(
            Affine(sources, weights, offset, precision, roundings, merged_weights, merged_bias),
            shape,
            precision,
        )

    def linear(
        self,
        x: Computed,
        function: Callable[[Floats], Floats],
        shape: Shape,
        roundings: int = 0,
    ) -> Computed:
        """Add a linear map that is given as a function of arrays ``(K, *x.shape) -> (K, *shape)``."""
        term = Term(x, self.matrix(x, function, shape))
        return self.affine([term], np.zeros(math.prod(shape)), shape, x.precision, roundings)

    def matrix(self, x: Computed, function: Callable[[Floats], Floats], shape: Shape) -> Floats:
        """Return the matrix ``(size, x.size)`` of a linear map, by applying it to the unit vectors."""
        self.reserve(x.size, max(x.size, math.prod(shape)))
        basis = np.eye(x.size).reshape((x.size, *x.shape))
        return cast(Floats, function(basis).reshape(x.size, -1).T)

    def copies(
        self, terms: Sequence[tuple[Computed, Indices]], bias: Floats, shape: Shape, precision: Precision
    ) -> Computed:
        """Add exact copies: element i takes ``x_k[index_k[i]]`` where that index is not -1, else the bias."""
        weights = []
        for source, index in terms:
            (rows,) = np.nonzero(index >= 0)
            weight = placed(rows, index[rows], np.ones(len(rows)), (index.size, source.size))
            weights.append(Term(source, weight))
        return self.affine(weights, bias, shape, precision)

    def broadcast(self, x: Computed, shape: Shape) -> Computed:
        """Return x broadcast to a shape as numpy does."""
        if x.size == math.prod(shape):
            return x.reshaped(shape)
        return self.copies([(x, broadcast_index(x, shape))], np.zeros(math.prod(shape)), shape, x.precision)

    def constant(self, values: Any, shape: Shape, precision: Precision) -> Computed:
        """Add a node without sources."""
        return self.affine([], np.broadcast_to(values, shape).astype(np.float64).ravel(), shape, precision)

    def inexact(self, numbers: Counted, precision: Precision) -> Computed:
        """Add a node without sources whose numbers a program may have otherwise."""
        shape, magnitude = numbers.values.shape, numbers.magnitudes.ravel()
        return self.affine(
            [], numbers.values.ravel(), shape, precision, numbers.roundings, bias_magnitude=magnitude
        )

    def scaled(self, x: Computed, factor: float, offset: float = 0.0, roundings: int = 0) -> Computed:
        """Add ``factor * x + offset`` with one number each."""
        term = Term(x, diagonal(np.full(x.size, factor)))
        return self.affine([term], np.full(x.size, offset), x.shape, x.precision, roundings)

    def activation(self, x: Computed, function: ActivationFunction | str) -> Computed:
        """Add an elementwise function."""
        if isinstance(function, str):
            function = activation(function)
        return self._append(Activation(x.node, function, x.size, x.precision), x.shape, x.precision)

    def product(self, left: Computed, right: Computed) -> Computed:
        """Add an elementwise product with broadcasting; a square is a function of one variable."""
        left, right = self._together(left, right)
        if left.node == right.node:
            return self.activation(left, activation("Pow", exponent=2.0))
        return self._append(
            Product(left.node, right.node, left.size, left.precision), left.shape, left.precision
        )

    def maximum(self, left: Computed, right: Computed) -> Computed:
        """Add an elementwise maximum with broadcasting."""
        left, right = self._together(left, right)
        if left.node == right.node:
            return left
        return self._append(
            Maximum(left.node, right.node, left.size, left.precision), left.shape, left.precision
        )

    def minimum(self, left: Computed, right: Computed) -> Computed:
        """Add an elementwise minimum with broadcasting."""
        left, right = self._together(left, right)
        if left.node == right.node:
            return left
        return self._append(
            Minimum(left.node, right.node, left.size, left.precision), left.shape, left.precision
        )

    def cast(self, x: Computed, precision: Precision) -> Computed:
        """Add a change of precision."""
        if precision == x.precision:
            return x
        return self._append(Cast(x.node, x.size, precision), x.shape, precision)

    def function_of(self, x: Computed, name: str) -> Computed | None:
        """Return the argument of x when x is the named activation of something, else None."""
        node = self.nodes[x.node]
        if isinstance(node, Activation) and node.function.name == name:
            return Computed(node.source, x.shape, x.precision)
        return None

    def scaling_of(self, x: Computed) -> UniformScaling | None:
        """Return how x is ``factor * source + offset`` with one number each, None when it is not or was merged."""
        node = self.nodes[x.node]
        if not isinstance(node, Affine) or len(node.sources) != 1:
            return None
        if node.merged_weights is not None or node.merged_bias is not None:
            return None
        (source,), (weight,) = node.sources, node.weights
        factors = scale_of(weight)
        if factors is None or (factors != factors[0]).any() or (node.bias != node.bias[0]).any():
            return None
        factor, offset = float(factors[0]), float(node.bias[0])
        return UniformScaling(Computed(source, x.shape, x.precision), factor, offset, node.roundings)

    def expect_folding(self, x: Computed, roundings: int) -> None:
        """Let a matrix product that made x carry the roundings of a scaling after it.

        A runtime may fold the scaling (a batch normalisation, a product by a constant) into the weights, so that
        each term is rounded more often than in the order of the graph.
        """
        node = self.nodes[x.node]
        if isinstance(node, Affine) and any((terms(w) > 1).any() for w in node.weights):
            self.nodes[x.node] = replace(node, roundings=node.roundings + roundings)

    def reserve(self, rows: int, columns: int) -> None:
        """Refuse a dense matrix that is too large before it is made.

        Raises
        ------
        Refusal
            If it is.
        """
        if rows * columns > MAX_ENTRIES:
            raise Refusal(
                f"maps {columns} numbers to {rows}, a matrix larger than viatool keeps",
                "export the actor alone, with the observation of the robot as its input",
            )

    def network(self, output: Computed) -> Network:
        """Return the network that ends in a value; nodes that it does not need are dropped."""
        return pruned(self.nodes, output.node, self._calls)

    def _together(self, left: Computed, right: Computed) -> tuple[Computed, Computed]:
        shape = np.broadcast_shapes(left.shape, right.shape)
        return self.broadcast(left, shape), self.broadcast(right, shape)

    def _append(self, node: Node, shape: Shape, precision: Precision) -> Computed:
        if node.size != math.prod(shape):
            raise Refusal(f"gives {node.size} numbers where the shape {list(shape)} is expected")
        if node.size == 0:
            raise Refusal("gives an empty tensor")
        if isinstance(node, Affine):
            self._entries += sum(weight.size for weight in node.weights)
            if self._entries > MAX_TOTAL_ENTRIES:
                raise Refusal("makes the network larger than viatool keeps", "export the actor alone")
        self.nodes.append(node)
        self._calls.append(self.call)
        return Computed(len(self.nodes) - 1, shape, precision)


def _magnitude(term: Term) -> Weights:
    return absolute(term.weights) if term.magnitudes is None else term.magnitudes


def _beyond(magnitudes: Weights | None, values: Weights) -> Weights | None:
    """Return magnitudes where they are larger than the absolute values of what was added up, else None."""
    if magnitudes is None or same(magnitudes, absolute(values)):
        return None
    return magnitudes


def broadcast_index(x: Computed, shape: Shape) -> Indices:
    """Return for each element of a broadcast tensor the element of x that it copies."""
    return np.broadcast_to(np.arange(x.size).reshape(x.shape), shape).ravel()


def pruned(nodes: Sequence[Node], output: int, calls: Sequence[str]) -> Network:
    """Return the network of the nodes that one of them depends on, renumbered; the input always stays."""
    needed = {0, output}
    for index in range(output, 0, -1):
        if index in needed:
            needed.update(nodes[index].sources)
    number = {old: new for new, old in enumerate(sorted(needed))}
    kept = sorted(needed)
    return Network(tuple(renumbered(nodes[old], number) for old in kept), tuple(calls[old] for old in kept))


def renumbered(node: Node, number: Mapping[int, int] | Sequence[int]) -> Node:
    """Return a node that reads other nodes, by their new numbers."""
    match node:
        case Input():
            return node
        case Affine():
            return replace(node, sources=tuple(number[source] for source in node.sources))
        case Activation() | Cast():
            return replace(node, source=number[node.source])
        case Product() | Maximum() | Minimum():
            return replace(node, left=number[node.left], right=number[node.right])
