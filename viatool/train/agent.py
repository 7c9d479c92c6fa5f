"""The networks of a configuration, and one update of all of them."""

from __future__ import annotations

import numpy as np
import torch

from viatool.arrays import Floats
from viatool.train.configuration import TrainingConfiguration
from viatool.train.embedding import Embedding
from viatool.train.methods import Method
from viatool.train.networks import TrainedNetwork, Weights
from viatool.train.observation import Mirror, UnitScaling, near_features
from viatool.train.reachability import action_width
from viatool.train.replay import Batch, ReplayBuffer
from viatool.train.updates import (
    Agent,
    Metrics,
    act,
    critic_input,
    smoothed_action,
    task_target,
    update_actor,
    update_targets,
    update_task_critics,
)

ACTIONS = 2


def make_agent(
    configuration: TrainingConfiguration,
    method: Method,
    observation_size: int,
    bins: int,
    generator: torch.Generator,
) -> Agent:
    """Draw the initial networks of all seeds.

    Parameters
    ----------
    configuration : TrainingConfiguration
        Widths and seeds.
    method : Method
        Says which outputs the cost critic has.
    observation_size : int
        n, the budget included.
    bins : int
        LiDAR bins, for the critics' near-range features.
    generator : torch.Generator
        Source of the weights.
    """
    seeds = configuration.seeds
    features = observation_size + (bins if configuration.near_features else 0)
    embedding = None
    if method.embedded:
        sizes = (observation_size, configuration.critic_hidden[0], configuration.embedding_size)
        embedding = Embedding(sizes, ACTIONS, seeds, generator)
        features += 2 * embedding.code
    inputs = features + ACTIONS
    hidden = configuration.critic_hidden
    actor = Weights(
        (observation_size, *configuration.actor_hidden, ACTIONS), seeds, configuration.actor_activation
    )
    task_critics = Weights((inputs, *hidden, 1), 2 * seeds)
    cost_critic = Weights((inputs, *hidden, method.cost_outputs), seeds) if method.cost_outputs else None
    return Agent(
        actor=TrainedNetwork(actor.draw(generator, configuration.actor_output_scale)),
        task_critics=TrainedNetwork(task_critics.draw(generator)),
        cost_critic=None if cost_critic is None else TrainedNetwork(cost_critic.draw(generator)),
        embedding=embedding,
        value_range=torch.zeros(4, seeds),
    )


class Learner:
    """Updates an agent from a replay buffer as the configuration says.

    Parameters
    ----------
    configuration : TrainingConfiguration
        Rates, delays, noise.
    method : Method
        How costs enter.
    agent : Agent
        Updated in place.
    replay : ReplayBuffer
        Source of the batches.
    scaling : UnitScaling
        Of the robot.
    generator : torch.Generator
        Of batches and smoothing noise.
    """

    def __init__(
        self,
        configuration: TrainingConfiguration,
        method: Method,
        agent: Agent,
        replay: ReplayBuffer,
        scaling: UnitScaling,
        generator: torch.Generator,
    ) -> None:
        self.configuration = configuration
        self.method = method
        self.agent = agent
        self.replay = replay
        self.bins = scaling.bins
        self.mirror = Mirror(scaling.channels)
        self.radius = scaling.radius(configuration.reachability_eps)
        self.generator = generator
        self.updates = 0

    def _features(self, observation: torch.Tensor) -> torch.Tensor:
        return near_features(observation, self.bins) if self.configuration.near_features else observation

    def _mirrored(self, batch: Batch) -> Batch:
        """Return the batch with its first half mirrored; which transitions these are is random anyway."""
        if self.configuration.mirror:
            half = batch.reward.shape[1] // 2
            for part in (batch.observation[:, :half], batch.next_observation[:, :half]):
                part.copy_(self.mirror.observation(part))
            batch.action[:, :half] = self.mirror.action(batch.action[:, :half])
        return batch

    def _width(self, observation: torch.Tensor) -> torch.Tensor | None:
        """Return ``(S,)`` the mean width of the reachable sets of some of the states, None if it is not used."""
        options = self.configuration
        if not options.reachability_weight:
            return None
        states = observation[:, : options.reachability_states]
        return action_width(self.agent.actor.weights, states, self.radius).mean((1, 2))

    def update(self, multiplier: torch.Tensor, learning_rate: float, *, measure: bool = False) -> Metrics:
        """Take one step of Algorithm 1, line "off-policy updates".

        Parameters
        ----------
        multiplier : Tensor
            ``(S,)`` lambda.
        learning_rate : float
            Of this step.
        measure : bool
            Also compute metrics that the step itself does not need.

        Returns
        -------
        dict
            ``(S,)`` tensors by name.
        """
        options, agent = self.configuration, self.agent
        self.updates += 1
        with torch.no_grad():
            batch = self._mirrored(self.replay.sample(options.batch_size, self.generator))
            features = self._features(batch.observation)
            inputs = critic_input(features, batch.action)
            next_action = smoothed_action(
                agent.actor.target,
                batch.next_observation,
                options.target_noise,
                options.target_noise_limit,
                self.generator,
            )
            next_input = critic_input(self._features(batch.next_observation), next_action)
            reward = self.method.learnt_reward(batch, multiplier)
            target = task_target(agent.task_critics.target, next_input, reward, batch.discount)
        metrics = update_task_critics(agent.task_critics, inputs, target, learning_rate, measure=measure)
        if agent.cost_critic is not None and self.updates % options.cost_critic_delay == 0:
            metrics |= self.method.update_cost_critic(
                agent.cost_critic, inputs, next_input, batch, learning_rate, measure=measure
            )
        if self.updates % options.policy_delay == 0:
            metrics |= update_actor(
                agent,
                self.method,
                batch.observation,
                features,
                batch.observation[..., -1] * options.budget_limit,
                multiplier,
                learning_rate=learning_rate,
                saturation_penalty=options.saturation_penalty,
                width=self._width(batch.observation),
                width_penalty=options.reachability_weight,
            )
            update_targets(agent, options.target_rate)
        return metrics

    def start_cost(self, observation: torch.Tensor) -> Floats:
        """Return ``(S,)`` the mean predicted cost of the policies' actions in start states ``(S, E, n)``."""
        critic = self.agent.cost_critic
        if critic is None:
            return np.zeros(observation.shape[0])
        with torch.no_grad():
            action = act(self.agent.actor.weights, observation)
            outputs = critic.weights(critic_input(self._features(observation), action))
            budget = observation[..., -1] * self.configuration.budget_limit
            return self.method.action_cost(outputs, budget).mean(-1).numpy().astype(np.float64)
