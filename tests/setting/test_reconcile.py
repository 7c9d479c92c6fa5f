"""What policy and map say of the same thing: they agree, the user decides, or it is refused with a hint that works."""

from dataclasses import replace
from pathlib import Path

import pytest

from tests.hall import write_policy
from viatool import load_map, load_policy
from viatool.errors import ConfigurationError, PolicyError
from viatool.policy.action_channels import Bound, Override
from viatool.setting.setting import Setting
from viatool.setting.wishes import Wishes

LAB = load_map(Path("maps/lab.yaml"))
GRID = load_map(Path("maps/office.ros.yaml"))  # names no robot


@pytest.fixture(scope="module")
def policy(tmp_path_factory):
    return load_policy(write_policy(tmp_path_factory.mktemp("policy") / "policy.onnx"))


def said(policy, **changes):
    """The policy with another specification."""
    return replace(policy, spec=policy.spec.model_copy(update=changes))


def limits(policy, fastest):
    v, omega = policy.spec.action
    return said(policy, action=[v.model_copy(update={"upper": fastest}), omega])


def lidar(policy, **changes):
    first, *others = policy.spec.observation
    sensor = first.lidar.model_copy(update=changes)
    return said(policy, observation=[first.model_copy(update={"lidar": sensor}), *others])


def value_of(setting, name):
    return next(premise for premise in setting.premises if premise.name == name)


CONTRADICTIONS = {
    "interval": (lambda policy: said(policy, control_interval=0.25), ("0.25 s", "0.1 s")),
    "limits": (lambda policy: limits(policy, 2.0), ("0 to 2 m/s", "0 to 0.5 m/s")),
    "lidar": (lambda policy: lidar(policy, maximum_range=3.5), ("3.5", "7")),
}


@pytest.mark.parametrize("matter", CONTRADICTIONS)
def test_a_contradiction_is_refused_with_both_values_and_both_files_and_the_hint_works(policy, matter):
    change, values = CONTRADICTIONS[matter]
    other = change(policy)
    with pytest.raises(ConfigurationError) as refusal:
        Setting.of(other, LAB, 0.01)
    for word in (*values, str(LAB.path), str(policy.path)):
        assert word in refusal.value.message
    for party in ("policy", "map"):
        assert f"--prefer {matter}={party}" in refusal.value.hint
        for preferred in ({matter: party}, {"": party}):
            setting = Setting.of(other, LAB, 0.01, Wishes(prefer=preferred))
            counts = " ".join(premise.value for premise in setting.premises)
            assert values[0 if party == "policy" else 1] in counts


def test_what_counts_reaches_rules_robot_and_sensor(policy):
    slow = Setting.of(said(policy, control_interval=0.25), LAB, 0.01, Wishes(prefer={"": "policy"}))
    assert slow.rules.interval == slow.robot.control_interval == 0.25
    chosen = Setting.of(said(policy, control_interval=0.25), LAB, 0.01, Wishes(interval=0.3))
    assert chosen.rules.interval == chosen.robot.control_interval == 0.3
    assert value_of(chosen, "control interval").source == "--interval"
    fast = Setting.of(limits(policy, 2.0), LAB, 0.01, Wishes(prefer={"limits": "policy"}))
    assert fast.rules.upper.tolist() == [2.0, 1.0]
    clipped = Setting.of(limits(policy, 2.0), LAB, 0.01, Wishes(prefer={"limits": "map"}))
    assert clipped.rules.upper.tolist() == [0.5, 1.0]
    assert "clipped" in value_of(clipped, "commands").source
    short = lidar(policy, maximum_range=3.5)
    for party, most in (("policy", 3.5), ("map", 7.0)):
        setting = Setting.of(short, LAB, 0.01, Wishes(prefer={"lidar": party}))
        assert setting.spec.observation[0].lidar.maximum_range == most


def test_a_policy_within_the_robots_limits_agrees(policy):
    slow = Setting.of(limits(policy, 0.3), LAB, 0.01)
    assert slow.rules.upper.tolist() == [0.5, 1.0]  # what the robot carries out, whoever commands it


def test_a_robot_that_the_user_names_clips_what_the_policy_asks_for(policy):
    setting = Setting.of(policy, LAB, 0.01, Wishes(robot="turtlebot3_burger"))
    assert setting.rules.upper.tolist() == [0.22, 2.84]
    assert setting.robot.lidar == LAB.robot.lidar
    with pytest.raises(ConfigurationError, match="unknown robot 'pepper'"):
        Setting.of(policy, LAB, 0.01, Wishes(robot="pepper"))
    with pytest.raises(
        PolicyError, match="commands angular and linear, a robot of kinematics 'holonomic' takes"
    ):
        Setting.of(policy, LAB, 0.01, Wishes(robot="spot"))


def test_a_map_that_names_no_robot_leaves_it_to_the_policy(policy):
    fast = said(limits(policy, 2.0), control_interval=0.2, robot="jackal")
    setting = Setting.of(fast, GRID, 0.01)
    assert setting.rules.upper.tolist() == [2.0, 1.0]
    assert setting.rules.interval == 0.2
    assert setting.robot.name == "jackal"
    assert setting.rules.footprint.kind == "polygon"
    v, omega = policy.spec.action
    lame = said(policy, action=[v, omega.model_copy(update={"lower": -0.5})])
    with pytest.raises(ConfigurationError, match="limits turns equally"):
        Setting.of(lame, GRID, 0.01)


