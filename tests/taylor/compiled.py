"""Checks of the compiled engine: how far what a network can do leaves what the kernel says of it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests import oracles, runtimes
from viatool.policy.activations import ActivationFunction, activation
from viatool.policy.network import Activation, Affine, Input, Network, Node
from viatool.taylor.kernel import Kernel
from viatool.taylor.packed import packed

Floats = NDArray[np.float64]

STRAIGHT = (
    activation("Relu"),
    activation("LeakyRelu", alpha=float(np.float32(0.01))),
    activation("Clip", min=-0.75, max=1.25),
    activation("HardSigmoid", alpha=float(np.float32(0.2))),
    activation("Abs"),
)
BENT = tuple(map(activation, ("Tanh", "Elu", "Sigmoid", "Softplus", "Gelu", "Mish", "Selu", "HardSwish")))


def layered(
    rng: np.random.Generator, *widths: int, hidden: ActivationFunction, scale: float = 1.0, last: bool = False
) -> Network:
    """Return layers of random weights, the first scaled number by number, as a normaliser does."""
    size = widths[0]
    nodes: list[Node] = [Input(size)]
    nodes.append(Affine((0,), (np.diag(rng.uniform(-2, 2, size)),), rng.normal(size=size)))
    for before, after in pairwise(widths):
        weight = scale * rng.normal(size=(after, before)) / np.sqrt(before)
        nodes.append(Affine((len(nodes) - 1,), (weight,), scale * rng.normal(size=after)))
        nodes.append(Activation(len(nodes) - 1, hidden, after))
    return Network(tuple(nodes if last else nodes[:-1]))


def branched(rng: np.random.Generator, hidden: ActivationFunction) -> Network:
    """Return a network that reads its input twice, as one with a clipped part does."""
    first, second, out = (rng.normal(size=shape) for shape in ((3, 4), (5, 4), (5, 3)))
    return Network(
        (
            Input(4),
            Affine((0,), (first,), rng.normal(size=3)),
            Activation(1, hidden, 3),
            Affine((0, 2), (second, out), rng.normal(size=5)),
            Activation(3, hidden, 5),
            Affine((4,), (rng.normal(size=(2, 5)),), rng.normal(size=2)),
        )
    )


def kernel_over(network: Network, **allowances: float) -> Kernel:
    """Return the kernel of a whole network, with some allowances for rounding changed."""
    read = packed(network, len(network.nodes))
    assert read is not None
    for name, value in allowances.items():
        assert hasattr(read.allowances, name)
        setattr(read.allowances, name, value)
    return Kernel(network, len(network.nodes), read)


def escape(
    kernel: Kernel, lower: Floats, upper: Floats, seed: int = 0, samples: int = 4, **effort: int
) -> float:
    """Return how far exact values of any node at points of boxes (B, n) leave their hulls, or a question's bound."""
    found = kernel.bound(lower, upper, **effort)
    assert found.done.all()
    rng = np.random.default_rng(seed)
    actions = kernel.network.output_size
    bounds = found.bound.reshape(2 * actions, -1)
    points = found.points.reshape(2 * actions, *lower.shape)
    worst = 0.0
    for b in range(len(lower)):
        drawn = [rng.uniform(lower[b], upper[b]).clip(lower[b], upper[b]) for _ in range(samples)]
        corners = [
            np.where(rng.uniform(size=lower[b].size) < 0.5, lower[b], upper[b]) for _ in range(samples)
        ]
        for point in [*drawn, *corners, *points[:, b]]:
            values = _values_of(kernel.network, point)
            flat = [value for node in values for value in node]
            for value, low, high in zip(flat, found.lower[b], found.upper[b], strict=True):
                worst = max(worst, _excess(value, low, high))
            for q, bound in enumerate(bounds[:, b]):
                value = values[-1][q % actions]
                worst = max(worst, _excess(value if q < actions else -value, -np.inf, bound))
    return worst


def escape_of_bounds(
    network: Network,
    lower: Floats,
    upper: Floats,
    bounds: tuple[Floats, Floats],
    seed: int = 0,
    samples: int = 4,
) -> float:
    """Return how far exact actions at points of boxes (B, n) leave bounds (B, A)."""
    rng, worst = np.random.default_rng(seed), 0.0
    for b in range(len(lower)):
        for number in range(2 * samples):
            share = rng.uniform(size=lower[b].size)
            inner = (lower[b] + share * (upper[b] - lower[b])).clip(lower[b], upper[b])
            point = inner if number % 2 else np.where(share < 0.5, lower[b], upper[b])
            for value, low, high in zip(
                _values_of(network, point)[-1], *(end[b] for end in bounds), strict=True
            ):
                worst = max(worst, _excess(value, low, high))
    return worst


def _values_of(network: Network, point: Floats) -> Any:
    if oracles.is_rational(network):
        return oracles.exact_values(network, point.tolist())
    return oracles.precise_values(network, point.tolist())


def _excess(value: Any, low: float, high: float) -> float:
    number = Fraction if isinstance(value, Fraction) else oracles.MP.mpf
    gaps = [value - number(float(high))] + ([number(float(low)) - value] if np.isfinite(low) else [])
    return max(float(max(gaps)), 5e-324) if max(gaps) > 0 else 0.0


