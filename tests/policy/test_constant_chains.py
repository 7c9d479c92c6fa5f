"""Constants that a graph computes from others, as programs have them: exact, rounded at each step, in between.

A chain of constants goes into every place that takes one. The exact value is written down in fractions; of programs,
onnxruntime runs the graph itself (without half arithmetic it keeps float32 numbers between the steps) and numpy rounds
each step to the type of the model.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from numpy.typing import NDArray

from tests.policy.models import model_of, node, save, weights
from tests.policy.test_merged_terms import programs
from tests.taylor.containment import Bare
from viatool.errors import PolicyError
from viatool.policy import load_policy
from viatool.policy.assembly import Counted
from viatool.policy.operators import convolution, elementwise, linear, matrix, normalisation, registry, shape
from viatool.taylor import reach

Floats = NDArray[np.float64]
TYPES = {
    "float16": onnx.TensorProto.FLOAT16,
    "float32": onnx.TensorProto.FLOAT,
    "float64": onnx.TensorProto.DOUBLE,
}


@dataclass(frozen=True)
class Chain:
    """Nodes that make the constant c of a and b, and what c is."""

    nodes: list[onnx.NodeProto]
    value: Callable[[Any, Any], Any]


CHAINS = {
    "what is left of a sum": Chain(
        [node("Add", ["a", "b"], ["s"]), node("Sub", ["s", "a"], ["c"])], lambda a, b: (a + b) - a
    ),
    "a product": Chain([node("Mul", ["b", "b"], ["s"]), node("Mul", ["s", "b"], ["c"])], lambda a, b: b * b * b),
    "a quotient": Chain([node("Div", ["b", "a"], ["s"]), node("Mul", ["s", "a"], ["c"])], lambda a, b: b / a * a),
    "moved": Chain(
        [node("Sub", ["a", "b"], ["s"]), node("Concat", ["s", "a"], ["t"], axis=0),
         node("Slice", ["t", "first", "second"], ["u"]), node("Sub", ["u", "a"], ["v"]), node("Neg", ["v"], ["c"])],
        lambda a, b: -((a - b) - a),
    ),
    "a sum of three": Chain([node("Neg", ["a"], ["n"]), node("Sum", ["a", "b", "n"], ["c"])], lambda a, b: (a + b) - a),
}  # fmt: skip


def root(square: Any) -> Any:
    """Return the square root of a number, that of a fraction to 40 digits."""
    return (
        Fraction(math.isqrt(int(square * 10**80)), 10**40)
        if isinstance(square, Fraction)
        else np.sqrt(square)
    )


@dataclass(frozen=True)
class Use:
    """Nodes that make y of x and c, and what the first action is."""

    nodes: list[onnx.NodeProto]
    action: Callable[[Any, Any, Any], Any]
    kinds: tuple[str, ...] = ("float16", "float32", "float64")


USES = {
    "Add": Use([node("Add", ["x", "c"], ["y"])], lambda x, z, c: x + c),
    "Sub": Use([node("Sub", ["c", "x"], ["y"])], lambda x, z, c: c - x),
    "Mul": Use([node("Mul", ["x", "c"], ["y"])], lambda x, z, c: x * c),
    "Div": Use([node("Div", ["x", "c"], ["y"])], lambda x, z, c: x / c),
    "Div of a constant": Use([node("Div", ["c", "x"], ["y"])], lambda x, z, c: c / x),
    "Max": Use([node("Max", ["x", "c"], ["y"])], lambda x, z, c: max(x, c)),
    "Min": Use([node("Min", ["x", "c"], ["y"])], lambda x, z, c: min(x, c)),
    "Clip from below": Use(
        [node("Squeeze", ["c"], ["l"]), node("Clip", ["x", "l"], ["y"])], lambda x, z, c: max(x, c)
    ),
    "Clip from above": Use(
        [node("Squeeze", ["c"], ["l"]), node("Clip", ["x", "", "l"], ["y"])], lambda x, z, c: min(x, c)
    ),
    "Concat": Use(
        [node("Unsqueeze", ["c", "none"], ["r"]), node("Concat", ["r", "x"], ["y"], axis=1)],
        lambda x, z, c: c + 0 * x,
    ),
    "MatMul": Use(
        [node("Concat", ["c", "c"], ["p"], axis=0), node("Unsqueeze", ["p", "last"], ["w"]),
         node("MatMul", ["x", "w"], ["y"])],
        lambda x, z, c: x * c + z * c,
    ),
    "Gemm": Use(
        [node("Concat", ["c", "c"], ["p"], axis=0), node("Unsqueeze", ["p", "last"], ["w"]),
         node("Gemm", ["x", "w", "c"], ["y"])],
        lambda x, z, c: x * c + z * c + c,
    ),
    "PRelu": Use(
        [node("Neg", ["x"], ["m"]), node("PRelu", ["m", "c"], ["y"])],
        lambda x, z, c: -x * c if x > 0 else -x,
        ("float32",),
    ),
    "Conv": Use(
        [node("Unsqueeze", ["x", "none"], ["i"]), node("Reshape", ["c", "cube"], ["k"]),
         node("Conv", ["i", "k", "c"], ["o"]), node("Squeeze", ["o", "none"], ["y"])],
        lambda x, z, c: x * c + c,
        ("float32",),
    ),
    "BatchNormalization": Use(
        [node("Concat", ["c", "c"], ["p"], axis=0),
         node("BatchNormalization", ["x", "one", "p", "p", "one"], ["y"], epsilon=0.0)],
        lambda x, z, c: (x - c) + c,
        ("float32",),
    ),
    "InstanceNormalization": Use(
        [node("Unsqueeze", ["x", "none"], ["i"]),
         node("InstanceNormalization", ["i", "c", "c"], ["o"], epsilon=0.25), node("Squeeze", ["o", "none"], ["y"])],
        lambda x, z, c: (x - z) / 2 / root((x - z) ** 2 / 4 + type(x)(0.25)) * c + c,
        ("float32",),
    ),
}  # fmt: skip
FIRST = {"float16": 1024.0, "float32": 2.0**20, "float64": 2.0**40}
SECOND = 0.3


CANCELLING = ("what is left of a sum", "moved", "a sum of three")
RELATIVE = ("Div", "BatchNormalization")
"""What takes no constant that may be off by more than a share of itself, as that it may vanish."""


def exactly(number: float) -> Fraction:
    return Fraction(float(number))


def largest_escape(chain: Chain, use: Use, kind: str, folder: Path) -> float:
    """Return how far an exact value or a program leaves the bounds of its arithmetic, around two observations."""
    a, b = np.array([FIRST[kind]], dtype=kind), np.array([SECOND], dtype=kind)
    constants = {
        "a": a, "b": b, "none": np.array([0]), "last": np.array([1]), "cube": np.array([1, 1, 1]),
        "first": np.array([0]), "second": np.array([1]), "one": np.ones(2, dtype=kind),
    }  # fmt: skip
    nodes = [*chain.nodes, *use.nodes]
    read = {name for call in nodes for name in call.input}
    arrays = {name: array for name, array in constants.items() if name in read}
    path = save(model_of(nodes, arrays, shape=(1, 2), dtype=TYPES[kind], opset=15), folder)
    loaded = Bare(load_policy(path, self_check=False).network)  # without what onnxruntime folded itself
    worst = 0.0
    for centre in (np.array([[0.75, 0.25]]), np.array([[0.0625, -2.0]])):
        points = (centre + 0.01 * np.linspace(-0.99, 0.99, 9)[:, None]).astype(kind)
        points = points[(np.abs(points.astype(np.float64) - centre) <= 0.01).all(axis=1)]
        deployed, real = (
            reach(loaded, centre, 0.01, arithmetic=arithmetic) for arithmetic in ("float32", "real")
        )
        value = chain.value(exactly(a[0]), exactly(b[0]))
        for x, z in points:
            action = use.action(exactly(x), exactly(z), value)
            excess = max(action - exactly(real.upper[0, 0]), exactly(real.lower[0, 0]) - action)
            worst = max(worst, float(excess))
        rounded = chain.value(a, b)[0]
        strict = [float(use.action(x, z, rounded)) for x, z in points]
        values = np.concatenate([programs(path, points, kind).ravel(), strict])
        values = values[np.isfinite(values)]  # a strict program divides by a constant that vanished
        worst = max(worst, (values - deployed.upper[0, 0]).max(), (deployed.lower[0, 0] - values).max())
    return worst


@pytest.mark.parametrize(
    ("chain", "use", "kind"), [(c, u, k) for c in CHAINS for u in USES for k in USES[u].kinds]
)
def test_every_program_and_the_exact_value_keep_to_the_bounds(
    chain: str, use: str, kind: str, tmp_path: Path
) -> None:
    if use in RELATIVE and chain in CANCELLING and kind != "float64":
        with pytest.raises(PolicyError, match="no bound"):
            largest_escape(CHAINS[chain], USES[use], kind, tmp_path)
        return
    assert largest_escape(CHAINS[chain], USES[use], kind, tmp_path) <= 0


@pytest.mark.parametrize("use", [use for use in USES if use not in RELATIVE])
def test_a_use_that_does_not_count_the_roundings_of_its_constant_is_found_out(
    use: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def uncounted(constant: Any, meaning: str) -> Counted:
        numbers = registry.counted(constant, meaning)
        return Counted(numbers.values, np.abs(numbers.values))

    for module in (convolution, elementwise, linear, matrix, normalisation, shape):
        monkeypatch.setattr(module, "counted", uncounted)
    kind = USES[use].kinds[0]
    assert largest_escape(CHAINS["what is left of a sum"], USES[use], kind, tmp_path) > 0


def test_a_constant_counts_what_it_was_before_it_cancelled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def cancelled(constant: Any, meaning: str) -> Counted:
        numbers = registry.counted(constant, meaning)
        return Counted(numbers.values, np.abs(numbers.values), numbers.roundings)

    monkeypatch.setattr(linear, "counted", cancelled)
    assert largest_escape(CHAINS["what is left of a sum"], USES["Add"], "float32", tmp_path) > 0


@pytest.mark.parametrize("rows", [2, 3])
def test_a_transposed_weight_keeps_the_magnitude_of_each_element(tmp_path: Path, rows: int) -> None:
    """What was added up before it cancelled is turned along with the element that it belongs to."""
    large = np.zeros((rows, 2), dtype=np.float32)
    large[0, 1] = 1e4
    small = weights(1, rows, 2)
    chain = [node("Add", ["a", "b"], ["s"]), node("Sub", ["s", "a"], ["w"])]
    deviations = []
    for transposed in (False, True):
        stored = {"a": large, "b": small} if transposed else {"a": large.T, "b": small.T}
        model = model_of(
            [*chain, node("Gemm", ["x", "w"], ["y"], transB=int(transposed))], stored, shape=(1, 2)
        )
        policy = load_policy(save(model, tmp_path))
        deviations.append(reach(policy, [[1.0, 0.5]], 0.01, refine="none").deviation)
    np.testing.assert_allclose(deviations[1], deviations[0], rtol=1e-9)
    assert deviations[0][0, 0] > 20 * deviations[0][0, 1]
