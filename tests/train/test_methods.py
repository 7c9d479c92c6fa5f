"""What distinguishes the methods, by hand-computed numbers."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from viatool.train.configuration import make_configuration
from viatool.train.methods import METHODS, Method
from viatool.train.methods.method import EpochCosts
from viatool.train.methods.wcsac import gaussian_cvar_factor, variance_target
from viatool.train.networks import TrainedNetwork, Weights
from viatool.train.replay import Batch

COSTS = EpochCosts(var=3.0, episodes=np.array([0.0, 0.0, 2.0, 6.0]), start=4.0)


def method(name: str, **options: float) -> Method:
    return METHODS[name](make_configuration(**({"alpha": 0.5, "cost_limit": 8.0} | options)))


def batch(reward: float, cost: float, discount: float, count: int = 1) -> Batch:
    zeros, ones = torch.zeros(1, count, 3), torch.ones(1, count)
    return Batch(zeros, zeros, torch.zeros(1, count, 2), reward * ones, cost * ones, discount * ones)


def test_each_method_judges_the_constraint_in_its_own_way() -> None:
    deviation = math.sqrt((4 + 4 + 0 + 16) / 4)
    expected = {
        "td3": None,
        "td7": None,
        "rcpo": 8.0 - 2.0,
        "sac-lag": 8.0 - 2.0,
        "wcsac": 8.0 - 2.0 - gaussian_cvar_factor(0.5) * deviation,
        "cvar-cpo": 8.0 - 3.0 - 4.0,
        "via": 8.0 - 3.0 - 2.0,
    }
    assert {name: method(name).slack(COSTS) for name in METHODS} == pytest.approx(expected)


def test_via_can_judge_by_the_cvar_itself() -> None:
    assert method("via", multiplier_rule="cvar").slack(COSTS) == pytest.approx(8.0 - 4.0)  # type: ignore[arg-type]


def test_the_gaussian_cvar_is_the_mean_of_the_tail() -> None:
    assert gaussian_cvar_factor(0.5) == pytest.approx(2 / math.sqrt(2 * math.pi))
    draws = np.sort(np.random.default_rng(0).standard_normal(1_000_000))
    assert gaussian_cvar_factor(0.9) == pytest.approx(draws[900_000:].mean(), rel=1e-2)


def test_the_variance_target_is_that_of_the_bellman_equation() -> None:
    # cost 1 and then, discounted by 0.5, a cost of mean 2 and variance 3: mean 2, variance 0.25 * 3
    target = variance_target(
        torch.tensor([[2.0]]), torch.tensor([[2.0]]), torch.tensor([[3.0]]), batch(0.0, 1.0, 0.5)
    )
    assert target.item() == pytest.approx(0.75)
    known = variance_target(
        torch.tensor([[1.0]]), torch.tensor([[9.0]]), torch.tensor([[9.0]]), batch(0, 1, 0)
    )
    assert known.item() == pytest.approx(1e-4)


def test_only_rcpo_learns_a_penalised_reward() -> None:
    transition, multiplier = batch(5.0, 2.0, 1.0), torch.tensor([0.25])
    rewards = {name: method(name).learnt_reward(transition, multiplier).item() for name in METHODS}
    assert rewards == {
        "td3": 5.0,
        "rcpo": 4.5,
        "sac-lag": 5.0,
        "wcsac": 5.0,
        "cvar-cpo": 5.0,
        "via": 5.0,
        "td7": 5.0,
    }


def test_only_the_cvar_methods_with_quantiles_follow_the_budget() -> None:
    assert [name for name in METHODS if METHODS[name].budgeted] == ["cvar-cpo", "via"]


@pytest.mark.parametrize(("name", "expected"), [("sac-lag", 4.0), ("wcsac", 4.0), ("via", 4.0)])
def test_every_cost_critic_finds_the_mean_of_a_random_cost(name: str, expected: float) -> None:
    chosen = method(name, quantiles=10, huber_threshold=0.1)
    critic = TrainedNetwork(Weights((5, 16, chosen.cost_outputs), 1).draw(torch.Generator().manual_seed(0)))
    inputs = torch.zeros(1, 100, 5)
    # every episode ends at once, with a cost of 2 to 6
    costs = batch(0.0, 0.0, 0.0, 100)._replace(cost=torch.linspace(2, 6, 100).unsqueeze(0))
    for step in range(800):
        metrics = chosen.update_cost_critic(
            critic, inputs, inputs, costs, 1e-2 * (1 - step / 801), measure=True
        )
    assert metrics["cost_value"].item() == pytest.approx(expected, abs=0.05)
    if name == "wcsac":
        cvar = chosen.action_cost(critic.weights(inputs), torch.zeros(1, 100)).mean().item()
        assert cvar > 4.0
    if name == "via":
        upper = chosen.action_cost(critic.weights(inputs), torch.full((1, 100), 4.0)).mean().item()
        assert upper == pytest.approx(5.0, abs=0.15)
