"""The network as the engine sees it: a directed acyclic graph of a few kinds of vector-valued nodes.

Every value is a flat vector per state, so an array of B states is ``(B, N)``. All linear operators of ONNX
(Gemm, MatMul, Add, Sub, Mul by a constant, Concat, Slice, Gather, Transpose, ReduceMean, Conv, ...) are one
kind, `Affine`; every elementwise function of one variable is `Activation`; what couples two computed vectors
is `Product`, `Maximum` or `Minimum`. `Cast` changes the precision in which the runtime computes.

These kinds are a closed union, `Node`. Whatever is different for each of them (evaluation, enclosure, derivative,
rounding, ...) is one function that dispatches with ``match node:``, names every kind and has no ``case _``: so the type
checker refuses a kind that was forgotten ("Missing return statement"). A function that looks for one kind only may ask
``isinstance(node, Activation)`` where leaving the others out costs no soundness.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from viatool.arrays import Floats
from viatool.policy.activations import ActivationFunction
from viatool.policy.weights import Weights, absolute, scale_of

Precision = Literal["float16", "bfloat16", "float32", "float64"]


@dataclass(frozen=True, eq=False)
class Input:
    """The observation, ``(B, size)``; always node 0."""

    size: int
    precision: Precision = "float32"

    @property
    def sources(self) -> tuple[int, ...]:
        """Return the indices of the nodes that this node reads."""
        return ()


@dataclass(frozen=True, eq=False)
class Affine:
    """``y = sum_k weights[k] @ x[sources[k]] + bias``.

    Parameters
    ----------
    sources : tuple of int
        Indices of the nodes that are read; empty for a constant.
    weights : tuple of ndarray or Sparse
        One ``(size, N_k)`` float64 matrix for each source, holding the stored weights exactly; see `weights`.
    bias : ndarray
        ``(size,)`` float64.
    precision : str
        The precision in which the runtime computes this node. A row whose only nonzero weight is 1 and whose
        bias is 0 copies a value and is exact in every precision.
    roundings : int
        How many more roundings than a dot product each term may carry, because a weight stands for several
        operations of the program (a division, a normalisation). When it is not 0, the stored weights and bias
        are within this many float64 roundings, of their magnitudes, of the real numbers that they stand for.
    merged_weights, merged_bias : optional
        What the program may add up before it cancels: the sums of the absolute values of the terms that were merged
        into each weight, ``(size, N_k)``, and into the bias, ``(size,)``. None where each stands for one term.
    """

    sources: tuple[int, ...]
    weights: tuple[Weights, ...]
    bias: Floats
    precision: Precision = "float32"
    roundings: int = 0
    merged_weights: tuple[Weights, ...] | None = None
    merged_bias: Floats | None = None

    @property
    def size(self) -> int:
        """Return the length of the output vector."""
        return int(self.bias.shape[0])

    @cached_property
    def absolute_weights(self) -> tuple[Weights, ...]:
        """Return the absolute values of the weights: how far each source can move the result."""
        return tuple(absolute(weight) for weight in self.weights)

    @cached_property
    def is_elementwise(self) -> bool:
        """Whether each element of the one source is scaled and shifted by itself."""
        return len(self.sources) == 1 and scale_of(self.weights[0]) is not None

    @property
    def magnitudes(self) -> tuple[Weights, ...]:
        """Return what the roundings of the weighted terms are relative to, ``(size, N_k)`` for each source."""
        return self.absolute_weights if self.merged_weights is None else self.merged_weights

    @cached_property
    def bias_magnitude(self) -> Floats:
        """Return what the roundings of the constants are relative to, ``(size,)``."""
        return np.abs(self.bias) if self.merged_bias is None else self.merged_bias


@dataclass(frozen=True, eq=False)
class Activation:
    """``y_i = function(x_i)``."""

    source: int
    function: ActivationFunction
    size: int
    precision: Precision = "float32"

    @property
    def sources(self) -> tuple[int, ...]:
        """Return the indices of the nodes that this node reads."""
        return (self.source,)


@dataclass(frozen=True, eq=False)
class Product:
    """``y_i = left_i * right_i``, one rounding."""

    left: int
    right: int
    size: int
    precision: Precision = "float32"

    @property
    def sources(self) -> tuple[int, ...]:
        """Return the indices of the nodes that this node reads."""
        return (self.left, self.right)


@dataclass(frozen=True, eq=False)
class Maximum:
    """``y_i = max(left_i, right_i)``, exact in every precision."""

    left: int
    right: int
    size: int
    precision: Precision = "float32"

    @property
    def sources(self) -> tuple[int, ...]:
        """Return the indices of the nodes that this node reads."""
        return (self.left, self.right)


@dataclass(frozen=True, eq=False)
class Minimum:
    """``y_i = min(left_i, right_i)``, exact in every precision."""

    left: int
    right: int
    size: int
    precision: Precision = "float32"

    @property
    def sources(self) -> tuple[int, ...]:
        """Return the indices of the nodes that this node reads."""
        return (self.left, self.right)


@dataclass(frozen=True, eq=False)
class Cast:
    """The same real values in another precision; a narrower one costs one rounding."""

    source: int
    size: int
    precision: Precision = "float32"

    @property
    def sources(self) -> tuple[int, ...]:
        """Return the indices of the nodes that this node reads."""
        return (self.source,)


Node = Input | Affine | Activation | Product | Maximum | Minimum | Cast
"""Every kind of node; a new one is added here, and mypy then names each pass that lacks it."""


@dataclass(frozen=True, eq=False)
class Network:
    """A feedforward network.

    Parameters
    ----------
    nodes : tuple of Node
        In topological order; ``nodes[0]`` is the only `Input`, the last node is the output.
    calls : tuple of str
        For each node the call of the model that it was read from, as messages name it; empty where none is known.

    Raises
    ------
    ValueError
        If a node reads a later node, or sizes do not fit.
    """

    nodes: tuple[Node, ...]
    calls: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.nodes or not isinstance(self.nodes[0], Input):
            raise ValueError("nodes[0] must be the Input")
        for index, node in enumerate(self.nodes[1:], start=1):
            if isinstance(node, Input):
                raise ValueError(f"node {index} is a second Input; a network has one")
            for source in node.sources:
                if not 0 <= source < index:
                    raise ValueError(f"node {index} reads node {source}, which does not stand before it")
            if problem := _problem_of_sizes(node, [self.nodes[source].size for source in node.sources]):
                raise ValueError(f"node {index}: {problem}")

    def label(self, index: int) -> str:
        """Return how a node is called in messages: as the call that it was read from, else by its number."""
        call = self.calls[index] if index < len(self.calls) else ""
        return f"node {call}" if call else f"node {index} of the network"

    @property
    def input_size(self) -> int:
        """Return the length of the observation vector."""
        return self.nodes[0].size

    @property
    def output_size(self) -> int:
        """Return the number of actions."""
        return self.nodes[-1].size

    def __call__(self, observations: Floats) -> Floats:
        """Evaluate the network in float64.

        Parameters
        ----------
        observations : ndarray
            ``(B, input_size)``.

        Returns
        -------
        ndarray
            ``(B, output_size)``, float64.
        """
        return self.values(observations)[-1]

    def values(self, observations: Floats, noise: Sequence[Floats] | None = None) -> list[Floats]:
        """Evaluate every node in float64: one ``(B, size)`` array for each, plus the noise of each if given."""
        values: list[Floats] = []
        for index, node in enumerate(self.nodes):
            value = _evaluate(node, values, observations)
            values.append(value if noise is None else value + noise[index])
        return values


def _problem_of_sizes(node: Node, sizes: Sequence[int]) -> str | None:
    """Return what is wrong with the sizes of the sources of a node, None if they fit."""
    match node:
        case Affine():
            for weights in (node.weights, node.magnitudes):
                for size, weight in zip(sizes, weights, strict=True):
                    if weight.shape != (node.size, size):
                        return f"weight {weight.shape} does not map {size} to {node.size}"
            return None
        case Input() | Activation() | Product() | Maximum() | Minimum() | Cast():
            if any(size != node.size for size in sizes):
                return "an elementwise node keeps the size of its sources"
            return None


def _evaluate(node: Node, values: Sequence[Floats], observations: Floats) -> Floats:
    match node:
        case Input():
            return observations
        case Affine():
            result = np.broadcast_to(node.bias, (observations.shape[0], node.size))
            for source, weight in zip(node.sources, node.weights, strict=True):
                result = result + values[source] @ weight.T
            return result
        case Activation():
            return node.function(values[node.source])
        case Product():
            return values[node.left] * values[node.right]
        case Maximum():
            return np.maximum(values[node.left], values[node.right])
        case Minimum():
            return np.minimum(values[node.left], values[node.right])
        case Cast():
            return values[node.source]
