"""A network under construction: operator readers add nodes to it, tensors become flat vectors.

A tensor of the model at batch size 1 is a vector of its elements in C order, so reshaping costs nothing and
moving elements about is an affine node with one 1 in each row, which copies exactly.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

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

Shape = tuple[int, ...]

MAX_ENTRIES = 2**24
"""Most entries of one dense weight matrix."""

MAX_TOTAL_ENTRIES = 2**26
"""Most entries of all weight matrices of a network together."""


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
class Scaling:
    """``factor * source + offset``, the same numbers for every element."""

    source: Computed
    factor: float
    offset: float
    roundings: int


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
        self._entries = 0

    def affine(
        self,
        terms: Sequence[tuple[Computed, Floats]],
        bias: Floats,
        shape: Shape,
        precision: Precision,
        roundings: int = 0,
    ) -> Computed:
        """Add ``sum_k weights_k @ x_k + bias``; terms of one source are merged."""
        merged: dict[int, Floats] = {}
        for source, weight in terms:
            known = merged.get(source.node)
            merged[source.node] = weight if known is None else known + weight
        merged = {node: weight for node, weight in merged.items() if weight.any()}
        if len(merged) == 1 and not bias.any():
            ((node, weight),) = merged.items()
            rows, columns = weight.shape
            if rows == columns and np.array_equal(weight, np.eye(rows)):
                return Computed(node, shape, precision)
        sources = tuple(sorted(merged))
        weights = tuple(np.ascontiguousarray(merged[node], dtype=np.float64) for node in sources)
        return self._append(
            Affine(sources, weights, np.asarray(bias, dtype=np.float64).ravel(), precision, roundings),
            shape,
            precision,
        )

    def linear(
        self,
        x: Computed,
        function: Callable[[Floats], Floats],
        shape: Shape,
        bias: Floats | None = None,
        roundings: int = 0,
    ) -> Computed:
        """Add a linear map that is given as a function of arrays ``(K, *x.shape) -> (K, *shape)``."""
        return self.affine(
            [(x, self.matrix(x, function, shape))],
            np.zeros(math.prod(shape)) if bias is None else bias,
            shape,
            x.precision,
            roundings,
        )

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
            self.reserve(index.size, source.size)
            weight = np.zeros((index.size, source.size))
            (rows,) = np.nonzero(index >= 0)
            weight[rows, index[rows]] = 1.0
            weights.append((source, weight))
        return self.affine(weights, bias, shape, precision)

    def broadcast(self, x: Computed, shape: Shape) -> Computed:
        """Return x broadcast to a shape as numpy does."""
        if x.size == math.prod(shape):
            return x.reshaped(shape)
        return self.copies([(x, broadcast_index(x, shape))], np.zeros(math.prod(shape)), shape, x.precision)

    def constant(self, values: Any, shape: Shape, precision: Precision) -> Computed:
        """Add a node without sources."""
        return self.affine([], np.broadcast_to(values, shape).astype(np.float64).ravel(), shape, precision)

    def scaled(self, x: Computed, factor: float, offset: float = 0.0, roundings: int = 0) -> Computed:
        """Add ``factor * x + offset`` with one number each."""
        self.reserve(x.size, x.size)
        return self.affine(
            [(x, factor * np.eye(x.size))], np.full(x.size, offset), x.shape, x.precision, roundings
        )

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

    def scaling_of(self, x: Computed) -> Scaling | None:
        """Return how x is ``factor * source + offset`` with one number each, None when it is not."""
        node = self.nodes[x.node]
        if not isinstance(node, Affine) or len(node.sources) != 1:
            return None
        (source,), (weight,) = node.sources, node.weights
        factor, offset = float(weight[0, 0]), float(node.bias[0])
        if weight.shape[0] != weight.shape[1] or (node.bias != offset).any():
            return None
        if not np.array_equal(weight, factor * np.eye(len(weight))):
            return None
        return Scaling(Computed(source, x.shape, x.precision), factor, offset, node.roundings)

    def expect_folding(self, x: Computed, roundings: int) -> None:
        """Let a matrix product that made x carry the roundings of a scaling after it.

        A runtime may fold the scaling (a batch normalisation, a product by a constant) into the weights, so that
        each term is rounded more often than in the order of the graph.
        """
        node = self.nodes[x.node]
        if isinstance(node, Affine) and any((np.count_nonzero(w, axis=1) > 1).any() for w in node.weights):
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
        return pruned(self.nodes, output.node)

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
        return Computed(len(self.nodes) - 1, shape, precision)


def broadcast_index(x: Computed, shape: Shape) -> Indices:
    """Return for each element of a broadcast tensor the element of x that it copies."""
    return np.broadcast_to(np.arange(x.size).reshape(x.shape), shape).ravel()


def pruned(nodes: Sequence[Node], output: int) -> Network:
    """Return the network of the nodes that one of them depends on, renumbered; the input always stays."""
    needed = {0, output}
    for index in range(output, 0, -1):
        if index in needed:
            needed.update(nodes[index].sources)
    number = {old: new for new, old in enumerate(sorted(needed))}
    return Network(tuple(_renumbered(nodes[old], number) for old in sorted(needed)))


def _renumbered(node: Node, number: dict[int, int]) -> Node:
    match node:
        case Input():
            return node
        case Affine():
            return replace(node, sources=tuple(number[source] for source in node.sources))
        case Activation() | Cast():
            return replace(node, source=number[node.source])
        case Product() | Maximum() | Minimum():
            return replace(node, left=number[node.left], right=number[node.right])
