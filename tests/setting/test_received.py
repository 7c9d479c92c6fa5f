"""Commands on their way: known from what was observed or recorded, or not known at all."""

from pathlib import Path

import numpy as np
import pytest

from tests.hall import write_policy
from viatool import load_map, load_policy
from viatool.errors import ConfigurationError, TrajectoryError
from viatool.setting.received import commands_before, commands_under_way
from viatool.setting.setting import Setting
from viatool.setting.wishes import Wishes
from viatool.simulate import Conditions
from viatool.simulate.roll_out import drive
from viatool.trajectory import Trajectory
from viatool.uncertainty import ErrorModel

LAB = load_map(Path("maps/lab.yaml"))
COMMANDS = np.stack([np.linspace(0.0, 0.45, 10), np.linspace(-0.9, 0.9, 10)], axis=1)


@pytest.fixture(scope="module")
def policy(tmp_path_factory):
    return load_policy(write_policy(tmp_path_factory.mktemp("policy") / "policy.onnx"))


def recording(policy, *, observed=True, recorded=True, time=None, **more):
    """Ten states of one episode, an interval apart, with the commands `COMMANDS`."""
    spec = policy.spec
    observations = np.full((10, spec.observation_size), 1.0)
    first = spec.columns("previous_linear")[0]
    observations[:, first : first + 2] = np.vstack([[0.3, 0.1], COMMANDS[:-1]]) if observed else 7.0
    return Trajectory(
        poses=np.zeros((10, 3)),
        observations=observations,
        actions=COMMANDS if recorded else np.zeros((10, 0)),
        episode=np.zeros(10, dtype=np.int64),
        time=np.arange(10) * 0.1 if time is None else time,
        outcomes=np.array(["unknown"]),
        costs=np.array([np.nan]),
        scenarios=(None,),
        **more,
    )


@pytest.mark.parametrize(
    "stated", [{"delay": 1.5}, {"timing": {"delay": [0.0, 1.5]}}], ids=["option", "model"]
)
def test_a_delay_longer_than_the_recording_is_refused(policy, stated):
    """Its ten states last 0.9 s."""
    errors = ErrorModel.model_validate({key: value for key, value in stated.items() if key == "timing"})
    wishes = Wishes(delay=stated.get("delay", 0.0), errors=errors)
    asked = Setting.of(policy, LAB, 0.01, wishes, job="verify")
    with pytest.raises(TrajectoryError, match=r"up to 1\.5 s .* takes 0\.9 s"):
        commands_under_way(asked, recording(policy))


def setting(policy, delay, **spec):
    asked = Setting.of(policy, LAB, 0.01, Wishes(delay=delay))
    assert asked.rules.dead_time.commands == int(np.ceil(delay / 0.1 - 1e-9))
    return asked


@pytest.mark.parametrize("delay", [0.03, 0.1, 0.25, 0.3])
def test_the_queue_holds_what_was_given_and_nothing_is_guessed_before_the_recording(policy, delay):
    asked = setting(policy, delay)
    queue = commands_under_way(asked, recording(policy))
    count = asked.rules.dead_time.commands
    for row in range(10):
        for place in range(count):
            given = row - (count - place)  # the state in which the command was given
            if given >= 0:
                np.testing.assert_allclose(queue[row, place], COMMANDS[given])
            elif given == -1:
                np.testing.assert_allclose(queue[row, place], [0.3, 0.1])  # observed in the first state
            else:
                assert np.isnan(queue[row, place]).all()


def test_a_gap_in_the_recording_ends_what_is_known(policy):
    late = np.arange(10) * 0.1 + 0.4 * (np.arange(10) >= 5)
    known = np.isfinite(commands_under_way(setting(policy, 0.2), recording(policy, time=late))).all(
        axis=(1, 2)
    )
    assert known.tolist() == [False, True, True, True, True, False, True, True, True, True]


def test_what_contradicts_itself_is_not_known(policy):
    other = recording(policy)
    other.actions[3, 0] += 0.01
    before = commands_before(setting(policy, 0.1), other)
    assert np.flatnonzero(np.isnan(before).any(axis=1)).tolist() == [4]


