"""Each kind of channel by itself: its parts agree with each other, for every kind that the registry names."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.channels import test_encoded
from viatool import load_map
from viatool.channels import (
    BoxView,
    Extent,
    Quantities,
    Quantity,
    RecordedInstants,
    View,
    kinds,
    see_precisely,
)
from viatool.loop.observation import Sensors
from viatool.policy import LidarSpecification, ObservationChannel
from viatool.sets.forms import Forms, PoseBoxes
from viatool.sets.states import StateBoxes
from viatool.sight.shapes import Shapes
from viatool.trajectory.scans import Readings, Scans, bin_scans
from viatool.world import Obstacles, Scenes

LAB = load_map(Path("maps/lab.yaml"))
SCENARIO = LAB.scenarios[0]
ROBOT = LAB.robot
PARTS = ("measure", "record", "enclose", "bounds", "mirror")


def scan(name, view, rays, bins, least, largest):
    described = LidarSpecification(
        field_of_view=view, rays=rays, bins=bins, minimum_range=least, maximum_range=largest
    )
    return ObservationChannel(name=name, size=bins, kind="lidar", lidar=described)


CHANNELS = [
    ObservationChannel(name="speed", kind="previous_linear"),
    scan("front", 1.2, 24, 4, 0.0, 3.0),
    ObservationChannel(name="ahead", kind="goal_cosine"),
    ObservationChannel(name="aside", kind="goal_sine"),
    scan("all_round", 6.0, 60, 12, 0.3, 7.0),
    ObservationChannel(name="far", kind="goal_distance"),
    ObservationChannel(name="far_again", kind="goal_distance"),
    ObservationChannel(name="turn", kind="previous_angular"),
    ObservationChannel(name="held", kind="previous_linear", value=0.25),
    ObservationChannel(name="u", kind="budget", value=1.5),
    ObservationChannel(name="battery", kind="other", size=2, value=0.5),
]
OBSERVED = Quantities.of(CHANNELS, ROBOT)
SCENES = Scenes.of(LAB, [SCENARIO])
ROUNDING = 2e-6  # of an observation to float32


def free_poses(generator, count, clearance=0.05):
    poses = generator.uniform((-4.9, -4.9, -3.2), (4.9, 4.9, 3.2), (20 * count, 3))
    return poses[SCENES.clearance(poses[:, :2], np.zeros(len(poses), np.int64)) > clearance][:count]


def view_at(generator, count):
    goals = np.broadcast_to(np.array(SCENARIO.goal), (count, 2))
    most = [ROBOT.max_linear, ROBOT.max_angular]
    previous = generator.uniform([ROBOT.min_linear, -ROBOT.max_angular], most, (count, 2))
    poses = free_poses(generator, count)
    return View(SCENES, poses, np.zeros(count, np.int64), goals, previous, eyes=see_precisely)


def test_every_kind_that_has_a_part_is_tested_here():
    tested = {channel.kind for channel in (*CHANNELS, *test_encoded.PLAIN) if channel.value is None}
    tested.add("previous_lateral")  # this robot takes no such command
    tested |= {
        "previous_raw",
        "steps_left",
    }  # in tests/loop/test_told.py: sets of poses alone do not tell them
    assert tested == {name for name, kind in kinds().items() if kind.enclose is not Quantity.enclose}
    assert all(quantity.has(part) for quantity in OBSERVED for part in PARTS)


@pytest.mark.parametrize("side", [0.004, 0.05, 0.3])
def test_what_is_measured_in_a_box_lies_within_what_encloses_it(side):
    generator = np.random.default_rng(0)
    centre = free_poses(generator, 200)
    radius = generator.uniform(0.1, 1.0, (len(centre), 3)) * side
    lower = generator.uniform((0.0, -1.0), (0.4, 0.6), (len(centre), 2))
    cells = StateBoxes(PoseBoxes(centre, radius), lower, lower + np.array([0.1, 0.4]))
    sensors = Sensors(OBSERVED, Shapes.of(LAB, SCENARIO), SCENES, np.array(SCENARIO.goal))
    forms = sensors.enclose(cells).forms
    for _ in range(20):
        z = generator.uniform(-1, 1, (len(cells), 5))
        z[::2] = np.sign(z[::2])
        half = 0.5 * (cells.previous_upper - cells.previous_lower)
        seen = sensors.measure(centre + z[:, :3] * radius, lower + (1.0 + z[:, 3:]) * half)
        linear = forms.centre + np.einsum("cs,csn->cn", z, forms.slope)
        assert (np.abs(seen - linear) <= forms.rest + ROUNDING * (1.0 + np.abs(seen))).all()


def test_sets_in_other_symbols_are_enclosed_in_those():
    """A slanted set: x and y move together, against the previous command; two symbols."""
    generator = np.random.default_rng(1)
    centre = np.column_stack([free_poses(generator, 100, 0.5), np.tile([0.2, 0.1], (100, 1))])
    slope = np.tile(np.array([[0.03, 0.03, 0.0, -0.05, 0.0], [0.0, 0.0, 0.02, 0.0, 0.3]]), (100, 1, 1))
    reach = np.abs(slope).sum(axis=1) + 1e-12
    boxes = StateBoxes(
        PoseBoxes(centre[:, :3], reach[:, :3]), (centre - reach)[:, 3:], (centre + reach)[:, 3:]
    )
    sensors = Sensors(OBSERVED, Shapes.of(LAB, SCENARIO), SCENES, np.array(SCENARIO.goal))
    forms = sensors.enclose(boxes, Forms(centre, slope, np.zeros_like(centre))).forms
    assert forms.slope.shape == (100, 2, OBSERVED.size)
    for _ in range(20):
        z = generator.uniform(-1, 1, (100, 2))
        states = centre + np.einsum("cs,csk->ck", z, slope)
        seen = sensors.measure(states[:, :3], states[:, 3:])
        linear = forms.centre + np.einsum("cs,csn->cn", z, forms.slope)
        assert (np.abs(seen - linear) <= forms.rest + ROUNDING * (1.0 + np.abs(seen))).all()


def test_the_mirror_image_is_what_is_observed_in_the_mirrored_scene():
    generator = np.random.default_rng(2)
    circles = np.column_stack([generator.uniform(-4, 4, (6, 2)), generator.uniform(0.1, 0.6, 6)])
    poses = np.column_stack([generator.uniform(-4, 4, (60, 2)), generator.uniform(-3, 3, 60)])
    goals, previous = generator.uniform(-4, 4, (60, 2)), generator.uniform(-1, 1, (60, 2))

    def observed(sign):
        scenes = Scenes(
            LAB.arena, Obstacles(circles * [1.0, sign, 1.0]), np.zeros((1, 0, 3)), np.zeros((1, 0, 4))
        )
        turn, axis = np.array([1.0, sign, sign]), np.array([1.0, sign])
        view = View(
            scenes, poses * turn, np.zeros(60, np.int64), goals * axis, previous * axis, eyes=see_precisely
        )
        return OBSERVED.measure(view)

    columns, signs = OBSERVED.mirror()
    np.testing.assert_allclose(observed(1.0)[:, columns] * signs, observed(-1.0), atol=1e-5)


def test_a_recording_of_a_simulated_drive_gives_what_was_measured():
    generator = np.random.default_rng(3)
    view = view_at(generator, 50)

    def recorded_scan(channel):
        """As a driver publishes it: rays from right to left, infinite where nothing came back."""
        sensor = channel.lidar.lidar(ROBOT.lidar.noise)
        ranges = SCENES.cast(view.poses, view.scene, sensor)
        ranges = np.where(ranges >= sensor.maximum_range, np.inf, np.maximum(ranges, 1e-3)).astype(np.float32)
        step = sensor.field_of_view / (sensor.rays - 1)
        geometry = np.tile([-0.5 * sensor.field_of_view, step, 1e-4, sensor.maximum_range], (50, 1))
        stamps = np.arange(50)
        return bin_scans(
            Scans(stamps, stamps, tuple(ranges), geometry, "laser"), channel.lidar, 0.0, 1, Readings()
        )

    twist = np.insert(view.previous, 1, 0.0, axis=1)
    found = OBSERVED.record(
        RecordedInstants(view.poses, np.array(SCENARIO.goal), twist, np.zeros((50, 3)), recorded_scan)
    )
    np.testing.assert_allclose(OBSERVED.observe(found), OBSERVED.measure(view), atol=1e-5)


def test_natural_bounds_hold_what_is_measured():
    generator = np.random.default_rng(4)
    view = view_at(generator, 2000)
    lower, upper = OBSERVED.bounds(Extent(*LAB.bounds))
    seen = OBSERVED.measure(view)
    assert (lower - ROUNDING <= seen).all()
    assert (seen <= upper + ROUNDING).all()
    assert (
        upper[: OBSERVED.columns[1].stop] - lower[: OBSERVED.columns[1].stop] <= [0.5, 3.0, 3.0, 3.0, 3.0]
    ).all()


def test_goals_are_seen_from_where_the_robot_believes_to_be():
    view = view_at(np.random.default_rng(5), 10)
    lost = replace(view, believed=view.poses + np.array([1.0, 0.0, 0.0]))
    moved = replace(view, poses=view.poses + np.array([1.0, 0.0, 0.0]))
    place = OBSERVED.columns[5]
    np.testing.assert_array_equal(OBSERVED.measure(lost)[:, place], OBSERVED.measure(moved)[:, place])
    front = OBSERVED.columns[1]
    np.testing.assert_array_equal(OBSERVED.measure(lost)[:, front], OBSERVED.measure(view)[:, front])


def test_a_box_of_one_state_is_what_is_measured_there():
    view = view_at(np.random.default_rng(6), 30)
    cells = StateBoxes(PoseBoxes(view.poses, np.zeros_like(view.poses)), view.previous, view.previous)
    dry = np.zeros(30, dtype=bool)
    forms = OBSERVED.enclose(
        BoxView(cells, cells.forms, Shapes.of(LAB, SCENARIO), np.array(SCENARIO.goal), dry)
    ).forms
    np.testing.assert_allclose(forms.centre, OBSERVED.measure(view), atol=1e-5)
    assert forms.rest.max() < 1e-5