def test_a_lidar_that_a_map_does_not_describe_binds_nobody(policy, tmp_path):
    text = (
        "arena: {shape: box, center: [0, 0], size: [8, 8]}\nrobot: turtlebot3\n"
        "scenarios: [{start: [0, 0, 0], goal: [2, 2]}]\n"
    )
    (tmp_path / "m.yaml").write_text(text)
    setting = Setting.of(lidar(policy, maximum_range=3.5), load_map(tmp_path / "m.yaml"), 0.01)
    assert setting.spec.observation[0].lidar.maximum_range == 3.5


def test_radii_say_who_gave_them(policy):
    first, *others = policy.spec.observation
    given = said(policy, observation=[first.model_copy(update={"eps": 0.03}), *others])
    setting = Setting.of(given, LAB, {"goal_distance": 0.2, "": 0.01})
    assert value_of(setting, "eps of lidar").value == "0.01 m"
    assert value_of(setting, "eps of goal_distance").source == "--eps"
    with pytest.raises(ConfigurationError, match="no eps"):
        Setting.of(given, LAB, {"goal_distance": 0.2})
    every = [
        c if c.value is not None else c.model_copy(update={"eps": 0.004}) for c in given.spec.observation
    ]
    setting = Setting.of(said(policy, observation=every), LAB, {"lidar": 0.03})
    assert setting.errors.to_json()["lidar"] == 0.03
    assert setting.errors.to_json()["goal_sine"] == 0.004
    assert value_of(setting, "eps of goal_sine").source == "specification"


def test_a_policy_that_cannot_be_asked_is_refused(policy):
    with pytest.raises(PolicyError, match="no specification"):
        Setting.of(replace(policy, spec=None), LAB, 0.01)
    v, omega = policy.spec.action
    with pytest.raises(PolicyError, match="kind 'angular'"):
        Setting.of(said(policy, action=[v, omega.model_copy(update={"kind": "other"})]), LAB, 0.01)
    with pytest.raises(PolicyError, match="takes 26 numbers"):
        Setting.of(said(policy, observation=policy.spec.observation[1:]), LAB, 0.01)


@pytest.mark.parametrize("prefer", [{"speed": "map"}, {"limits": "robot"}])
def test_a_preference_that_does_not_exist_is_refused(prefer):
    with pytest.raises(ConfigurationError, match="choose"):
        Wishes(prefer=prefer)


def test_a_goal_in_an_obstacle_is_refused(policy):
    inside = replace(LAB.scenarios[0], goal=(2.83, 2.93))
    with pytest.raises(ConfigurationError, match=r"goal \(2\.83, 2\.93\)"):
        Setting.of(policy, LAB, 0.01, scenarios=[inside])


def test_a_robot_that_the_user_names_brings_its_body_unless_the_map_states_a_footprint(policy):
    slow = limits(policy, 0.2)
    kept = Setting.of(slow, LAB, 0.01, Wishes(robot="jackal"))
    assert kept.rules.footprint.kind == "point"
    assert "map" in value_of(kept, "footprint").source
    own = Setting.of(slow, GRID, 0.01, Wishes(robot="jackal"))
    assert own.rules.footprint.kind == "polygon"
    assert value_of(own, "footprint").source == "--robot"


def test_a_policy_that_names_another_robot_than_the_map_is_told(policy):
    assert (
        "the policy names jackal"
        in value_of(Setting.of(said(policy, robot="jackal"), LAB, 0.01), "robot").source
    )


def test_a_lidar_that_the_policy_leaves_out_is_among_the_premises(policy):
    first, *others = policy.spec.observation
    silent = said(policy, observation=[first.model_copy(update={"lidar": None}), *others])
    assert "does not describe it" in value_of(Setting.of(silent, LAB, 0.01), "LiDAR 'lidar'").source


def test_a_delay_of_a_thousand_intervals_is_refused(policy):
    with pytest.raises(ConfigurationError, match="more than 1000 control intervals"):
        Setting.of(policy, LAB, 0.01, Wishes(delay=1e9))


def test_a_premise_names_both_files_where_they_agree(policy):
    source = value_of(Setting.of(policy, LAB, 0.01), "control interval").source
    assert str(policy.path) in source
    assert str(LAB.path) in source


def test_the_command_of_a_rule_is_a_command_too(policy):
    """Clipped in silence, a rule that drives at 5 m/s would be judged as if it drove at 0.5 m/s."""
    rule = Override(when={"goal_distance": Bound(below=0.5)}, command=(5.0, 0.0))
    ruled = said(policy, schema_version=2, overrides=[rule])
    with pytest.raises(ConfigurationError, match="the policy or a rule around it commands v 0 to 5 m/s"):
        Setting.of(ruled, LAB, 0.01)
    setting = Setting.of(ruled, LAB, 0.01, Wishes(prefer={"limits": "policy"}))
    assert setting.robot.max_linear == 5.0
