"""Budget recursion, value at risk and multiplier, by hand-computed numbers."""

from __future__ import annotations

import numpy as np
import pytest

from viatool.train.constraint import empirical_cvar, initial_var, next_budget, update_multiplier, update_var


def test_the_budget_pays_the_cost_and_is_discounted() -> None:
    budget = next_budget(np.array([2.0, 2.0, 0.0]), np.array([0.0, 1.0, 1.0]), discount=0.5, limit=10.0)
    assert budget.tolist() == [4.0, 2.0, -2.0]


def test_the_budget_is_clipped_so_that_the_recursion_cannot_run_away() -> None:
    budget = np.array([1.0, 1.0])
    for cost in (0.0, 1.0):
        for _ in range(300):
            budget = next_budget(budget, np.array([0.0, cost]), discount=0.99, limit=10.0)
    assert budget.tolist() == [10.0, -10.0]


def test_unclipped_the_budget_compares_like_the_discounted_rest_of_the_cost() -> None:
    # e_T >= 0 exactly when the discounted cost so far is at most u
    costs, discount, u = [1.0, 0.0, 1.0, 1.0], 0.9, 2.5
    budget = np.array([u])
    for cost in costs:
        budget = next_budget(budget, np.array([cost]), discount, limit=np.inf)
    spent = sum(discount**t * cost for t, cost in enumerate(costs))
    assert budget[0] == pytest.approx((u - spent) / discount ** len(costs))


def test_the_initial_var_is_the_empirical_quantile_of_each_seed() -> None:
    costs = np.array([[0, 1, 2, 3, 4, 5, 6, 7, 8, 9], [0, 0, 0, 0, 0, 0, 0, 0, 0, 9]], dtype=float)
    assert initial_var(costs, 0.9).tolist() == [8.0, 0.0]


def test_the_var_moves_by_the_exceedance_beyond_the_tail() -> None:
    costs = np.array([0.0, 0.0, 3.0, 5.0])
    var, metrics = update_var(3.0, costs, alpha=0.9, step=2.0, ceiling=9.0)
    assert var == pytest.approx(3.0 + 2.0 * (0.5 - 0.1))
    assert metrics["exceedance"] == 0.5
    var, _ = update_var(6.0, costs, alpha=0.9, step=2.0, ceiling=9.0)
    assert var == pytest.approx(6.0 - 2.0 * 0.1)


def test_the_var_stays_between_zero_and_its_ceiling() -> None:
    assert update_var(8.9, np.full(4, 9.0), alpha=0.9, step=2.0, ceiling=9.0)[0] == 9.0
    assert update_var(0.1, np.zeros(4), alpha=0.9, step=2.0, ceiling=9.0)[0] == 0.0


def test_the_var_of_a_policy_without_costs_rests_at_zero() -> None:
    var, metrics = update_var(0.0, np.zeros(20), alpha=0.9, step=2.0, ceiling=9.0)
    assert (var, metrics["exceedance"]) == (0.0, 0.0)


def test_the_adaptive_var_settles_around_the_quantile() -> None:
    rng = np.random.default_rng(0)
    var, path = 0.0, []
    for _ in range(4000):
        var, _ = update_var(var, rng.exponential(2.0, 70), alpha=0.9, step=0.2, ceiling=90.0)
        path.append(var)
    assert np.mean(path[1000:]) == pytest.approx(-2.0 * np.log(0.1), rel=0.03)


def test_the_empirical_var_rule_is_the_quantile() -> None:
    costs = np.arange(10.0)
    assert update_var(0.0, costs, alpha=0.9, step=2.0, ceiling=99.0, rule="empirical")[0] == 8.0


def test_the_multiplier_grows_with_the_violation_and_shrinks_with_the_slack() -> None:
    assert update_multiplier(0.1, -1.0, step=0.1, maximum=0.3) == pytest.approx(0.2)
    assert update_multiplier(0.1, 0.5, step=0.1, maximum=0.3) == pytest.approx(0.05)


def test_the_multiplier_is_projected() -> None:
    assert update_multiplier(0.1, -8.0, step=1.0, maximum=0.3) == 0.3
    assert update_multiplier(0.1, 4.0, step=1.0, maximum=0.3) == 0.0
    assert update_multiplier(0.1, None, step=1.0, maximum=0.3) == 0.1


def test_the_var_stays_without_episodes() -> None:
    assert update_var(3.0, np.zeros(0), alpha=0.9, step=2.0, ceiling=9.0)[0] == 3.0


@pytest.mark.parametrize(("alpha", "expected"), [(0.5, 4.0), (0.75, 6.0), (0.9, 6.0)])
def test_the_empirical_cvar_is_the_mean_of_the_worst_episodes(alpha: float, expected: float) -> None:
    assert empirical_cvar(np.array([6.0, 0.0, 2.0, 0.0]), alpha) == pytest.approx(expected)
