"""Goals that are polygons: boxes and points against an oracle of its own, whole missions, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests import hall
from tests.missions import parking
from tests.missions.dodging import write_dodging_policy
from viatool import load_map, load_policy, verify
from viatool.errors import ConfigurationError, MapError
from viatool.loop.destination import StatesInPolygon
from viatool.missions import mission

FREE = np.full(3, np.inf)


def star(generator):
    """Corners (n, 2) of a simple polygon that is not convex, around the origin."""
    count = int(generator.integers(5, 12))
    angle = 2.0 * np.pi * (np.arange(count) + generator.uniform(-0.3, 0.3, count)) / count
    return (generator.uniform(0.3, 1.0, count) * np.exp(1j * angle)).view(float).reshape(-1, 2)


def crossings(corners, points):
    """Tell which points (..., 2) lie inside, by how often a ray to the right crosses the outline."""
    inside = np.zeros(points.shape[:-1], dtype=bool)
    for (ax, ay), (bx, by) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        x, y = points[..., 0], points[..., 1]
        across = (ay > y) != (by > y)
        with np.errstate(divide="ignore", invalid="ignore"):
            inside ^= across & (x < ax + (y - ay) * (bx - ax) / (by - ay))
    return inside


def wrongly_judged(seed, draws=60):
    """Count boxes that are said to lie inside with a place outside, or that said to be apart with one inside."""
    generator = np.random.default_rng(seed)
    wrong, said = np.zeros(2, int), np.zeros(2, int)
    for _ in range(draws):
        corners = star(generator)
        region = StatesInPolygon(False, -FREE, FREE, corners)
        centre, half = generator.uniform(-1.0, 1.0, (200, 3)), generator.uniform(0.0, 0.4, (200, 3))
        share = generator.uniform(-1.0, 1.0, (1, 400, 2))
        places = centre[:, None, :2] + share * half[:, None, :2]
        inside = crossings(corners, places)
        surely, possibly = (judge(centre - half, centre + half) for judge in (region.surely, region.possibly))
        wrong += (surely & ~inside.all(axis=1)).sum(), (~possibly & inside.any(axis=1)).sum()
        said += surely.sum(), (~possibly).sum()
    assert (said > 100).all()
    return wrong


def test_boxes_are_judged_as_the_places_in_them():
    assert (wrongly_judged(0) == 0).all()


@pytest.mark.parametrize("share", [0.0, 0.7])
def test_boxes_that_are_judged_by_less_than_all_of_them_are_found_out(share, monkeypatch):
    right = StatesInPolygon._places

    def smaller(lower, upper):
        middle, half = 0.5 * (lower + upper), 0.5 * (upper - lower)
        return right(middle - share * half, middle + share * half)

    monkeypatch.setattr(StatesInPolygon, "_places", staticmethod(smaller))
    assert (wrongly_judged(0) > 0).all()


def test_a_polygon_limits_the_place_and_ends_the_rest():
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    region = StatesInPolygon(False, np.array([-np.inf, 0.2, -0.1]), np.array([np.inf, np.inf, 0.1]), square)
    state = np.array(
        [[0.5, 0.5, 0.05], [0.5, 0.1, 0.0], [0.5, 0.5, 0.3], [1.5, 0.5, 0.0], [0.5, 0.5, 2 * np.pi]]
    )
    assert region.holds(state).tolist() == [True, False, False, False, True]
    assert region.surely(state, state).tolist() == [True, False, False, False, True]
    assert region.possibly(state, state).tolist() == [True, False, False, False, True]
    assert region.holds(np.array([1.0, 0.5, 0.0]))
    nan = np.full((1, 3), np.nan)
    assert not region.surely(nan, nan).any()


def parked(folder, goal, **changes):
    text = parking.MAP.replace("MOST", "1.5")
    old = "goal: {lower: [-0.4, -0.4, null, -0.5], upper: [0.4, 0.4, null, 0.5]}"
    for before, after in {old: f"goal: {goal}", **changes}.items():
        assert before in text
        text = text.replace(before, after)
    path = folder / "park.yaml"
    path.write_text(text, encoding="utf-8")
    return load_map(path)


@pytest.fixture(scope="module")
def policy(tmp_path_factory):
    return load_policy(parking.write_parking_policy(tmp_path_factory.mktemp("policies") / "parking.onnx"))


L_SHAPE = "[[-0.5, -0.5], [0.6, -0.5], [0.6, 0.0], [0.35, 0.6], [-0.5, 0.6], [0.0, 0.0]]"


@pytest.mark.parametrize(
    "goal",
    [
        L_SHAPE,
        f"{{shape: polygon, points: {L_SHAPE}, lower: [null, null, null, -0.5], upper: [null, null, null, 0.5]}}",
    ],
)
def test_runs_of_a_proved_mission_end_in_its_polygon(goal, policy, tmp_path):
    world = parked(tmp_path, goal)
    one = mission(policy, world, eps=0.003).missions[0]
    assert one.verdict == "proved"
    assert one.to_json()["task"].startswith("a polygon of 6 corners")
    corners = np.array([[-0.5, -0.5], [0.6, -0.5], [0.6, 0.0], [0.35, 0.6], [-0.5, 0.6], [0.0, 0.0]])
    generator = np.random.default_rng(0)
    states = parking.LOWER + generator.integers(0, 2, (500, 4)) * (parking.UPPER - parking.LOWER)
    for _ in range(30):
        raw = policy.run(np.float32(states[:, [0, 1, 3, 2]] + generator.uniform(-0.003, 0.003, (500, 4))))
        commands = np.clip(raw, [-3.0, -2.0], [3.0, 2.0]).astype(float)
        states = parking.drive(states, commands, 1.5)[:, -1]
    assert crossings(corners, states[:, :2]).all()
    with pytest.raises(ConfigurationError, match="only viatool mission follows"):
        verify(policy, world, eps=0.003)


def test_a_polygon_that_runs_miss_refutes(policy, tmp_path):
    one = mission(policy, parked(tmp_path, "[[-0.5, -0.5], [0.0, -0.5], [-0.5, 0.0]]"), eps=0.003).missions[0]
    assert one.verdict == "refuted"
    assert "still on its way" in one.reason


def test_robots_with_a_lidar_arrive_in_polygons_and_by_their_deadline(tmp_path):
    policy = load_policy(write_dodging_policy(tmp_path / "dodging.onnx"))
    path = tmp_path / "hall.yaml"
    path.write_text(hall.MAP, encoding="utf-8")
    world = load_map(path)
    plain = mission(policy, world, eps=0.01, start_error=(0.02, 0.02), time_limit=9.0).missions[0]
    x, y = plain.scenario.goal
    points = [[x - 0.5, y - 0.5], [x + 0.5, y - 0.5], [x + 0.5, y + 0.5], [x - 0.5, y + 0.5]]
    scenario = replace(plain.scenario, deadline=9.0, region=load_region(tmp_path, points))
    one = mission(policy, world, eps=0.01, start_error=(0.02, 0.02), scenarios=[scenario]).missions[0]
    assert one.verdict == "proved"
    assert one.steps <= plain.steps  # the square holds the disc
    late = replace(scenario, deadline=0.1 * (one.proof.earliest - 1))
    assert mission(policy, world, eps=0.01, scenarios=[late]).missions[0].verdict == "refuted"


def load_region(folder, points):
    """Read a polygon as a map has it."""
    text = parking.MAP.replace("MOST", "1.5").replace("size: [8, 8]", "size: [80, 80]")
    text = text.replace(
        "goal: {lower: [-0.4, -0.4, null, -0.5], upper: [0.4, 0.4, null, 0.5]}", f"goal: {points}"
    )
    path = folder / "polygon.yaml"
    path.write_text(text, encoding="utf-8")
    return load_map(path).scenarios[0].region


@pytest.mark.parametrize(
    ("goal", "message"),
    [
        (
            "[[0, 0], [1, 1], [1, 0], [0, 1]]",
            r"yaml:11: scenarios\[0\]\.goal: the polygon is not a simple polygon",
        ),
        ("[[0, 0], [1, 1]]", r"scenarios\[0\]\.goal: .*at least 3"),
        ("[[0, 0], [1, 1], [0, 0]]", "2 distinct corners, expected at least 3"),
        ("[[0, 0], [1, 1], [2, 2]]", "the polygon is not a simple polygon"),
        ("{shape: polygon, points: [[0, 0], [1, 0]]}", r"scenarios\[0\]\.goal\.points: .*at least 3"),
        ("{shape: circle, points: [[0, 0], [1, 0], [1, 1]]}", r"scenarios\[0\]\.goal\.shape: .*polygon"),
        ("{points: [[0, 0], [1, 0], [1, 1]], lower: [0, 0, 1], upper: [0, 0, 0]}", "expected at least 1"),
        ("{points: [[0, 0], [1, 0], [1, 1]], lower: [null, null, 1]}", "expected as many numbers"),
        ("[[1.8, 0.5], [2.0, 0.5], [2.0, 0.7]]", "lies in an obstacle or outside the arena"),
        ("[[20, 20], [21, 20], [21, 21]]", "lies in an obstacle or outside the arena"),
        ("{lower: [1.8, 0.5], upper: [2.0, 0.7]}", "lies in an obstacle or outside the arena"),
        ("{points: [[0, 0], [1, 0], [1, 1]], lower: [5, 5], upper: [6, 6]}", "holds no place"),
    ],
)
def test_goals_that_nobody_can_mean_are_refused_by_name(goal, message, tmp_path):
    with pytest.raises(MapError, match=message):
        parked(tmp_path, goal)
