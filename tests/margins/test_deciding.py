"""What is said to decide does: entries that a policy does not read have no weight."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import viatool
from tests.hall import MAP, write_policy
from viatool.margins.result import Margins
from viatool.simulate import Places


def test_what_a_policy_does_not_read_has_no_weight(tmp_path: Path) -> None:
    write_policy(tmp_path / "policy.onnx")  # reads the cosine and the sine of the goal alone
    (tmp_path / "map.yaml").write_text(MAP, encoding="utf-8")
    found = viatool.margin(tmp_path / "policy.onnx", tmp_path / "map.yaml", places=Places(count=400))
    assert len(found) > 3
    assert set(found.deciding_channels()) == {"goal_cosine", "goal_sine"}
    assert {one["entry"] for row in range(len(found)) for one in found.decides(row)} <= {
        "goal_cosine", "goal_sine",
    }  # fmt: skip


def test_weights_are_parts_of_a_whole(via: Margins) -> None:
    weight = via.findings.weight
    total = weight.sum(axis=1)
    assert (np.isclose(total, 1.0) | (total == 0.0)).all()
    assert (weight >= 0.0).all()
    fails_alone = via.refuted == 0.0
    assert (total[fails_alone] == 0.0).all()
    assert (total[np.isfinite(via.certified)] > 0.0).all()


def test_the_entry_that_weighs_most_is_worth_more_than_another(via: Margins) -> None:
    """Leave out the error of the weightiest channel, and more is survived than without that of the lightest."""
    weightiest, *_, lightest = via.deciding_channels()
    others = set(via.varied.proportions)
    survived = {}
    for left_out in (weightiest, lightest):
        channels = sorted(others - {left_out})
        found = viatool.margin(
            "via", "lab", trajectory=via.trajectory.select(via.states), channels=channels, close=0
        )
        survived[left_out] = found.certified[np.isfinite(via.certified)].sum()
    assert survived[weightiest] > survived[lightest]
