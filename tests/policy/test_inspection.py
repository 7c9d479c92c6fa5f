"""What `inspect` can tell of a file, also of one that cannot be verified."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from onnx import helper

from tests.policy.models import model_of, node, save, two_layers, weights
from viatool.errors import PolicyError
from viatool.policy import (
    ActionChannel,
    ActionMap,
    ObservationChannel,
    PolicySpecification,
    describe,
    load_policy,
)


def test_a_policy_that_can_be_verified(tmp_path: Path) -> None:
    model = two_layers()
    model.producer_name, model.producer_version = "someone", "1.2"
    found = describe(save(model, tmp_path))

    assert found.verifiable
    assert (found.opset, found.producer) == (17, "someone 1.2")
    assert [(v.name, v.dtype, v.shape) for v in found.inputs] == [("x", "float", ("batch", 4))]
    assert [v.name for v in found.outputs] == ["y"]
    assert found.operators == {"Gemm": 2, "Relu": 1, "Tanh": 1}
    assert [(layer.kind, layer.size) for layer in found.layers] == [
        ("affine", 5),
        ("Relu", 5),
        ("affine", 2),
        ("Tanh", 2),
    ]
    assert [layer.parameters for layer in found.layers] == [25, 0, 12, 0]
    assert found.activations == {"Relu": 5, "Tanh": 2}
    assert found.maps is not None
    assert found.maps.before.startswith("nothing")
    assert found.maps.after.startswith(
        "inside the model: Tanh; what the robot makes of the output is not known"
    )
    assert found.failure is None


def test_a_policy_that_cannot_be_read_names_everything(tmp_path: Path) -> None:
    nodes = [node("Sin", ["x"], ["s"], name="wave"), node("Round", ["s"], ["y"], name="steps")]
    found = describe(save(model_of(nodes), tmp_path))
    assert not found.verifiable
    assert [(f.node, f.operator) for f in found.findings] == [("wave", "Sin"), ("steps", "Round")]
    assert found.layers == ()
    assert found.ports is not None


def test_problems_beside_the_nodes(tmp_path: Path) -> None:
    spec = PolicySpecification(
        observation=[ObservationChannel(name="x", size=3)], action=[ActionChannel(name="v", lower=0, upper=1)]
    )
    found = describe(save(two_layers(), tmp_path), spec)
    assert not found.verifiable
    assert "4 observations" in found.problems[0].message
    several = describe(
        save(model_of([node("Relu", ["x"], ["y"]), node("Tanh", ["x"], ["z"])], outputs=("y", "z")), tmp_path)
    )
    assert "2 outputs" in several.problems[0].message
    assert [value.depends_on for value in several.outputs] == [("x",), ("x",)]
    with pytest.raises(PolicyError):
        describe(tmp_path / "missing.onnx")


def test_the_maps_before_and_after_the_network(tmp_path: Path) -> None:
    nodes = [
        node("Sub", ["x", "m"], ["c"]),
        node("Div", ["c", "s"], ["n"]),
        node("Gemm", ["n", "w"], ["y"], transB=1),
    ]
    constants = {"m": weights(1, 4), "s": np.full(4, 2, np.float32), "w": weights(2, 1, 4)}
    spec = PolicySpecification(
        observation=[ObservationChannel(name="x", size=4)],
        action=[ActionChannel(name="v", lower=0, upper=1)],
        action_map=ActionMap(scale=[0.25], offset=[0.5], clip=True),
    )
    found = describe(save(model_of(nodes, constants), tmp_path), spec)
    assert found.maps is not None
    assert re.fullmatch(r"inside the model: 0\.5 \* value \+ \(.*\)", found.maps.before)
    assert found.maps.after == "by the specification: command = 0.25 * output + 0.5, clipped to [0, 1]"
    assert [layer.kind for layer in found.layers][-1] == "Clip"


def test_a_chain_of_maps_is_one_sentence(tmp_path: Path) -> None:
    nodes = [
        node("Sub", ["x", "m"], ["c"]),
        node("Mul", ["c", "s"], ["n"]),
        node("Clip", ["n", "low", "high"], ["k"]),
        node("Gemm", ["k", "w"], ["g"], transB=1),
        node("Tanh", ["g"], ["t"]),
        node("Mul", ["t", "s"], ["y"]),
    ]
    constants = {
        "m": np.full(4, 3, np.float32), "s": np.float32(2), "w": weights(2, 1, 4),
        "low": np.float32(-5), "high": np.float32(5),
    }  # fmt: skip
    maps = load_policy(save(model_of(nodes, constants), tmp_path)).maps
    assert maps.before == "inside the model: 2 * value + -6, then clipped to [-5, 5]"
    assert maps.after.startswith("inside the model: Tanh, then 2 * value;")


def test_a_value_that_is_also_read_raw_is_not_called_normalised(tmp_path: Path) -> None:
    nodes = [node("Mul", ["x", "s"], ["n"]), node("Tanh", ["n"], ["t"]), node("Sub", ["t", "x"], ["y"])]
    policy = load_policy(save(model_of(nodes, {"s": np.float32(2)}), tmp_path))
    assert policy.maps.before.startswith("nothing")


def test_everything_that_prevents_verification_is_one_error(tmp_path: Path) -> None:
    model = model_of([node("Sin", ["x"], ["y"], name="wave")])
    helper.set_model_props(model, {"viatool.spec": "{}"})
    failure = describe(save(model, tmp_path)).failure
    assert isinstance(failure, PolicyError)
    assert "wave" in failure.message
    assert "viatool.spec" in failure.message


def test_the_document_holds_everything(tmp_path: Path) -> None:
    document = json.loads(describe(save(two_layers(), tmp_path)).to_json())
    assert document["verifiable"] is True
    assert document["layers"][0] == {
        "kind": "affine", "size": 5, "precision": "float32", "sources": [0], "parameters": 25,
    }  # fmt: skip
    assert document["inputs"] == [{"name": "x", "dtype": "float", "shape": ["batch", 4], "depends_on": []}]
    assert document["maps"].keys() == {"before", "after"}
    assert document["self_check"]["points"] > 50
    broken = json.loads(
        describe(save(model_of([node("Sin", ["x"], ["y"], name="wave")]), tmp_path)).to_json()
    )
    assert broken["findings"][0]["node"] == "wave"
    assert broken["verifiable"] is False
