from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.safety.brute_force import FOOTPRINTS, clearance, drive_all, random_world, rim_of
from viatool.motion.law import Kinematics
from viatool.motion.manoeuvre import Manoeuvre
from viatool.safety.enclosure import MotionBoxes, enclose
from viatool.safety.proof import prove_clearance
from viatool.safety.scene_poses import ScenePoses

CORNERS = np.array(np.meshgrid(*[[-1.0, 1.0]] * 5, indexing="ij")).reshape(5, -1).T  # v, omega, x, y, theta


def setting(seed, count=24, turning=False):
    """Boxes of poses of all shapes in a crowded room with boxes of commands; or poses that only turn."""
    generator = np.random.default_rng(seed)
    world = random_world(seed)
    poses = np.column_stack([generator.uniform(-2.6, 2.6, (count, 2)), generator.uniform(-4, 4, count)])
    radii = generator.uniform(0.0, 0.15, (count, 3)) * generator.choice([0.0, 1.0, 3.0], (count, 3))
    lower = generator.uniform((-0.3, -2.0), (0.9, 1.8), (count, 2))
    upper = lower + generator.uniform(0.0, 0.2, (count, 2))
    if turning:
        radii, upper = radii * [0.0, 0.0, 1.0], lower
    placed = ScenePoses.of(world, [None], poses, np.zeros(count, dtype=np.int64))
    return world, replace(placed, radii=radii), lower, upper


def found_within(world, placed, lower, upper, manoeuvre, footprint):
    """The least clearance that the corners of each box reach at the begin, the middle and the end of the path."""
    count = len(lower)
    share = CORNERS[None]
    command = 0.5 * (lower + upper)[:, None] + 0.5 * (upper - lower)[:, None] * share[..., :2]
    start = placed.poses[:, None] + placed.radii[:, None] * share[..., 2:]
    v, w = command.reshape(-1, 2).T
    seconds = manoeuvre.seconds(np.abs(v), np.abs(w))[:, None] * [0.0, 0.5, 1.0]
    poses = drive_all(start.reshape(-1, 3), v, w, seconds, np.float64)
    return clearance(world, poses, footprint).reshape(count, -1).min(axis=1)


def excess(name, manoeuvre, seeds=range(3), **options):
    """The largest amount by which the least clearance exceeds one that is found inside a box."""
    footprint, worst = FOOTPRINTS[name], -np.inf
    for seed in seeds:
        world, placed, lower, upper = setting(seed, **options)
        found = enclose(MotionBoxes.whole(lower, upper, placed.radii), placed, manoeuvre, footprint)
        attained = found_within(world, placed, lower, upper, manoeuvre, footprint)
        worst = max(worst, float((found.least - attained).max()))
    return worst


@pytest.mark.parametrize(("name", "kind"), [("point", "braking"), ("square", "swept")])
def test_no_pose_of_a_box_comes_nearer_than_its_bound(name, kind):
    swept, braking = Manoeuvre(0.5), Manoeuvre(0.1, 0.8, rim_of(FOOTPRINTS[name]))
    assert excess(name, swept if kind == "swept" else braking) <= 0.0


def test_brute_force_catches_a_bound_that_forgets_other_places(monkeypatch):
    right = Kinematics.from_elsewhere
    monkeypatch.setattr(Kinematics, "from_elsewhere", lambda *a: (0.0 * right(*a)[0], right(*a)[1]))
    assert excess("point", Manoeuvre(0.1)) > 0.0


def test_brute_force_catches_a_bound_that_forgets_other_headings(monkeypatch):
    right = Kinematics.from_elsewhere
    monkeypatch.setattr(Kinematics, "from_elsewhere", lambda *a: (right(*a)[0], 0.0 * right(*a)[1]))
    assert excess("square", Manoeuvre(0.01), turning=True) > 0.0


def test_what_is_proved_of_a_box_is_proved_of_its_corners():
    manoeuvre, footprint, threshold = Manoeuvre(0.3), FOOTPRINTS["point"], 0.05
    world, placed, lower, upper = setting(0, count=60)
    proof = prove_clearance(placed, lower, upper, threshold, manoeuvre, footprint)
    attained = found_within(world, placed, lower, upper, manoeuvre, footprint)
    assert proof.proved.sum() > 10
    assert (attained[proof.proved] > threshold).all()
    assert not (proof.proved & proof.refuted).any()
