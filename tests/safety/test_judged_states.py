"""Commands on their way: the closest approach is where and when the robot really is, and nothing is guessed."""

from dataclasses import replace

import numpy as np
import pytest

from tests.safety.brute_force import drive_all, random_world
from tests.safety.cases import make_cases
from viatool.safety import find_contested, judge


def place_at(case, index, command, seconds):
    """Where brute force has the robot so many seconds after it observed: along its queue, then under the command."""
    rules, pose = case.rules, case.observing.poses[index][None]
    whole = int(rules.delay / rules.interval + 1e-9)
    rest = rules.delay - whole * rules.interval
    lasting = ([rest] if rest > 1e-9 else []) + [rules.interval] * whole + [rules.interval]
    for held, most in zip([*case.under_way[index], command], lasting, strict=True):
        spent = min(seconds, most)
        pose = drive_all(pose, held[:1], held[1:], np.array([[spent]]))[:, -1]
        seconds -= spent
    assert seconds < 1e-9
    return pose[0]


@pytest.mark.parametrize("delay", [0.0, 0.06, 0.1, 0.25])
def test_the_robot_is_at_the_closest_approach_at_its_time(delay):
    world = random_world(3)
    case, lower, upper = make_cases(world, "swept", 5, delay=delay)
    commands = case.rules.clip(0.5 * (lower + upper))
    _, seconds, poses = (part[:, 0] for part in case.closest_approach(commands[:, None]))
    assert (seconds <= delay + case.rules.interval + 1e-12).all()
    assert np.ptp(seconds) > 0.0
    for index in range(len(case)):
        there = place_at(case, index, commands[index], seconds[index])
        np.testing.assert_allclose(poses[index][:2], there[:2], atol=1e-9)


@pytest.mark.parametrize("delay", [0.05, 0.25])
def test_a_state_with_an_unknown_command_on_its_way_is_never_safe(delay):
    world = random_world(3)
    case, lower, _ = make_cases(world, "swept", 5, delay=delay)
    stop = np.zeros_like(lower)
    known = judge(case, stop, stop, find_contested(case))
    assert known.safe.any()
    lost = case.under_way.copy()
    lost[::2, 0] = np.nan
    asked = replace(case, under_way=lost)
    contested = find_contested(asked)
    judged = judge(asked, stop, stop, contested)
    for found in (judged.safe, judged.danger, judged.sampled):
        assert not found[::2].any()
    assert contested.collision[::2].all()
    np.testing.assert_array_equal(judged.safe[1::2], known.safe[1::2])


def test_a_queue_of_another_length_is_a_slip_of_the_program():
    case, _, _ = make_cases(random_world(3), "swept", 5, delay=0.25)
    with pytest.raises(ValueError, match="on their way"):
        replace(case, under_way=case.under_way[:, 1:])
