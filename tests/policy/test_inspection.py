"""What `inspect` can tell of a file, also of one that cannot be verified."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.policy.models import model_of, node, save, two_layers, weights
from viatool.errors import PolicyError
from viatool.policy import (
    ActionChannel,
    ActionMap,
    ObservationChannel,
    PolicySpecification,
    describe,
    load_policy,
    load_specification,
    specification_template,
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
    assert found.before.startswith("none")
    assert found.after.startswith("unknown")


def test_a_policy_that_cannot_be_read_names_everything(tmp_path: Path) -> None:
    nodes = [node("Sin", ["x"], ["s"], name="wave"), node("Round", ["s"], ["y"], name="steps")]
    found = describe(save(model_of(nodes), tmp_path))
    assert not found.verifiable
    assert [(f.node, f.operator) for f in found.findings] == [("wave", "Sin"), ("steps", "Round")]
    assert found.layers == ()
    assert found.port is not None


def test_problems_beside_the_nodes(tmp_path: Path) -> None:
    spec = PolicySpecification(
        observation=[ObservationChannel(name="x", size=3)], action=[ActionChannel(name="v", lower=0, upper=1)]
    )
    found = describe(save(two_layers(), tmp_path), spec)
    assert not found.verifiable
    assert "4 observations" in found.problems[0]
    several = describe(
        save(model_of([node("Relu", ["x"], ["y"]), node("Tanh", ["x"], ["z"])], outputs=("y", "z")), tmp_path)
    )
    assert "2 outputs" in several.problems[0]
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
    assert "in 2 steps" in found.before
    assert (
        found.after == "by the specification: (0.25) * output + (0.5), clipped to the limits of the actions"
    )
    assert [layer.kind for layer in found.layers][-1] == "Clip"


def test_the_template_is_a_specification(tmp_path: Path) -> None:
    path = save(two_layers(), tmp_path)
    sidecar = tmp_path / "robot.yaml"
    for source in (describe(path), load_policy(path)):
        sidecar.write_text(specification_template(source))
        spec = load_specification(sidecar)
        assert (spec.observation_size, spec.action_size) == (4, 2)
    assert load_policy(path, sidecar).spec == spec
    with pytest.raises(PolicyError, match="sizes"):
        specification_template(describe(save(model_of([node("Sin", ["x"], ["y"])]), tmp_path, "sin.onnx")))


def test_the_document_holds_everything(tmp_path: Path) -> None:
    document = json.loads(describe(save(two_layers(), tmp_path)).to_json())
    assert document["verifiable"] is True
    assert document["layers"][0] == {
        "kind": "affine", "size": 5, "precision": "float32", "sources": [0], "parameters": 25,
    }  # fmt: skip
    assert document["inputs"] == [{"name": "x", "dtype": "float", "shape": ["batch", 4]}]
    assert document["self_check"]["points"] > 50
    broken = json.loads(
        describe(save(model_of([node("Sin", ["x"], ["y"], name="wave")]), tmp_path)).to_json()
    )
    assert broken["findings"][0]["node"] == "wave"
    assert broken["verifiable"] is False
