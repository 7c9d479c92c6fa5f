"""Graphs with several inputs: the observation is their numbers, one input after another, in a known order."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from click.testing import CliRunner
from onnx import TensorProto, helper

from tests.policy.enclosure import escapes
from tests.policy.models import model_of, node, save, weights
from viatool.cli import main
from viatool.errors import PolicyError
from viatool.policy import describe, load_policy, load_specification
from viatool.proposals import specification_text

SIZES = {"scan": (1, 3, 16), "goal": (1, 2), "speed": (1, 2)}


def several(
    order: tuple[str, ...] = ("scan", "goal", "speed"),
    batch: int | str = 1,
    types: dict[str, int] | None = None,
) -> onnx.ModelProto:
    """A convolution over the scans, and goal and speed, scaled, beside what it gives."""
    nodes = [
        node("Div", ["scan", "range"], ["shares"]),
        node("Sub", ["shares", "half"], ["centred"]),
        node("Conv", ["centred", "k", "kb"], ["c"], strides=[2]),
        node("Relu", ["c"], ["r"]),
        node("Flatten", ["r"], ["f"]),
        node("Mul", ["speed", "quarter"], ["s"]),
        node("Concat", ["f", "goal", "s"], ["all"], axis=1),
        node("Gemm", ["all", "w", "b"], ["g"]),
        node("Tanh", ["g"], ["y"]),
    ]
    constants: dict[str, Any] = {
        "range": np.float32(6), "half": np.float32(0.5), "quarter": np.float32(0.25),
        "k": weights(1, 4, 3, 5, scale=0.5), "kb": weights(2, 4), "w": weights(3, 28, 2, scale=0.3), "b": weights(4, 2),
    }  # fmt: skip
    model = model_of(nodes, constants)
    del model.graph.input[:]
    for name in order:
        kind = (types or {}).get(name, TensorProto.FLOAT)
        shape = [batch, *SIZES[name][1:]]
        model.graph.input.append(helper.make_tensor_value_info(name, kind, shape))
    return model


def described(folder: Path, text: str = "input: [scan, goal, speed]", goal: str = "") -> Path:
    path = folder / "policy.yaml"
    path.write_text(
        f"""schema_version: 2
{text}
observation:
  - {{name: lidar, kind: lidar, lidar: {{field_of_view: 3.14, rays: 16, maximum_range: 6}},
     frames: {{count: 3}}}}
  - {{name: x, kind: goal_x{goal}}}
  - {{name: y, kind: goal_y}}
  - {{name: v, kind: linear_velocity}}
  - {{name: turn, kind: angular_velocity}}
action:
  - {{name: linear, kind: linear, lower: -1, upper: 1}}
  - {{name: angular, kind: angular, lower: -1, upper: 1}}
