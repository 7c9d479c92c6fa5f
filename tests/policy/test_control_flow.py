"""Loops and branches within one observation: unrolled where constants decide, refused where the observation does."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper

from tests.policy.enclosure import escapes
from tests.policy.models import model_of, node, save, weights
from tests.policy.operator_cases import counting, told
from viatool.errors import PolicyError, SelfCheckError
from viatool.policy import load_policy
from viatool.policy.operators import control_flow

torch = pytest.importorskip("torch")

NUMBERS: dict[str, Any] = {
    "trip": np.array(4),
    "true": np.array(True),
    "w": weights(1, 4, 4, scale=0.4),
    "v": weights(2, 4, 2),
    "five": np.float32(5),
    "two": np.array(2),
    "step": np.array(0.1, np.float32),
    "end": np.array(1.0, np.float32),
}
TURN = [node("MatMul", ["h", "w"], ["m"]), node("Add", ["m", "x"], ["a"]), node("Tanh", ["a"], ["h2"])]


def looped(*nodes: onnx.NodeProto, count: str = "trip", go: str = "true") -> onnx.ModelProto:
    """A loop over a state of four numbers, and two actions of what it leaves."""
    body = counting(*(nodes or TURN), outputs=("h2",))
    call = node("Loop", [count, go, "x"], ["last"], body=body, name="repeat")
    return model_of([call, node("MatMul", ["last", "v"], ["y"])], NUMBERS)


def nested() -> list[onnx.NodeProto]:
    """A loop in a loop that reads states of both, and a branch by the number of the round."""
    deep = helper.make_graph(
        [node("Identity", ["go2"], ["on2"]), node("MatMul", ["k", "w"], ["km"]), node("Add", ["km", "h"], ["ka"]),
         node("Tanh", ["ka"], ["k2"])], "inner",
        [told("j", TensorProto.INT64, []), told("go2", TensorProto.BOOL, []), told("k")],
        [told("on2", TensorProto.BOOL), told("k2")],
    )  # fmt: skip
    branches = {
        f"{which}_branch": helper.make_graph([node(bend, ["in"], [which])], which, [], [told(which)])
        for which, bend in (("then", "Tanh"), ("else", "Relu"))
    }
    return [
        node("Loop", ["two", "true", "h"], ["in"], body=deep),
        node("Less", ["i", "two"], ["early"]),
        node("If", ["early"], ["bent"], **branches),
        node("Add", ["bent", "x"], ["h2"]),
    ]


@pytest.mark.parametrize("nodes", [TURN, nested()], ids=["one", "nested"])
def test_a_loop_of_fixed_length_is_bounded_as_onnxruntime_runs_it(
    nodes: list[onnx.NodeProto], tmp_path: Path
) -> None:
    policy = load_policy(save(looped(*nodes), tmp_path))
    rows = np.random.default_rng(0).normal(size=(30, 4)).astype(np.float32).astype(np.float64)
    np.testing.assert_allclose(policy(rows), policy.run(rows), atol=1e-5)
    assert escapes(policy, samples=4000) == 0


def test_a_round_less_is_found_by_the_self_check(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    count = control_flow._Run._count
    monkeypatch.setattr(control_flow._Run, "_count", lambda run, value: count(run, value) - 1)  # type: ignore[operator]
    with pytest.raises(SelfCheckError, match="disagree"):
        load_policy(save(looped(), tmp_path))


def test_a_loop_in_a_function_reads_the_values_of_its_call(tmp_path: Path) -> None:
    body = counting(*TURN, outputs=("h2",))
    inner = [
        node("Constant", [], ["n"], value=onnx.numpy_helper.from_array(np.array(3))),
        node("Constant", [], ["t"], value=onnx.numpy_helper.from_array(np.array(True))),
        node("Loop", ["n", "t", "x"], ["last"], body=body),
    ]
    opset = [helper.make_opsetid("", 17)]
    function = helper.make_function("own", "Turned", ["x", "w"], ["last"], inner, opset)
    calls = [node("Turned", ["x", "w"], ["p"], domain="own"), node("Turned", ["p", "w"], ["q"], domain="own")]
    model = model_of(
        [*calls, node("MatMul", ["q", "v"], ["y"])], NUMBERS, functions=[function], domains={"own": 1}
    )
    model.graph.initializer.append(helper.make_tensor("unused", TensorProto.FLOAT, [1], [0.0]))
    policy = load_policy(save(model, tmp_path))
    rows = np.random.default_rng(0).normal(size=(30, 4))
    expected = rows
    for _ in range(2):
        h = expected
        for _ in range(3):
            h = np.tanh(h @ NUMBERS["w"].astype(float) + expected)
        expected = h
    np.testing.assert_allclose(policy(rows), expected @ NUMBERS["v"].astype(float), atol=1e-12)
    assert escapes(policy, samples=2000) == 0


def test_a_loop_without_a_round_hands_its_state_on(tmp_path: Path) -> None:
    model = looped()
    model.graph.initializer[0].CopyFrom(onnx.numpy_helper.from_array(np.array(0), "trip"))
    rows = np.random.default_rng(0).normal(size=(3, 4))
    np.testing.assert_allclose(load_policy(save(model, tmp_path))(rows), rows @ NUMBERS["v"].astype(float))


def deciding(*nodes: onnx.NodeProto, made: str) -> onnx.ModelProto:
    """A loop that goes on as long as something holds."""
    model = looped(*TURN, *nodes)
    graph = model.graph.node[0].attribute[0].g
    graph.node.remove(graph.node[0])
    graph.output[0].name = made
    return model


def by_a_branch() -> onnx.ModelProto:
    branches = {
        f"{which}_branch": helper.make_graph([node(bend, ["x"], [which])], which, [], [told(which)])
        for which, bend in (("then", "Tanh"), ("else", "Relu"))
    }
    nodes = [node("ReduceSum", ["x"], ["s"], keepdims=0), node("Less", ["s", "five"], ["c"])]
    return model_of([*nodes, node("If", ["c"], ["y"], name="fork", **branches)], NUMBERS)


def counted_by_the_observation() -> onnx.ModelProto:
    model = looped(count="n")
    nodes = [node("ReduceSum", ["x"], ["s"], keepdims=0), node("Cast", ["s"], ["n"], to=TensorProto.INT64)]
    for index, call in enumerate(nodes):
        model.graph.node.insert(index, call)
    return model


@pytest.mark.parametrize(
    ("model", "message"),
    [
        (deciding(node("ReduceSum", ["h2"], ["s"], keepdims=0), node("Less", ["s", "five"], ["c"]), made="c"),
         r"node 'repeat' \(Loop\) is control flow: the observation decides how often it runs"),
        (counted_by_the_observation(), r"'s?n?' \(Cast\)|'repeat' \(Loop\) is control flow"),
        (by_a_branch(), r"node 'fork' \(If\) is control flow: the observation decides which branch it takes"),
        (looped(*TURN[:2], node("Sin", ["a"], ["h2"], name="wave")),
         r"node 'repeat' \(Loop\) holds the node 'repeat/round 0/wave' \(Sin\), which is a trigonometric function"),
        (looped(*TURN[:2], node("Tanh", ["lost"], ["h2"])), "nothing makes the value 'lost'"),
    ],
    ids=["a condition", "a count", "a branch", "an operator", "a name"],
)  # fmt: skip
def test_what_cannot_be_unrolled_is_refused_by_its_node(
    model: onnx.ModelProto, message: str, tmp_path: Path
) -> None:
    with pytest.raises(PolicyError, match=message) as refused:
        load_policy(save(model, tmp_path))
    assert refused.value.hint


def test_a_loop_that_rounding_may_end_a_round_earlier_is_refused(tmp_path: Path) -> None:
    """A float counter that programs may round otherwise does not decide how many rounds there are."""
    states = [
        told("i", TensorProto.INT64, []),
        told("go", TensorProto.BOOL, []),
        told("h"),
        told("t", shape=[]),
    ]
    nodes = [*TURN, node("Add", ["t", "step"], ["t2"]), node("Less", ["t2", "end"], ["on"])]
    body = helper.make_graph(
        nodes, "body", states, [told("on", TensorProto.BOOL), told("h2"), told("t2", shape=[])]
    )
    call = node("Loop", ["", "true", "x", "step"], ["last", ""], body=body, name="repeat")
    with pytest.raises(PolicyError, match=r"'repeat' \(Loop\) holds the node .*\(Less\)"):
        load_policy(save(model_of([call, node("MatMul", ["last", "v"], ["y"])], NUMBERS), tmp_path))


def test_an_absurd_number_of_rounds_is_refused_soon(tmp_path: Path) -> None:
    model = looped()
    model.graph.initializer[0].CopyFrom(onnx.numpy_helper.from_array(np.array(2**60), "trip"))
    with pytest.raises(PolicyError, match=r"runs more than 20000 calls in all its rounds"):
        load_policy(save(model, tmp_path))


class Repeated(torch.nn.Module):
    """Layers through which a loop goes five times; without annotations, as scripting reads them."""

    def __init__(self):
        super().__init__()
        self.turn, self.out = torch.nn.Linear(4, 4), torch.nn.Linear(4, 2)

    def forward(self, x):
        h, rounds = x, 0
        while rounds < 5:
            h = torch.tanh(self.turn(h)) + x
            rounds += 1
        return torch.tanh(self.out(h))


def test_a_scripted_loop_of_torch_is_unrolled(tmp_path: Path) -> None:
    torch.manual_seed(0)
    module, path = Repeated().eval(), tmp_path / "policy.onnx"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        scripted = torch.jit.script(module)
        torch.onnx.export(scripted, (torch.zeros(1, 4),), str(path), dynamo=False, opset_version=17)
    assert "Loop" in [call.op_type for call in onnx.load(path).graph.node]
    policy = load_policy(path)
    rows = np.random.default_rng(0).normal(size=(20, 4))
    with torch.no_grad():
        expected = module(torch.tensor(rows, dtype=torch.float32)).numpy()
    np.testing.assert_allclose(policy(rows), expected, atol=1e-5)
    assert escapes(policy, samples=2000) == 0
