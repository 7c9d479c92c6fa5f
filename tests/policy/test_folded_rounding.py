"""Constants that runtimes fold differently: the roundings they carry cover onnxruntime's value, and are counted."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
import pytest

from tests.policy.enclosure import escapes
from tests.policy.models import model_of, node, save, weights
from tests.policy.operator_cases import floats, ints, positive
from viatool.errors import PolicyError
from viatool.policy import load_policy
from viatool.policy.folding import fold
from viatool.policy.graph import live, read_graph
from viatool.policy.network import Affine
from viatool.policy.tensors import Constant

ELEMENTWISE = (
    "Abs", "Acos", "Asin", "Atan", "Celu", "Cos", "Cosh", "Elu", "Erf", "Exp", "HardSigmoid", "LogSoftmax", "Neg",
    "Reciprocal", "Selu", "Sigmoid", "Sin", "Sinh", "Softmax", "Softplus", "Softsign", "Tan", "Tanh",
)  # fmt: skip
OF_POSITIVE = ("Acosh", "Log", "Sqrt")
SUMS = ("ReduceSum", "ReduceMean", "ReduceSumSquare", "ReduceL1", "ReduceL2", "ReduceProd", "Mean", "Sum")
BINARY = ("Add", "Sub", "Mul", "Div")


def case(operator: str) -> tuple[onnx.NodeProto, dict[str, Any]]:
    generator = np.random.default_rng(4)
    small = generator.uniform(-1, 1, (3, 300)).astype(np.float32)
    if operator in OF_POSITIVE:
        return node(operator, ["a"], ["y"]), {"a": positive(3, 300) + np.float32(1)}
    if operator == "Pow":
        return node("Pow", ["a", "b"], ["y"]), {"a": positive(3, 300), "b": np.float32(1.7)}
    if operator == "MatMul":
        return node("MatMul", ["a", "b"], ["y"]), {"a": small, "b": weights(3, 300, 5)}
    if operator == "CumSum":
        return node("CumSum", ["a", "axis"], ["y"]), {"a": small[0], "axis": np.int64(0)}
    if operator == "ReduceProd":
        return node(operator, ["a"], ["y"]), {"a": positive(2, 4)}
    if operator in BINARY:
        return node(operator, ["a", "b"], ["y"]), {"a": small, "b": weights(3, 300)}
    return node(operator, ["a"], ["y"]), {"a": small}


@pytest.mark.parametrize("operator", [*ELEMENTWISE, *OF_POSITIVE, *SUMS, *BINARY, "Pow", "MatMul", "CumSum"])
def test_the_roundings_of_a_folded_constant_cover_what_onnxruntime_makes_of_it(operator: str) -> None:
    call, constants = case(operator)
    model = model_of([call], constants, opset=18)
    del model.graph.input[:]
    expected = onnxruntime.InferenceSession(model.SerializeToString()).run(None, {})[0].astype(np.float64)

    (graph_node,) = live(read_graph(model, Path()), "y").nodes
    inputs = [
        Constant(np.asarray(constants[name]), str(np.asarray(constants[name]).dtype)) for name in call.input
    ]
    attributes = {"axis": -1} if operator in ("Softmax", "LogSoftmax") else dict(graph_node.attributes)
    (found,) = fold(graph_node, inputs, attributes)

    difference = np.abs(found.array.astype(np.float64) - expected)
    magnitude = np.abs(expected) if found.magnitude is None else found.magnitude
    assert (difference <= found.roundings * 2.0**-24 * magnitude).all()
    assert (found.roundings == 0) == (operator in ("Abs", "Neg"))


@pytest.mark.parametrize("operator", ["Softmax", "LogSoftmax", "Hardmax"])
@pytest.mark.parametrize("axis", [0, 1, 2, -1, -2])
def test_old_operators_take_a_constant_as_a_matrix_like_onnxruntime(operator: str, axis: int) -> None:
    constant = weights(4, 2, 3, 4)
    model = model_of([node(operator, ["a"], ["y"], axis=axis)], {"a": constant}, opset=11)
    del model.graph.input[:]
    expected = onnxruntime.InferenceSession(model.SerializeToString()).run(None, {})[0]
    (graph_node,) = live(read_graph(model, Path()), "y").nodes
    (found,) = fold(graph_node, [Constant(constant, "float32")], {"axis": axis})
    np.testing.assert_allclose(found.array, expected, rtol=1e-5)


def test_a_constant_that_runtimes_fold_differently_is_counted(tmp_path: Path) -> None:
    nodes = [node("Softmax", ["c"], ["s"]), node("Mul", ["s", "two"], ["t"]), node("Add", ["x", "t"], ["y"])]
    policy = load_policy(save(model_of(nodes, {"c": weights(1, 4), "two": np.float32(2)}), tmp_path))
    (affine,) = (part for part in policy.network.nodes if isinstance(part, Affine))
    assert affine.roundings > 64
    assert escapes(policy, samples=2000) == 0


def test_roundings_add_up_and_cancellation_is_seen() -> None:
    graph = read_graph(model_of([node("Sub", ["a", "b"], ["y"])]), Path())
    (call,) = graph.nodes
    a, b = Constant(floats(1.0), "float32", 3), Constant(floats(0.5), "float32", 5)
    (difference,) = fold(call, [a, b], {})
    assert difference.magnitude is not None
    assert difference.roundings * difference.magnitude >= 3 * 1.0 + 5 * 0.5
    (nothing,) = fold(call, [a, replace(a, array=floats(1.0))], {})
    assert nothing.magnitude is not None
    assert nothing.array == 0
    assert nothing.roundings * nothing.magnitude >= 6


@pytest.mark.parametrize(
    ("nodes", "constants"),
    [
        ([node("Exp", ["c"], ["e"]), node("Pow", ["x", "e"], ["y"])], {"c": np.float32(0.3)}),
        (
            [node("Exp", ["c"], ["e"]), node("Greater", ["e", "z"], ["g"]), node("Where", ["g", "x", "e"], ["y"])],
            {"c": weights(1, 1, 4), "z": np.float32(1)},
        ),
        (
            [node("Exp", ["c"], ["e"]), node("Floor", ["e"], ["f"]), node("Add", ["x", "f"], ["y"])],
            {"c": np.zeros((1, 4), dtype=np.float32)},
        ),
    ],
)  # fmt: skip
def test_whoever_cannot_count_them_refuses(
    nodes: list[onnx.NodeProto], constants: dict[str, Any], tmp_path: Path
) -> None:
    with pytest.raises(PolicyError, match="compute differently") as refusal:
        load_policy(save(model_of(nodes, constants), tmp_path))
    assert "fold constants" in refusal.value.hint


def test_moved_constants_keep_their_roundings(tmp_path: Path) -> None:
    nodes = [
        node("Exp", ["c"], ["e"]),
        node("Reshape", ["e", "shape"], ["r"]),
        node("Transpose", ["r"], ["w"]),
        node("MatMul", ["x", "w"], ["y"]),
    ]
    constants = {"c": weights(1, 8), "shape": ints(2, 4)}
    policy = load_policy(save(model_of(nodes, constants), tmp_path))
    (affine,) = (part for part in policy.network.nodes if isinstance(part, Affine))
    assert affine.roundings >= 64
    assert escapes(policy, samples=2000) == 0
