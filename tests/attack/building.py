"""Building a random graph node by node, every value known at a few observations while it grows."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from tests.attack.interpreter import FLOATING, apply, fold

Array = np.ndarray[Any, Any]

KINDS = {"float16": TensorProto.FLOAT16, "float32": TensorProto.FLOAT, "float64": TensorProto.DOUBLE}
OLDEST_OPSET, NEWEST_OPSET = 13, min(28, onnx.defs.onnx_opset_version())
"""Newer ones than the last are not run by any released onnxruntime."""

MOST_ELEMENTS = 48
"""Of one value: graphs stay small, so that many are attacked."""

WITHOUT_DOUBLE = frozenset(
    (
        "AveragePool", "Celu", "Conv", "Elu", "Erf", "Gelu", "GlobalAveragePool", "GlobalMaxPool", "HardSigmoid",
        "HardSwish", "InstanceNormalization", "LeakyRelu", "Mean", "Mish", "PRelu", "Selu", "Softplus", "Softsign",
        "Swish", "ThresholdedRelu",
    )
)  # fmt: skip
"""Operators for which onnxruntime has no double-precision kernel on a CPU."""

_RECURRENT = frozenset(("GRU", "LSTM", "RNN"))
_LACKING = {
    "float64": WITHOUT_DOUBLE | _RECURRENT,
    "float16": frozenset(("Celu", "ReduceLogSumExp")) | _RECURRENT,
}

_LARGEST = {"float16": 2e3, "float32": 1e5, "float64": 1e7}
_LARGEST_OF_WILD = {"float16": 6e4, "float32": 3e37, "float64": 1e300}


class Unfit(Exception):  # noqa: N818  # not an error: the piece is tried elsewhere
    """A piece does not fit here: an undefined or overflowing value, a missing operator, too large a tensor."""


@dataclass(frozen=True, eq=False)
class Value:
    """A value of the graph: an array for each probe, or one array where it is constant."""

    name: str
    samples: Sequence[Array]
    constant: bool = False

    @property
    def shape(self) -> tuple[int, ...]:
        """Return the shape at batch size 1."""
        return self.samples[0].shape

    @property
    def size(self) -> int:
        return math.prod(self.shape)

    @property
    def array(self) -> Array:
        """Return the array of a constant."""
        return self.samples[0]


@dataclass(eq=False)
class Builder:
    """A graph that grows.

    Parameters
    ----------
    rng : Generator
        Draws everything.
    opset : int
        Of the default domain.
    kind : str
        Element type of the input.
    shape : tuple of int
        Of the input, batch size 1 first.
    batched : bool
        Whether the first axis is a batch, which no operator then touches.
    wild : bool
        Whether values may come near overflow.
    most : int
        Elements of one value.
    """

    rng: np.random.Generator
    opset: int
    kind: str
    shape: tuple[int, ...]
    batched: bool
    wild: bool = False
    most: int = MOST_ELEMENTS
    nodes: list[onnx.NodeProto] = field(default_factory=list)
    initializers: list[onnx.TensorProto] = field(default_factory=list)
    probes: list[Array] = field(default_factory=list)
    _count: int = 0
    _free: bool = False

    def __post_init__(self) -> None:
        numbers = [
            np.zeros(self.shape),
            self.rng.normal(size=self.shape),
            10 * self.rng.normal(size=self.shape),
        ]
        self.probes = [self.typed(x).astype(np.float64) for x in numbers]

    # --- draws ---

    def typed(self, array: Any, kind: str | None = None) -> Array:
        with np.errstate(all="ignore"):
            return np.asarray(array, dtype=np.dtype(kind or self.kind))

    def chance(self, probability: float) -> bool:
        return bool(self.rng.random() < probability)

    def pick(self, options: Sequence[Any]) -> Any:
        return options[int(self.rng.integers(len(options)))]

    def between(self, low: int, high: int) -> int:
        """Draw an integer, both ends included."""
        return int(self.rng.integers(low, high + 1))

    def numbers(self, *shape: int) -> Array:
        """Draw constants of one of several characters."""
        plain = self.rng.normal(size=shape)
        match self.rng.integers(10):
            case 0:
                plain = np.round(4 * plain) / 4
            case 1:
                plain = np.where(self.rng.random(shape) < 0.5, plain, 0.0)
            case 2:
                plain = plain * 10.0 ** self.rng.uniform(-3, 1.5, shape)
            case 3 if self.kind != "float16":
                plain = plain * 10.0 ** self.rng.choice([-30.0, -12.0, 0.0, 4.0], shape)
            case 4 if plain.size > 1:  # large ones that cancel, and what is left
                flat, large = plain.ravel(), 2.0 ** self.rng.integers(4, 8 if self.kind == "float16" else 14)
                flat[0], flat[-1] = large, -large + flat[-1]
                plain = flat.reshape(shape)
            case 5:
                plain = np.exp2(np.round(2 * plain)) * np.sign(plain)
        return self.typed(plain)

    def number(self, *options: float) -> float:
        """Pick a parameter, as a float32 number."""
        return float(np.float32(self.pick(options)))

    # --- values ---

    def name(self) -> str:
        self._count += 1
        return f"v{self._count}"

    def input(self) -> Value:
        return Value("x", self.probes)

    def has(self, operator: str) -> bool:
        """Whether the opset has an operator, and onnxruntime a kernel of this element type."""
        if operator in _LACKING.get(self.kind, ()):
            return False
        try:
            onnx.defs.get_schema(operator, self.opset, "")
        except onnx.defs.SchemaError:
            return False
        return True

    def version(self, operator: str) -> int:
        """Return the version of an operator in this opset."""
        return int(onnx.defs.get_schema(operator, self.opset, "").since_version)

    def stored(self, array: Any) -> Value:
        """Store an array as it is: as an initialiser or as a Constant node."""
        array, name = np.asarray(array), self.name()
        tensor = numpy_helper.from_array(array, name)
        if self.chance(0.2):
            self.nodes.append(helper.make_node("Constant", [], [name], value=tensor))
        else:
            self.initializers.append(tensor)
        return Value(name, [array], constant=True)

    def call(self, operator: str, *inputs: Value | None, count: int = 1, **attributes: Any) -> Any:
        """Add a node; return its value, or a list of `count` of them.

        Raises
        ------
        Unfit
            If the operator is missing here, or a value would overflow or be too large.
        """
        computed = [value for value in inputs if value is not None and not value.constant]
        if not self.has(operator) and computed:
            raise Unfit(f"no {operator}")
        outputs = [self.name() for _ in range(count)]
        given = list(inputs)
        while given and given[-1] is None:
            given.pop()
        names = [value.name if value is not None else "" for value in given]
        node = helper.make_node(operator, names, outputs, **attributes)
        try:
            results = self._evaluated(node, given, bool(computed))
        except (ArithmeticError, ValueError, IndexError, TypeError, KeyError, RuntimeError) as error:
            raise Unfit(f"{operator}: {error}") from error
        for samples in results:
            for sample in samples:
                self._check(operator, sample)
        self.nodes.append(node)
        values = [
            Value(name, samples, constant=not computed)
            for name, samples in zip(outputs, results, strict=False)
        ]
        return values[0] if count == 1 else values

    @contextmanager
    def overflowing(self) -> Iterator[None]:
        """Let values become infinite, as where an exponential saturates what it is a part of."""
        before, self._free = self._free, True
        try:
            yield
        finally:
            self._free = before

    def _evaluated(
        self, node: onnx.NodeProto, inputs: Sequence[Value | None], computed: bool
    ) -> list[list[Array]]:
        if not computed:
            arrays = [None if value is None else value.array for value in inputs]
            return [[array] for array in fold(node, self.opset, arrays)]
        rows = [
            apply(
                node,
                self.opset,
                [None if v is None else v.array if v.constant else v.samples[k] for v in inputs],
                FLOATING,
            )
            for k in range(len(self.probes))
        ]
        return [list(column) for column in zip(*rows, strict=True)]

    def _check(self, operator: str, sample: Array) -> None:
        if sample.size > self.most * (8 if sample.dtype.kind != "f" else 1) or sample.size == 0:
            raise Unfit(f"{operator} makes {sample.size} elements")
        if sample.dtype.kind == "f" and sample.dtype.itemsize <= 8:
            largest = np.inf if self._free else (_LARGEST_OF_WILD if self.wild else _LARGEST)[self.kind]
            if not (np.abs(sample.astype(np.float64)) <= largest).all():
                raise Unfit(f"{operator} leaves the range")

    # --- shapes ---

    def reshaped(self, x: Value, *shape: int) -> Value:
        """Reshape behind the batch axis; shape at batch size 1."""
        if shape == x.shape:
            return x
        first = self.pick([0, -1]) if self.batched else shape[0]
        return self.call("Reshape", x, self.stored(np.array([first, *shape[1:]], dtype=np.int64)))

    def ranked(self, x: Value, rank: int) -> Value:
        """Return x with another number of axes."""
        if len(x.shape) == rank:
            return x
        return self.reshaped(x, 1, *self.factors(x.size, rank - 1))

    def factors(self, size: int, count: int) -> tuple[int, ...]:
        """Write a size as a product."""
        sizes = []
        for _ in range(count - 1):
            divisors = [d for d in range(1, size + 1) if size % d == 0]
            sizes.append(self.pick(divisors))
            size //= sizes[-1]
        return (*sizes, size)

    def axis(self, x: Value) -> int:
        """Pick an axis that is not the batch; sometimes counted from the end."""
        rank = len(x.shape)
        if self.batched and rank == 1:
            raise Unfit("the batch is the only axis")
        axis = self.between(1 if self.batched else 0, rank - 1)
        return axis - rank if self.chance(0.3) else axis

    # --- files ---

    def model(self, output: Value) -> onnx.ModelProto:
        """Return the model that ends here."""
        first: list[int | str] = ["batch" if self.batched and self.chance(0.6) else self.shape[0]]
        graph = helper.make_graph(
            self.nodes,
            "attacked",
            [helper.make_tensor_value_info("x", KINDS[self.kind], [*first, *self.shape[1:]])],
            [helper.make_tensor_value_info(output.name, KINDS[self.kind], None)],
            self.initializers,
        )
        return helper.make_model(graph, opset_imports=[helper.make_opsetid("", self.opset)], ir_version=10)
