"""Random graphs of constants and sums: exact values and onnxruntime keep to the bounds of the file's own network."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from numpy.typing import NDArray

from tests.policy.models import model_of, node, save
from tests.policy.test_merged_terms import programs
from tests.taylor.containment import Bare
from viatool.errors import EnclosureError
from viatool.policy import load_policy
from viatool.taylor import reach

Exact = Callable[[Fraction], Fraction]
TYPES = {
    "float16": onnx.TensorProto.FLOAT16,
    "float32": onnx.TensorProto.FLOAT,
    "float64": onnx.TensorProto.DOUBLE,
}
OPERATORS: dict[str, Callable[[Fraction, Fraction], Fraction]] = {
    "Add": lambda a, b: a + b,
    "Max": max,
    "Min": min,
    "Mul": lambda a, b: a * b,
    "Sub": lambda a, b: a - b,
    "Sum": lambda a, b: a + b,
}
ROUNDS = 25
EPS = 0.02


@dataclass
class Arithmetic:
    """A random graph from one number x to one number y, with the exact value of everything in it."""

    kind: str
    generator: np.random.Generator
    nodes: list[onnx.NodeProto] = field(default_factory=list)
    stored: dict[str, NDArray[Any]] = field(default_factory=dict)
    constants: dict[str, Fraction] = field(default_factory=dict)

    def draw(self) -> Exact:
        """Store three constants, make others of them, and make y of x, of them and of x again."""
        for index in range(3):
            size = 10.0 ** self.generator.integers(-2, 3 if self.kind == "float16" else 6)
            value = np.array([size * self.generator.uniform(-3, 3)], dtype=self.kind)
            self.stored[f"c{index}"], self.constants[f"c{index}"] = value, Fraction(float(value[0]))
        for index in range(self.generator.integers(1, 4)):
            operator, left, right = self.operator(), self.constant(), self.constant()
            self.nodes.append(node(operator, [left, right], [f"k{index}"]))
            value = OPERATORS[operator](self.constants[left], self.constants[right])
            self.constants[f"k{index}"] = value
        last: str = "x"
        exact: Exact = lambda x: x  # noqa: E731  # the first of a chain of functions
        for index in range(self.generator.integers(1, 5)):
            last, exact = self.extended(last, exact, f"v{index}")
        self.nodes.append(node("Neg", [last], ["y"]))
        return lambda x: -exact(x)

    def extended(self, last: str, exact: Exact, name: str) -> tuple[str, Exact]:
        """Append one node to what depends on x."""
        other = self.constant()
        constant = self.constants[other]
        match self.generator.integers(4):
            case 0:  # two constants that are merged
                second = self.constant()
                self.nodes.append(node("Sum", [other, last, second], [name]))
                both = constant + self.constants[second]
                return name, lambda x: exact(x) + both
            case 1:  # the same source twice
                self.nodes.append(node("Sum", [last, other, last], [name]))
                return name, lambda x: 2 * exact(x) + constant
            case 2:  # weights that cancel where nothing has happened yet
                self.nodes.append(node("Unsqueeze", [other, "axis"], [f"{name}w"]))
                self.nodes.append(node("Gemm", [last, f"{name}w", "x"], [name], beta=-1.0))
                self.stored["axis"] = np.array([0])
                return name, lambda x: exact(x) * constant - x
            case _:
                operator = self.operator()
                self.nodes.append(node(operator, [last, other], [name]))
                return name, lambda x: OPERATORS[operator](exact(x), constant)

    def operator(self) -> str:
        return str(self.generator.choice(list(OPERATORS)))

    def constant(self) -> str:
        return str(self.generator.choice(list(self.constants)))

    def save(self, folder: Path) -> Path:
        read = {name for call in self.nodes for name in call.input}
        arrays = {name: array for name, array in self.stored.items() if name in read}
        return save(model_of(self.nodes, arrays, shape=(1, 1), dtype=TYPES[self.kind], opset=13), folder)


@pytest.mark.parametrize("kind", TYPES)
def test_random_arithmetic_keeps_to_the_bounds_of_both_arithmetics(kind: str, tmp_path: Path) -> None:
    checked = 0
    for seed in range(ROUNDS):
        graph = Arithmetic(kind, np.random.default_rng([seed, len(kind)]))
        exact = graph.draw()
        path = graph.save(tmp_path)
        loaded = Bare(load_policy(path, self_check=False).network)
        centre = float(np.array(graph.generator.normal(), dtype=kind))
        points = (centre + EPS * np.linspace(-0.99, 0.99, 7)[:, None]).astype(kind)
        points = points[np.abs(points[:, 0].astype(float) - centre) <= EPS]
        try:
            deployed, real = (reach(loaded, [[centre]], EPS, arithmetic=a) for a in ("float32", "real"))
        except EnclosureError:  # float16 may overflow
            assert kind == "float16"
            continue
        for value in (exact(Fraction(float(x))) for x in points[:, 0]):
            assert Fraction(real.lower[0, 0]) <= value <= Fraction(real.upper[0, 0]), seed
        values = programs(path, points, kind)
        assert deployed.lower[0, 0] <= values.min(), seed
        assert values.max() <= deployed.upper[0, 0], seed
        checked += 1
    assert checked > ROUNDS // 2
