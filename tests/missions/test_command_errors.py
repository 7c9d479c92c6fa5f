"""Missions of robots whose commands err: an oracle's runs under errors stay in the sets, and keep the clearance."""

from __future__ import annotations

import numpy as np
import pytest

from tests.missions.parking import LIMITS, LOWER, MAP, UPPER, drive, write_parking_policy
from viatool import load_map, load_policy, mission
from viatool.errors import ConfigurationError, PolicyError
from viatool.loop import successor
from viatool.loop.closed_loop import ClosedLoop
from viatool.loop.successor import fold_apart, name_rests, step
from viatool.missions.starts import Starts
from viatool.motion.command_errors import Strayed
from viatool.sets.forms import PoseBoxes
from viatool.sets.states import StateBoxes
from viatool.setting.setting import Setting
from viatool.setting.wishes import Wishes
from viatool.uncertainty import ErrorModel

MOST, STEPS, RUNS, SLACK = 1.5, 20, 1000, 1e-6
BESIDE = {"linear_acceleration": {"absolute": 0.01}, "angular": {"absolute": 0.003, "relative": 0.003}}
ERRORS = ErrorModel(actuation=BESIDE, source="errors.yaml")


@pytest.fixture(scope="module")
def policy(tmp_path_factory):
    return load_policy(write_parking_policy(tmp_path_factory.mktemp("policies") / "parking.onnx"))


def written(folder, **changes):
    text = MAP.replace("MOST", str(MOST))
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    (folder / "park.yaml").write_text(text, encoding="utf-8")
    return load_map(folder / "park.yaml")


@pytest.fixture(scope="module")
def driven(policy):
    """Symbols of starts (RUNS, 4) and states (RUNS, STEPS + 1, 4): what acts changes within each interval."""
    generator = np.random.default_rng(0)
    z = generator.choice([-1.0, 1.0], (RUNS, 4))
    states = 0.5 * (LOWER + UPPER) + z * 0.5 * (UPPER - LOWER)
    found, held = [states], generator.choice([-1.0, 1.0], (RUNS, 2))
    for _ in range(STEPS):
        raw = policy.run(np.float32(states[:, [0, 1, 3, 2]]))
        told = np.clip(raw, [-3.0, -2.0], [3.0, 2.0]).astype(float)
        most = np.array([0.01, 0.003]) + np.array([0.0, 0.003]) * np.abs(told)
        drawn = generator.choice([-1.0, 1.0], (2, RUNS, 2))
        signs = np.where(np.arange(RUNS)[:, None] % 3 == 0, drawn, held)
        for half in signs:
            states = drive(states, told + half * most, MOST, share=0.5)[:, -1]
        found.append(states)
    return z, np.stack(found, axis=1)


def beyond(policy, world, driven):
    """How far runs are beyond the forms of their own starts, at most; forms that few of the runs reach are lost."""
    setting = Setting.of(policy, world, 0.0, Wishes(errors=ERRORS), job="mission")
    loop = ClosedLoop.of(setting.commanding(policy), setting, setting.scenarios[0])
    (z, states), forms, worst = driven, Starts(LOWER[None], UPPER[None]).forms, -np.inf
    for k in range(1, 5):
        forms = fold_apart(name_rests(step(loop, forms).states), 4, 40)
        middle = forms.centre[0] + z @ forms.slope[0, :4]
        own = np.abs(forms.slope[0, 4:]).sum(axis=0) + forms.rest[0]
        worst = max(worst, float((np.abs(states[:, k] - middle) - own).max()))
    return worst


def test_runs_under_errors_of_commands_stay_in_the_forms_of_their_starts(
    policy, tmp_path, driven, monkeypatch
):
    world = written(tmp_path)
    assert beyond(policy, world, driven) < SLACK
    monkeypatch.setattr(Strayed, "around", lambda self, states: states)
    assert beyond(policy, world, driven) > 100 * SLACK


@pytest.mark.slow
def test_a_mission_under_errors_of_commands_holds_all_runs(policy, tmp_path, driven):
    found = mission(policy, written(tmp_path), eps=0.0, errors=ERRORS)
    one, (_, states) = found.missions[0], driven
    assert one.verdict == "proved"
    tube = one.proof.tube
    for k in range(1, STEPS + 1):
        lower, upper = tube.lower[tube.step == k], tube.upper[tube.step == k]
        inside = (states[:, k, None] >= lower - SLACK) & (states[:, k, None] <= upper + SLACK)
        assert inside.all(axis=2).any(axis=1).all()
    stated = [premise.value for premise in found.premises if premise.name.startswith("actuation.")]
    assert stated[0].startswith("0.003")
    ideal = mission(policy, written(tmp_path), eps=0.0).missions[0]
    assert one.clearance < ideal.clearance


