"""Variances of computed values, whichever way a runtime computes them.

A variance is the mean of squared deviations. Runtimes compute it so (two passes), or as the mean of squares less the
squared mean (one pass, in which nearly everything may cancel), or by updates from value to value (Welford). So that
bounds hold for all of them, its node says what the one-pass sum adds up before it cancels: it also reads the squares
of the values themselves, with weight 0 and their magnitudes.
"""

from __future__ import annotations

import math

import numpy as np

from viatool.arrays import Floats
from viatool.policy.activations import activation
from viatool.policy.assembly import Assembly, Computed, Shape, Term, broadcast_index
from viatool.policy.network import Activation, Affine, Cast
from viatool.policy.weights import Weights, absolute, dense, is_scaling, is_zero, same

_SQUARE = activation("Pow", exponent=2.0)

_SLIGHTLY_ABOVE = 1.0 + 2.0**-20
"""Covers the stored weights of a mean, which are rounded."""


def variance(
    assembly: Assembly, deviation: Computed, weights: Floats, shape: Shape, *, uncentred: Computed | None
) -> Computed:
    """Add ``weights @ deviation**2``.

    Parameters
    ----------
    assembly : Assembly
        Gets the nodes.
    deviation : Computed
        Of N values.
    weights : ndarray
        ``(G, N)``: 1/n where a value belongs to a group of n.
    shape : tuple of int
        Of the G results.
    uncentred : Computed, optional
        The values before their mean was subtracted; None where nothing was, so that nothing cancels.

    Notes
    -----
    **Sound:** the roundings of the node cover two passes, one pass and Welford's updates, in any order. With exact
    ``q = mean(x^2)`` of n values, a one-pass program errs by at most ``gamma_{n+2} q`` in the mean of squares (a
    product, n - 1 sums, a division or a product by a stored 1/n), by ``2 gamma_{n+1} q`` and a rounding in the squared
    mean, as ``mean|x|^2 <= q``, and by a rounding of the difference: ``(3 n + 5) u q`` to first order. Where the mean
    is joined to the shift, deviations are three roundings of ``|x| + |mean|`` off, their mean square at most
    ``6 u (q + variance)``. The rule of affine nodes counts 2 n + 2 roundings of the magnitudes, which are chosen to
    give one more in all.
    """
    terms = [Term(assembly.activation(deviation, _SQUARE), weights)]
    if uncentred is not None:
        square = assembly.activation(uncentred, _SQUARE)
        count = np.count_nonzero(weights, axis=1, keepdims=True)
        terms.append(Term(square, np.zeros_like(weights), (3 * count + 12) / (2 * count + 2) * weights))
    return assembly.affine(terms, np.zeros(len(weights)), shape, deviation.precision, roundings=1)


def mean_of_squares(assembly: Assembly, squares: Computed, weights: Floats, shape: Shape) -> Computed | None:
    """Return the mean of squared deviations from a mean as a variance, else None.

    Runtimes join the operators of a normalisation that is spelled out in a graph, and then choose the algorithm.
    """
    square = assembly.nodes[squares.node]
    if not isinstance(square, Activation) or square.function != _SQUARE:
        return None
    deviation = Computed(square.source, squares.shape, squares.precision)
    x = _before_centring(assembly, deviation)
    return None if x is None else variance(assembly, deviation, weights, shape, uncentred=x)


def _before_centring(assembly: Assembly, deviation: Computed) -> Computed | None:
    """Return x where a value is x less, or subtracted from, a linear function of x."""
    node = assembly.nodes[_before_casts(assembly, deviation.node)]
    if not isinstance(node, Affine) or len(node.sources) != 2:
        return None
    for source, weight, other in zip(node.sources, node.weights, node.sources[::-1], strict=True):
        mean = assembly.nodes[_before_casts(assembly, other)]
        if not isinstance(mean, Affine) or len(mean.sources) != 1 or not _is_sign(weight):
            continue
        if _before_casts(assembly, mean.sources[0]) == _before_casts(assembly, source):
            return assembly.cast(
                Computed(source, deviation.shape, assembly.nodes[source].precision), deviation.precision
            )
    return None


