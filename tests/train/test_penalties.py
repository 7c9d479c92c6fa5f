"""Penalties on the actor: what they measure, and when they count."""

from __future__ import annotations

import pytest
import torch

from viatool import load_map
from viatool.train import make_configuration
from viatool.train.agent import Learner, make_agent
from viatool.train.methods import METHODS
from viatool.train.networks import Weights
from viatool.train.observation import make_scaling
from viatool.train.reachability import action_width
from viatool.train.replay import Batch, ReplayBuffer
from viatool.train.smoothness import jumped, restlessness


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def test_a_jump_lets_one_bin_read_what_a_neighbour_does() -> None:
    observation = torch.randn(2, 500, 8, generator=generator())
    other = jumped(observation, 5, generator(1))
    changed = other != observation
    assert (changed.sum(-1) == 1).all()
    seed, state, bin_ = changed.nonzero().T
    assert set(bin_.tolist()) == {0, 1, 2, 3, 4}
    left = observation[seed, state, (bin_ - 1).clamp(min=0)]
    right = observation[seed, state, (bin_ + 1).clamp(max=4)]
    read = other[seed, state, bin_]
    assert ((read == left) | (read == right)).all()
    assert (read == left).any()
    assert (read == right).any()


def test_restlessness_is_the_change_of_the_actions() -> None:
    actor = Weights((3, 2), 1)
    with torch.no_grad():
        actor.layers[0].copy_(torch.tensor([[[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]]]))
    here, there = torch.zeros(1, 4, 3), torch.tensor([0.5, 0.0, 9.0]).expand(1, 4, 3)
    assert restlessness(actor, here, there).item() == pytest.approx(
        0.5 * torch.tanh(torch.tensor(0.5)).item()
    )


def learner(**options: object) -> Learner:
    configuration = make_configuration(seeds=2, **options)  # type: ignore[arg-type]
    scaling, method = make_scaling(load_map("maps/lab.yaml").robot, 10.0), METHODS["via"](configuration)
    agent = make_agent(configuration, method, scaling, generator())
    return Learner(configuration, method, agent, ReplayBuffer(2, 64, 26, 2), scaling, generator())


def batch() -> Batch:
    observation = torch.randn(2, 16, 26, generator=generator(2))
    nothing = torch.zeros(2, 16)
    return Batch(observation, observation, torch.zeros(2, 16, 2), nothing, nothing, nothing)


@pytest.mark.parametrize(
    ("start", "full", "expected"),
    [(0.0, 0.0, [1.0, 1.0, 1.0, 1.0]), (0.2, 0.6, [0.0, 0.0, 0.5, 1.0]), (0.4, 0.0, [0.0, 0.0, 1.0, 1.0])],
)
def test_the_weight_of_reachable_sets_grows(start: float, full: float, expected: list[float]) -> None:
    taught = learner(reachability_weight=2.0, reachability_start=start, reachability_full=full)
    shares = []
    for progress in (0.0, 0.2, 0.4, 0.8):
        taught.progress = progress
        weight = taught.penalties(batch()).get("action_width", (0.0, None))[0]
        shares.append(weight / 2.0)
    assert shares == pytest.approx(expected)


def test_without_weights_there_are_no_penalties_and_no_random_numbers_are_drawn() -> None:
    taught = learner()
    before = taught.generator.get_state()
    assert taught.penalties(batch()) == {}
    assert torch.equal(before, taught.generator.get_state())


def test_a_penalty_on_jumps_makes_them_smaller() -> None:
    actors = {}
    for weight in (0.0, 1.0):
        actor = Weights((26, 16, 2), 1).draw(generator(), 3.0)
        observation = torch.randn(1, 200, 26, generator=generator(3))
        for step in range(60):
            change = restlessness(actor, observation, jumped(observation, 20, generator(step)))
            kept = (actor(observation).tanh() - 0.3).square().mean()
            gradients = torch.autograd.grad(kept + weight * change.sum(), actor.layers)
            with torch.no_grad():
                for layer, gradient in zip(actor.layers, gradients, strict=True):
                    layer -= 0.1 * gradient
        actors[weight] = restlessness(actor, observation, jumped(observation, 20, generator(99))).item()
    assert actors[1.0] < 0.8 * actors[0.0]


def test_the_square_of_widths_is_about_the_wide_ones() -> None:
    found = {}
    for form in ("mean", "square"):
        taught = learner(reachability_weight=1.0, reachability_form=form)
        found[form] = taught.penalties(batch())["action_width"][1]
    widths = action_width(taught.agent.actor.weights, batch().observation, taught.radius)
    torch.testing.assert_close(found["mean"], widths.mean((1, 2)))
    torch.testing.assert_close(found["square"], widths.square().mean((1, 2)))
