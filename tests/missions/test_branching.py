"""Runs that branch: they keep within the errors, get nearer than others, and refute what few runs do not."""

from __future__ import annotations

import numpy as np
import pytest

from tests.loop.noisy_runs import runs
from viatool.loop.closed_loop import ClosedLoop
from viatool.loop.horizon import Horizon
from viatool.loop.runs import drive
from viatool.loop.tube import TubeFollower
from viatool.missions import MissionLimits, attack, branching, mission
from viatool.missions.branching import branch
from viatool.missions.follow import MissionFollower
from viatool.missions.work import MissionExamination
from viatool.setting.setting import Setting

EPS, START, STEPS = 0.05, (0.02, 0.02), 42


@pytest.fixture
def few(monkeypatch):
    monkeypatch.setattr(branching, "RUNS", 200)


@pytest.fixture
def follower(hall, dodging):
    limits = MissionLimits(STEPS)
    setting = Setting.of(dodging, hall, EPS, job="mission")
    examination = MissionExamination(dodging, setting, (0.02, 0.02, 0.02), 0.5, limits, "float32", 0)
    loop = ClosedLoop.of(dodging, setting, hall.scenarios[0])
    return MissionFollower(loop, 0.5, limits), *examination.starts(hall.scenarios[0])


def test_runs_that_branch_begin_at_starts_and_err_within_eps(few, follower, hall, dodging):
    some, lower, upper = follower
    sizes = some.loop.setting.radii * (1.0 - 1e-6)
    starts, errors = branch(some, lower, upper, sizes, seed=0)
    assert ((starts >= lower) & (starts <= upper)).all()
    assert (np.abs(errors) <= sizes).all()
    poses, _ = runs(dodging, hall, hall.scenarios[0], (starts[:, :3], starts[:, 3:]), errors)
    tubes = TubeFollower(some.loop, 0.5, Horizon(STEPS), some.destination)
    found = drive(tubes, starts[:, :3], starts[:, 3:], errors, told=some.told(2))
    assert np.abs(found.ends - poses).max() < 1e-5


def test_the_nearest_run_is_nearer_than_all_that_are_driven_without_an_aim(few, follower):
    some, lower, upper = follower
    sizes = some.loop.setting.radii * (1.0 - 1e-6)
    starts, errors = branch(some, lower, upper, sizes, seed=0)
    generator = np.random.default_rng(0)
    others = lower + generator.random((200, len(lower))) * (upper - lower)
    drawn = generator.choice([-1.0, 1.0], (200, STEPS, len(sizes))) * sizes
    tubes = TubeFollower(some.loop, 0.5, Horizon(STEPS), some.destination)
    left = [
        drive(tubes, start[:, :3], start[:, 3:], off, told=some.told(len(start))).clearance.min()
        for start, off in ((starts[:1], errors[:1]), (others, drawn))
    ]
    assert left[0] < left[1]


def test_a_mission_that_few_runs_do_not_refute_is_refuted_by_those_that_branch(
    few, hall, dodging, monkeypatch
):
    monkeypatch.setattr(attack, "_far", lambda runs, limit: True)  # no search for a collision
    given = {"eps": EPS, "start_error": START, "scenarios": hall.scenarios[:1], "time_limit": 9.0}
    asked = {"clearance": 0.443, "limits": MissionLimits(0, parts=5, finer=0)}
    (found,) = mission(dodging, hall, **given, **asked)
    assert found.verdict == "refuted"
    assert "a run comes within 0.4" in found.reason
    assert len(found.arrived) == 48 + 2  # which are looked for where the 48 refute nothing
