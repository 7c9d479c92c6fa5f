"""The physics engine against geometry, against the unicycle, and against itself."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from tests.needs import WITHOUT_PYBULLET
from viatool.errors import ConfigurationError
from viatool.policy.specification import ObservationChannel
from viatool.setting.reconcile import with_robot
from viatool.simulate import Conditions, NavigationSimulator, Simulator, make_simulator
from viatool.simulate.models import MODELS
from viatool.uncertainty import ErrorModel
from viatool.world import ROBOTS, Footprint, Lidar, Obstacles, Scenario, Scenes, WorldMap, load_map

if WITHOUT_PYBULLET:
    pytest.skip("pybullet has no wheel for this Python", allow_module_level=True)

from viatool.simulate.bullet import BulletSimulator
from viatool.simulate.bullet.world import BulletWorld

MAPS = [
    f"{name}{kind}" for name in ("lab", "office", "corridor", "warehouse") for kind in ("", "-grid", ".ros")
]


@cache
def world_named(name: str) -> WorldMap:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("warnings.warn", lambda *_, **__: None)  # maps may say something odd about themselves
        return load_map(f"maps/{name}.yaml")


@pytest.fixture(scope="module")
def lab() -> WorldMap:
    return load_map("maps/lab.yaml")


def free_poses(world_map: WorldMap, scenario: Scenario | None, count: int, seed: int) -> np.ndarray:
    """Return random poses where the body of any robot has room."""
    x_min, y_min, x_max, y_max = world_map.bounds
    rng = np.random.default_rng(seed)
    drawn = rng.uniform((x_min, y_min, -np.pi), (x_max, y_max, np.pi), (40 * count, 3))
    scenes = Scenes.of(world_map, [scenario])
    return drawn[scenes.clearance(drawn[:, :2], np.zeros(len(drawn), int)) > 0.35][:count]


@pytest.mark.parametrize("term", [{"angle": 0.3}, {"thin": 2.0}], ids=lambda term: next(iter(term)))
def test_an_analytic_lidar_errs_as_a_whole_in_both_engines(lab: WorldMap, term: dict[str, float]) -> None:
    scenarios, seen = [lab.scenarios[0]], []
    errors = ErrorModel.model_validate({"sensor": {"lidar": term}})
    for engine, model in (("kinematic", errors), ("bullet", errors), ("bullet", ErrorModel())):
        lidar = None if engine == "kinematic" else "analytic"
        simulator = make_simulator(
            engine, lab, 1, lidar=lidar, scenarios=scenarios, noise=0.0, errors=model, adversary=True, seed=3
        )
        seen.append(simulator.reset())
        simulator.close()
    kinematic, bullet, plain = seen
    assert bullet == pytest.approx(kinematic, abs=1e-6)
    assert np.abs(bullet - plain).max() > 0.05


@pytest.mark.parametrize("name", MAPS)
def test_both_engines_observe_the_same_at_the_same_pose(name: str) -> None:
    world_map = world_named(name)
    scenario = world_map.scenarios[0] if world_map.scenarios else None
    own = Obstacles() if scenario is None else scenario.obstacles
    goal = (0.0, 0.0) if scenario is None else scenario.goal
    poses = free_poses(world_map, scenario, 12, seed=1)
    scenarios = [Scenario(f"{index}", tuple(pose), goal, own) for index, pose in enumerate(poses.tolist())]
    observations = []
    for engine in ("kinematic", "bullet"):
        simulator = make_simulator(
            engine, world_map, 1 if engine == "bullet" else 12, scenarios=scenarios, noise=0.0
        )
        rounds = 12 // len(simulator)
        observations.append(np.concatenate([simulator.reset() for _ in range(rounds)]))
        simulator.close()
    kinematic, bullet = observations
    assert kinematic[:, 20:] == pytest.approx(bullet[:, 20:], abs=1e-6)
    # A ray that grazes an edge may pass on one side in one engine; then a hair more or less of turn explains it.
    lidar = replace(world_map.robot.lidar, rays=180)
    scenes = Scenes.of(world_map, [scenario])
    lowest, highest = kinematic[:, :20].copy(), kinematic[:, :20].copy()
    for turn in (-2e-3, -5e-4, 5e-4, 2e-3):
        for shift in (-2e-3, 0.0, 2e-3):
            moved = poses + np.array([0.0, 0.0, turn])
            moved[:, :2] += shift * np.stack([-np.sin(poses[:, 2]), np.cos(poses[:, 2])], axis=1)
            ranges = scenes.cast(moved, np.zeros(12, int), lidar).reshape(12, 20, 9).min(axis=2)
            ranges = np.maximum(ranges, lidar.minimum_range)
            np.minimum(lowest, ranges, out=lowest)
            np.maximum(highest, ranges, out=highest)
    assert (bullet[:, :20] >= lowest - 5e-3).all()
    assert (bullet[:, :20] <= highest + 5e-3).all()
    assert (np.abs(kinematic[:, :20] - bullet[:, :20]) < 5e-3).mean() > 0.97


@pytest.mark.parametrize("robot", [name for name, model in MODELS.items() if not model.pushed])
def test_constant_commands_end_where_the_unicycle_ends(lab: WorldMap, robot: str) -> None:
    empty = replace(with_robot(lab, robot), obstacles=Obstacles())
    limits = ROBOTS[robot]
    acceleration = MODELS[robot].acceleration
    fast = min(limits.max_linear, 1.0)  # two seconds have to fit into the arena
    turning = min(limits.max_angular, 2.0)
    commands = [(fast, 0.0), (0.5 * fast, turning), (0.5 * fast, -0.5 * turning), (0.0, turning), (fast, 0.3)]
    start = Scenario("", (-3.5, -3.5, 0.3), (4.0, 4.0))
    ends = []
    for engine in ("kinematic", "bullet"):
        simulator = make_simulator(
            engine,
            empty,
            len(commands),
            scenarios=[start] * len(commands),
            conditions=Conditions(acceleration=acceleration),
        )
        simulator.reset()
        for _ in range(20):
            simulator.step(np.array(commands))
        ends.append(simulator.poses.copy())
        simulator.close()
    away = np.hypot(*(ends[0] - ends[1])[:, :2].T)
    turned = np.abs(np.angle(np.exp(1j * (ends[0] - ends[1])[:, 2])))
    assert away.max() < 0.02
    assert turned.max() < 0.03
    assert np.hypot(*(ends[1][0] - start.start)[:2]) > 0.8 * fast * 2.0 - fast**2 / acceleration


def ramped(start: np.ndarray, command: np.ndarray, most: np.ndarray, seconds: float) -> np.ndarray:
    """Where a body gets whose velocity ahead, turning and to the left grows evenly, by the midpoint rule."""
    (x, y, theta), held, step = start, np.zeros(3), 1e-3
    for _ in range(round(seconds / step)):
        held = held + np.clip(command - held, -most * step, most * step)
        middle = theta + 0.5 * step * held[1]
        x += step * (held[0] * np.cos(middle) - held[2] * np.sin(middle))
        y += step * (held[0] * np.sin(middle) + held[2] * np.cos(middle))
        theta += step * held[1]
    return np.array([x, y, theta])


@pytest.mark.parametrize(
    ("robot", "commands"),
    [
        ("spot", [(0.8, 0.0, 0.0), (0.5, 1.0, 0.3), (0.0, 0.0, -0.6), (-0.4, -0.8, 0.5), (0.0, 1.5, 0.0)]),
        ("f1tenth", [(1.0, 0.0), (0.8, 0.7), (0.8, -0.7), (-0.5, 0.4), (0.0, 0.0)]),
    ],
)
def test_a_pushed_body_goes_where_its_velocity_leads(
    lab: WorldMap, robot: str, commands: list[tuple[float, ...]]
) -> None:
    model = MODELS[robot]
    empty = replace(with_robot(lab, robot), obstacles=Obstacles())
    start = Scenario("", (-2.5, -2.5, 0.3), (4.0, 4.0))
    with BulletSimulator(
        empty, len(commands), scenarios=[start] * len(commands), lidar="analytic"
    ) as simulator:
        simulator.reset()
        for _ in range(20):
            simulator.step(np.array(commands))
        ends = simulator.poses.copy()
    most = np.array([model.acceleration, model.acceleration / model.reach, model.acceleration])
    for command, end in zip(commands, ends, strict=True):
        full = np.array([*command, 0.0][:3])
        expected = ramped(np.array(start.start), full, most, 20 * empty.robot.control_interval)
        assert np.hypot(*(end - expected)[:2]) < 0.01, command
        assert abs(np.angle(np.exp(1j * (end - expected)[2]))) < 0.01, command


@pytest.mark.parametrize(("robot", "command"), [("spot", (0.0, 0.0, 0.8)), ("f1tenth", (0.8, 0.0))])
def test_a_pushed_body_does_not_pass_through_what_it_touches(
    lab: WorldMap, robot: str, command: tuple[float, ...]
) -> None:
    world = with_robot(lab.with_clearance(0.001, 0.001), robot)
    aside = robot == "spot"
    post = [0.0, 0.8, 0.1] if aside else [1.0, 0.0, 0.1]
    scenario = Scenario("post", (0.0, 0.0, 0.0), (3.0, 0.0), Obstacles(np.array([post])))
    narrow = replace(world, robot=replace(world.robot, footprint=Footprint()))
    with BulletSimulator(narrow, 1, scenarios=[scenario], lidar="analytic") as simulator:
        simulator.reset()
        for _ in range(30):
            step = simulator.step(np.array([command]))
            if step.collision[0]:
                break
        x, y, _ = simulator.poses[0]
    assert step.collision[0]
    front = MODELS[robot].outline[:, 1 if aside else 0].max()  # of the body, from the origin
    assert (y if aside else x) == pytest.approx((0.8 if aside else 1.0) - 0.1 - front, abs=0.04)


@pytest.mark.parametrize("robot", ["spot", "f1tenth"])
def test_both_engines_fill_the_observations_of_robots_without_driven_wheels(
    robot: str, lab: WorldMap
) -> None:
    kinds = ["linear_velocity", "angular_velocity", "pose_x", "pose_y", "heading", "goal_x", "goal_y"]
    kinds += ["lateral_velocity", "previous_lateral"] if robot == "spot" else []
    channels = [ObservationChannel(name=kind, kind=kind, size=1) for kind in kinds]
    world = replace(with_robot(lab, robot), obstacles=Obstacles())
    scenario = Scenario("", (-2.5, -2.5, 0.3), (4.0, 4.0))
    command = np.array([[0.5, 0.4, 0.3][: 3 if robot == "spot" else 2]])
    seen = []
    for engine in ("kinematic", "bullet"):
        simulator = make_simulator(engine, world, 1, scenarios=[scenario], channels=channels, noise=0.0)
        simulator.reset()
        for _ in range(15):
            step = simulator.step(command)
        seen.append(step.observation[0])
        simulator.close()
    kinematic, bullet = (dict(zip(kinds, row.tolist(), strict=True)) for row in seen)
    for kind in kinds:
        near = 0.02 if "velocity" in kind or "previous" in kind else 0.2  # the body starts from rest
        assert bullet[kind] == pytest.approx(kinematic[kind], abs=near), kind


def test_a_body_of_another_kind_of_robot_is_refused_by_name(lab: WorldMap) -> None:
    robot = replace(ROBOTS["spot"], name="jackal")
    with pytest.raises(ConfigurationError, match="'jackal', which moves as 'holonomic', is not known"):
        BulletSimulator(replace(lab, robot=robot), 1, scenarios=lab.scenarios)


def test_a_robot_that_stands_stays(lab: WorldMap) -> None:
    with BulletSimulator(lab, 1, scenarios=lab.scenarios, lidar="analytic") as simulator:
        simulator.reset()
        before = simulator.poses.copy()
        for _ in range(30):
            simulator.step(np.zeros((1, 2)))
        assert simulator.poses == pytest.approx(before, abs=1e-3)


def drive(simulator: Simulator, steps: int) -> list[np.ndarray]:
    rng = np.random.default_rng(0)
    seen = [simulator.reset()]
    for _ in range(steps):
        commands = rng.uniform((0.0, -1.0), (0.5, 1.0), (len(simulator), 2))
        step = simulator.step(commands)
        seen += [step.observation, simulator.poses.copy()]
        if step.done.any():
            seen.append(simulator.reset(step.done))
    return seen


ROUGH = Conditions(noise=0.02, dropout=0.05, lidar_rate=5.0, delay=0.15, drift=0.02)


def test_a_seed_decides_everything_however_many_processes_there_are(lab: WorldMap) -> None:
    runs = []
    for workers, seed in ((1, 3), (2, 3), (1, 4)):
        with BulletSimulator(lab, 3, workers=workers, conditions=ROUGH, seed=seed) as simulator:
            runs.append(drive(simulator, 12))
            if workers == 1:  # nothing of the first run is left in the engine
                simulator.reseed(seed)
                runs.append(drive(simulator, 12))
    first, again, shared, other, _ = runs
    for run in (again, shared):
        assert all((a == b).all() for a, b in zip(first, run, strict=True))
    assert (first[0] != other[0]).any()


def test_a_body_that_touches_an_obstacle_has_collided(lab: WorldMap) -> None:
    narrow = replace(lab.with_clearance(0.001, 0.001), arena=lab.arena)
    post = Scenario("post", (0.0, 0.0, 0.0), (3.0, 0.0), Obstacles(np.array([[0.5, 0.0, 0.1]])))
    ends = {}
    for engine in ("kinematic", "bullet"):
        simulator = make_simulator(engine, narrow, 1, scenarios=[post], noise=0.0)
        simulator.reset()
        for _ in range(40):
            step = simulator.step(np.array([[0.5, 0.0]]))
            if step.collision[0]:
                break
        ends[engine] = float(simulator.poses[0, 0])
        simulator.close()
    # the point drives up to the post, the Waffle's front half of 0.14 m before that
    assert ends["kinematic"] > 0.39
    assert 0.2 < ends["bullet"] < 0.28


@pytest.fixture(scope="module")
def worlds(lab: WorldMap) -> Iterator[BulletWorld]:
    world = BulletWorld(lab, MODELS["turtlebot3"], 1.0, 1.0 / 120.0)
    yield world
    world.close()


def test_memory_is_flat_over_a_thousand_resets(worlds: BulletWorld) -> None:
    box = np.array([[0.0, 2.5], [0.4, 2.5], [0.4, 2.8], [0.0, 2.8]])
    boxes = tuple(box + 0.01 * index for index in range(3))
    own = Obstacles(np.array([[2.0, 0.0, 0.5], [-2.0, 0.5, 0.25]]), boxes)

    def resident() -> float:
        with open("/proc/self/statm", encoding="ascii") as stream:
            return int(stream.read().split()[1]) * 4096 / 1e6

    before = 0.0
    for reset in range(1100):
        if reset == 100:
            before = resident()
        # now and then without obstacles, and elsewhere
        shifted = replace(own, circles=own.circles + np.array([0.001 * reset, 0.0, 0.0]))
        worlds.place(np.array([0.0, 0.0, 0.01 * reset]), shifted if reset % 7 else Obstacles())
    assert resident() - before < 2.0  # MB


def test_rays_do_not_see_the_robot_itself(worlds: BulletWorld, lab: WorldMap) -> None:
    worlds.place(np.zeros(3), Obstacles())
    around = Lidar(field_of_view=2.0 * np.pi, rays=360, bins=1)
    ranges = worlds.cast(around.directions(), 7.0)
    assert ranges.min() > 1.0
    expected = Scenes.of(lab, [None]).cast(np.zeros((1, 3)), np.zeros(1, int), around)[0]
    assert np.median(np.abs(ranges - expected)) < 1e-6


def test_obstacles_of_a_scenario_come_and_go(worlds: BulletWorld) -> None:
    ray = np.array([[1.0], [0.0]])
    wall = np.array([[1.0, -1.0], [1.2, -1.0], [1.2, 1.0], [1.0, 1.0]])
    turned = wall @ np.array([[0.0, 1.0], [-1.0, 0.0]])  # a quarter to the left
    for own, theta, expected in (
        (Obstacles(), 0.0, 4.85),
        (Obstacles(polygons=(wall,)), 0.0, 1.0),
        (Obstacles(polygons=(turned,)), 0.5 * np.pi, 1.0),
        (Obstacles(polygons=(turned,)), 0.0, 4.85),
        (Obstacles(np.array([[1.5, 0.0, 0.25]])), 0.0, 1.25),
        (Obstacles(np.array([[1.5, 0.0, 0.25]]), (wall,)), 0.0, 1.0),
        (Obstacles(np.array([[2.0, 0.0, 0.25]])), 0.0, 1.75),
        (Obstacles(), 0.0, 4.85),
    ):
        worlds.place(np.array([0.0, 0.0, theta]), own)
        assert worlds.cast(ray, 7.0)[0] == pytest.approx(expected, abs=2e-3)


def test_what_cannot_be_simulated_is_refused(lab: WorldMap) -> None:
    with pytest.raises(ConfigurationError, match="unknown engine 'gazebo'"):
        make_simulator("gazebo", lab, 1)
    with pytest.raises(ConfigurationError, match="unknown robot 'pepper'"):
        with_robot(lab, "pepper")
    with pytest.raises(ConfigurationError, match="unknown LiDAR"):
        make_simulator("bullet", lab, 1, lidar="sonar")
    with pytest.raises(ConfigurationError, match="no ray tests"):
        make_simulator("kinematic", lab, 1, lidar="rays")
    with pytest.raises(ConfigurationError, match="0 workers"):
        make_simulator("bullet", lab, 1, workers=0)
    mine = lab.with_robot(replace(lab.robot, name="homemade"))
    with pytest.raises(ConfigurationError, match=r"'homemade'.* is not known"):
        make_simulator("bullet", mine, 1)
    inside = Scenario("inside", (2.83, 2.93, 0.0), (0.0, 0.0))
    walled = Scenario("walled", (0.0, 0.0, 0.0), (4.9, 0.0))
    for engine in ("kinematic", "bullet"):
        with pytest.raises(ConfigurationError, match=r"start .* of scenario 'inside' lies in an obstacle"):
            make_simulator(engine, lab, 1, scenarios=[inside])
        with pytest.raises(ConfigurationError, match=r"goal .* of scenario 'walled' lies in an obstacle"):
            make_simulator(engine, lab, 1, scenarios=[walled])
    tight = Scenario("tight", (4.7, 0.0, 0.0), (0.0, 0.0))  # 0.15 m from the wall
    NavigationSimulator(lab, 1, scenarios=[tight]).reset()
    with (
        BulletSimulator(with_robot(lab, "jackal"), 1, scenarios=[tight], lidar="analytic") as simulator,
        pytest.raises(ConfigurationError, match="body of jackal does not fit"),
    ):
        simulator.reset()
