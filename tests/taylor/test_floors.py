"""What no program is below: sums of squares in any arithmetic, so that normalisations by them stay defined."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from onnx import NodeProto

from tests.policy.enclosure import escapes
from tests.policy.models import model_of, node, save, weights
from viatool.policy import load_policy
from viatool.policy.activations import activation
from viatool.policy.network import Activation, Affine, Cast, Input, Maximum, Minimum, Node, Product
from viatool.taylor import reach
from viatool.taylor.rounding import floor_of

RMS = [
    node("Mul", ["h", "h"], ["q"]),
    node("ReduceMean", ["q"], ["m"], axes=[1], keepdims=1),
    node("Add", ["m", "tiny"], ["v"]),
    node("Sqrt", ["v"], ["r"]),
    node("Div", ["h", "r"], ["n"]),
]
NORMALISED: dict[str, tuple[list[NodeProto], int]] = {
    "spelled out": (RMS, 17),
    "RMSNormalization": ([node("RMSNormalization", ["h", "s"], ["n"], axis=-1, epsilon=1e-6)], 23),
}


@pytest.mark.parametrize(("nodes", "opset"), NORMALISED.values(), ids=NORMALISED)
@pytest.mark.parametrize("eps", [1.0, 100.0])
def test_a_root_mean_square_is_bounded_also_where_rounding_is_as_large_as_itself(
    nodes: list[NodeProto], opset: int, eps: float, tmp_path: Path
) -> None:
    layers = [
        node("MatMul", ["x", "w"], ["h"]),
        *nodes,
        node("MatMul", ["n", "u"], ["o"]),
        node("Tanh", ["o"], ["y"]),
    ]
    constants = {
        "w": weights(1, 4, 6),
        "u": weights(2, 6, 2),
        "tiny": np.float32(1e-6),
        "s": np.ones(6, np.float32),
    }
    read = {name for call in layers for name in call.input}
    model = model_of(layers, {name: v for name, v in constants.items() if name in read}, opset=opset)
    policy = load_policy(save(model, tmp_path))
    sets = reach(policy, np.zeros((1, 4)), eps)
    near_zero = np.random.default_rng(0).normal(size=(200, 4)) * np.logspace(-30, 0, 200)[:, None] * eps / 6
    for level in ("none", "default"):
        actions = policy.runtime.at(level).rows(near_zero)
        assert (actions >= sets.lower).all()
        assert (actions <= sets.upper).all()
    assert escapes(policy, samples=2000, eps=eps) == 0


def floors(*nodes: Node) -> list[np.ndarray]:
    found: list[np.ndarray] = []
    for entry in nodes:
        found.append(floor_of(entry, entry.precision, found))
    return found


SQUARE = activation("Pow", exponent=2.0)
MEAN = Affine((1,), (np.full((1, 5), 0.2),), np.array([1e-3]), "float16", 1)


def test_sums_of_squares_in_float16_are_never_below_their_floor() -> None:
    """In any order of summation, multiplied or divided, with whatever is flushed to zero."""
    last = floors(Input(5, "float16"), Activation(0, SQUARE, 5, "float16"), MEAN)[-1]
    generator = np.random.default_rng(0)
    half = np.float16
    stored = half(1e-3 * (1 - 2.0**-11))  # the constant may be rounded, too
    for _ in range(3000):
        terms = [half(x) * half(x) for x in generator.normal(size=5) * 10.0 ** generator.uniform(-6, 2)]
        terms = [half(0) if value < 2.0**-14 else value for value in terms]
        shares = (
            [value * half(0.2) for value in terms]
            if generator.random() < 0.5
            else [v / half(5) for v in terms]
        )
        total = half(0)
        for value in generator.permutation(np.array([*shares, stored], dtype=half)):
            total = half(total + value)
        assert float(total) >= last[0]
    assert last[0] > 0.99e-3


NOTHING = {
    "an observation": [],
    "an odd power": [Activation(0, activation("Pow", exponent=3.0), 5)],
    "a negative weight": [
        Activation(0, SQUARE, 5),
        Affine((1,), (np.diag([1.0, 1.0, 1.0, 1.0, -1.0]),), np.ones(5)),
    ],
    "a negative constant": [Activation(0, SQUARE, 5), Affine((1,), (np.eye(5),), np.full(5, -1e-9))],
    "what may be added up otherwise": [
        Activation(0, SQUARE, 5),
        Affine((1,), (np.eye(5),), np.ones(5), merged_weights=(2.0 * np.eye(5),)),
    ],
    "a product with an observation": [Activation(0, SQUARE, 5), Product(0, 1, 5)],
    "the smaller of a square and an observation": [Activation(0, SQUARE, 5), Minimum(0, 1, 5)],
}


@pytest.mark.parametrize("nodes", NOTHING.values(), ids=NOTHING)
def test_nothing_is_known_of_other_values(nodes: list[Node]) -> None:
    assert floors(Input(5), *nodes)[-1].min() == -np.inf


def test_what_keeps_a_floor() -> None:
    square = Activation(0, SQUARE, 5)
    above = Affine((1,), (np.eye(5),), np.full(5, 0.5))
    *_, halves = floors(Input(5), square, above, Cast(2, 5, "float16"))
    assert (halves <= 0.5).all()
    assert (halves > 0.49).all()
    assert (floors(Input(5), square, Maximum(0, 1, 5))[-1] == 0.0).all()
    assert (floors(Input(5), square, Product(1, 1, 5))[-1] == 0.0).all()
    tiny = replace(above, bias=np.full(5, 1e-40))  # which a program may take for zero
    assert (floors(Input(5), square, tiny)[-1] == 0.0).all()
