"""Gaussian heads: the mean is the action, picked by its name."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from tests.policy.models import model_of, node, save, weights
from viatool.cli import main
from viatool.errors import PolicyError
from viatool.policy import ActionChannel, ObservationChannel, PolicySpecification, load_policy


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
    assert "export the mean alone" in refused.value.hint
