"""The cost critic's quantiles, their loss and V_C, by hand-computed numbers."""

from __future__ import annotations

import math

import pytest
import torch

from viatool.train.methods.quantiles import (
    noncrossing_quantiles,
    quantile_huber_gradient,
    quantile_huber_loss,
    quantile_midpoints,
    tail_cost,
)


def test_midpoints_lie_halfway_between_the_fractions() -> None:
    assert quantile_midpoints(4).tolist() == [0.125, 0.375, 0.625, 0.875]


def test_quantiles_are_slope_times_cumulated_softmax_plus_shift() -> None:
    # softmax of (ln 1, ln 2, ln 5) is (1, 2, 5)/8; a raw slope of ln(e^2 - 1) has softplus 2; the shift is -1
    logits = torch.tensor([math.log(1), math.log(2), math.log(5), math.log(math.e**2 - 1), -1.0])
    expected = [2 * 1 / 8 - 1, 2 * 3 / 8 - 1, 2 * 8 / 8 - 1]
    torch.testing.assert_close(noncrossing_quantiles(logits), torch.tensor(expected))


def test_quantiles_never_cross_whatever_the_network_says() -> None:
    logits = 30 * torch.randn(200, 7, 22, generator=torch.Generator().manual_seed(0))
    quantiles = noncrossing_quantiles(logits)
    assert quantiles.shape == (200, 7, 20)
    assert (quantiles.diff(dim=-1) >= 0).all()


def test_quantile_huber_loss_of_two_quantiles() -> None:
    # d_ij = target_j - predicted_i: [[0.5, 3], [-1.5, 1]], midpoints 1/4 and 3/4, kappa 1
    predicted, target = torch.tensor([0.0, 2.0]), torch.tensor([0.5, 3.0])
    terms = [0.25 * 0.125, 0.25 * 2.5, 0.25 * 1.0, 0.75 * 0.5]
    assert quantile_huber_loss(predicted, target).item() == pytest.approx(sum(terms) / 4)


@pytest.mark.parametrize("kappa", [0.5, 1.0, 3.0])
def test_the_hand_written_gradient_is_that_of_the_loss(kappa: float) -> None:
    generator = torch.Generator().manual_seed(1)
    predicted = torch.randn(3, 5, 8, generator=generator).requires_grad_()
    target = 2 * torch.randn(3, 5, 8, generator=generator)
    (expected,) = torch.autograd.grad(quantile_huber_loss(predicted, target, kappa).sum(), predicted)
    torch.testing.assert_close(quantile_huber_gradient(predicted.detach(), target, kappa), expected)


def test_the_loss_is_least_at_the_quantiles_of_the_target() -> None:
    target = torch.arange(100.0).view(1, 1, 100)
    predicted = torch.zeros(1, 1, 4)
    for _ in range(4000):
        predicted -= 20 * quantile_huber_gradient(predicted, target, kappa=0.01)
    torch.testing.assert_close(predicted.flatten(), torch.tensor([12.0, 37.0, 62.0, 87.0]), atol=1.0, rtol=0)


def test_tail_cost_is_the_mean_of_the_quantiles_that_reach_the_budget() -> None:
    quantiles = torch.tensor([[0.0, 1.0, 2.0, 3.0]])
    assert tail_cost(quantiles, torch.tensor([1.0]), alpha=0.5).item() == 2.0
    assert tail_cost(quantiles, torch.tensor([-7.0]), alpha=0.5).item() == 1.5


def test_tail_cost_without_a_quantile_above_the_budget_is_the_mean_of_the_upper_tail() -> None:
    quantiles = torch.tensor([[0.0, 1.0, 2.0, 3.0]])
    assert tail_cost(quantiles, torch.tensor([9.0]), alpha=0.5).item() == 2.5
    assert tail_cost(quantiles, torch.tensor([9.0]), alpha=0.75).item() == 3.0
    assert tail_cost(quantiles, torch.tensor([9.0]), alpha=0.99).item() == 3.0


def test_tail_cost_has_a_finite_gradient_on_either_side() -> None:
    quantiles = torch.tensor([[0.0, 1.0, 2.0, 3.0], [0.0, 1.0, 2.0, 3.0]], requires_grad=True)
    tail_cost(quantiles, torch.tensor([1.0, 9.0]), alpha=0.5).sum().backward()
    assert quantiles.grad is not None
    torch.testing.assert_close(quantiles.grad, torch.tensor([[0, 1 / 3, 1 / 3, 1 / 3], [0, 0, 0.5, 0.5]]))