def escape_of_parts(kernel: Kernel, lower: Floats, upper: Floats, seed: int = 0, samples: int = 40) -> float:
    """Return how far exact values leave the bounds of parts, at points (of boxes (B, n)) that meet their conditions."""
    network, rng = kernel.network, np.random.default_rng(seed)
    activations = [index for index, node in enumerate(network.nodes) if isinstance(node, Activation)]
    worst = 0.0
    for b in range(len(lower)):
        points = rng.uniform(lower[b], upper[b], (samples, lower.shape[1])).clip(lower[b], upper[b])
        node = rng.choice(activations, 3)
        neuron = np.array([rng.integers(network.nodes[index].size) for index in node])
        side = rng.choice([-1, 0, 1], 3)
        values = network.values(points)
        arguments = [
            values[network.nodes[index].sources[0]][:, i] for index, i in zip(node, neuron, strict=True)
        ]
        threshold = np.array([rng.choice(argument) for argument in arguments])
        meets = np.all([s * (x - t) >= 0 for s, x, t in zip(side, arguments, threshold, strict=True)], axis=0)
        action, sign = np.array([rng.integers(network.output_size)]), rng.choice([-1.0, 1.0], 1)
        conditions = (node[None], neuron[None], side[None], threshold[None])
        found = kernel.examine(lower[b : b + 1], upper[b : b + 1], action, sign, conditions)
        assert found.done.all()
        assert ((found.points[0] >= lower[b]) & (found.points[0] <= upper[b])).all()
        for point in points[meets][:6]:
            exact = _values_of(network, point)
            held = [exact[network.nodes[index].sources[0]][i] for index, i in zip(node, neuron, strict=True)]
            if all(
                s * (x - Fraction(t)) >= 0
                for s, x, t in zip(side.tolist(), held, threshold.tolist(), strict=True)
            ):
                worst = max(worst, _excess(int(sign[0]) * exact[-1][action[0]], -np.inf, found.bound[0]))
    return worst


def escape_of_programs(kernel: Kernel, lower: Floats, upper: Floats, seed: int = 0) -> float:
    """Return how far float32 programs, in any order of sums, fused or not, and onnxruntime leave the deviation."""
    network = kernel.network
    found = kernel.bound(lower, upper)
    known = kernel.deviation(kernel.hulls(found.lower, found.upper), None)
    assert known is not None
    low, high = known[:2]
    rng = np.random.default_rng(seed)
    points = np.concatenate([rng.uniform(lower, upper, (24, *lower.shape)), lower[None], upper[None]])
    flat = points.reshape(-1, lower.shape[1])
    outputs = [runtimes.run_in_any_order(network, flat, rng, fused=fused) for fused in (False, True)]
    outputs.append(runtimes.run_onnx(network, flat))
    values = np.stack(outputs).reshape(-1, *low.shape)
    return float(np.maximum(values - high, low - values).max())


@contextmanager
def engine_chosen(monkeypatch: Any, name: str) -> Iterator[None]:
    """Run with one of the engines."""
    with monkeypatch.context() as patch:
        patch.setenv("VIATOOL_ENGINE", name)
        yield


def inputs_together(
    rng: np.random.Generator, network: Network, count: int = 6, symbols: int = 3, spread: float = 0.1
) -> tuple[Floats, Floats, Floats]:
    """Return centres (B, n), what symbols add (B, V, n), and what each input has to itself (B, n)."""
    size = network.input_size
    own = spread * rng.uniform(size=(count, size)) * (rng.uniform(size=(count, size)) < 0.7)
    return rng.normal(size=(count, size)), spread * rng.normal(size=(count, symbols, size)), own


def escape_of_linear(
    kernel: Kernel, given: tuple[Floats, Floats, Floats], assumed: Floats | None = None, seed: int = 0
) -> float:
    """Return how far exact actions leave their linear models at exact inputs; the kernel is told `assumed` as own."""
    centre, shared, own = given
    rng = np.random.default_rng(seed)
    told = own if assumed is None else assumed
    norm = (np.abs(shared).sum(axis=1) + told) * (1.0 + 2.0**-40)
    found = kernel.linear(
        centre, shared, told, np.zeros_like(centre), norm, (centre - norm - 1e-9, centre + norm + 1e-9)
    )
    assert found.done.all()
    worst = 0.0
    for b in range(len(centre)):
        for number in range(8):
            z, e = (rng.choice([-1.0, 1.0], size) for size in (shared.shape[1], centre.shape[1]))
            if number % 2:
                z, e = (rng.integers(-8, 9, len(part)) / 8.0 for part in (z, e))
            point = [
                _exactly(c, [*row, o], [*z, y])
                for c, row, o, y in zip(centre[b], shared[b].T, own[b], e, strict=True)
            ]
            for a, value in enumerate(_at(kernel.network, point)[-1]):
                line = value - _like(value, _exactly(found.centre[b, a], found.slope[b, :, a], z))
                worst = max(worst, _excess(line, -float(found.others[b, a]), float(found.others[b, a])))
    return worst


def _exactly(constant: float, slopes: Iterable[float], symbols: Iterable[float]) -> Fraction:
    terms = (Fraction(s) * Fraction(x) for s, x in zip(slopes, symbols, strict=True))
    return sum(terms, Fraction(constant))


def _at(network: Network, point: list[Fraction]) -> Any:
    if oracles.is_rational(network):
        return oracles.exact_values(network, point)
    return oracles.precise_values(network, [oracles.MP.mpf(x.numerator) / x.denominator for x in point])


def _like(value: Any, number: Fraction) -> Any:
    return number if isinstance(value, Fraction) else oracles.MP.mpf(number.numerator) / number.denominator
