"""The networks of a configuration, and one update of all of them."""

from __future__ import annotations

import torch

from viatool.train.configuration import TrainingConfiguration
from viatool.train.networks import TrainedNetwork, Weights
from viatool.train.observation import near_features
from viatool.train.replay import ReplayBuffer
from viatool.train.updates import (
    Agent,
    Metrics,
    cost_target,
    critic_input,
    smoothed_action,
    task_target,
    update_actor,
    update_cost_critic,
    update_targets,
    update_task_critics,
)

ACTIONS = 2


def make_agent(
    configuration: TrainingConfiguration, observation_size: int, bins: int, generator: torch.Generator
) -> Agent:
    """Draw the initial networks of all seeds.

    Parameters
    ----------
    configuration : TrainingConfiguration
        Widths, seeds, quantiles.
    observation_size : int
        n, the budget included.
    bins : int
        LiDAR bins, for the critics' near-range features.
    generator : torch.Generator
        Source of the weights.
    """
    seeds = configuration.seeds
    features = observation_size + (bins if configuration.near_features else 0)
    inputs = features + ACTIONS
    hidden = configuration.critic_hidden
    actor = Weights(
        (observation_size, *configuration.actor_hidden, ACTIONS), seeds, configuration.actor_activation
    )
    return Agent(
        actor=TrainedNetwork(actor.draw(generator, configuration.actor_output_scale)),
        task_critics=TrainedNetwork(Weights((inputs, *hidden, 1), 2 * seeds).draw(generator)),
        cost_critic=TrainedNetwork(
            Weights((inputs, *hidden, configuration.quantiles + 2), seeds).draw(generator)
        ),
    )


class Learner:
    """Updates an agent from a replay buffer as the configuration says.

    Parameters
    ----------
    configuration : TrainingConfiguration
        Rates, delays, noise.
    agent : Agent
        Updated in place.
    replay : ReplayBuffer
        Source of the batches.
    bins : int
        LiDAR bins of an observation.
    generator : torch.Generator
        Of batches and smoothing noise.
    """

    def __init__(
        self,
        configuration: TrainingConfiguration,
        agent: Agent,
        replay: ReplayBuffer,
        bins: int,
        generator: torch.Generator,
    ) -> None:
        self.configuration = configuration
        self.agent = agent
        self.replay = replay
        self.bins = bins
        self.generator = generator
        self.updates = 0

    def _features(self, observation: torch.Tensor) -> torch.Tensor:
        return near_features(observation, self.bins) if self.configuration.near_features else observation

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
            batch = self.replay.sample(options.batch_size, self.generator)
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
            target = task_target(agent.task_critics.target, next_input, batch)
        metrics = update_task_critics(agent.task_critics, inputs, target, learning_rate)
        if self.updates % options.cost_critic_delay == 0:
            with torch.no_grad():
                returns = cost_target(agent.cost_critic.target, next_input, batch)
            metrics |= update_cost_critic(agent.cost_critic, inputs, returns, learning_rate, measure=measure)
        if self.updates % options.policy_delay == 0:
            metrics |= update_actor(
                agent,
                batch.observation,
                features,
                batch.observation[..., -1] * options.budget_limit,
                multiplier,
                alpha=options.alpha,
                learning_rate=learning_rate,
                saturation_penalty=options.saturation_penalty,
            )
            update_targets(agent, options.target_rate)
        return metrics