def test_a_robot_of_a_simulation_stands_before_its_first_command(policy):
    simulated = recording(policy, observed=False, from_rest=True)
    simulated.observations[:] = 0.0
    start = policy.spec.columns("previous_linear")[0]
    simulated.observations[1:, start : start + 2] = COMMANDS[:-1]
    queue = commands_under_way(setting(policy, 0.3), simulated)
    assert np.isfinite(queue).all()
    np.testing.assert_array_equal(queue[0], 0.0)
    np.testing.assert_allclose(queue[2], [[0.0, 0.0], COMMANDS[0], COMMANDS[1]])
    later = simulated.select(np.arange(10) >= 4)  # a part of it does not begin at rest
    assert np.isnan(commands_under_way(setting(policy, 0.3), later)[0, :2]).all()


@pytest.mark.parametrize("delay", [0.1, 0.3])
def test_the_queue_moves_the_robot_as_the_simulator_does(policy, delay):
    """From every driven state, the commands on their way lead to where the simulator is after the dead time."""
    from tests.safety.brute_force import drive_all

    asked = setting(policy, delay)
    path = drive(policy, asked, conditions=Conditions(noise=0.0, delay=delay), seed=1).trajectory
    queue = commands_under_way(asked, path)
    whole = round(delay / 0.1)
    ends, here = path.poses, np.flatnonzero(path.episode[whole:] == path.episode[:-whole])
    poses = path.poses[here]
    for place in range(whole):
        poses = drive_all(poses, *queue[here, place].T, np.array([[0.1]]))[:, -1]
    away = poses[:, :2] - ends[here + whole, :2]
    assert np.abs(away).max() < 1e-6


def test_a_dead_time_without_any_command_is_refused(policy):
    spec = policy.spec
    fixed = [
        c.model_copy(update={"value": 0.0} if c.name.startswith("previous") else {}) for c in spec.observation
    ]
    asked = Setting.of_specification(
        spec.model_copy(update={"observation": fixed}), LAB, 0.01, Wishes(delay=0.1)
    )
    with pytest.raises(ConfigurationError, match="neither observed nor recorded"):
        commands_under_way(asked, recording(policy, recorded=False))
    queue = commands_under_way(asked, recording(policy))
    np.testing.assert_allclose(queue[1:, 0], COMMANDS[:-1])  # not the value to which the channel is fixed
    assert np.isnan(queue[0]).all()


def test_a_command_that_was_assumed_is_not_known(policy):
    """As a bag's before its first Twist, where the robot is taken to stand still."""
    told = np.arange(10) >= 2
    some = recording(policy, recorded=False, commanded=told)
    queue = commands_under_way(setting(policy, 0.1), some)
    assert np.isnan(queue).any(axis=(1, 2)).tolist() == (~told).tolist()
    kept = some.select(np.arange(10) >= 1)
    assert kept.commanded.tolist() == told[1:].tolist()


@pytest.mark.parametrize("spacing", [0.05, 0.075, 0.13, 0.2])
def test_rows_that_are_not_an_interval_apart_do_not_follow_one_another(policy, spacing):
    sparse = recording(policy, recorded=False, time=np.arange(10) * spacing)
    queue = commands_under_way(setting(policy, 0.2), sparse)
    assert np.isnan(queue[:, 0]).all()


def test_a_recording_without_a_clock_tells_nothing_of_older_commands(policy, tmp_path):
    from viatool import load_trajectory

    whole = recording(policy)
    for name, clock in (("with", {"time": np.arange(10) * 1.0}), ("without", {})):
        np.savez(tmp_path / f"{name}.npz", pose=whole.poses, observation=whole.observations, **clock)
    asked = Setting.of(policy, LAB, 0.01, Wishes(interval=1.0, delay=2.0))
    with_clock, without = (
        commands_under_way(asked, load_trajectory(tmp_path / f"{name}.npz")) for name in ("with", "without")
    )
    assert np.isfinite(with_clock[1:]).all()
    assert np.isnan(without[:, 0]).all()


def test_only_the_first_state_of_a_simulation_begins_at_rest(policy):
    """Also where commands are asked about that are held much longer than they were."""
    simulated = recording(policy, observed=False, from_rest=True)
    fixed = [
        c.model_copy(update={"value": 0.0} if c.name.startswith("previous") else {})
        for c in policy.spec.observation
    ]
    spec = policy.spec.model_copy(update={"observation": fixed})
    asked = Setting.of_specification(spec, LAB, 0.01, Wishes(interval=2.0, delay=2.0))
    queue = commands_under_way(asked, simulated)
    np.testing.assert_array_equal(queue[0], 0.0)
    assert np.isnan(queue[1:]).all()
