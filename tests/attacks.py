"""How far the actions of a network really reach in a box: sampling, gradient attacks, an exact program."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from viatool.policy.network import Activation, Affine, Cast, Input, Maximum, Minimum, Network, Product

Floats = NDArray[np.float64]


def sample(lower: Floats, upper: Floats, count: int, rng: np.random.Generator) -> Floats:
    """Draw ``(count, B, n)`` points of boxes (B, n): the middle, uniform ones, corners, faces."""
    uniform = rng.uniform(size=(count, *lower.shape))
    corners = rng.integers(0, 2, size=uniform.shape).astype(np.float64)
    at_end = rng.uniform(size=uniform.shape) < rng.choice([0.0, 0.5, 0.9, 1.0], size=(count, 1, 1))
    fraction = np.where(at_end, corners, uniform)
    fraction[:1] = 0.5
    points = lower + (upper - lower) * fraction
    points = np.where(fraction == 1.0, upper, points)
    return np.clip(points, lower, upper)


def attack(
    network: Network,
    lower: Floats,
    upper: Floats,
    seed: Floats,
    rng: np.random.Generator,
    *,
    start: Floats | None = None,
    restarts: int = 4,
    steps: int = 24,
) -> tuple[Floats, Floats]:
    """Search boxes for a large value of ``seed . actions``, by steps towards the corner the gradient names.

    Parameters
    ----------
    network : Network
        n inputs, A actions.
    lower, upper : ndarray
        ``(B, n)``.
    seed : ndarray
        ``(B, A)``.
    start : ndarray, optional
        ``(B, n)``; the middle otherwise. Later restarts begin at random points.

    Returns
    -------
    tuple of ndarray
        The best points found (B, n) and their values (B,), in float64.
    """
    best = (lower + upper) / 2 if start is None else start
    value = np.einsum("ba,ba->b", network(best), seed)
    for restart in range(restarts):
        point = best if restart == 0 else sample(lower, upper, 2, rng)[1]
        for step in range(steps):
            slope = gradient(network, point, seed)
            corner = np.where(slope > 0, upper, np.where(slope < 0, lower, point))
            length = 1.0 if step % 4 == 0 else 0.6 ** (1 + step // 2)
            point = np.clip(point + length * (corner - point), lower, upper)
            reached = np.einsum("ba,ba->b", network(point), seed)
            better = reached > value
            best, value = np.where(better[:, None], point, best), np.where(better, reached, value)
    return best, value


def gradient(network: Network, points: Floats, seed: Floats) -> Floats:
    """Differentiate ``seed . actions`` at points (B, n), activations by central differences; not rigorous."""
    values = network.values(points)
    adjoints = [np.zeros(value.shape) for value in values]
    adjoints[-1] += seed
    for node, adjoint in zip(network.nodes[::-1], adjoints[::-1], strict=True):
        match node:
            case Affine():
                for source, weight in zip(node.sources, node.weights, strict=True):
                    adjoints[source] += adjoint @ weight
            case Activation():
                x = values[node.source]
                step = 1e-6 * np.maximum(np.abs(x), 1e-3)
                rise = node.function(x + step) - node.function(x - step)
                adjoints[node.source] += adjoint * np.nan_to_num(rise / (2 * step), posinf=0.0, neginf=0.0)
            case Product():
                adjoints[node.left] += adjoint * values[node.right]
                adjoints[node.right] += adjoint * values[node.left]
            case Maximum() | Minimum():
                left = (values[node.left] > values[node.right]) == isinstance(node, Maximum)
                adjoints[node.left] += adjoint * left
                adjoints[node.right] += adjoint * ~left
            case Cast():
                adjoints[node.source] += adjoint
            case Input():
                break
    return np.nan_to_num(adjoints[0], posinf=0.0, neginf=0.0)


def milp_maximum(network: Network, lower: Floats, upper: Floats, seed: Floats) -> float:
    """Return the maximum of ``seed . actions`` over one box, up to the solver's 1e-6; ReLU networks only.

    Parameters
    ----------
    network : Network
        Affine and ReLU nodes.
    lower, upper : ndarray
        ``(n,)``.
    seed : ndarray
        ``(A,)``.

    Notes
    -----
    A mixed-integer linear program with one binary variable for each undecided ReLU, and big-M from interval
    arithmetic.
    """
    program = _Program(network, lower, upper)
    return program.maximum(seed)


class _Program:
    """All node values as variables, then one binary for each undecided ReLU."""

    def __init__(self, network: Network, lower: Floats, upper: Floats) -> None:
        self.network = network
        self.starts = np.concatenate([[0], np.cumsum([node.size for node in network.nodes])])
        self.low, self.high = [*lower], [*upper]
        self.rows: list[tuple[dict[int, float], float, float]] = []
        for index, node in enumerate(network.nodes[1:], start=1):
            for row in range(node.size):
                if isinstance(node, Affine):
                    self._add_affine(int(self.starts[index]) + row, node, row)
                else:
                    assert isinstance(node, Activation)
                    assert node.function.name == "Relu"
                    self._add_value(0.0, max(0.0, self.high[self.starts[node.source] + row]))
        self.integrality = [0] * len(self.low)
        for index, node in enumerate(network.nodes):
            if isinstance(node, Activation):
                for row in range(node.size):
                    self._add_relu(int(self.starts[node.source]) + row, int(self.starts[index]) + row)

    def _add_value(self, low: float, high: float) -> None:
        self.low.append(low)
        self.high.append(high)

    def _add_affine(self, target: int, node: Affine, row: int) -> None:
        factors = {target: -1.0}
        low = high = float(node.bias[row])
        for source, weight in zip(node.sources, node.weights, strict=True):
            for column in np.flatnonzero(weight[row]).tolist():
                position, factor = int(self.starts[source]) + column, float(weight[row, column])
                factors[position] = factors.get(position, 0.0) + factor
                ends = (factor * self.low[position], factor * self.high[position])
                low, high = low + min(ends), high + max(ends)
        self._add_value(low, high)
        self.rows.append((factors, -float(node.bias[row]), -float(node.bias[row])))

    def _add_relu(self, x: int, y: int) -> None:
        low, high = self.low[x], self.high[x]
        if high <= 0:
            return  # y is already 0
        if low >= 0:
            self.rows.append(({y: 1.0, x: -1.0}, 0.0, 0.0))
            return
        on = len(self.low)
        self._add_value(0.0, 1.0)
        self.integrality.append(1)
        self.rows.append(({y: 1.0, x: -1.0}, 0.0, np.inf))
        self.rows.append(({y: 1.0, x: -1.0, on: -low}, -np.inf, -low))
        self.rows.append(({y: 1.0, on: -high}, -np.inf, 0.0))

    def maximum(self, seed: Floats) -> float:
        from scipy.optimize import Bounds, LinearConstraint, milp

        size = len(self.low)
        matrix = np.zeros((len(self.rows), size))
        for row, (factors, _, _) in enumerate(self.rows):
            matrix[row, list(factors)] = list(factors.values())
        objective = np.zeros(size)
        objective[self.starts[-2] : self.starts[-1]] = -seed
        answer = milp(
            objective,
            integrality=np.array(self.integrality),
            bounds=Bounds(np.array(self.low), np.array(self.high)),
            constraints=LinearConstraint(
                matrix, [row[1] for row in self.rows], [row[2] for row in self.rows]
            ),
            options={"mip_rel_gap": 0.0},
        )
        assert answer.success, answer.message
        return float(-answer.fun)
