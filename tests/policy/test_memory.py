"""Memory over time: inputs of the graph that take what an output gave in the step before."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from tests.policy.enclosure import escapes
from tests.policy.models import save
from tests.remembering import HIDDEN, SENSED, Deployed, described, recurrent, specification, written
from viatool.cli import main
from viatool.errors import PolicyError
from viatool.policy import load_policy
from viatool.policy.memory import CarriedMemory
from viatool.setting.sensor_errors import SensorErrors
from viatool.taylor import reach


@pytest.mark.parametrize("kind", ["GRU", "LSTM", "RNN"])
@pytest.mark.parametrize("batch", [1, "n"])
def test_a_policy_remembers_as_onnxruntime_does(kind: str, batch: int | str, tmp_path: Path) -> None:
    policy = load_policy(*written(tmp_path, kind, batch=batch))
    size = 2 * HIDDEN if kind == "LSTM" else HIDDEN
    assert policy.input_size == SENSED + size
    assert policy.output_size == 2
    assert policy.spec is not None
    deployed = Deployed(policy.path, dict(policy.spec.memory))
    rows = np.random.default_rng(0).normal(size=(4, SENSED + size)).astype(np.float32).astype(np.float64)
    for row, made in zip(rows, policy.remember(rows), strict=True):
        deployed.remember(row[SENSED:])
        action = deployed.step(row[:SENSED])
        np.testing.assert_array_equal(made, deployed.numbers)
        expected = np.clip(action * [0.25, 1] + [0.25, 0], [0, -1], [0.5, 1])
        np.testing.assert_allclose(policy(row[None])[0], expected, atol=1e-6)
    assert policy.remember(rows[:0]).shape == (0, size)
    every_input_errs = load_policy(policy.path, output_name="action")
    assert escapes(every_input_errs, samples=2000) == 0


def test_the_memory_is_known_exactly_unless_it_is_named(tmp_path: Path) -> None:
    policy = load_policy(*written(tmp_path))
    assert policy.spec is not None
    np.testing.assert_array_equal(policy.spec.radii(0.1)[SENSED:], 0.0)
    np.testing.assert_array_equal(policy.spec.radii({"": 0.1, "h": 0.2})[SENSED:], 0.2)
    lines = "{name: h, kind: memory, eps: 0.05}"
    told = load_policy(*written(tmp_path, channels=lines)).spec
    assert told is not None
    assert SensorErrors.of(told, 0.1).to_json() == {"": 0.1, "h": 0.05}
    assert SensorErrors.of(policy.spec, 0.1).to_json() == 0.1
    premise = {one.name: one for one in SensorErrors.of(policy.spec, 0.1).premises()}["eps of h"]
    assert (premise.value, premise.source) == ("0", "memory of the policy, as it was in each state")
    rows = np.random.default_rng(0).normal(size=(3, SENSED + HIDDEN))
    exact, wide = (reach(policy, rows, policy.spec.radii({"": 0.0, "h": eps})) for eps in (0.0, 0.1))
    assert (wide.upper - wide.lower > 10.0 * (exact.upper - exact.lower)).all()


def test_a_memory_begins_with_what_its_channel_says(tmp_path: Path) -> None:
    numbers = ", ".join(str(0.1 * k) for k in range(HIDDEN))
    for told, expected in (
        ("", np.zeros(HIDDEN)),
        ("{name: h, kind: memory, initial: 0.5}", np.full(HIDDEN, 0.5)),
        (f"{{name: h, kind: memory, initial: [{numbers}]}}", 0.1 * np.arange(HIDDEN)),
        (f"{{name: h, kind: memory, size: {HIDDEN}, initial: -1}}", np.full(HIDDEN, -1.0)),
    ):
        policy = load_policy(*written(tmp_path, channels=told))
        assert policy.spec is not None
        np.testing.assert_allclose(policy.spec.initial_memory, expected)
        carried = CarriedMemory(policy.spec, 2)
        np.testing.assert_allclose(carried.beside(np.ones((2, SENSED)))[:, SENSED:], [expected, expected])


def test_a_robot_that_begins_anew_forgets_and_the_others_do_not(tmp_path: Path) -> None:
    policy = load_policy(*written(tmp_path))
    assert policy.spec is not None
    carried, sensed = CarriedMemory(policy.spec, 3), np.ones((3, SENSED))
    carried.carry(policy, carried.beside(sensed))
    after = carried.beside(sensed)[:, SENSED:].copy()
    assert np.abs(after).min() > 0.0
    carried.begin(np.array([False, True, False]))
    now = carried.beside(sensed)[:, SENSED:]
    np.testing.assert_array_equal(now, after * [[1], [0], [1]])
    carried.keep(np.array([False, True, True]))
    np.testing.assert_array_equal(carried.beside(sensed[1:])[:, SENSED:], now[1:])


@pytest.mark.parametrize(
    ("memory", "channels", "message"),
    [
        ("{g: h_out}", "", "the model has no input 'g'"),
        ("{h: out}", "", "the model has no output 'out'"),
        ("{h: action}", "", "'action' is the action, and cannot be memory as well"),
        ("{h: h_out, c: h_out}", "", "the output 'h_out' is remembered twice"),
        ("{h: c_out, c: h_out}", "", None),  # of equal sizes, so it is believed
        ("{h: h_out}", "", "takes several inputs .*does not say in which order"),
        ("{h: h_out, c: c_out}", "{name: c, kind: other}", "'c' is of kind 'other', but `memory` says"),
        ("{h: h_out, c: c_out}", "{name: g, kind: memory}", "'g' is of kind 'memory', but `memory` names no such"),
        ("{h: h_out, c: c_out}", "{name: h, kind: memory, size: 5}", "takes 6 numbers, the channel .* has 5"),
        ("{h: h_out, c: c_out}", "{name: h, kind: memory, initial: [1, 2]}", "takes 6 numbers, the channel"),
        ("{h: h_out, c: c_out}", "{name: h, kind: memory, size: 3, initial: [1, 2]}", "size 3 and 2 initial"),
        ("{h: h_out, c: c_out}", "{name: h, kind: memory, value: 1.0}", "has `value`, but its numbers are taken as"),
        ("{h: h_out, c: c_out}", "{name: h, kind: memory, scale: 2.0}", "has `scale`, but its numbers are taken as"),
        ("{h: h_out, c: c_out}", "{name: c, kind: memory}\n{name: h, kind: memory}", "in the order of `memory`"),
        ("{h: h_out, c: c_out}", "{name: h, kind: memory}\n{name: x, kind: other}", "behind all others"),
        ("{h: h_out, c: c_out}", "{name: x, kind: goal_x, initial: 1.0}", "has `initial` numbers, which only"),
        ("{h: h_out, c: c_out}", "{name: x, kind: goal_x}", "takes several inputs"),
    ],
)  # fmt: skip
def test_contradictions_are_refused(memory: str, channels: str, message: str | None, tmp_path: Path) -> None:
    path = save(recurrent("LSTM"), tmp_path)
    if message is None:
        load_policy(path, specification(tmp_path, described(memory, channels)))
        return
    with pytest.raises(PolicyError, match=message):
        load_policy(path, specification(tmp_path, described(memory, channels) + "output: action\n"))


def test_an_output_that_gives_other_numbers_than_its_input_takes_is_refused(tmp_path: Path) -> None:
    import onnx
    from onnx import TensorProto, helper

    for operator, inputs, expected in (
        ("Concat", ["h_out", "h_out"], r"'h' takes 6 numbers of float32, and the output 'two' gives 12"),
        ("Cast", ["h_out"], "'two' gives 6 of float64"),
    ):
        model: Any = onnx.ModelProto()
        model.CopyFrom(recurrent())
        more: dict[str, int] = {"axis": 0} if operator == "Concat" else {"to": TensorProto.DOUBLE}
        model.graph.node.append(helper.make_node(operator, inputs, ["two"], **more))
        kind = TensorProto.FLOAT if operator == "Concat" else TensorProto.DOUBLE
        model.graph.output.append(helper.make_tensor_value_info("two", kind, None))
        with pytest.raises(PolicyError, match=expected):
            load_policy(
                save(model, tmp_path), specification(tmp_path, described("{h: two}") + "output: action\n")
            )


def test_a_memory_that_nothing_reads_and_an_old_version_are_refused(tmp_path: Path) -> None:
    from onnx import TensorProto, helper

    model = recurrent()
    model.graph.input.append(helper.make_tensor_value_info("idle", TensorProto.FLOAT, [1, 2]))
    model.graph.node.append(helper.make_node("Identity", ["idle_in"], ["idle_out"]))
    model.graph.initializer.append(helper.make_tensor("idle_in", TensorProto.FLOAT, [1, 2], [0.0, 0.0]))
    model.graph.output.append(helper.make_tensor_value_info("idle_out", TensorProto.FLOAT, None))
    with pytest.raises(PolicyError, match="neither the action nor the memory depends on it"):
        load_policy(save(model, tmp_path), specification(tmp_path, described("{h: h_out, idle: idle_out}")))
    with pytest.raises(PolicyError, match="memory: this needs `schema_version: 2`"):
        specification(tmp_path, described().replace("schema_version: 2", "schema_version: 1"))
    with pytest.raises(PolicyError, match="give `frames` to each channel"):
        specification(tmp_path, described() + "frames: {count: 2}\n")


def test_an_inspection_shows_what_is_remembered(tmp_path: Path) -> None:
    path, spec = written(tmp_path, "LSTM")
    out = tmp_path / "written.yaml"
    asked = CliRunner().invoke(main, ["inspect", str(path), "--spec", str(spec)])
    shown = " ".join(asked.output.split())
    assert (
        "h: float [1, 1, 6], 15 to 20 of the observation, memory: what h_out gave in the step before" in shown
    )
    assert "c_out: float, memory: taken by c in the next step" in shown
    asked = CliRunner().invoke(main, ["inspect", str(path), "--spec", str(spec), "--write-spec", str(out)])
    assert asked.exit_code == 0
    again = load_policy(path, out)
    assert again.spec is not None
    assert again.spec.memory == {"h": "h_out", "c": "c_out"}
    assert [channel.size for channel in again.spec.remembered] == [HIDDEN, HIDDEN]


def test_bounds_are_of_the_memory_that_is_given(tmp_path: Path) -> None:
    path, spec = written(tmp_path)
    rows = np.random.default_rng(0).normal(size=(3, SENSED + HIDDEN))
    np.save(tmp_path / "rows.npy", rows)
    np.save(tmp_path / "short.npy", rows[:, :SENSED])
    asked = ["bounds", str(path), str(tmp_path / "rows.npy"), "--spec", str(spec), "--eps", "0.01"]
    bounds = tmp_path / "bounds.npz"
    assert CliRunner().invoke(main, [*asked, "--output", str(bounds)]).exit_code == 0
    with np.load(bounds) as table:
        deployed = Deployed(path, {"h": "h_out"})
        for row, lower, upper in zip(rows, table["lower"], table["upper"], strict=True):
            deployed.remember(row[SENSED:])
            action = deployed.step(row[:SENSED]) * [0.25, 1.0] + [0.25, 0.0]
            assert (lower - 1e-6 <= action).all()
            assert (action <= upper + 1e-6).all()
    asked[2] = str(tmp_path / "short.npy")
    refused = CliRunner().invoke(main, asked)
    assert refused.exit_code == 2
    assert "of which the last 6 are its memory" in " ".join(refused.output.split())