def _before_casts(assembly: Assembly, index: int) -> int:
    node = assembly.nodes[index]
    while isinstance(node, Cast):
        index, node = node.source, assembly.nodes[node.source]
    return index


def _is_sign(weight: Weights) -> bool:
    return is_scaling(absolute(weight))


def difference_of_means(assembly: Assembly, left: Computed, right: Computed) -> Computed | None:
    """Return ``mean(x^2) - mean(x)^2`` as the variance of x, None where the operands are something else.

    Notes
    -----
    **Sound:** both are the same in real arithmetic, as the weights of every group are those of a mean; the groups do
    not overlap. As deviations they are never negative, and bounds do not suffer from the difference.
    """
    if left.shape != right.shape:
        return None
    squares = _mean_at(assembly, left.node)
    square, squared = assembly.nodes[squares.sources[0]] if squares else None, assembly.nodes[right.node]
    if squares is None or not isinstance(square, Activation) or not isinstance(squared, Activation):
        return None
    mean = _mean_at(assembly, squared.source)
    if mean is None or not (square.function == squared.function == _SQUARE):
        return None
    weights = dense(mean.weights[0])
    if mean.sources[0] != square.source or not same(weights, squares.weights[0]):
        return None
    size = weights.shape[1]
    x = Computed(square.source, (size,), left.precision)
    groups = Computed(squared.source, (len(weights),), left.precision)
    terms = [Term(x, np.eye(size)), Term(groups, -(weights.T != 0).astype(np.float64))]
    deviation = assembly.affine(terms, np.zeros(size), (size,), left.precision)
    return variance(assembly, deviation, weights, left.shape, uncentred=x)


def _mean_at(assembly: Assembly, index: int) -> Affine | None:
    """Return a node that takes the means of groups of one source that do not overlap, None if it is another."""
    node = assembly.nodes[index]
    if not isinstance(node, Affine) or len(node.sources) != 1 or node.bias.any() or node.bias_magnitude.any():
        return None
    weight = dense(node.weights[0])
    inside = weight != 0
    counts = inside.sum(axis=1, keepdims=True)
    if node.merged_weights is not None or node.roundings != 1 or not counts.all():
        return None
    means = np.array_equal(weight, inside / counts) and (inside.sum(axis=0) <= 1).all()
    return node if means else None


def normalised(assembly: Assembly, left: Computed, right: Computed) -> Computed:
    """Add ``left * right``, within its natural range where one is divided by its own root mean square.

    Notes
    -----
    **Sound:** ``|x_i| / sqrt(sum_j w_j x_j^2 + epsilon) <= 1 / sqrt(w_i)`` for weights and epsilon that are not
    negative. The program does not know that limit, so its rounding is not cut by it.
    """
    product = assembly.product(left, right)
    for x, factor in ((left, right), (right, left)):
        least = _least_own_weight(assembly, x, factor, product.shape)
        if least > 0:
            limit = _SLIGHTLY_ABOVE / math.sqrt(least)
            return assembly.activation(product, activation("Known", min=-limit, max=limit))
    return product


def _least_own_weight(assembly: Assembly, x: Computed, factor: Computed, shape: Shape) -> float:
    """Return the least weight of an element's own square in the reciprocal root that it is multiplied by, else 0."""
    root = assembly.function_of(factor, "Reciprocal")
    raised = None if root is None else assembly.function_of(root, "Sqrt")
    if raised is None or x.shape != shape:
        return 0.0
    scaling = assembly.scaling_of(raised)
    if scaling is not None and scaling.factor == 1.0 and scaling.offset >= 0.0:
        raised = scaling.source
    node = assembly.nodes[raised.node]
    if not isinstance(node, Affine) or (node.bias < 0).any():
        return 0.0
    weight: Floats | None = None
    for source, numbers in zip(node.sources, node.weights, strict=True):
        square = assembly.nodes[source]
        if isinstance(square, Activation) and square.function == _SQUARE and square.source == x.node:
            weight = dense(numbers)
        elif not is_zero(numbers):
            return 0.0
    if weight is None or (weight < 0).any():
        return 0.0
    row = broadcast_index(factor, shape)
    return float(weight[row, np.arange(x.size)].min(initial=math.inf))
