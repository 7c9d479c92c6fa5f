"""LiDARs in solids: a footprint that does not hold the robot's origin may be free where its sensor is in one."""

from __future__ import annotations

import numpy as np
import pytest

from tests.channels.square import lidar, linear_policy, square
from viatool import verify
from viatool.channels import Quantities, View, see, see_precisely
from viatool.loop.observation import Sensors
from viatool.policy import LidarSpecification, ObservationChannel
from viatool.sets.forms import PoseBoxes
from viatool.sets.states import StateBoxes
from viatool.sight.shapes import Shapes
from viatool.trajectory import Trajectory
from viatool.world import Footprint, Scenes, load_map

LEAST, FAR = 0.1, 3.0
SCAN = ObservationChannel(
    name="scan", size=4, kind="lidar",
    lidar=LidarSpecification(field_of_view=6.0, rays=8, bins=4, minimum_range=LEAST, maximum_range=FAR),
)  # fmt: skip
SOLIDS = {
    "circle": "[{shape: circle, center: [0.5, 0.2], radius: 0.4}]",
    "box": "[{shape: box, center: [0.5, 0.2], size: [0.7, 0.6]}]",
    "polygon": "[{shape: polygon, points: [[0.1, -0.2], [0.9, 0.0], [0.5, 0.6]]}]",
}


def sensors(world, *, dry):
    scenario = world.scenarios[0]
    scenes = Scenes.of(world, [scenario])
    return Sensors(
        Quantities.of([SCAN], world.robot), Shapes.of(world, scenario), scenes, np.array(scenario.goal), dry
    )


@pytest.mark.parametrize("solid", SOLIDS)
def test_what_is_read_in_a_solid_and_off_the_map_is_enclosed(tmp_path, solid):
    world = square(tmp_path, SOLIDS[solid])
    some, generator = sensors(world, dry=False), np.random.default_rng(0)
    centre = generator.uniform((-2.3, -2.3, -3.0), (2.3, 2.3, 3.0), (400, 3))
    radius = np.full((400, 3), 0.05)
    cells = StateBoxes(PoseBoxes(centre, radius), np.zeros((400, 2)), np.zeros((400, 2)))
    forms = some.enclose(cells).forms
    read_nothing = 0
    for _ in range(20):
        poses = centre + generator.uniform(-1, 1, (400, 3)) * radius
        seen = some.measure(poses, np.zeros((400, 2)))
        inside = some.scenes.clearance(poses[:, :2], np.zeros(400, np.int64)) <= 0.0
        assert (seen[inside] == np.float32(LEAST)).all()
        read_nothing += int(inside.sum())
        assert (seen >= forms.lower - 1e-6).all()
        assert (seen <= forms.upper + 1e-6).all()
    assert read_nothing > 500


@pytest.mark.parametrize("solid", ["box", "polygon"])  # a circle is hit from within as well
def test_sampling_catches_an_enclosure_that_takes_all_sensors_for_dry(tmp_path, solid):
    world = square(tmp_path, SOLIDS[solid])
    some = sensors(world, dry=True)
    centre = np.tile([0.5, 0.2, 0.0], (1, 1))
    cells = StateBoxes(PoseBoxes(centre, np.full((1, 3), 0.01)), np.zeros((1, 2)), np.zeros((1, 2)))
    assert some.measure(centre, np.zeros((1, 2))).max() < some.enclose(cells).forms.lower.max()


def test_simulators_and_proofs_read_the_same_in_the_cells_of_a_grid():
    world = load_map("maps/office.yaml")
    scenes = Scenes.of(world, [None])
    generator = np.random.default_rng(1)
    x_min, y_min, x_max, y_max = world.bounds
    poses = generator.uniform((x_min, y_min, -3.0), (x_max, y_max, 3.0), (2000, 3))
    inside = scenes.clearance(poses[:, :2], np.zeros(2000, np.int64)) <= 0.0
    assert inside.sum() > 100
    for eyes in (see, see_precisely):
        view = View(scenes, poses, np.zeros(2000, np.int64), poses[:, :2], np.zeros((2000, 2)), eyes=eyes)
        seen = Quantities.of([SCAN], world.robot).measure(view)
        assert (seen[inside] == np.float32(LEAST)).all()


FORK = [[0.4, -0.05], [0.7, -0.05], [0.7, 0.05], [0.4, 0.05]]
BOXES = (
    "[{shape: box, center: [-0.5, 0], size: [0.4, 0.4]}, {shape: box, center: [0.5, 0], size: [0.4, 0.4]}]"
)


def fork_lift(folder):
    """A robot that drives on only where all readings are 0: in a solid. Its footprint is ahead of its sensor."""
    scan = lidar("scan", 3.0, 10)
    rows = {("scan", index): (-0.5, 0.0) for index in range(10)}
    return linear_policy(folder / "fork.onnx", [scan], rows, bias=(0.5, 0.0)), square(folder, BOXES, 0.05)


def test_what_a_sensor_reads_in_a_solid_counts_in_tubes(tmp_path):
    policy, world = fork_lift(tmp_path)
    trajectory = Trajectory(
        poses=np.array([[-0.5, 0.0, 0.0], [-1.9, 0.0, 0.0]]),  # with a box before the fork, and in the open
        observations=np.ones((2, 10)),
        actions=np.zeros((2, 0)),
        episode=np.zeros(2, np.int64),
        time=np.zeros(2),
        outcomes=np.array(["unknown"]),
        costs=np.array([np.nan]),
        scenarios=world.scenarios,
    )
    result = verify(policy, world, eps=0.001, trajectory=trajectory, footprint=FORK, horizon=6)
    assert result.horizon.verdict[0] != "safe"
    assert result.horizon.verdict[1] == "safe"


@pytest.mark.parametrize(
    ("corners", "distance", "held"),
    [
        ([[-0.2, -0.1], [0.2, -0.1], [0.2, 0.1], [-0.2, 0.1]], 0.0, True),
        ([[0.4, -0.1], [0.7, -0.1], [0.7, 0.1], [0.4, 0.1]], 0.3, False),
        (
            [[0.4, -0.1], [0.7, -0.1], [0.7, 0.1], [0.4, 0.1]],
            0.41,
            True,
        ),  # nearer than the clearance that is kept
        ([[0.0, -0.1], [0.7, -0.1], [0.7, 0.1], [0.0, 0.1]], 0.0, False),  # on the outline
        (
            [[-0.3, -0.3], [0.3, -0.3], [0.3, 0.3], [0.2, 0.3], [0.2, -0.2], [-0.3, -0.2]],
            0.1,
            False,
        ),  # in the corner
    ],
)
def test_whether_a_footprint_holds_the_sensor(corners, distance, held):
    assert Footprint("polygon", polygon=np.array(corners)).holds_origin(distance) is held


def test_points_and_discs_hold_the_sensor():
    assert Footprint().holds_origin()
    assert Footprint("circle", radius=0.2).holds_origin()