"""
    )
    return path


def expected(rows: np.ndarray[Any, Any], order: tuple[str, ...]) -> np.ndarray[Any, Any]:
    import onnxruntime

    session = onnxruntime.InferenceSession(several(order).SerializeToString())
    results, start = [], 0
    for row in rows.astype(np.float32):
        feed, start = {}, 0
        for name in order:
            size = int(np.prod(SIZES[name]))
            feed[name] = row[start : start + size].reshape(SIZES[name])
            start += size
        results.append(session.run(None, feed)[0][0])
    return np.array(results)


@pytest.mark.parametrize("order", [("scan", "goal", "speed"), ("speed", "scan", "goal")])
@pytest.mark.parametrize("batch", [1, "n"])
def test_inputs_are_joined_in_the_order_of_the_graph(
    order: tuple[str, ...], batch: int | str, tmp_path: Path
) -> None:
    policy = load_policy(save(several(order, batch), tmp_path))
    assert policy.input_size == 52
    assert policy.ports.names == order
    rows = np.random.default_rng(0).uniform(0, 6, (40, 52))
    np.testing.assert_array_equal(policy.run(rows[:1]), expected(rows[:1], order))
    np.testing.assert_allclose(policy.run(rows), expected(rows, order), atol=1e-6)
    np.testing.assert_allclose(policy(rows), expected(rows, order), atol=1e-5)
    assert policy.runtime.batches
    assert escapes(policy, samples=4000) == 0


def test_a_specification_names_another_order_of_the_inputs(tmp_path: Path) -> None:
    policy = load_policy(save(several(("speed", "goal", "scan")), tmp_path), described(tmp_path))
    rows = np.random.default_rng(0).uniform(0, 6, (5, 52))
    np.testing.assert_allclose(policy.run(rows), expected(rows, ("scan", "goal", "speed")), atol=1e-6)
    named = load_policy(save(several(), tmp_path), input_name=("speed", "goal", "scan"))
    np.testing.assert_allclose(named.run(rows), expected(rows, ("speed", "goal", "scan")), atol=1e-6)


def test_an_input_may_hold_constants(tmp_path: Path) -> None:
    policy = load_policy(save(several(), tmp_path), described(tmp_path, goal=", value: 2.5"))
    assert policy.spec is not None
    np.testing.assert_array_equal(np.flatnonzero(~np.isnan(policy.spec.fixed_values())), [48])
    assert policy.spec.radii(0.1)[48] == 0.0


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", r"scan 48, goal 2, speed 2.*does not say in which order"),
        (
            "input: [scan, goal]",
            "depends on the inputs scan, goal, speed, and those that are named are scan, goal",
        ),
        ("input: scan", "depends on the inputs scan, goal, speed"),
        ("input: [scan, goal, velocity]", "no input 'velocity'"),
        ("input: [goal, scan, speed]", "'lidar' goes on where the input 'scan' begins"),
        ("input: [scan, goal, goal]", "input 'goal' is given twice"),
        ("input: [scan, goal, speed]\nframes: {count: 2}", "frames are given for everything and for lidar"),
    ],
)
def test_inputs_that_do_not_fit_are_named_with_their_sizes(text: str, words: str, tmp_path: Path) -> None:
    with pytest.raises(PolicyError, match=words):
        load_policy(save(several(), tmp_path), described(tmp_path, text))


def test_channels_that_do_not_add_up_are_named_beside_the_inputs(tmp_path: Path) -> None:
    spec = described(tmp_path)
    spec.write_text(spec.read_text().replace("count: 3", "count: 2"))
    words = r"\(scan 48, goal 2, speed 2\), 52 numbers together, its specification describes 36 \(lidar 32, x 1, y 1"
    with pytest.raises(PolicyError, match=words):
        load_policy(save(several(), tmp_path), spec)


def test_several_inputs_need_version_2(tmp_path: Path) -> None:
    spec = described(tmp_path)
    spec.write_text(
        "input: [a, b]\nobservation: [{name: a, size: 2}]\naction: [{name: v, lower: 0, upper: 1}]\n"
    )
    with pytest.raises(PolicyError, match="input: this needs `schema_version: 2`"):
        load_specification(spec)


def test_inputs_of_several_element_types_are_refused_by_name(tmp_path: Path) -> None:
    model = model_of([node("Cast", ["z"], ["f"], to=TensorProto.FLOAT), node("Add", ["x", "f"], ["y"])])
    model.graph.input.append(helper.make_tensor_value_info("z", TensorProto.DOUBLE, [1, 4]))
    with pytest.raises(PolicyError, match="x float32, z float64"):
        load_policy(save(model, tmp_path))


def test_inspect_tells_the_order_and_what_each_input_passes(tmp_path: Path) -> None:
    path = save(several(), tmp_path)
    found = describe(path)
    assert found.verifiable
    assert found.maps is not None
    assert found.maps.before == (
        "inside the model: scan: 0.166667 * value + -0.5; goal: nothing; speed: 0.25 * value"
    )
    template = tmp_path / "template.yaml"
    template.write_text(specification_text(found))
    assert load_policy(path, template).ports.names == ("scan", "goal", "speed")
    shown = " ".join(CliRunner().invoke(main, ["inspect", str(path)]).output.split())
    assert "0 to 47 of the observation, joined in the graph's order" in shown
    assert "50 to 51 of the observation, joined in the graph's order" in shown
    told = CliRunner().invoke(main, ["inspect", str(path), "--spec", str(described(tmp_path))]).output
    assert "0 to 47 of the observation" in told
    assert "in the graph's order" not in " ".join(told.split())
