"""A mission of a policy that was trained to be proved: the tube holds what an oracle drives, and every run arrives."""

from __future__ import annotations

import numpy as np
import pytest

from tests.loop.noisy_runs import runs as drive
from tests.loop.noisy_runs import sensor_errors
from tests.missions.test_mission import EPS, ROUNDING, RUNS, START, outside
from viatool import load_map, load_policy
from viatool.loop import told_apart
from viatool.missions import MissionLimits, mission

LAB, POLICY = load_map("maps/lab.yaml"), load_policy("policies/via-mission.onnx")
SCENARIO = LAB.scenarios[7]
LIMITS = MissionLimits(130, finer=0)


class WithoutCommands:
    """The program, given the observations of the lab's other policies."""

    def run(self, observations):
        return POLICY.run(np.delete(observations, [23, 24], axis=1))


@pytest.fixture(scope="module")
def runs():
    """Poses (R, K, 3) of adversarial runs, from corners and the inside of the box of starts."""
    generator = np.random.default_rng(0)
    share = generator.uniform(-1.0, 1.0, (RUNS, 3))
    share[::2] = np.sign(share[::2])
    starts = np.array(SCENARIO.start) + share * np.array([START[0], START[0], START[1]])
    radii = np.array([EPS] * 23 + [0.0] * 3)
    errors = sensor_errors(generator, radii, RUNS, LIMITS.steps)
    return drive(WithoutCommands(), LAB, SCENARIO, (starts, np.zeros((RUNS, 2))), errors)[0]


def followed():
    (found,) = mission(POLICY, LAB, eps=EPS, start_error=START, scenarios=[SCENARIO], limits=LIMITS)
    return found


def test_a_mission_is_proved_and_holds_every_run(runs):
    found = followed()
    assert found.verdict == "proved"
    assert found.proof.most_parts < 1000
    assert outside(found.proof.tube, runs, SCENARIO) < ROUNDING
    far = np.hypot(*(runs[:, : found.steps, :2] - np.array(SCENARIO.goal)).transpose(2, 0, 1))
    assert far.min(axis=1).max() < 0.5


def test_rays_that_are_followed_less_far_than_the_network_sees_lose_runs(runs, monkeypatch):
    honest = told_apart.ceilings
    monkeypatch.setattr(told_apart, "ceilings", lambda network: 0.6 * honest(network))
    assert outside(followed().proof.tube, runs, SCENARIO) > 1e-3
