"""Gaussian heads: the mean is the action, picked by its name."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from tests.policy.enclosure import escapes
from tests.policy.models import model_of, node, save, weights
from viatool.channels import Extent
from viatool.cli import main
from viatool.doctor.commands import actions_swapped
from viatool.doctor.interpretation import Background
from viatool.errors import PolicyError
from viatool.policy import (
    ActionChannel,
    ObservationChannel,
    PolicySpecification,
    load_policy,
    load_specification,
)
from viatool.world import Robot


def head(names: tuple[str, ...] = ("mean", "log_std")) -> Any:
    """A body with two linear heads."""
    nodes = [node("Tanh", ["x"], ["h"])]
    nodes += [node("MatMul", ["h", f"w{k}"], [name]) for k, name in enumerate(names)]
    constants = {f"w{k}": weights(k, 4, 2) for k in range(len(names))}
    return model_of(nodes, constants, outputs=names)


def described(**more: Any) -> PolicySpecification:
    return PolicySpecification(
        schema_version=2,
        observation=[ObservationChannel(name="x", size=4)],
        action=[ActionChannel(name=name, lower=-9, upper=9) for name in ("v", "turn")],
        **more,
    )


@pytest.mark.parametrize("name", ["mean", "mu", "action_mean", "policy.mu", "Deterministic_actions"])
def test_the_mean_of_a_gaussian_head_is_proposed_by_its_name(name: str, tmp_path: Path) -> None:
    path = save(head((name, "log_std")), tmp_path)
    with pytest.raises(PolicyError, match=re.escape(f"{name}, log_std")) as refused:
        load_policy(path)
    assert f"--graph-output {name}" in refused.value.hint
    rows = np.random.default_rng(0).normal(size=(3, 4))
    expected = np.tanh(rows) @ weights(0, 4, 2).astype(np.float64)
    np.testing.assert_allclose(load_policy(path, output_name=name)(rows), expected, atol=1e-12)
    np.testing.assert_allclose(load_policy(path, described(output=name))(rows), expected, atol=1e-12)
    shown = " ".join(CliRunner().invoke(main, ["inspect", str(path)]).output.split())
    assert "sounds like the mean of a Gaussian head" in shown


@pytest.mark.parametrize(
    "names", [("left", "right"), ("mean_of_v", "mean_of_turn"), ("meaning", "simulation")]
)
def test_no_output_is_proposed_where_none_or_several_sound_like_it(
    names: tuple[str, str], tmp_path: Path
) -> None:
    with pytest.raises(PolicyError) as refused:
        load_policy(save(head(names), tmp_path))
    assert "--graph-output NAME" in refused.value.hint


def test_an_output_of_mean_and_deviation_is_named_as_such(tmp_path: Path) -> None:
    model = model_of([node("Tanh", ["x"], ["y"])])
    with pytest.raises(PolicyError, match="has 4 actions, its specification describes 2") as refused:
        load_policy(save(model, tmp_path), described())
    assert "say which numbers are the actions (`entry: 0`" in refused.value.hint


JOINED = """schema_version: 2
observation: [{name: x, size: 4}]
action:
  - {name: v, kind: linear, lower: 0.0, upper: 0.5, scale: 0.25, offset: 0.25, entry: 1}
  - {name: turn, kind: angular, lower: -1.0, upper: 1.0, entry: 0}
"""


def joined(rank: int = 2, opset: int = 17) -> Any:
    """Mean and deviation of two actions in one row."""
    nodes = [node("MatMul", ["x", "w"], ["o"]), node("Tanh", ["o"], ["flat"])]
    nodes += [node("Reshape", ["flat", "shape"], ["y"])]
    shape = np.array([1, 4] if rank == 2 else [1, 1, 4][-rank:])
    return model_of(nodes, {"w": weights(5, 4, 4), "shape": shape}, opset=opset)


@pytest.mark.parametrize("rank", [1, 2, 3])
def test_entries_of_an_output_are_the_actions_and_the_others_are_dropped(rank: int, tmp_path: Path) -> None:
    path, spec = save(joined(rank), tmp_path), tmp_path / "spec.yaml"
    spec.write_text(JOINED, "utf-8")
    policy = load_policy(path, spec)
    rows = np.random.default_rng(0).normal(size=(5, 4)).astype(np.float32).astype(np.float64)
    raw = np.array([run(path, row) for row in rows])
    expected = np.clip(raw[:, [1, 0]] * [0.25, 1.0] + [0.25, 0.0], [0.0, -1.0], [0.5, 1.0])
    assert policy.output_size == 2
    np.testing.assert_allclose(policy(rows), expected, atol=1e-6)
    np.testing.assert_allclose(policy.run(rows), expected, atol=1e-7)
    np.testing.assert_array_equal(policy.outputs(rows), raw[:, [1, 0]])
    assert "entries 1, 0 of the output, the others are dropped" in policy.maps.after
    assert escapes(policy, samples=2000) == 0
    shown = " ".join(CliRunner().invoke(main, ["inspect", str(path), "--spec", str(spec)]).output.split())
    assert "y: float, the action: its entries 1, 0" in shown


def run(path: Path, row: Any) -> Any:
    import onnxruntime

    session = onnxruntime.InferenceSession(path.read_bytes())
    return session.run(None, {"x": row[None].astype(np.float32)})[0].ravel()


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        (", entry: 0", "", "action 'turn' has no `entry`, but 'v' has one"),
        ("entry: 0", "entry: 1", "actions 'v' and 'turn' take the same entry, 1"),
        ("entry: 0", "entry: 4", r"takes entry 4 of the output 'y', which has 4 \(0 to 3\)"),
        ("entry: 0", "entry: -1", "expected at least 0, not -1"),
        ("schema_version: 2", "schema_version: 1", "needs `schema_version: 2`"),
    ],
)
def test_entries_that_contradict_each_other_are_refused(
    before: str, after: str, message: str, tmp_path: Path
) -> None:
    spec = tmp_path / "spec.yaml"
    spec.write_text(JOINED.replace(before, after), "utf-8")
    with pytest.raises(PolicyError, match=message):
        load_policy(save(joined(), tmp_path), spec)


def test_a_diagnosis_that_swaps_actions_leaves_the_entries_where_they_are(tmp_path: Path) -> None:
    (tmp_path / "spec.yaml").write_text(JOINED, "utf-8")
    spec = load_specification(tmp_path / "spec.yaml")
    ((_, swapped),) = actions_swapped(spec, Background(Robot(), Extent(0.0, 0.0, 1.0, 1.0)))
    assert [(action.name, action.entry) for action in swapped.action] == [("turn", 1), ("v", 0)]


def test_the_deviation_in_an_output_of_its_own_is_left_out(tmp_path: Path) -> None:
    path = save(head(), tmp_path)
    policy = load_policy(path, described(output="mean"))
    assert policy.output_size == 2
    assert escapes(policy, samples=1000) == 0
