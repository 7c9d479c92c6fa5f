"""What TD7 adds, by hand-computed numbers."""

from __future__ import annotations

import pytest
import torch

from viatool.train.embedding import Embedding, normalise_code
from viatool.train.replay import Batch, PrioritisedReplay
from viatool.train.td7 import lap_huber, priority


def test_codes_have_a_mean_absolute_value_of_one() -> None:
    torch.testing.assert_close(normalise_code(torch.tensor([2.0, -6.0])), torch.tensor([0.5, -1.5]))
    assert normalise_code(torch.zeros(3)).tolist() == [0.0, 0.0, 0.0]


def test_the_loss_is_quadratic_near_zero_and_linear_beyond_one() -> None:
    assert lap_huber(torch.tensor([0.5, -1.0, 3.0])).tolist() == [0.125, 1.0, 3.0]


def test_the_priority_is_that_of_the_worse_critic_and_at_least_one() -> None:
    errors = torch.tensor([[[0.1, -32.0]], [[0.5, 1.0]]])
    torch.testing.assert_close(priority(errors), torch.tensor([[1.0, 4.0]]))


def test_transitions_are_drawn_in_proportion_to_their_priority() -> None:
    replay = PrioritisedReplay(2, 8, 1, 1)
    number = torch.arange(4.0).expand(2, 4)
    replay.add(Batch(number[..., None], number[..., None], number[..., None], number, number, number))
    replay.set_priority(
        torch.tensor([[0, 1, 2, 3], [0, 1, 2, 3]]), torch.tensor([[1.0, 0, 0, 3], [0, 1, 1, 0]])
    )
    batch, slots = replay.sample_by_priority(4000, torch.Generator().manual_seed(0))
    torch.testing.assert_close(batch.reward, slots.float())
    shares = torch.stack([torch.bincount(row, minlength=4) for row in slots]) / 4000
    torch.testing.assert_close(
        shares, torch.tensor([[0.25, 0, 0, 0.75], [0, 0.5, 0.5, 0]]), atol=0.03, rtol=0
    )
    replay.add(Batch(*(part[:, :1] for part in batch)))
    assert replay.priority[:, 4].tolist() == [3.0, 1.0]


def test_the_embedding_learns_to_predict_and_moves_up_by_generations() -> None:
    generator = torch.Generator().manual_seed(0)
    embedding = Embedding((3, 32, 4), actions=2, seeds=2, generator=generator)
    observation = torch.randn(2, 128, 3, generator=generator)
    action = torch.randn(2, 128, 2, generator=generator)
    following = observation + 0.5 * torch.nn.functional.pad(action, (0, 1))
    fixed = embedding.codes(observation, action)
    losses = [embedding.update(observation, action, following, 3e-3) for _ in range(300)]
    assert (losses[-1] < 0.3 * losses[0]).all()
    assert torch.equal(embedding.codes(observation, action), fixed)
    embedding.renew()
    assert torch.equal(embedding.codes(observation, action, older=True), fixed)
    assert not torch.equal(embedding.codes(observation, action), fixed)


def test_the_critics_see_how_the_action_changes_the_code() -> None:
    embedding = Embedding((3, 16, 4), actions=2, seeds=1, generator=torch.Generator().manual_seed(0))
    action = torch.zeros(1, 5, 2, requires_grad=True)
    embedding.codes(torch.ones(1, 5, 3), action).sum().backward()
    assert action.grad is not None
    assert action.grad.abs().sum().item() > 0
    assert pytest.approx(0.0) != action.grad[0, 0, 0].item()
