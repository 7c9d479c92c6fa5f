"""Motors and clocks over time: what an oracle drives in a closed loop stays in tubes and missions, and keeps clear."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import viatool
from tests.loop.motor_runs import Motors, Oracle, drive
from tests.loop.noisy_runs import sensor_errors
from tests.sight.ray_oracle import outlines, scan
from viatool.cli import main
from viatool.errors import ConfigurationError, PolicyError
from viatool.loop.closed_loop import ClosedLoop
from viatool.loop.horizon import Horizon
from viatool.loop.keeping import clearance_kept
from viatool.loop.successor import LoopStep
from viatool.loop.tube import TubeFollower
from viatool.motion import actuated_sets
from viatool.sets.forms import Forms, PoseBoxes
from viatool.sets.states import StateBoxes
from viatool.setting.setting import Setting
from viatool.setting.wishes import Wishes
from viatool.simulate import roll_out
from viatool.uncertainty import ErrorModel
from viatool.world import Scenes
from viatool.world.scenario import StateRange

EPS, ROUNDING = 0.01, 1e-6
LAB, VIA = viatool.load_map("maps/lab.yaml"), viatool.load_policy("via")
AT_ONCE = {
    "gain": (
        {"actuation": {"linear": {"relative": 0.05}, "angular": {"relative": 0.05}}},
        {"relative": (0.05, 0, 0.05)},
    ),
    "bias": (
        {"actuation": {"linear": {"absolute": 0.02}, "angular": {"absolute": 0.03}}},
        {"absolute": (0.02, 0, 0.03)},
    ),
    "slip": ({"actuation": {"slip": 0.05}}, {"slip": 0.05}),
    "jitter": ({"timing": {"interval": [0.095, 0.105]}}, {"interval": (0.095, 0.105)}),
}
SLOW = {
    "limits": (
        {"actuation": {"linear": {"acceleration": [1.0, 2.0]}, "angular": {"acceleration": 3.0}}},
        {
            "speeding": ((1.0, 2.0), (1.0, 1.0), (3.0, np.inf)),
            "slowing": ((1.0, 2.0), (1.0, 1.0), (3.0, np.inf)),
        },
    ),
    "lag": (
        {"actuation": {"linear": {"lag": [0.02, 0.05]}, "angular": {"lag": [0.0, 0.05]}}},
        {"lag": ((0.02, 0.05), (0.0, 0.0), (0.0, 0.05))},
    ),
}
LATE = {
    "delay": ({"timing": {"delay": [0.02, 0.05]}}, {"delay": (0.02, 0.05)}),
    "sensing": ({"timing": {"sensing": 0.01}}, {"sensing": 0.01}),
}
TERMS = AT_ONCE | SLOW | LATE
TUBES = TERMS | {"long delay": ({"timing": {"delay": [0.11, 0.13]}}, {"delay": (0.11, 0.13)})}
ALL = (
    {
        "actuation": {
            "linear": {"acceleration": 2.0, "lag": [0.0, 0.02], "relative": 0.01, "absolute": 0.002},
            "angular": {"acceleration": 6.0, "lag": [0.0, 0.02], "relative": 0.01, "absolute": 0.002},
            "slip": 0.01,
        },
        "timing": {"interval": [0.098, 0.102], "delay": [0.005, 0.015], "sensing": 0.002},
    },
    {
        "speeding": ((2.0, np.inf), (1.0, 1.0), (6.0, np.inf)),
        "slowing": ((2.0, np.inf), (1.0, 1.0), (6.0, np.inf)),
        "lag": ((0.0, 0.02), (0.0, 0.0), (0.0, 0.02)),
        "relative": (0.01, 0.0, 0.01),
        "absolute": (0.002, 0.0, 0.002),
        "slip": 0.01,
        "interval": (0.098, 0.102),
        "delay": (0.005, 0.015),
        "sensing": 0.002,
    },
)


def deciding(policy, world, scenario, errors):
    """What policies of 20 bins, goal, previous command and budget command, sensor errors (R, K, n) added."""
    shapes, goal = outlines(world, scenario), np.array(scenario.goal)
    low = np.array([world.robot.min_linear, -world.robot.max_angular])
    high = np.array([world.robot.max_linear, world.robot.max_angular])

    def decide(poses, before, k):
        away = goal - poses[:, :2]
        bearing = np.arctan2(away[:, 1], away[:, 0]) - poses[:, 2]
        seen = [
            np.hypot(*away.T),
            np.cos(bearing),
            np.sin(bearing),
            before[:, 0],
            before[:, 2],
            0.0 * bearing,
        ]
        seen = np.hstack([scan(poses, world.robot.lidar, shapes), np.stack(seen, axis=1)])
        told = np.clip(policy.run(np.float32(seen + errors[:, k])), low, high).astype(float)
        return np.stack([told[:, 0], 0.0 * bearing, told[:, 1]], axis=1)

    return decide


def runs(policy, world, scenario, start, motors, steps, seed=0):
    """Poses (R, K, 3) at observations, and poses between (R, K, N, 3), from poses and commands (R, 3) each."""
    poses, before = start
    oracle, generator = Oracle(Motors(**motors), len(poses), seed), np.random.default_rng(seed)
    errors = sensor_errors(generator, Setting.of(policy, world, EPS).radii, len(poses), steps)
    begun = oracle.begin(poses, before, np.repeat(before[:, None], 4, axis=1))
    found = drive(oracle, begun, deciding(policy, world, scenario, errors), steps)
    return found[0], found[1]


def asked(terms, **more):
    return ErrorModel.model_validate(terms | more)


def nearest(world, scenario, poses, radius=0.0):
    """The distance (...) from poses (..., 3) to obstacles and walls."""
    flat = poses.reshape(-1, 3)
    scenes = Scenes.of(world, [scenario])
    return scenes.clearance(flat[:, :2], np.zeros(len(flat), np.int64)).reshape(poses.shape[:-1]) - radius


def follower(terms, steps):
    setting = Setting.of(VIA, LAB, EPS, Wishes(errors=asked(terms)), job="verify with a horizon")
    return TubeFollower(ClosedLoop.of(VIA, setting, LAB.scenarios[0]), 0.5, Horizon(steps))


STEPS, STATES, RUNS = 5, 6, 300


@pytest.fixture(scope="module")
def begun():
    driven = roll_out(VIA, LAB, LAB.scenarios[:1], seed=0)
    rows = np.linspace(5, len(driven) - 20, STATES).astype(int)
    return driven.poses[rows], driven.observations[rows][:, 23:25]


def of_lab(begun, motors):
    poses, before = (np.repeat(part, RUNS, axis=0) for part in begun)
    before = np.stack([before[:, 0], 0.0 * before[:, 0], before[:, 1]], axis=1)
    found, between = runs(VIA, LAB, LAB.scenarios[0], (poses, before), motors, STEPS)
    return (part.reshape(STATES, RUNS, *part.shape[1:]) for part in (found, between))


def followed(begun, terms):
    some = follower(terms, STEPS)
    poses, before = begun
    groups = len(some.loop.rules.carried) // 2
    return some.follow(poses, np.tile(before, groups))


def excess(tubes, found):
    return float(np.maximum(found - tubes.upper[:, None], tubes.lower[:, None] - found).max())


@pytest.mark.parametrize("name", [*TUBES, "all"])
def test_runs_stay_in_their_tubes_at_their_clearance_and_leave_those_of_ideal_robots(begun, name):
    terms, motors = TUBES.get(name, ALL)
    found, between = of_lab(begun, motors)
    tubes = followed(begun, terms)
    assert excess(tubes, found) < ROUNDING
    left = nearest(LAB, LAB.scenarios[0], between).min(axis=3)
    assert (left >= tubes.clearance[:, None] - ROUNDING).all()
    assert excess(followed(begun, {}), found) > 100 * ROUNDING


@pytest.mark.parametrize("name", AT_ONCE)
def test_more_of_a_term_that_may_be_nothing_never_proves_more(begun, name):
    few, none = followed(begun, TERMS[name][0]), followed(begun, {})
    assert (few.lower <= none.lower + ROUNDING)[..., :2].all()  # headings are cut elsewhere
    assert (few.upper >= none.upper - ROUNDING)[..., :2].all()
    assert (few.clearance <= none.clearance + ROUNDING).all()
    assert (few.steps <= none.steps).all()


def in_tube(one, found):
    """By how much runs that have not arrived leave every part of their interval, at most."""
    goal, worst, tube = np.array(one.scenario.goal), 0.0, one.proof.tube
    going = np.ones(len(found), dtype=bool)
    for k in range(found.shape[1]):
        going &= np.hypot(*(found[:, k, :2] - goal).T) >= 0.5
        if going.any():
            parts, poses = tube.step == k + 1, found[going, k][:, None]
            if not parts.any():
                return np.inf
            over = np.maximum(tube.lower[parts, :3] - poses, poses - tube.upper[parts, :3])
            worst = max(worst, float(over.max(axis=2).min(axis=1).max()))
    return worst


def of_mission(dodging, hall, one, motors, count=500):
    start = np.repeat([one.scenario.start], count, axis=0), np.zeros((count, 3))
    return runs(dodging, hall, one.scenario, start, motors, one.steps)


@pytest.mark.parametrize("name", [*TERMS, "all"])
def test_missions_hold_all_runs_from_the_start_to_the_goal(hall, dodging, name):
    terms, motors = TERMS.get(name, ALL)
    (one,) = viatool.mission(
        dodging, hall, eps=EPS, errors=asked(terms), scenarios=hall.scenarios[1:], time_limit=12.0
    )
    assert one.verdict == "proved"
    found, between = of_mission(dodging, hall, one, motors)
    assert in_tube(one, found) < ROUNDING
    away = np.hypot(*np.moveaxis(found[:, :, :2] - np.array(one.scenario.goal), 2, 0))
    assert (away < 0.5).any(axis=1).all()
    assert (away < 0.5).argmax(axis=1).min() + 1 >= one.proof.earliest
    driving = np.logical_and.accumulate(
        np.concatenate([away[:, :1] > 0.0, away[:, :-1] >= 0.5], axis=1), axis=1
    )
    left = nearest(hall, one.scenario, between).min(axis=2)
    assert (left[driving] >= one.clearance - ROUNDING).all()
    assert one.arrival[0] - 1e-9 <= one.driven_arrival[0] <= one.driven_arrival[1] <= one.arrival[1] + 1e-9


def beyond_what_is_carried(dodging, hall, steps=12, count=200):
    """By how much runs leave every part of their interval in pose, commands on their way or velocity, at most."""
    terms, motors = ALL
    (one,) = viatool.mission(
        dodging, hall, eps=EPS, errors=asked(terms), scenarios=hall.scenarios[1:], time_limit=0.1022 * steps
    )
    oracle, none = Oracle(Motors(**motors), count), np.zeros((count, 3))
    generator, radii = np.random.default_rng(0), Setting.of(dodging, hall, EPS).radii
    decide = deciding(dodging, hall, one.scenario, sensor_errors(generator, radii, count, one.steps))
    tube, worst = one.proof.tube, 0.0
    older = (tube.lower.shape[1] - 5) // 2
    now = oracle.begin(np.repeat([one.scenario.start], count, axis=0), none, np.zeros((count, 4, 3)))
    for k in range(one.steps):
        now = oracle.follow(now, decide(now.poses, now.commands[:, 0], k))
        behind = now.commands[:, :older, ::2].reshape(count, -1), now.velocity[:, ::2]
        here, parts = np.concatenate([now.poses, *behind], axis=1)[:, None], tube.step == k + 1
        over = np.maximum(tube.lower[parts] - here, here - tube.upper[parts])
        worst = max(worst, float(over.max(axis=2).min(axis=1).max()))
    return worst


def test_sets_hold_the_commands_on_their_way_and_the_velocity(hall, dodging, monkeypatch):
    assert beyond_what_is_carried(dodging, hall) < ROUNDING
    honest = actuated_sets._behind

    def as_told(*given):
        found = honest(*given)
        return Forms(found.centre, found.slope, 0.0 * found.rest)

    monkeypatch.setattr(actuated_sets, "_behind", as_told)
    assert beyond_what_is_carried(dodging, hall) > 100 * ROUNDING


@pytest.mark.parametrize("criterion", ["swept", "braking"])
def test_the_stop_is_from_the_velocity_that_the_robot_has(hall, dodging, criterion):
    """Straight at a wall: at 0.5 m/s, and told to stand, it rolls on for 12.5 cm at 1 m/s^2."""
    terms = {"actuation": {"linear": {"acceleration": 1.0}, "angular": {"acceleration": 3.0}}}
    setting = Setting.of(dodging, hall, EPS, Wishes(criterion, errors=asked(terms)), job="mission")
    loop = ClosedLoop.of(dodging, setting, hall.scenarios[0])
    none, told = np.zeros((1, 3)), np.zeros((1, 2))
    for had, way in ((0.5, 0.125 if criterion == "braking" else 0.045), (0.0, 0.0)):
        behind = np.array([[0.0, 0.0, had, 0.0]])
        cells = StateBoxes(PoseBoxes(np.array([[3.0 - 0.8, 0.0, 0.0]]), none), behind, behind)
        after = LoopStep(
            np.zeros(1, np.int64), cells, told, told, none, none, told, told, Forms(none, none[:, None], none)
        )
        least, _ = clearance_kept(loop, cells, after.start, after.lower, after.upper)
        assert 0.8 - way - 0.02 <= least[0] <= 0.8 - way + 1e-6


def test_a_time_limit_counts_the_longest_intervals(hall, dodging):
    terms = asked({"timing": {"interval": [0.08, 0.12], "sensing": 0.0}})
    given = {"eps": EPS, "errors": terms, "scenarios": hall.scenarios[1:]}
    found = viatool.mission(dodging, hall, time_limit=6.0, **given)
    assert found.limits.steps == 50
    assert found.missions[0].verdict == "unknown"
    assert "still be on their way" in found.missions[0].reason


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"arrive": "at", "deadline": 7.0}, "need not end then"),
        ({"starts": ((-1.5, -2.0, 0.0, 0.4), (-1.5, -2.0, 0.0, 0.6))}, "has v from 0.4 to 0.6"),
        (
            {"region": ((1.0, -3.0, -4.0, 0.0), (2.0, -1.0, 4.0, 0.5))},
            "limits v, which is not what was commanded",
        ),
    ],
)
def test_what_varying_time_leaves_open_is_refused_by_name(hall, dodging, change, message):
    change = {name: StateRange(*box) if isinstance(box, tuple) else box for name, box in change.items()}
    one = replace(hall.scenarios[1], **change)
    errors = asked({"timing": {"interval": [0.09, 0.11]}})
    with pytest.raises(ConfigurationError, match=message):
        viatool.mission(dodging, hall, eps=EPS, errors=errors, scenarios=[one])


def test_a_velocity_that_is_measured_is_refused_by_name(hall, dodging):
    channels = [
        one.model_copy(update={"kind": "linear_velocity"}) if one.kind == "previous_linear" else one
        for one in dodging.spec.observation
    ]
    measuring = viatool.load_policy(dodging.path, dodging.spec.model_copy(update={"observation": channels}))
    with pytest.raises(PolicyError, match="motors and timing are those of an error model"):
        viatool.mission(measuring, hall, eps=EPS, errors=asked(TERMS["lag"][0]))


def test_verify_follows_recorded_states_with_motors_and_a_delay():
    """Tubes begin with the commands and the velocity that the recording allows, and hold what was recorded later."""
    terms = asked({"actuation": {"linear": {"lag": [0.02, 0.05]}}, "timing": {"delay": [0.02, 0.05]}})
    driven = roll_out(VIA, LAB, LAB.scenarios[:1], seed=3, errors=terms)
    found = viatool.verify(VIA, LAB, eps=EPS, errors=terms, trajectory=driven, horizon=3)
    tubes = found.horizon.tubes
    assert np.isfinite(tubes.lower[5:-4]).all()
    for k in range(3):
        later = driven.poses[6 + k : len(driven) - 4 + k]
        turn = np.round((later[:, 2] - tubes.lower[5 : len(driven) - 5, k, 2]) / (2.0 * np.pi)) * 2.0 * np.pi
        later = later - turn[:, None] * [0.0, 0.0, 1.0]
        assert (later >= tubes.lower[5 : len(driven) - 5, k] - ROUNDING).all()
        assert (later <= tubes.upper[5 : len(driven) - 5, k] + ROUNDING).all()


def test_a_mission_begins_with_the_speed_that_its_start_names(hall, dodging):
    """Runs that begin at half of their speed, told so for long, are held; those at rest are not."""
    terms, motors = SLOW["limits"]
    one = replace(
        hall.scenarios[1], starts=StateRange((-1.5, -2.0, 0.0, 0.25, 0.0), (-1.5, -2.0, 0.0, 0.25, 0.0))
    )
    (found,) = viatool.mission(dodging, hall, eps=EPS, errors=asked(terms), scenarios=[one], time_limit=9.0)
    assert found.verdict == "proved"
    poses, before = np.repeat([one.start], 300, axis=0), np.repeat([[0.25, 0.0, 0.0]], 300, axis=0)
    assert in_tube(found, runs(dodging, hall, one, (poses, before), motors, found.steps)[0]) < ROUNDING
    assert in_tube(found, runs(dodging, hall, one, (poses, 0.0 * before), motors, 6)[0]) > 1e-3


def test_a_report_assumes_nothing_that_the_error_model_contradicts(hall, dodging, tmp_path, capsys):
    (tmp_path / "e.yaml").write_text(
        "actuation: {slip: 0.01}\ntiming: {delay: [0.0, 0.02]}\nobstacles: {speed: 0.01}\n", encoding="utf-8"
    )
    asked_for = ["mission", str(dodging.path), "--map", str(hall.path), "--scenario", "1", "--eps", "0.01"]
    with pytest.raises(SystemExit) as left:
        main([*asked_for, "--errors", str(tmp_path / "e.yaml"), "--time-limit", "9"])
    assert left.value.code == 0
    told = " ".join(capsys.readouterr().out.split())
    assert "100.00 % of 1 mission are proved" in told
    for idle in ("without slip", "commands act at once", "nothing on it moves"):
        assert idle not in told
    assert "act within timing.delay 0 to 0.02 s, but for actuation.slip 0.01 share" in told