def test_bounds_beside_the_forms_are_widened_too(policy, tmp_path):
    """A robot that stands and is told to stand may have begun to move."""
    setting = Setting.of(policy, written(tmp_path), 0.0, Wishes(errors=ERRORS), job="mission")
    loop = ClosedLoop.of(setting.commanding(policy), setting, setting.scenarios[0])
    after = successor.step(loop, Starts(LOWER[None], UPPER[None]).forms)
    plain = loop.rules.kinematics.displacement(
        after.start.poses, *loop.given_in(after.start, after.lower, after.upper), loop.rules.interval
    )
    assert (after.least < plain[0] - 5e-5).all()
    assert (after.most > plain[1] + 5e-5).all()


@pytest.mark.parametrize("gap", [1e-5, 1.5e-4])
def test_the_clearance_of_a_robot_whose_commands_err_is_that_of_its_nearest_path(gap, policy, tmp_path):
    """Driving straight at a wall: with errors 0.01 m/s^2 for 0.2 s it comes 0.2 mm nearer than without."""
    world = written(tmp_path, **{"collision: 0.05": "collision: 0.0001"})
    setting = Setting.of(policy, world, 0.0, Wishes(errors=ERRORS), job="mission")
    loop = ClosedLoop.of(setting.commanding(policy), setting, setting.scenarios[0])
    side = 5.0  # of the arena, at x = 5
    begin = np.array([[side - 0.2 - 1e-4 - gap, 2.0, 0.0, 1.0]])
    cells = StateBoxes(PoseBoxes(begin[:, :3], np.zeros((1, 3))), begin[:, 3:], begin[:, 3:])
    none = np.zeros((1, 2))
    assert not loop.holds(cells, none, none)[0]
    ideal = Setting.of(policy, world, 0.0, job="mission")
    assert ClosedLoop.of(ideal.commanding(policy), ideal, ideal.scenarios[0]).holds(cells, none, none)[0]


@pytest.mark.parametrize(
    ("terms", "message"),
    [
        ({"linear": {"absolute": 0.1}}, r"actuation\.linear\.absolute is not followed .*second_order_linear"),
        ({"angular": {"lag": (0.0, 0.1)}}, r"actuation\.angular\.lag: motors are followed"),
        ({"angular_acceleration": {"absolute": 0.1}}, r"actuation\.angular_acceleration\.absolute is not"),
        ({"slip": 0.1}, r"actuation\.slip is not followed"),
    ],
)
def test_what_is_not_followed_is_refused_by_name(terms, message, policy, tmp_path):
    with pytest.raises(ConfigurationError, match=message):
        mission(policy, written(tmp_path), eps=0.0, errors=ErrorModel(actuation=terms))


def test_who_does_not_follow_them_refuses_them(policy, tmp_path):
    for job in ("verify", "certify", "simulate"):
        with pytest.raises(ConfigurationError, match="viatool mission alone"):
            Setting.of(policy, written(tmp_path), 0.0, Wishes(errors=ERRORS), (), job=job)
    with pytest.raises(ConfigurationError, match="braking"):
        mission(policy, written(tmp_path), eps=0.0, errors=ERRORS, criterion="braking")
    with pytest.raises(ConfigurationError, match=r"actuation\.linear_acceleration is not followed"):
        mission("via", "lab", errors=ErrorModel(actuation={"linear_acceleration": {"absolute": 0.1}}))


def test_a_velocity_that_is_commanded_and_measured_is_refused(policy, tmp_path):
    spec = policy.spec.model_copy(deep=True)
    channels = [
        channel.model_copy(update={"kind": "angular_velocity"} if channel.kind == "heading" else {})
        for channel in spec.observation
    ]
    spec = spec.model_copy(update={"observation": channels})
    with pytest.raises(PolicyError, match="differs from the command"):
        mission(load_policy(policy.path, spec), written(tmp_path), eps=0.0, errors=ERRORS)
    assert set(LIMITS) == {"linear_acceleration", "angular"}
