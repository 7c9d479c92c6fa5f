"""The way around obstacles, and the mirror: what shaping and augmentation rest on."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from viatool.channels import View
from viatool.simulate import Observer, navigation_channels
from viatool.train.guide import FAR, Guide, solve_eikonal
from viatool.train.observation import Mirror, make_scaling
from viatool.world import Obstacles, Scenes, load_map

LAB = load_map("maps/lab.yaml")


def test_in_the_open_the_distance_to_go_is_the_straight_one() -> None:
    rows, columns = np.mgrid[0:41, 0:41] * 0.25
    straight = np.hypot(rows - 2.0, columns - 3.0).astype(np.float32)
    start = np.where(straight < 0.4, straight, FAR).astype(np.float32)
    found = solve_eikonal(start[None], np.full((1, 41, 41), 0.25, dtype=np.float32))[0]
    assert (found >= straight - 1e-3).all()
    assert np.abs(found - straight).max() < 0.35  # first order in the spacing, along the diagonals
    assert found[8, 40] == pytest.approx(7.0, abs=1e-3)


def test_a_wall_is_gone_around() -> None:
    step = np.full((1, 21, 21), 1.0, dtype=np.float32)
    step[0, :15, 10] = 100.0  # open from row 15 on
    start = np.full((1, 21, 21), FAR, dtype=np.float32)
    start[0, 5, 5] = 0.0
    found = solve_eikonal(start, step)[0]
    around = np.hypot(10.0, 5.0) * 2  # to the end of the wall and back up
    assert around <= found[5, 15] < 1.2 * around
    assert found[5, 9] == pytest.approx(4.0, abs=1e-3)


@pytest.mark.parametrize("index", range(len(LAB.scenarios)))
def test_going_downhill_leads_to_the_goal_clear_of_obstacles(index: int) -> None:
    scenario = LAB.scenarios[index]
    scenes = Scenes.of(LAB, [scenario])
    guide = Guide(LAB, 1)
    zero, goal = np.zeros(1, dtype=np.int64), np.array([scenario.goal])
    guide.aim(zero, scenes, zero, goal)
    place, least = np.array([scenario.start[:2]]), np.inf
    for _ in range(400):
        slope = [
            guide.distance(place + offset) - guide.distance(place - offset) for offset in np.eye(2) * 0.15
        ]
        direction = -np.array(slope).T
        place = place + 0.05 * direction / np.hypot(*direction.T)
        least = min(least, float(scenes.clearance(place, zero)[0]))
        if np.hypot(*(place - goal).T)[0] < 0.5:
            break
    else:
        pytest.fail("the goal was not reached")
    assert least > LAB.clearance.collision


def gap(half: float) -> Scenes:
    """Return two columns of half a metre's radius, between which the middle keeps so many metres."""
    columns = Obstacles(np.array([[0.0, 0.5 + half, 0.5], [0.0, -0.5 - half, 0.5]]))
    return Scenes(LAB.arena, columns, np.zeros((1, 0, 3)), np.zeros((1, 0, 4)))


def ways(scenes: Scenes, narrow: float, *places: float) -> list[float]:
    """Return the distances to (2, 0) from places on the x-axis, along which the gap is passed at 0."""
    zero = np.zeros(1, dtype=np.int64)
    guide = Guide(LAB, 1, narrow)
    guide.aim(zero, scenes, zero, np.array([[2.0, 0.0]]))
    return [float(guide.distance(np.array([[x, 0.0]]))[0]) for x in places]


def test_a_narrow_gap_is_gone_around() -> None:
    # The middle keeps 0.55 m. Around, past the columns' far sides at y = 1.55 m and 0.65 m more, it is
    # hypot(1, 2.2) + hypot(2, 2.2) = 5.4 m; the way beside the columns costs up to 0.8 m more where it is near.
    mouth, inside = ways(gap(0.55), 4.0, -1.0, -0.5)
    assert 5.4 < mouth < 7.5
    assert inside > mouth + 0.5  # downhill leads out of the gap
    # Through it, straight on, where the lattice's lines at y = -0.1 and 0.15 keep 0.45 and 0.4 m: n up to 9.8.
    assert ways(gap(0.55), 0.0, -0.5)[0] < inside


def test_a_wide_gap_stays_open() -> None:
    for narrow in (0.0, 4.0):
        far, near = ways(gap(0.9), narrow, -2.0, -0.5)
        assert (far, near) == (pytest.approx(4.0, abs=0.35), pytest.approx(2.5, abs=0.35))


def test_a_start_in_a_narrow_place_finds_its_way() -> None:
    lengths = ways(gap(0.45), 4.0, 0.0, 0.25, 0.5, 1.0)
    assert (np.diff(lengths) < 0.0).all()
    assert lengths[-1] == pytest.approx(1.0, abs=0.1)
    assert lengths[0] < 11.0 * 2.0  # n is at most 1 + 6 + 4


def test_robots_have_ways_of_their_own() -> None:
    scenes = Scenes.of(LAB, LAB.scenarios)
    guide = Guide(LAB, 3)
    goals = np.array([scenario.goal for scenario in LAB.scenarios[:3]])
    guide.aim(np.arange(3), scenes, np.arange(3), goals)
    before = guide.fields.copy()
    guide.aim(np.array([1]), scenes, np.array([4]), goals[:1])
    assert np.array_equal(guide.fields[[0, 2]], before[[0, 2]])
    assert not np.array_equal(guide.fields[1], before[1])
    assert guide.distance(goals)[[0, 2]].max() < 0.2  # interpolated


def test_the_mirror_shows_what_a_robot_in_the_mirrored_world_observes() -> None:
    rng = np.random.default_rng(0)
    circles = np.column_stack([rng.uniform(-4, 4, (6, 2)), rng.uniform(0.1, 0.6, 6)])
    poses = np.column_stack([rng.uniform(-4, 4, (30, 2)), rng.uniform(-3, 3, 30)])
    goals, previous = rng.uniform(-4, 4, (30, 2)), rng.uniform(-1, 1, (30, 2))

    def observe(sign: float) -> torch.Tensor:
        own = Obstacles(circles * [1.0, sign, 1.0])
        scenes = Scenes(LAB.arena, own, np.zeros((1, 0, 3)), np.zeros((1, 0, 4)))
        turn, axis = np.array([1.0, sign, sign]), np.array([1.0, sign])
        view = View(scenes, poses * turn, np.zeros(30, dtype=np.int64), goals * axis, previous * axis)
        observer = Observer(navigation_channels(LAB.robot.lidar), LAB.robot, noise=0.0)
        rows = observer.observe(view, np.random.default_rng(0))
        return torch.from_numpy(np.column_stack([rows, np.ones(30)]))  # with a budget

    mirror = Mirror(make_scaling(LAB.robot, 10.0).channels)
    torch.testing.assert_close(
        mirror.observation(observe(1.0).float()), observe(-1.0).float(), atol=2e-4, rtol=0
    )
    assert mirror.action(torch.tensor([[0.2, 0.7]])).tolist() == [[pytest.approx(0.2), pytest.approx(-0.7)]]
