"""What driving robots earn and carry: shaping that is no bait, the cost of standing, the budget of an episode."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from viatool.train import TrainingMaps, make_configuration
from viatool.train.collection import Collector
from viatool.train.methods import METHODS
from viatool.train.networks import Weights
from viatool.train.observation import make_scaling
from viatool.train.run import begin_run, with_margin
from viatool.world import load_map
from viatool.world.world_map import Clearance

LAB = load_map("maps/lab.yaml")
BUDGET = 1.0


def collector(**settings: object) -> Collector:
    """Return four robots without exploration noise."""
    quiet = {"seeds": 1, "robots": 4, "noise_lowest": 0.0, "noise_highest": 0.0}
    options = make_configuration(**(quiet | settings))
    scaling, method = make_scaling(LAB.robot, options.budget_limit), METHODS[options.method](options)
    return Collector(options, LAB, scaling, method, np.full(1, BUDGET), 0)


def driver(v: float) -> Weights:
    """Return an actor that always commands v in m/s, straight on."""
    actor = Weights((26, 4, 2), 1)
    with torch.no_grad():
        actor.layers[-1][0, 0, 0] = math.atanh(v / 0.25 - 1.0)
    return actor


def rewards(robots: Collector, v: float, credit: float = 0.0) -> np.ndarray:
    """Return the unscaled rewards of one step, before which the robots seemed `credit` metres farther away."""
    robots.distance = robots.distance + credit
    transition, _ = robots.step(driver(v), np.full(1, BUDGET))
    return transition.reward[0].numpy() / robots.configuration.reward_scale


@pytest.mark.parametrize(("v", "share"), [(0.001, 0.99), (0.05, 0.5), (0.1, 0.0), (0.4, 0.0)])
def test_standing_costs_and_driving_does_not(v: float, share: float) -> None:
    free = rewards(collector(standing_penalty=0.0), v)
    penalised = rewards(collector(standing_penalty=0.5), v)
    np.testing.assert_allclose(free - penalised, 0.5 * share, atol=1e-4)


def test_a_step_pays_no_more_than_one_in_the_open() -> None:
    # the point half a metre ahead moves 0.05 m with the robot, and 0.05 m across when it turns
    plain = rewards(collector(shaping=0.0), 0.4)
    most = 15.0 * math.hypot(0.05, 0.05)
    np.testing.assert_allclose(rewards(collector(), 0.4, credit=5.0) - plain, most, rtol=1e-4)
    assert (rewards(collector(shaping_capped=False), 0.4, credit=5.0) - plain > 10.0 * most).all()


def test_a_step_back_is_charged_in_full() -> None:
    plain = rewards(collector(shaping=0.0), 0.4)
    lost = rewards(collector(), 0.4, credit=-5.0) - plain
    np.testing.assert_allclose(lost, 15.0 * -5.0, atol=2.0)


@pytest.mark.parametrize(("rule", "after"), [("fixed", BUDGET), ("recursive", BUDGET / 0.96**3)])
def test_the_budget_of_an_episode(rule: str, after: float) -> None:
    robots = collector(budget_rule=rule)
    for _ in range(3):
        transition, _ = robots.step(driver(0.1), np.full(1, BUDGET))
    assert not transition.cost.any()
    np.testing.assert_allclose(robots.observation[0, :, -1].numpy() * 10.0, after, rtol=1e-5)


def test_robots_learn_with_a_margin_that_evaluations_do_not_have() -> None:
    assert with_margin(LAB, 0.05).clearance == Clearance(0.45, 0.55)
    assert with_margin(LAB, 0.0).clearance == LAB.clearance
    options = make_configuration(seeds=1, robots=4, warmup_episodes=0, clearance_margin=0.05)
    run = begin_run(options, TrainingMaps((LAB,)))
    fleet, _ = run.robots()
    assert fleet.collectors[0].simulator.world_map.clearance == Clearance(0.45, 0.55)
    assert run.maps.maps[0].clearance == LAB.clearance
