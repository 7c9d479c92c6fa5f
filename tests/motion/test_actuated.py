"""Nothing that motors, timing and brakes may do gives a robot a velocity outside of its profile."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.motion.actuated_runs import LIMITS, TERMS, Driver, H, limits, machine
from viatool.motion.actuated import ActuatedMotion
from viatool.motion.actuation import Actuation, Response

RUNS = 150


def drive(seed, kinematics, terms, rim=0.0):
    """Runs of a random machine, and what is known of them."""
    generator = np.random.default_rng(seed)
    asked = machine(generator, kinematics, terms, rim)
    ends = limits(kinematics)
    runs = Driver(generator, kinematics, asked, RUNS, asked.history).drive(*ends)
    known = None
    if "measured" in terms:
        error = generator.uniform(0.0, 0.05, (RUNS, 3))
        off = error * generator.uniform(-1.0, 1.0, (RUNS, 3))
        known = runs.had + off - error - 1e-12, runs.had + off + error + 1e-12
    return runs, ActuatedMotion(asked, (runs.before, runs.before), known)


def outside(runs, course):
    """By how much velocities leave their profile at most."""
    profile = course.profile(np.arange(RUNS), runs.new, runs.new)
    middle, worst = runs.time[:-1] + 0.5 * H, -np.inf
    lag = 3.0 * course._brake_lag if course.machine.deceleration is not None else 0.0
    for run in range(RUNS):
        some = np.arange(len(middle)) < runs.counts[run]
        some &= middle < course.end[run] - lag if lag else True
        stage = np.searchsorted(profile.edges[run], middle[some], side="right") - 1
        beyond = stage >= profile.lower.shape[1]
        low, high = (
            np.where(beyond[:, None], 0.0, end[run][np.minimum(stage, end.shape[1] - 1)])
            for end in (profile.lower, profile.upper)
        )
        seen = runs.velocity[run, some]
        if len(seen):
            worst = max(worst, (low - seen).max(), (seen - high).max())
    return worst


@pytest.mark.parametrize("term", TERMS)
def test_velocities_stay_within_the_profile_of_one_term(term):
    assert outside(*drive(1, "differential", (term,))) <= 1e-3


def without(asked, term):
    """The machine as if it were ideal in a term."""
    ideal = {
        "limits": ("acceleration", "deceleration"),
        "lag": ("lag",),
        "gain": ("relative",),
        "bias": ("absolute",),
    }
    if term in ideal:
        plain = {name: getattr(Response(), name) for name in ideal[term]}
        parts = [replace(response, **plain) for response in asked.actuation.responses]
        return replace(asked, actuation=Actuation(parts[0], parts[1], parts[2], asked.actuation.slip))
    if term == "slip":
        return replace(asked, actuation=replace(asked.actuation, slip=0.0))
    timing = {
        "jitter": {"interval": (float(np.mean(asked.timing.interval)),) * 2},
        "delay": {"delay": (float(np.mean(asked.timing.delay)),) * 2},
        "age": {"age": 0.0},
    }[term]
    return replace(asked, timing=replace(asked.timing, **timing))


@pytest.mark.parametrize("term", ["limits", "lag", "gain", "bias", "slip", "jitter", "delay", "age"])
def test_runs_leave_the_profile_of_a_machine_without_one_term(term):
    runs, motion = drive(
        5, "differential", ("limits", "gain", term) if term in ("jitter", "delay", "age") else (term,)
    )
    assert outside(runs, motion) <= 1e-3
    assert outside(runs, replace(motion, machine=without(motion.machine, term))) > 0.01


def test_runs_leave_a_profile_that_takes_a_measured_velocity_for_exact():
    runs, motion = drive(5, "differential", ("limits", "lag", "measured"))
    middle = 0.5 * (motion.velocity[0] + motion.velocity[1])
    assert outside(runs, motion) <= 1e-3
    assert outside(runs, replace(motion, velocity=(middle, middle))) > 0.01


def test_runs_leave_a_profile_that_forgets_what_was_under_way():
    runs, motion = drive(5, "differential", ("limits",))
    still = (0.0 * runs.before, 0.0 * runs.before)
    assert outside(runs, replace(motion, before=still)) > 0.1


def test_brakes_that_take_hold_late_leave_the_profile_of_brakes_that_do_not():
    runs, motion = drive(5, "differential", ("limits", "jitter", "brake"))
    assert outside(runs, motion) <= 1e-3
    harder = replace(motion.machine, deceleration=5.0)
    assert outside(runs, replace(motion, machine=replace(harder, actuation=Actuation()))) > 0.1


@pytest.mark.parametrize("kinematics", LIMITS)
def test_velocities_stay_within_the_profile_of_all_terms(kinematics):
    assert outside(*drive(2, kinematics, TERMS)) <= 1e-3
    assert outside(*drive(3, kinematics, TERMS[:-2])) <= 1e-3
