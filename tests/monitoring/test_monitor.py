"""The monitor under attack, its mutants, and what it tells."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import viatool
from tests.monitoring.attack import Anything, Attack, Ram
from tests.safety.brute_force import FOOTPRINTS, clearance, drive_all, random_world
from viatool.errors import ConfigurationError
from viatool.monitoring import Guard
from viatool.monitoring.monitor import setting_of_commands
from viatool.monitoring.simulated import simulate_monitored
from viatool.setting.setting import Setting
from viatool.setting.wishes import Wishes
from viatool.simulate.conditions import Conditions
from viatool.uncertainty import ErrorModel

RADII = (0.03, 0.03, 0.04)
POSE = ErrorModel.model_validate({"pose": dict(zip(("x", "y", "theta"), RADII, strict=True))})


@pytest.fixture(scope="module")
def lab():
    return viatool.load_map("lab")


def asked(world, criterion="braking", **wishes):
    return setting_of_commands(world, Wishes(criterion, **wishes))


def attacked(
    world,
    believed,
    *,
    scenarios=(None,),
    radii=RADII,
    delay=0,
    robots=10,
    intervals=40,
    ram=False,
    until=False,
):
    attack = Attack(world, scenarios, believed, radii, 5, robots, delay)
    ends = believed.rules.lower, believed.rules.upper
    source = Ram(*ends, attack.distance) if ram else Anything(*ends)
    return attack.run(source, intervals, until_violation=until)


WORLDS = {
    "circles": lambda: (viatool.load_map("lab"), viatool.load_map("lab").scenarios[:4]),
    **{
        name: lambda name=name: (random_world(3, FOOTPRINTS[name], max_angular=1.0, max_linear=0.6), (None,))
        for name in ("square", "circle")
    },
}


@pytest.mark.parametrize("ram", [False, True], ids=["anything", "ram"])
@pytest.mark.parametrize("name", WORLDS)
def test_no_robot_comes_too_near_whatever_is_commanded(name, ram):
    world, scenarios = WORLDS[name]()
    found = attacked(world, asked(world, errors=POSE), scenarios=scenarios, ram=ram)
    assert found.violations == 0
    assert found.proved == found.intervals
    assert found.least < world.clearance.collision + 0.1


@pytest.mark.parametrize("ram", [False, True], ids=["anything", "ram"])
def test_nor_with_commands_on_their_way(lab, ram):
    believed = asked(lab, errors=POSE, delay=0.15)
    found = attacked(lab, believed, scenarios=lab.scenarios[:2], delay=0.15, ram=ram)
    assert found.violations == 0
    assert found.proved == found.intervals


MUTANTS = {
    "brakes of half the way": {"deceleration": 2.0},
    "no pose error": {"errors": ErrorModel()},
    "no heading error": {"errors": ErrorModel.model_validate({"pose": {"x": 0.03, "y": 0.03}})},
    "no stop": {"deceleration": 1e9},
    "half an interval": {"interval": 0.05},
    "no delay": {"delay": 0.0},
    "a smaller footprint": {"footprint": 0.05},
    "a smaller distance": {"clearance": 0.35},
}


@pytest.mark.parametrize("mutant", MUTANTS)
def test_the_oracle_sees_what_a_monitor_forgets(mutant):
    world = viatool.load_map("lab").with_clearance(0.4, 0.5)
    world = world.with_robot(replace(world.robot, footprint=FOOTPRINTS["circle"], max_angular=2.0))
    told = {"errors": POSE, "delay": 0.1, "criterion": "braking", **MUTANTS[mutant]}
    radii, delay = (0.0, 0.0, 0.5) if mutant == "no heading error" else RADII, 0.1
    if mutant == "no heading error":
        told["errors"] = ErrorModel()
    believed = asked(world, **told)
    found = attacked(
        world, believed, scenarios=world.scenarios[:2], delay=delay, radii=radii, intervals=100, until=True
    )
    assert found.violations > 0


def start(world, number=0):
    return world.scenarios[number], np.array(world.scenarios[number].start, float)


def test_brakes_in_steps_are_on_the_path_of_brakes_that_never_cease(lab):
    manoeuvre = asked(lab).rules.manoeuvre
    command, pose = np.array([[0.5, 0.7]]), np.array([[0.3, -0.2, 0.4]])
    assert manoeuvre.stopping(command) == pytest.approx(0.5)
    here = pose
    for number in range(7):
        told = manoeuvre.braked(command, np.array([number]))
        here = drive_all(here, *told.T, np.array([[0.1]]))[:, 0]
        passed = min((number + 1) * 0.1, 0.5)
        there = drive_all(pose, *command.T, np.array([[passed - passed**2]]))[:, 0]
        np.testing.assert_allclose(here, there, rtol=0.0, atol=1e-12)
    assert (told == 0.0).all()


def test_a_command_passes_until_the_robot_could_not_stop_any_more(lab):
    scenario, pose = start(lab)
    monitor = viatool.Monitor(None, lab, scenario=scenario)
    sources = []
    for _ in range(200):
        found = monitor.decide(pose, [0.5, 0.0])
        assert found.proved
        assert found.passed == (found.source == "policy")
        sources.append(found.source)
        pose = drive_all(pose[None], *found.command[:, None], np.array([[0.1]]))[0, 0]
        if not found.command.any():
            break
    away = clearance(lab, pose[None], lab.robot.footprint, scenario)[0]
    braking = sources.index("brake")
    assert set(sources[:braking]) == {"policy"}
    assert set(sources[braking:]) == {"brake"}
    assert len(sources) - braking == 6  # half a second of brakes, then the robot stands
    assert 0.4 < away < 0.4 + 0.05 + 1e-3


def test_a_policy_and_its_fallback_are_asked_in_turn(lab):
    policy, scenario = viatool.load_policy("via"), lab.scenarios[0]
    states = viatool.roll_out(policy, lab, [scenario])
    monitor = viatool.Monitor(policy, lab, scenario=scenario, fallback=lambda seen: [0.0, 1.0])
    found = monitor(states.poses[10], states.observations[10])
    np.testing.assert_allclose(found.command, policy.run(states.observations[10:11])[0], atol=1e-7)
    assert found.passed
    near = [3.079 - 0.75 - 0.41, 0.53, 0.0]  # in front of an obstacle
    assert monitor.decide(near, [0.5, 0.0]).source == "brake"
    monitor.reset(scenario)
    other = monitor.decide(near, [0.5, 0.0], states.observations[10])
    assert (other.source, other.proved, other.command.tolist()) == ("fallback", True, [0.0, 1.0])
    twice = viatool.Monitor("via", lab, scenario=scenario, fallback="td3")
    assert twice(states.poses[10], states.observations[10]).passed


def test_nothing_is_promised_before_something_is_proved(lab):
    scenario, pose = start(lab)
    monitor = viatool.Monitor(None, lab, scenario=scenario, errors=POSE)
    near = [3.079 - 0.75 - 0.42, 0.53, 0.0]  # clear, but not from every pose within the error
    found = monitor.decide(near, [0.0, 0.5])
    assert (found.source, found.proved, found.command.tolist()) == ("brake", False, [0.0, 0.0])
    assert monitor.decide(pose, [np.nan, 0.0]).proved  # it stands, and is clear
    assert not monitor.decide([np.nan, 0.0, 0.0], [0.0, 0.0]).passed
    monitor.reset(scenario)
    assert not monitor.decide([np.nan, 0.0, 0.0], [0.0, 0.0]).proved
    assert monitor.decide(pose, [0.1, 0.0]).passed


def test_commands_beyond_the_robot_pass_as_it_carries_them_out(lab):
    scenario, pose = start(lab)
    found = viatool.Monitor(None, lab, scenario=scenario).decide(pose, [9.0, -9.0])
    assert found.command.tolist() == [0.5, -1.0]
    assert found.asked.tolist() == [9.0, -9.0]


@pytest.mark.parametrize("speed", [3.0, -3.0, 1.0])
def test_a_car_is_told_no_harder_turn_than_it_steers(lab, speed):
    """It would come to the wall on the way that its wheels allow where the turn it is asked for ends before it."""
    monitor = viatool.Monitor(None, lab, robot="f1tenth", clearance=0.1)
    robot, manoeuvre = monitor.setting.robot, monitor.setting.rules.manoeuvre
    passed = 0
    for gap in np.arange(0.3, 1.5, 0.1):
        pose = np.array([lab.bounds[2] - gap, 0.0, 0.0 if speed > 0.0 else np.pi])
        monitor.reset()
        found = monitor.decide(pose, [speed, 26.0])
        assert abs(found.command[1]) <= abs(found.command[0]) * np.tan(robot.max_steering) / robot.wheelbase
        if found.passed:
            seconds = np.linspace(0.0, manoeuvre.duration(found.command[None])[0], 50)[None]
            steered = abs(speed) * np.tan(robot.max_steering) / robot.wheelbase
            way = drive_all(pose[None], np.array([speed]), np.array([min(26.0, steered)]), seconds)
            assert (clearance(lab, way[0], robot.footprint, None) > 0.1).all()
            passed += 1
    assert passed
    monitor.reset()
    assert monitor.decide([0.0, 0.0, 0.0], [0.0, 5.0]).command.tolist() == [0.0, 0.0]


@pytest.mark.parametrize(
    "answer", [lambda seen: 1 / 0, lambda seen: None, lambda seen: [0.0], lambda seen: "a"]
)
def test_the_robot_brakes_where_the_fallback_fails(lab, answer):
    scenario, pose = start(lab)
    monitor = viatool.Monitor(None, lab, scenario=scenario, fallback=answer)
    assert monitor.decide(pose, [0.5, 0.0]).passed
    with pytest.warns(RuntimeWarning, match="the fallback failed, the robot brakes"):
        found = monitor.decide(pose, [np.nan, 0.0], np.zeros(26))
    assert (found.source, found.proved) == ("brake", True)
    np.testing.assert_allclose(found.command, [0.45, 0.0])


@pytest.mark.parametrize(
    ("name", "command"), [("f1tenth", [1.0, 0.5]), ("spot", [0.5, 0.2, -0.4]), ("mir100", [1.0, 0.3])]
)
def test_without_a_policy_any_robot_is_monitored_that_is_told_velocities(lab, name, command):
    monitor = viatool.Monitor(None, lab, scenario=lab.scenarios[0], robot=name)
    found = monitor.decide(lab.scenarios[0].start, command)
    assert found.passed
    assert found.command.tolist() == command


def test_what_the_monitor_does_not_count_with_is_refused(lab):
    def model(**terms):
        return ErrorModel.model_validate(terms)

    for terms in (
        {"actuation": {"linear": {"lag": [0.1, 0.2]}}},
        {"timing": {"interval": [0.1, 0.2]}},
        {"obstacles": {"speed": 0.2}},
    ):
        with pytest.raises(ConfigurationError, match=f"{next(iter(terms))}"):
            viatool.Monitor(None, lab, errors=model(**terms))
    with pytest.raises(ConfigurationError, match="cannot stand"):
        viatool.Monitor(None, lab.with_robot(replace(lab.robot, min_linear=0.1)))
    with pytest.raises(ConfigurationError, match="says nothing of a stop"):
        Guard(asked(lab, "swept"))
    with pytest.raises(ConfigurationError, match="without a policy"):
        viatool.Monitor(None, lab)([0.0, 0.0, 0.0], np.zeros(26))
    with pytest.raises(ConfigurationError, match=r"a command has shape \(3,\), expected \(2,\)"):
        viatool.Monitor(None, lab).decide([0.0, 0.0, 0.0], [0.0, 0.0, 0.0])


def test_what_roams_is_kept_away_from():
    office = viatool.load_map("office")
    scenario = office.scenarios[0]
    pose = np.array(scenario.start, float)
    roaming = ErrorModel.model_validate({"obstacles": {"roams": {"pillar-1": 50.0}}})
    assert viatool.Monitor(None, office, scenario=scenario).decide(pose, [0.1, 0.0]).passed
    assert (
        not viatool.Monitor(None, office, scenario=scenario, errors=roaming).decide(pose, [0.1, 0.0]).passed
    )


def test_the_simulation_tells_what_the_monitor_changes(lab):
    """A policy that drives straight on collides without it, and under it never comes too near."""

    class StraightOn:
        spec = viatool.load_policy("via").spec
        path, sha256 = "straight-on", ""
        command_map = None

        def run(self, observations):
            return np.tile([0.5, 0.0], (len(observations), 1))

    scenarios = lab.generator.draw(20, 7)
    believed = Setting.of_specification(
        StraightOn.spec, lab, 0.0, Wishes("braking"), scenarios, job="monitor"
    )
    plain = Setting.of_specification(StraightOn.spec, lab, 0.0, Wishes(), scenarios, job="simulate")
    found = simulate_monitored(StraightOn(), plain, believed, seed=1, horizon=200)
    monitored = found.monitored
    assert (found.drive.trajectory.outcomes == "collision").any()
    assert not (monitored.outcomes == "collision").any()
    assert monitored.least_clearance.min() > lab.clearance.collision
    assert ((monitored.interventions > 0) == (found.drive.trajectory.outcomes == "collision")).all()
    assert monitored.unproved.sum() == 0
    assert monitored.intervals > monitored.interventions.sum() > 0


def test_the_simulation_refuses_what_the_monitor_does_not_count_with(lab):
    policy = viatool.load_policy("via")
    setting = Setting.of(policy, lab, 0.0, job="simulate")
    for conditions in (Conditions(drift=0.01), Conditions(acceleration=1.0)):
        with pytest.raises(ConfigurationError, match="the monitor does not count with"):
            simulate_monitored(policy, setting, setting, conditions=conditions)
