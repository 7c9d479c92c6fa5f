"""Missions in forms of where runs begin: an oracle's runs stay in the form of their own start, and arrive."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.missions.parking import LOWER, MAP, UPPER, drive, write_parking_policy
from tests.motion.changing_mutants import heading_that_is_frozen, velocity_that_is_not_carried
from viatool import load_map, load_policy, verify
from viatool.cli import main
from viatool.errors import ConfigurationError, InputError
from viatool.loop import successor
from viatool.loop.closed_loop import ClosedLoop
from viatool.loop.destination import NearPlace, StatesReached
from viatool.loop.observation import Sensors
from viatool.loop.successor import fold_apart, hull, name_rests, step
from viatool.missions import MissionLimits, carried, mission
from viatool.missions.carried import CarriedFollower
from viatool.missions.starts import Starts
from viatool.missions.work import MissionExamination
from viatool.motion import straight
from viatool.setting.setting import Setting
from viatool.simulate import roll_out

EPS, MOST, STEPS, RUNS = 0.003, 1.5, 30, 2000
SLACK = 1e-6
"""Metres by which the small steps of the oracle may err."""
BLOCK, YAW, SIDE, COLLISION = np.array([1.9, 0.6]), 0.3, 0.8, 0.05


@pytest.fixture(scope="module")
def policy(tmp_path_factory):
    return load_policy(write_parking_policy(tmp_path_factory.mktemp("policies") / "parking.onnx"))


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    return written(tmp_path_factory.mktemp("maps"))


def written(folder, **changes):
    text = MAP.replace("MOST", str(MOST))
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new)
    path = folder / "park.yaml"
    path.write_text(text, encoding="utf-8")
    return load_map(path)


@pytest.fixture(scope="module")
def driven(policy):
    """Start symbols (RUNS, 4), states (RUNS, STEPS + 1, 4) and their least distance to the block, (RUNS,)."""
    generator = np.random.default_rng(0)
    z = generator.uniform(-1.0, 1.0, (RUNS, 4))
    z[::2] = np.sign(z[::2])
    states = 0.5 * (LOWER + UPPER) + z * 0.5 * (UPPER - LOWER)
    held = generator.choice([-1.0, 1.0], (RUNS, 4))
    found, left = [states], np.full(RUNS, np.inf)
    for _ in range(STEPS):
        drawn = generator.choice([-1.0, 1.0], (RUNS, 4))
        errors = np.where(np.arange(RUNS)[:, None] % 3, held, drawn) * 0.9999 * EPS
        raw = policy.run(np.float32(states[:, [0, 1, 3, 2]] + errors))
        way = drive(states, np.clip(raw, [-3.0, -2.0], [3.0, 2.0]).astype(float), MOST)
        left = np.minimum(left, away(way).min(axis=1))
        states = way[:, -1]
        found.append(states)
    return z, np.stack(found, axis=1), left


def away(states):
    """How far states are from the block, (...)."""
    dx, dy = states[..., 0] - BLOCK[0], states[..., 1] - BLOCK[1]
    a, b = np.cos(YAW) * dx + np.sin(YAW) * dy, -np.sin(YAW) * dx + np.cos(YAW) * dy
    return np.hypot(np.maximum(np.abs(a) - SIDE / 2, 0.0), np.maximum(np.abs(b) - SIDE / 2, 0.0))


def closed_loop(policy, world, eps=EPS):
    setting = Setting.of(policy, world, eps, job="mission")
    return ClosedLoop.of(setting.commanding(policy), setting, setting.scenarios[0])


def beyond(loop, driven):
    """How far runs are beyond the forms of their own starts, at most."""
    z, states, _ = driven
    forms, worst = Starts(LOWER[None], UPPER[None]).forms, -np.inf
    for k in range(1, STEPS + 1):
        forms = fold_apart(name_rests(step(loop, forms).states), 4, 20)
        middle = forms.centre[0] + z @ forms.slope[0, :4]
        own = np.abs(forms.slope[0, 4:]).sum(axis=0) + forms.rest[0]
        worst = max(worst, float((np.abs(states[:, k] - middle) - own).max()))
        if hull(forms).poses.radius.max() > 3.0:
            break
    return worst


def test_runs_stay_in_the_forms_of_their_own_starts(policy, world, driven):
    assert beyond(closed_loop(policy, world), driven) < SLACK


def test_every_run_of_a_proved_mission_stays_in_its_tube_keeps_its_clearance_and_arrives(
    policy, world, driven
):
    found = mission(policy, world, eps=EPS)
    one, (_, states, left) = found.missions[0], driven
    assert one.verdict == "proved"
    assert (one.steps, one.proof.earliest) == (STEPS, STEPS)
    tube = one.proof.tube
    for k in range(1, STEPS):
        lower, upper = tube.lower[tube.step == k], tube.upper[tube.step == k]
        inside = (states[:, k, None] >= lower - SLACK) & (states[:, k, None] <= upper + SLACK)
        assert inside.all(axis=2).any(axis=1).all()
    assert left.min() >= one.clearance - SLACK
    assert one.clearance > COLLISION
    assert (np.abs(states[:, -1, :2]) <= 0.4).all()
    assert (np.abs(states[:, -1, 3]) <= 0.5).all()
    table = found.tube_table()
    assert table["lower"].shape[1] == 4
    assert one.to_json()["task"].endswith("at 6 s")


def no_errors(patch):
    right = Sensors.enclose
    patch.setattr(
        Sensors, "enclose", lambda self, *given, **named: right(replace(self, radii=None), *given, **named)
    )


def half_a_remainder(patch):
    right = straight.left_out

    def wrong(*given):
        (least, most), aside = right(*given)
        return (0.2 * least, 0.2 * most), 0.2 * aside

    patch.setattr(straight, "left_out", wrong)


def symbols_that_are_dropped(patch):
    right = successor.fold
    patch.setattr(successor, "fold", lambda forms, most: replace(right(forms, 1), rest=0.0 * forms.rest))


@pytest.mark.parametrize(
    "mutate",
    [no_errors, velocity_that_is_not_carried, heading_that_is_frozen, symbols_that_are_dropped],
)
def test_runs_catch_forms_that_leave_something_out(mutate, policy, world, driven, monkeypatch):
    loop = closed_loop(policy, world)
    mutate(monkeypatch)
    assert beyond(loop, driven) > 100 * SLACK


def test_runs_without_errors_catch_half_a_remainder(policy, world, monkeypatch):
    """From a box so large that the remainder of the motion is what counts."""
    loop, generator = closed_loop(policy, world, 0.0), np.random.default_rng(1)
    lower, upper = LOWER - np.array([0.0, 0.0, 0.3, 0.5]), UPPER + np.array([0.0, 0.0, 0.3, 0.5])

    def over():
        z = generator.choice([-1.0, 1.0], (RUNS, 4))
        states = 0.5 * (lower + upper) + z * 0.5 * (upper - lower)
        raw = policy.run(np.float32(states[:, [0, 1, 3, 2]]))
        commands = np.clip(raw, [-3.0, -2.0], [3.0, 2.0]).astype(float)
        ends, moved = (
            drive(states, commands, MOST)[:, -1],
            step(loop, Starts(lower[None], upper[None]).forms),
        )
        # the command's own symbols, whatever they are: their share of the heading tells that of the turn
        middle = moved.states.centre[0] + z @ moved.states.slope[0, :4]
        own = np.abs(moved.states.slope[0, 4:]).sum(axis=0) + moved.states.rest[0]
        return float((np.abs(ends - middle) - own)[:, :2].max())

    honest = over()
    half_a_remainder(monkeypatch)
    assert honest < SLACK
    assert over() > honest


def follower(policy, world, **changes):
    setting = Setting.of(policy, world, EPS, job="mission")
    limits = MissionLimits(100, **changes)
    asked = MissionExamination(policy, setting, (0.0, 0.0, 0.0), 0.5, limits, "float32", 0)
    made = asked.follower(closed_loop(policy, world), setting.scenarios[0])
    assert isinstance(made, CarriedFollower)
    return made


def test_a_start_is_cut_where_one_form_does_not_suffice_and_no_part_is_lost(
    policy, tmp_path, driven, monkeypatch
):
    """The same mission, with a goal that one form does not prove: parts of it do, and hold all runs."""
    tight = written(
        tmp_path, **{"[-0.4, -0.4, null, -0.5]": "[0.07, 0.07, null, -0.5]", "[0.4, 0.4": "[0.24, 0.24"}
    )
    some = follower(policy, tight, parts=12)
    proof, (_, states, _) = some.prove(LOWER, UPPER), driven
    assert proof.proved
    assert 1 < proof.start_parts < 40
    k = STEPS // 2
    lower, upper = proof.tube.lower[proof.tube.step == k], proof.tube.upper[proof.tube.step == k]
    assert len(lower) == proof.start_parts

    def lost(lower, upper):
        inside = (states[:, k, None] >= lower - SLACK) & (states[:, k, None] <= upper + SLACK)
        return int((~inside.all(axis=2).any(axis=1)).sum())

    assert lost(lower, upper) == 0
    right = Starts.gridded

    def one_less(self, answers, most):
        all_ = right(self, answers, most)
        return Starts(all_.lower[1:], all_.upper[1:])

    monkeypatch.setattr(carried.Starts, "gridded", one_less)
    halved = some.prove(LOWER, UPPER).tube
    assert lost(halved.lower[halved.step == k], halved.upper[halved.step == k]) > 0


def test_what_cannot_be_proved_says_where(policy, tmp_path):
    tight = written(
        tmp_path, **{"[-0.4, -0.4, null, -0.5]": "[0.16, 0.16, null, -0.5]", "[0.4, 0.4": "[0.165, 0.165"}
    )
    proof = follower(policy, tight, parts=4).prove(LOWER, UPPER)
    assert not proof.proved
    assert "runs may not have arrived" in proof.reason
    found = mission(policy, tight, eps=EPS, limits=MissionLimits(0, parts=2)).missions[0]
    assert found.verdict == "refuted"
    assert "still on its way after 6 s" in found.reason
    near = written(tmp_path, **{"center: [1.9, 0.6]": "center: [1.9, 1.6]"})
    found = mission(policy, near, eps=EPS, limits=MissionLimits(0, parts=2)).missions[0]
    assert found.verdict == "refuted"
    crash = found.crashes
    for k in range(int(crash.step[0])):
        begin = np.hstack([crash.poses[:, k], crash.motions[:, k]])
        after = drive(begin, crash.actions[:, k], MOST)[:, -1]
        np.testing.assert_allclose(after[:, :2], crash.poses[:, k + 1, :2], atol=1e-6)
        np.testing.assert_allclose(after[:, 3:], crash.motions[:, k + 1], atol=1e-9)


def test_arriving_within_a_deadline_ends_a_run_and_at_it_does_not(policy, tmp_path):
    soon = written(
        tmp_path,
        **{
            "arrive: at": "arrive: within",
            "[-0.4, -0.4, null, -0.5]": "[-0.9, -0.9, null, -2]",
            "[0.4, 0.4, null, 0.5]": "[0.9, 0.9, null, 2]",
        },
    )
    one = mission(policy, soon, eps=EPS).missions[0]
    assert one.verdict == "proved"
    assert one.steps < 20
    assert 0 < one.proof.earliest <= one.steps


def test_destinations():
    region = StatesReached(False, np.array([-1.0, -np.inf, -0.1]), np.array([1.0, np.inf, 0.1]))
    box = np.array([[-0.5, 7.0, 2 * np.pi - 0.05], [-0.5, 7.0, 0.05], [0.5, 7.0, 0.05]])
    assert region.surely(box, box + np.array([0.1, 0.1, 0.04])).all()
    assert not region.surely(box, box + np.array([2.0, 0.1, 0.04])).any()
    assert not region.surely(box, box + np.array([0.1, 0.1, 0.4])).any()
    assert region.possibly(box, box + np.array([2.0, 0.1, 0.4])).all()
    assert not region.possibly(box + np.array([0.0, 0.0, 0.5]), box + np.array([0.0, 0.0, 0.6])).any()
    assert region.possibly(np.array([[0.0, 0.0, 0.5]]), np.array([[0.0, 0.0, 6.2]])).all()
    assert region.holds(box).all()
    assert not region.holds(box + np.array([0.0, 0.0, 0.2])).any()
    nan = np.full((1, 3), np.nan)
    for destination in (region, NearPlace(False, np.zeros(2), 1.0)):
        assert not destination.surely(nan, nan).any()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"deadline: 6": "deadline: 6.1"}, r"deadline of scenario 'park' is 6\.1 s"),
        ({"null, 0.5]": "null, 0.5, 1]", "null, -0.5]": "null, -0.5, -1]"}, "limits omega"),
        ({"null, 0.5]": "null, 0.5, 0]", "null, -0.5]": "null, -0.5, 0]"}, "limits omega"),
        ({"-2.3, 0.1]": "-2.3, 0.1, 0.2]", "-2.4, 0.0]": "-2.4, 0.0, 0.0]"}, "limits omega"),
    ],
)
def test_what_a_scenario_may_not_ask_is_refused_by_name(changes, message, policy, tmp_path):
    with pytest.raises(ConfigurationError, match=message):
        mission(policy, written(tmp_path, **changes), eps=EPS)


def test_what_is_given_twice_is_refused(policy, world):
    with pytest.raises(ConfigurationError, match="box of starts"):
        mission(policy, world, eps=EPS, start_error=(0.1, 0.1))
    with pytest.raises(ConfigurationError, match="have a deadline"):
        mission(policy, world, eps=EPS, time_limit=6.0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"upper: [3.1, 3.05, -2.3, 0.1]": "upper: [3.1, 3.05, -2.3]"}, "expected as many numbers"),
        ({"lower: [2.9, 2.95": "lower: [3.9, 2.95"}, "expected at least 3.9"),
        ({"lower: [2.9, 2.95": "lower: [null, 2.95"}, "no null"),
        ({"    deadline: 6\n": ""}, "expected a `deadline`"),
    ],
)
def test_mistakes_of_a_scenario_are_told(changes, message, tmp_path):
    with pytest.raises(InputError, match=message):
        written(tmp_path, **changes)


def test_other_jobs_refuse_boxes_of_starts_and_goals_by_name(policy, world):
    with pytest.raises(ConfigurationError, match="only viatool mission follows"):
        verify(policy, world, eps=EPS)
    with pytest.raises(ConfigurationError, match="a box of starts and a goal of states and a deadline"):
        roll_out(policy, world)


def test_it_is_reported(policy, world, tmp_path, capsys):
    arguments = ["mission", str(policy.path), "--map", str(world.path), "--eps", str(EPS), "--quiet"]
    outputs = {
        name: tmp_path / f"m.{ext}" for name, ext in (("json", "json"), ("tube", "npz"), ("figure", "svg"))
    }
    for name, path in outputs.items():
        arguments += ["--output", f"{name}:{path}"]
    with pytest.raises(SystemExit) as left:
        main([*arguments, "--fail-under", "1"])
    assert left.value.code == 0
    report = json.loads(outputs["json"].read_text())
    assert report["mission_rate"] == {"safe": 1, "total": 1, "rate": 1.0}
    with np.load(outputs["tube"]) as tube:
        assert tube["lower"].shape == tube["upper"].shape == (len(tube["step"]), 4)
    assert outputs["figure"].stat().st_size > 1000
