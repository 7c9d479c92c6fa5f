"""What counts nowhere: blocked cells hold no free pose, by shapely's distances."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.loop.plant import Plant
from viatool import load_map, load_policy
from viatool.loop.closed_loop import ClosedLoop
from viatool.sets.forms import PoseBoxes
from viatool.setting.setting import Setting
from viatool.setting.wishes import Wishes
from viatool.world import Footprint, simple_polygon

ROOM, POLICY = load_map(Path("maps/room.yaml")), load_policy(Path("policies/via.onnx"))
SCENARIO = ROOM.scenarios[0]
BAR = simple_polygon(np.array([[-0.1, -0.05], [0.4, -0.05], [0.4, 0.05], [-0.1, 0.05]]), "")
FOOTPRINTS = {
    "point": Footprint(),
    "disc": Footprint("circle", radius=0.1),
    "bar": Footprint("polygon", polygon=BAR),
}


def free_poses_of_blocked_boxes(name):
    """Blocked boxes, and how many sampled poses of them are free."""
    generator, footprint = np.random.default_rng(0), FOOTPRINTS[name]
    world = ROOM.with_clearance(0.15, None)
    wishes = Wishes("braking", footprint=footprint)
    asked = ClosedLoop.of(POLICY, Setting.of(POLICY, world, 0.01, wishes), SCENARIO)
    centre = generator.uniform((-2, -2, -math.pi), (2, 2, math.pi), (1500, 3))
    boxes = PoseBoxes(centre, generator.uniform(0.0, 0.1, (1500, 3)) * [1.0, 1.0, 3.0])
    blocked = np.flatnonzero(asked.blocked(boxes))
    robot = replace(Plant(POLICY, world, SCENARIO, 0.01), footprint=footprint)
    signs = generator.choice([-1.0, 1.0], (len(blocked), 16, 3))
    poses = boxes.centre[blocked][:, None] + signs * boxes.radius[blocked][:, None]
    return len(blocked), int(robot.free(poses.reshape(-1, 3)).sum())


@pytest.mark.parametrize("name", FOOTPRINTS)
def test_blocked_boxes_hold_no_free_pose(name):
    blocked, free = free_poses_of_blocked_boxes(name)
    assert blocked > 100
    assert free == 0


NOTHING = {
    "extent": lambda boxes: 0.0 * boxes.radius[:, 2],
    "turn": lambda boxes: 0.0 * boxes.radius[:, 2],
    "corners": lambda boxes: np.repeat(boxes.centre[:, None, :2], 4, axis=1),
}


@pytest.mark.parametrize(
    ("name", "rule"),
    [
        ("point", "extent"),
        ("disc", "extent"),
        ("bar", "extent"),
        ("bar", "turn"),
        ("point", "corners"),
        ("disc", "corners"),
    ],
)
def test_sampling_catches_the_rule_without_one_of_its_terms(monkeypatch, name, rule):
    monkeypatch.setattr(PoseBoxes, rule, property(NOTHING[rule]))
    assert free_poses_of_blocked_boxes(name)[1] > 0


def test_a_box_is_blocked_whose_corners_are_all_too_near_to_one_obstacle():
    """A disc around the box would reach a millimetre farther from the wall than the box does."""
    asked = ClosedLoop.of(POLICY, Setting.of(POLICY, ROOM, 0.01, Wishes("braking")), SCENARIO)
    wall, near = ROOM.arena[:, 0].max(), ROOM.clearance.collision
    centre = np.array([[wall - near + 0.0105, 0.0, 0.0], [wall - near + 0.0095, 0.0, 0.0]])
    boxes = PoseBoxes(centre, np.array([[0.01, 0.005, 0.1]] * 2))
    assert asked.blocked(boxes).tolist() == [True, False]
