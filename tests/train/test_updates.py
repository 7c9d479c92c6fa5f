"""Networks with a seed dimension, and the updates of TD3, by hand-computed numbers."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
import torch

from viatool.train.agent import Learner, make_agent
from viatool.train.collection import shaping_reward
from viatool.train.configuration import make_configuration
from viatool.train.methods import METHODS
from viatool.train.methods.via import cost_target
from viatool.train.networks import TrainedNetwork, Weights
from viatool.train.observation import make_scaling
from viatool.train.reachability import action_width
from viatool.train.replay import Batch, ReplayBuffer
from viatool.train.returns import NStepReturns, Transition
from viatool.train.updates import (
    Agent,
    first_value,
    smoothed_action,
    task_target,
    twin_values,
    update_actor,
    update_targets,
    update_task_critics,
)
from viatool.world import load_map


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def constant(sizes: tuple[int, ...], outputs: list[list[float]]) -> Weights:
    """A network whose output does not depend on its input: the rows of `outputs`, one for each seed."""
    weights = Weights(sizes, len(outputs))
    weights.layers[-1].detach().copy_(torch.tensor(outputs).unsqueeze(1))
    return weights


def batch(discount: list[float], reward: float = 1.0, cost: float = 1.0) -> Batch:
    count = len(discount)
    return Batch(
        observation=torch.zeros(1, count, 3),
        next_observation=torch.zeros(1, count, 3),
        action=torch.zeros(1, count, 2),
        reward=torch.full((1, count), reward),
        cost=torch.full((1, count), cost),
        discount=torch.tensor([discount]),
    )


def test_every_seed_computes_what_it_would_compute_alone() -> None:
    weights = Weights((3, 5, 2), seeds=4).draw(generator())
    inputs = torch.randn(4, 7, 3, generator=generator(1))
    together = weights(inputs)
    for seed in range(4):
        first, bias, second, shift = (layer.detach()[seed] for layer in weights.layers)
        alone = (inputs[seed] @ first + bias).relu() @ second + shift
        torch.testing.assert_close(together[seed].detach(), alone)


def test_a_step_of_one_seed_leaves_the_others_as_they_were() -> None:
    network = TrainedNetwork(Weights((3, 4, 1), seeds=4).draw(generator()))
    before = network.weights.flat.clone()
    inputs = torch.randn(2, 6, 3, generator=generator(1))
    target = twin_values(network.weights, inputs).detach().mean(0)
    target[0] += 1.0  # only the first of two seeds has anything to learn beyond its twins' disagreement
    update_task_critics(network, inputs, target, 1e-2)
    moved = [
        (layer.detach() - old).abs().amax((1, 2))
        for layer, old in zip(network.weights.layers, views(network, before), strict=True)
    ]
    assert all(step.shape == (4,) for step in moved)
    assert all((step > 0).any() for step in moved)


def views(network: TrainedNetwork, flat: torch.Tensor) -> list[torch.Tensor]:
    counts = [layer.numel() for layer in network.weights.layers]
    return [
        part.view(layer.shape) for part, layer in zip(flat.split(counts), network.weights.layers, strict=True)
    ]


def test_adam_follows_the_optimiser_of_torch() -> None:
    weights = Weights((3, 4, 2), seeds=2).draw(generator())
    network, reference = TrainedNetwork(weights.copy()), weights.copy()
    optimiser = torch.optim.Adam(reference.layers, lr=1e-2)
    for step in range(20):
        inputs = torch.randn(2, 5, 3, generator=generator(step))
        network.descend(
            torch.autograd.grad(network.weights(inputs).square().sum(), network.weights.layers), 1e-2
        )
        optimiser.zero_grad()
        reference(inputs).square().sum().backward()
        optimiser.step()
    torch.testing.assert_close(network.weights.flat, reference.flat, rtol=1e-4, atol=1e-6)


def test_the_task_target_takes_the_smaller_critic() -> None:
    critics = constant((5, 4, 1), [[3.0], [2.0]])  # two critics of one seed
    target = task_target(critics, torch.zeros(1, 2, 5), torch.ones(1, 2), torch.tensor([[0.5, 0.0]]))
    assert target.tolist() == [[1.0 + 0.5 * 2.0, 1.0]]


def test_the_cost_target_shifts_and_shrinks_every_quantile() -> None:
    logits = constant((5, 4, 4), [[0.0, 0.0, 20.0, 4.0]])  # quantiles 10 + 4 and 20 + 4
    quantiles = cost_target(logits, torch.zeros(1, 2, 5), batch([0.5, 0.0]))
    torch.testing.assert_close(quantiles[0], torch.tensor([[8.0, 13.0], [1.0, 1.0]]))


def step(time: float, reward: float, terminated: bool = False, truncated: bool = False) -> Transition:
    """One robot whose observation is the time."""
    now = torch.full((1, 1, 1), time)
    value = torch.full((1, 1), reward)
    return Transition(
        now, now + 1, now, value, 10 * value, torch.tensor([[terminated]]), torch.tensor([[truncated]])
    )


def test_targets_bootstrap_through_truncation_and_not_through_termination() -> None:
    for ending, discount in (({}, 0.5), ({"truncated": True}, 0.5), ({"terminated": True}, 0.0)):
        batch = NStepReturns(1, 0.5).push(step(0.0, 1.0, **ending))
        assert batch is not None
        assert batch.discount.item() == discount
        assert batch.next_observation.item() == 1.0


def test_three_step_returns_end_with_the_episode() -> None:
    returns = NStepReturns(3, 0.5)
    steps = [
        step(0, 1.0),
        step(1, 2.0),
        step(2, 4.0),
        step(3, 8.0, truncated=True),
        step(9, 99.0),
        step(10, 99.0),
    ]
    given = [returns.push(one) for one in steps]
    assert given[:2] == [None, None]
    complete = [batch for batch in given if batch is not None]
    assert [batch.observation.item() for batch in complete] == [0, 1, 2, 3]
    assert [batch.reward.item() for batch in complete] == [1 + 1 + 1, 2 + 2 + 2, 4 + 4, 8]
    assert [batch.cost.item() for batch in complete] == [30, 60, 80, 80]
    assert [batch.next_observation.item() for batch in complete] == [3, 4, 4, 4]
    assert [batch.discount.item() for batch in complete] == [0.125, 0.125, 0.25, 0.5]
    returns = NStepReturns(2, 0.5)
    returns.push(step(0, 1.0, terminated=True))
    last = returns.push(step(9, 99.0))
    assert last is not None
    assert (last.reward.item(), last.discount.item(), last.next_observation.item()) == (1.0, 0.0, 1.0)


def test_target_smoothing_is_clipped_noise_around_the_target_action() -> None:
    actor = constant((3, 4, 2), [[0.0, 3.0]])
    smoothed = smoothed_action(actor, torch.zeros(1, 20_000, 3), noise=0.2, limit=0.5, generator=generator())
    still, fast = smoothed[0].T
    assert still.abs().max().item() == 0.5
    assert still.std().item() == pytest.approx(0.2, rel=0.03)
    assert fast.max().item() == 1.0  # never beyond what the robot can do
    assert fast.min().item() >= np.tanh(3.0) - 0.5 - 1e-6


def test_the_first_critic_alone_equals_the_first_of_both() -> None:
    critics = Weights((5, 6, 6, 1), seeds=6).draw(generator())
    inputs = torch.randn(3, 9, 5, generator=generator(1))
    torch.testing.assert_close(first_value(critics, inputs), twin_values(critics, inputs)[0])


def tiny_agent() -> Agent:
    return Agent(
        actor=TrainedNetwork(Weights((3, 4, 2), 1).draw(generator(0))),
        task_critics=TrainedNetwork(constant((5, 4, 1), [[0.0], [0.0]])),
        cost_critic=TrainedNetwork(Weights((5, 8, 22), 1).draw(generator(2))),
    )


def test_the_actor_leaves_costly_actions_only_when_the_multiplier_is_positive() -> None:
    observation = torch.randn(1, 64, 3, generator=generator(3))
    via = METHODS["via"](make_configuration())
    for multiplier, moves in ((0.0, False), (1.0, True)):
        agent = tiny_agent()
        before = agent.actor.weights.flat.clone()
        costs = []
        for _ in range(50):
            metrics = update_actor(
                agent,
                via,
                observation,
                observation,
                torch.zeros(1, 64),
                torch.tensor([multiplier]),
                learning_rate=1e-2,
            )
            costs.append(float(metrics.get("action_cost", torch.zeros(1))))
        assert torch.equal(before, agent.actor.weights.flat) != moves
        assert (costs[-1] < costs[0]) == moves


def test_saturated_outputs_are_drawn_back_to_where_tanh_has_a_slope() -> None:
    agent = tiny_agent()
    agent.actor.weights.layers[-1].detach().fill_(6.0)
    observation = torch.randn(1, 64, 3, generator=generator(3))
    td3 = METHODS["td3"](make_configuration())
    for _ in range(500):
        update_actor(
            agent,
            td3,
            observation,
            observation,
            torch.zeros(1, 64),
            torch.zeros(1),
            learning_rate=1e-2,
            saturation_penalty=0.05,
        )
    assert agent.actor.weights(observation).abs().mean().item() < 3.0


def test_a_penalty_on_the_width_of_reachable_sets_shrinks_them() -> None:
    observation = torch.randn(1, 64, 3, generator=generator(3))
    td3 = METHODS["td3"](make_configuration())
    radius = torch.full((3,), 0.1)
    widths = []
    for penalty in (0.0, 1.0):
        agent = tiny_agent()
        for _ in range(50):
            width = action_width(agent.actor.weights, observation, radius).mean((1, 2))
            update_actor(
                agent,
                td3,
                observation,
                observation,
                torch.zeros(1, 64),
                torch.zeros(1),
                learning_rate=1e-2,
                penalties={"action_width": (penalty, width)},
            )
        widths.append(action_width(agent.actor.weights, observation, radius).mean().item())
    assert widths[1] < 0.5 * widths[0]


def test_targets_follow_by_their_rate() -> None:
    agent = tiny_agent()
    agent.actor.weights.flat.fill_(1.0)
    agent.actor.target.flat.zero_()
    update_targets(agent, 0.25)
    update_targets(agent, 0.25)
    assert agent.actor.target.flat[0].item() == pytest.approx(1 - 0.75**2)


def test_actor_and_targets_move_only_at_every_second_update_of_the_critics() -> None:
    options = make_configuration(seeds=2, batch_size=8, policy_delay=2, cost_critic_delay=1)
    random = generator()
    method = METHODS["via"](options)
    agent = make_agent(options, method, make_scaling(load_map("maps/lab.yaml").robot, 10.0), generator=random)
    replay = ReplayBuffer(2, 32, 26, 2)
    replay.add(
        Batch(
            torch.randn(2, 16, 26, generator=random),
            torch.randn(2, 16, 26, generator=random),
            torch.rand(2, 16, 2, generator=random),
            torch.randn(2, 16, generator=random),
            torch.zeros(2, 16),
            torch.ones(2, 16),
        )
    )
    scaling = make_scaling(load_map("maps/lab.yaml").robot, 10.0)
    learner = Learner(options, method, agent, replay, scaling, generator=random)
    networks = {
        "actor": agent.actor.weights,
        "target": agent.actor.target,
        "critics": agent.task_critics.weights,
    }
    moves = []
    for _ in range(4):
        before = {name: weights.flat.clone() for name, weights in networks.items()}
        learner.update(torch.zeros(2), 1e-3)
        moves.append(
            [name for name, weights in networks.items() if not torch.equal(before[name], weights.flat)]
        )
    assert moves == [["critics"], ["actor", "target", "critics"]] * 2


def test_shaping_changes_the_return_of_every_episode_by_its_first_state_alone() -> None:
    discount, weight = 0.9, 15.0
    for distances, terminated in (([3.0, 2.5, 2.6, 1.0], True), ([3.0, 4.0], True), ([3.0, 2.0, 1.5], False)):
        total = 0.0
        for t, (before, after) in enumerate(pairwise(distances)):
            end = terminated and t == len(distances) - 2
            shaped = shaping_reward(weight, discount, np.array([before]), np.array([after]), np.array([end]))
            total += discount**t * float(shaped[0])
        left = 0.0 if terminated else discount ** (len(distances) - 1) * -weight * distances[-1]
        assert total == pytest.approx(weight * 3.0 + left)


def test_the_replay_buffer_forgets_the_oldest_and_samples_each_seed_from_its_own() -> None:
    replay = ReplayBuffer(seeds=2, capacity=5, observation_size=1, action_size=1)
    for step in range(4):  # two robots of each seed
        value = torch.tensor([[[10.0 * step], [10.0 * step + 1]], [[-10.0 * step], [-10.0 * step - 1]]])
        flat = value.squeeze(-1)
        replay.add(Batch(value, value + 0.5, value, flat, flat, torch.ones(2, 2)))
    sample = replay.sample(200, generator())
    assert replay.size == 5
    assert sample.observation.shape == (2, 200, 1)
    assert set(sample.observation[0].flatten().tolist()) == {11.0, 20.0, 21.0, 30.0, 31.0}
    assert set(sample.observation[1].flatten().tolist()) == {-11.0, -20.0, -21.0, -30.0, -31.0}
    torch.testing.assert_close(sample.next_observation, sample.observation + 0.5)
    torch.testing.assert_close(sample.reward, sample.observation.squeeze(-1))
