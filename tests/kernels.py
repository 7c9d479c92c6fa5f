"""Kernels of runtimes that reduce or normalise: models, numbers that are hard for them, and how far they may stray.

What a kernel gives is compared with 240-bit arithmetic and measured in units of what the rounding model allows it at
that very input: the rounding of the observation itself, of which these inputs have none, is not counted.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray

from tests.oracles import MP
from tests.policy.models import model_of, node, save, weights
from viatool.errors import EnclosureError
from viatool.policy import Affine, Input, Network, load_policy
from viatool.taylor.deviation import runtime_deviation

Floats = NDArray[np.float64]
Exact = Callable[[list[Any]], list[Any]]

EPSILON = float(np.float32(1e-5))
SIZES = (2, 3, 7, 16, 33, 64, 255)
LARGEST_SOFTMAX = 33


@dataclass(frozen=True)
class Kernel:
    """A model with one kernel, and what it is exactly.

    Parameters
    ----------
    nodes : callable
        Of n numbers x to y, given n.
    exact : callable
        The outputs for n numbers of 240 bits.
    constants : callable
        Initializers, given n.
    opset : int
        That defines the operator.
    shape : callable
        Of x, given n.
    largest : int
        Largest n.
    dtype : str
        Of x.
    """

    nodes: Callable[[int], list[onnx.NodeProto]]
    exact: Exact
    constants: Callable[[int], dict[str, Any]] = field(default=lambda size: {})
    opset: int = 13
    shape: Callable[[int], tuple[int, ...]] = field(default=lambda size: (1, size))
    largest: int = 255
    dtype: str = "float32"

    def model(self, size: int) -> onnx.ModelProto:
        kind = onnx.TensorProto.FLOAT16 if self.dtype == "float16" else onnx.TensorProto.FLOAT
        constants = {
            name: value.astype(self.dtype) if value.dtype == np.float32 else value
            for name, value in self.constants(size).items()
        }
        return model_of(self.nodes(size), constants, shape=self.shape(size), opset=self.opset, dtype=kind)


# --- exact values -----------------------------------------------------------------------------------------


def mean(x: Sequence[Any]) -> Any:
    return MP.fsum(x) / len(x)


def standardised(x: list[Any], *, centre: bool = True) -> list[Any]:
    centred = [value - mean(x) for value in x] if centre else x
    spread = MP.sqrt(mean([value**2 for value in centred]) + MP.mpf(EPSILON))
    return [value / spread for value in centred]


def scaled(x: list[Any], shift: bool = True) -> list[Any]:
    scales, shifts = scale(len(x)), shift_of(len(x))
    return [
        a * MP.mpf(float(s)) + (MP.mpf(float(b)) if shift else 0)
        for a, s, b in zip(x, scales, shifts, strict=True)
    ]


def softmax(x: list[Any]) -> list[Any]:
    powers = [MP.exp(value - max(x)) for value in x]
    return [power / MP.fsum(powers) for power in powers]


def log_softmax(x: list[Any]) -> list[Any]:
    total = MP.log(MP.fsum(MP.exp(value - max(x)) for value in x))
    return [value - max(x) - total for value in x]


def batch_normalised(x: list[Any]) -> list[Any]:
    numbers = zip(x, *(map(MP.mpf, statistics(len(x))[name].tolist()) for name in "sbmv"), strict=True)
    return [(value - m) / MP.sqrt(v + MP.mpf(EPSILON)) * s + b for value, s, b, m, v in numbers]


def through_gemm(x: list[Any]) -> list[Any]:
    matrix = weights(5, len(x), len(x))
    return [MP.fsum(MP.mpf(float(w)) * value for w, value in zip(row, x, strict=True)) for row in matrix]


# --- models -----------------------------------------------------------------------------------------------


def scale(size: int) -> Any:
    return weights(1, size) + np.float32(1.5)


def shift_of(size: int) -> Any:
    return weights(2, size)


def statistics(size: int) -> dict[str, Any]:
    return {
        "s": scale(size),
        "b": shift_of(size),
        "m": 100 * weights(3, size),
        "v": np.abs(weights(4, size)) + np.float32(1e-3),
    }


def affine_constants(size: int) -> dict[str, Any]:
    return {
        "s": scale(size),
        "b": shift_of(size),
        "epsilon": np.array([EPSILON], dtype=np.float32),
        "two": np.array([2], dtype=np.float32),
    }


def layer(*names: str, operator: str = "LayerNormalization") -> Callable[[int], list[onnx.NodeProto]]:
    return lambda size: [node(operator, ["x", *names], ["y"], epsilon=EPSILON, axis=-1)]


def in_parts(variance: list[onnx.NodeProto], *, centre: bool = True) -> Callable[[int], list[onnx.NodeProto]]:
    """Return a normalisation spelled out, with the nodes that make its variance from x, its mean and deviations."""
    centred = "d" if centre else "x"
    before = [node("ReduceMean", ["x"], ["m"], axes=[-1]), node("Sub", ["x", "m"], ["d"])] if centre else []
    after = [
        node("Add", ["v", "epsilon"], ["e"]),
        node("Sqrt", ["e"], ["r"]),
        node("Div", [centred, "r"], ["z"]),
        node("Mul", ["z", "s"], ["a" if centre else "y"]),
        *([node("Add", ["a", "b"], ["y"])] if centre else []),
    ]
    return lambda size: [*before, *variance, *after]


def squares_of(name: str) -> list[onnx.NodeProto]:
    return [node("Pow", [name, "two"], ["q"]), node("ReduceMean", ["q"], ["v"], axes=[-1])]


ONE_PASS = [
    node("Mul", ["x", "x"], ["q"]),
    node("ReduceMean", ["q"], ["mq"], axes=[-1]),
    node("Mul", ["m", "m"], ["mm"]),
    node("Sub", ["mq", "mm"], ["v"]),
]


def image(size: int) -> tuple[int, ...]:
    return (1, 1, size)


def channels(size: int) -> tuple[int, ...]:
    return (1, size, 1)


def one_scale(size: int) -> dict[str, Any]:
    return {"s": np.float32([1.25]), "b": np.float32([-0.375])}


def with_one_scale(x: list[Any]) -> list[Any]:
    return [value * MP.mpf(1.25) - MP.mpf(0.375) for value in x]


def reduction(operator: str) -> Callable[[int], list[onnx.NodeProto]]:
    if operator == "ReduceSum":
        return lambda size: [node(operator, ["x", "axes"], ["y"])]
    return lambda size: [node(operator, ["x"], ["y"], axes=[-1])]


def parts_of(operator: str) -> Callable[[int], list[onnx.NodeProto]]:
    """Return an operator over n values of one element each."""

    def nodes(size: int) -> list[onnx.NodeProto]:
        names = [f"x{index}" for index in range(size)]
        return [node("Split", ["x", "ones"], names, axis=1), node(operator, names, ["y"])]

    return nodes


def plain(operator: str, **attributes: Any) -> Callable[[int], list[onnx.NodeProto]]:
    return lambda size: [node(operator, ["x"], ["y"], **attributes)]


def attention(size: int) -> list[onnx.NodeProto]:
    return [
        node("Mul", ["x", "scores"], ["a"]),
        node("Softmax", ["a"], ["p"], axis=-1),
        node("MatMul", ["p", "values"], ["y"]),
    ]


def attended(x: list[Any]) -> list[Any]:
    scores, values = weights(6, 3, len(x)), weights(7, len(x), 2)
    shares = [softmax([MP.mpf(float(w)) * a for w, a in zip(row, x, strict=True)]) for row in scores]
    columns = [[MP.mpf(float(v)) for v in column] for column in values.T]
    return [MP.fsum(p * v for p, v in zip(row, column, strict=True)) for row in shares for column in columns]


SUM = Kernel(reduction("ReduceSum"), lambda x: [MP.fsum(x)], lambda size: {"axes": np.array([-1])})
MEAN = Kernel(reduction("ReduceMean"), lambda x: [mean(x)])
LAYER = Kernel(
    layer("s", "b"),
    lambda x: scaled(standardised(x)),
    lambda size: {"s": scale(size), "b": shift_of(size)},
    17,
)
SOFTMAX = Kernel(plain("Softmax", axis=-1), softmax, largest=LARGEST_SOFTMAX)

KERNELS: dict[str, Kernel] = {
    "GroupNormalization": Kernel(
        lambda size: [node("GroupNormalization", ["x", "s", "b"], ["y"], epsilon=EPSILON, num_groups=1)],
        lambda x: scaled(standardised(x)),
        lambda size: {"s": scale(size), "b": shift_of(size)},
        21,
        channels,
    ),
    "InstanceNormalization": Kernel(
        lambda size: [node("InstanceNormalization", ["x", "s", "b"], ["y"], epsilon=EPSILON)],
        lambda x: with_one_scale(standardised(x)),
        one_scale,
        shape=image,
    ),
    "LayerNormalization": LAYER,
    "LayerNormalization in parts": Kernel(in_parts(squares_of("d")), LAYER.exact, affine_constants),
    "the same in one pass": Kernel(in_parts(ONE_PASS), LAYER.exact, affine_constants),
    "RMSNormalization": Kernel(
        layer("s", operator="RMSNormalization"),
        lambda x: scaled(standardised(x, centre=False), shift=False),
        lambda size: {"s": scale(size)},
        23,
    ),
    "RMSNormalization in parts": Kernel(
        in_parts(squares_of("x"), centre=False),
        lambda x: scaled(standardised(x, centre=False), shift=False),
        affine_constants,
    ),
    "BatchNormalization": Kernel(
        lambda size: [node("BatchNormalization", ["x", *"sbmv"], ["y"], epsilon=EPSILON)],
        batch_normalised,
        statistics,
        shape=channels,
    ),
    "BatchNormalization after Gemm": Kernel(
        lambda size: [
            node("Gemm", ["x", "w"], ["g"], transB=1),
            node("BatchNormalization", ["g", *"sbmv"], ["y"], epsilon=EPSILON),
        ],
        lambda x: batch_normalised(through_gemm(x)),
        lambda size: {**statistics(size), "w": weights(5, size, size)},
    ),
    "BatchNormalization after Conv": Kernel(
        lambda size: [
            node("Conv", ["x", "w"], ["g"]),
            node("BatchNormalization", ["g", *"sbmv"], ["y"], epsilon=EPSILON),
        ],
        lambda x: batch_normalised(through_gemm(x)),
        lambda size: {**statistics(size), "w": weights(5, size, size)[:, :, None]},
        shape=channels,
    ),
    "Softmax": SOFTMAX,
    "Softmax over attention": Kernel(
        attention,
        attended,
        lambda size: {"scores": weights(6, 3, size), "values": weights(7, size, 2)},
        largest=16,
    ),
    "LogSoftmax": Kernel(plain("LogSoftmax", axis=-1), log_softmax, largest=LARGEST_SOFTMAX),
    "ReduceSum": SUM,
    "ReduceMean": MEAN,
    "ReduceL1": Kernel(reduction("ReduceL1"), lambda x: [MP.fsum(map(abs, x))]),
    "ReduceL2": Kernel(reduction("ReduceL2"), lambda x: [MP.sqrt(MP.fsum(value**2 for value in x))]),
    "ReduceSumSquare": Kernel(reduction("ReduceSumSquare"), lambda x: [MP.fsum(value**2 for value in x)]),
    "ReduceMax": Kernel(reduction("ReduceMax"), lambda x: [max(x)]),
    "ReduceMin": Kernel(reduction("ReduceMin"), lambda x: [min(x)]),
    "Sum": Kernel(parts_of("Sum"), lambda x: [MP.fsum(x)], lambda size: {"ones": np.ones(size, dtype=np.int64)}),
    "Mean": Kernel(parts_of("Mean"), lambda x: [mean(x)], lambda size: {"ones": np.ones(size, dtype=np.int64)}),
    "AveragePool": Kernel(
        lambda size: [node("AveragePool", ["x"], ["y"], kernel_shape=[size])], lambda x: [mean(x)], shape=image
    ),
    "GlobalAveragePool": Kernel(plain("GlobalAveragePool"), lambda x: [mean(x)], shape=image),
    "LayerNormalization in float16": replace(LAYER, dtype="float16"),
    "Softmax in float16": replace(SOFTMAX, dtype="float16"),
    "ReduceSum in float16": replace(SUM, dtype="float16"),
    "ReduceMean in float16": replace(MEAN, dtype="float16"),
}  # fmt: skip


def hard_numbers(size: int, dtype: str = "float32") -> dict[str, Floats]:
    """Return inputs (n,) by name that are hard to add up or to normalise, all numbers of their type."""
    generator = np.random.default_rng(size)
    normal = generator.normal(size=size)
    pairs = np.resize([1.0, -1.0], size) * (1e4 if dtype == "float32" else 200.0)
    found = {
        "plain": normal,
        "mean 30": 30 + normal,
        "mean 100": 100 + normal,
        "mean 1000": 1000 + normal,
        "mean 10000": 1e4 + normal,
        "spread 0.001": 10 + 1e-3 * normal,
        "equal": np.full(size, 0.1),
        "mixed": normal * 10.0 ** generator.uniform(-6, 6, size),
        "cancelling": pairs + normal,
        "tiny": 1e-20 * normal,
        "subnormal": 1e-41 * normal,
        "large": 1e8 * normal,
    }
    with np.errstate(over="ignore"):
        stored = {name: x.astype(dtype).astype(np.float64) for name, x in found.items()}
    return {
        name: x
        for name, x in stored.items()
        if np.isfinite(x).all() and (dtype == "float32" or np.abs(x).max() < 1e3)
    }


@dataclass(frozen=True, eq=False)
class Question:
    """One kernel on P inputs of one size: what is exact, and how far a program may be from it.

    Parameters
    ----------
    model : onnx.ModelProto
        As bytes it is what every version runs.
    points : ndarray
        ``(P, n)``.
    exact : list of list
        P times the outputs, numbers of 240 bits.
    allowed, of_two_passes : ndarray
        ``(P, outputs)``: the bound, and the bound of a program that takes every variance in two passes; infinite
        where a program may overflow or leave a domain, which is refused.
    """

    model: onnx.ModelProto
    points: Floats
    exact: list[list[Any]]
    allowed: Floats
    of_two_passes: Floats

    def error(self, actions: Floats) -> Floats:
        """Return how far actions (P, outputs) are from the exact ones; infinite where they are no numbers."""
        rows = [
            [
                float(abs(MP.mpf(float(a)) - e)) if np.isfinite(a) else np.inf
                for a, e in zip(row, exact, strict=True)
            ]
            for row, exact in zip(actions, self.exact, strict=True)
        ]
        return np.array(rows)

    def used(self, actions: Floats) -> float:
        """Return the largest share of what is allowed that actions use up."""
        return _share(self.error(actions), self.allowed)

    def takes_one_pass(self, actions: Floats) -> bool:
        """Whether actions err by more than two passes explain."""
        return _share(self.error(actions), self.of_two_passes) > 1


def _share(error: Floats, allowed: Floats) -> float:
    with np.errstate(divide="ignore", invalid="ignore"):
        share = np.where(np.isinf(allowed) | (error == 0), 0.0, error / allowed)
    return float(share.max())


def question(kernel: Kernel, size: int, folder: Path) -> Question:
    """Ask one kernel about all hard numbers of a size."""
    model = kernel.model(size)
    network = load_policy(save(model, folder, "kernel.onnx"), self_check=False).network
    points = np.array(list(hard_numbers(size, kernel.dtype).values()))
    exact = [kernel.exact([MP.mpf(value) for value in row.tolist()]) for row in points]
    program = replace(network, nodes=(Input(size, "float64"), *network.nodes[1:]))
    return Question(model, points, exact, allowed(program, points), allowed(in_two_passes(program), points))


def in_two_passes(network: Network) -> Network:
    """Return a network without what one-pass variances may err by."""
    nodes = [replace(n, merged_weights=None) if isinstance(n, Affine) else n for n in network.nodes]
    return replace(network, nodes=tuple(nodes))


def allowed(network: Network, points: Floats) -> Floats:
    """Return how far a program may stray at points (P, n): (P, outputs), infinite where that is refused."""
    rows = []
    for point in points:
        with np.errstate(all="ignore"):
            values = network.values(point[None])
            try:
                rows.append(runtime_deviation(network, [(v, v) for v in values])[0])
            except EnclosureError:
                rows.append(np.full(network.output_size, np.inf))
    return np.array(rows)
