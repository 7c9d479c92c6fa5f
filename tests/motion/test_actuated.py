"""Nothing that motors, timing and brakes may do gives a robot a velocity outside of its profile."""

from __future__ import annotations

import numpy as np
import pytest

from tests.motion.actuated_runs import LIMITS, TERMS, Driver, H, limits, machine
from viatool.motion.actuated import ActuatedMotion

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


@pytest.mark.parametrize("kinematics", LIMITS)
def test_velocities_stay_within_the_profile_of_all_terms(kinematics):
    assert outside(*drive(2, kinematics, TERMS)) <= 1e-3
    assert outside(*drive(3, kinematics, TERMS[:-2])) <= 1e-3
