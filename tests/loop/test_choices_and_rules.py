"""The closed loop over sets where a policy chooses among commands or rules count, against runs of the program."""

from __future__ import annotations

import numpy as np
import pytest

from tests.choosing import choosing_specification, write_choosing
from tests.safety.hand_made_policy import specification, write_policy
from viatool.loop.closed_loop import ClosedLoop
from viatool.loop.successor import states_of, step
from viatool.policy import load_policy
from viatool.policy.overrides import Overrides
from viatool.sets.forms import PoseBoxes
from viatool.sets.states import StateBoxes
from viatool.setting.setting import Setting
from viatool.world import load_map

LAB = "maps/lab.yaml"
RULES = [
    {"when": {"goal_distance": {"below": 3.0}}, "command": [0.0, 0.9]},
    {"when": {"lidar": {"below": 0.9}}, "command": [0.1, -0.8]},
]


def loop_of(tmp_path, discrete):
    """A closed loop, through a policy that chooses or one of continuous commands with the same rules."""
    path = tmp_path / "policy.onnx"
    if discrete:
        write_choosing(path, choosing_specification(overrides=RULES))
    else:
        told = specification().model_dump(mode="json", exclude_none=True)
        write_policy(path, specification().model_validate({**told, "schema_version": 2, "overrides": RULES}))
    policy, lab = load_policy(path), load_map(LAB)
    return ClosedLoop.of(policy, Setting.of(policy, lab, 0.02), lab.scenarios[0])


def cells_of(loop, count, generator):
    """Boxes of free poses, and commands before."""
    centre = np.column_stack(
        [generator.uniform(-4.2, 4.2, (count, 2)), generator.uniform(-np.pi, np.pi, count)]
    )
    radius = np.broadcast_to(np.array([0.05, 0.05, 0.08]), centre.shape)
    middle = generator.uniform([0.05, -0.9], [0.45, 0.9], (count, 2))
    return StateBoxes(PoseBoxes(centre, radius), middle - 0.02, middle + 0.02)


def runs_of(loop, cells, generator, each):
    """Poses, commands before and commands sent, (C, K, ...), at random points of cells with random errors."""
    shape = (len(cells), each)
    signs = np.clip(generator.uniform(-1.3, 1.3, (*shape, 3)), -1, 1)
    poses = cells.poses.centre[:, None] + signs * cells.poses.radius[:, None]
    previous = generator.uniform(cells.previous_lower[:, None], cells.previous_upper[:, None], (*shape, 2))
    readings = loop.sensors.read(poses.reshape(-1, 3), previous.reshape(-1, 2))
    errors = np.clip(generator.uniform(-1.5, 1.5, readings.shape), -1, 1) * loop.setting.radii
    seen = (readings + errors).astype(np.float32).astype(np.float64)
    sent = loop.rules.clip(loop.driven.run(seen)).reshape(*shape, 2)
    return poses, sent


@pytest.mark.parametrize("discrete", [True, False])
def test_what_is_sent_anywhere_in_a_cell_is_within_its_commands_and_where_it_leads(tmp_path, discrete):
    generator = np.random.default_rng(1)
    loop = loop_of(tmp_path, discrete)
    cells = cells_of(loop, 60, generator)
    wet = loop.blocked(cells.poses)
    cells = cells.select(np.flatnonzero(~wet))
    bounds, after = loop.commands(cells), step(loop, states_of(cells))
    poses, sent = runs_of(loop, cells, generator, 40)
    free = (
        loop.geometry.still.footprint_clearance(
            poses.reshape(-1, 3), loop.rules.footprint, np.zeros(poses.shape[0] * poses.shape[1], np.int64)
        ).reshape(poses.shape[:2])
        > 0.0
    )
    owner, pieces = bounds.pieces.state, bounds.pieces
    assert (within(sent, owner, pieces.lower, pieces.upper) | ~free).all()
    ends = loop.rules.kinematics.advance(poses, sent, loop.rules.interval)
    low, high = after.bounds(
        cells.poses.centre - cells.poses.radius - 1e-12, cells.poses.centre + cells.poses.radius + 1e-12
    )
    turned = ends[:, :, 2] - poses[:, :, 2]
    ends[:, :, 2] = poses[:, :, 2] + np.mod(turned + np.pi, 2.0 * np.pi) - np.pi  # headings go on, unwrapped
    assert (within(np.concatenate([ends, sent], axis=2), after.origin, low, high) | ~free).all()
    assert (np.bincount(owner) > 1).sum() > 5  # or else no cell is sent one of several
    if discrete:
        assert (pieces.lower == pieces.upper).all()


def within(points, owner, lower, upper):
    """Tell which points (C, K, D) lie in one of the boxes (P, D) of their cell."""
    found = np.zeros(points.shape[:2], dtype=bool)
    some = points[owner]
    inside = (some >= lower[:, None] - 1e-9) & (some <= upper[:, None] + 1e-9)
    np.logical_or.at(found, owner, inside.all(axis=2))
    return found


def test_a_rule_that_is_forgotten_lets_a_command_escape(tmp_path, monkeypatch):
    """The mutant that takes the rules of the middle of a cell for those of all of it."""
    over = Overrides.over
    monkeypatch.setattr(
        Overrides, "over", lambda self, low, high: over(self, 0.5 * (low + high), 0.5 * (low + high))
    )
    with pytest.raises(AssertionError):
        test_what_is_sent_anywhere_in_a_cell_is_within_its_commands_and_where_it_leads(tmp_path, False)
