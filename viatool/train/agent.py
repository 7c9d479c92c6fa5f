"""The networks of a configuration, and one update of all of them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch

from viatool.arrays import Floats
from viatool.train.configuration import TrainingConfiguration, WidthForm
from viatool.train.embedding import Embedding
from viatool.train.gains import action_gain, limit_gain
from viatool.train.methods import Method
from viatool.train.networks import TrainedNetwork, Weights
from viatool.train.observation import Mirror, UnitScaling, near_features
from viatool.train.reachability import action_width
from viatool.train.replay import Batch, ReplayBuffer
from viatool.train.smoothness import jumped, restlessness
from viatool.train.updates import (
    Agent,
    Metrics,
    Penalties,
    act,
    critic_input,
    smoothed_action,
    task_target,
    update_actor,
    update_targets,
    update_task_critics,
)

ACTIONS = 2
_FORMS: dict[WidthForm, Callable[[torch.Tensor], torch.Tensor]] = {
    "mean": torch.Tensor.abs,
    "square": torch.Tensor.square,
}
"""What is averaged of the widths of reachable sets."""


def make_agent(
    configuration: TrainingConfiguration,
    method: Method,
    scaling: UnitScaling,
    generator: torch.Generator,
) -> Agent:
    """Draw the initial networks of all seeds.

    Parameters
    ----------
    configuration : TrainingConfiguration
        Widths and seeds.
    method : Method
        Says which outputs the cost critic has.
    scaling : UnitScaling
        Of the n numbers of an observation: critics get all of them, the actor what its view shows.
    generator : torch.Generator
        Source of the weights.
    """
    seeds, observation_size = configuration.seeds, len(scaling.offset)
    features = observation_size + (scaling.bins if configuration.near_features else 0)
    embedding = None
    if method.embedded:
        sizes = (observation_size, configuration.critic_hidden[0], configuration.embedding_size)
        embedding = Embedding(sizes, ACTIONS, seeds, generator)
        features += 2 * embedding.code
    inputs = features + ACTIONS
    hidden = configuration.critic_hidden
    actor = scaling.actor(configuration.actor_hidden, seeds, configuration.actor_activation)
    actor.draw(generator, configuration.actor_output_scale)
    if configuration.gain_limit is not None:
        limit_gain(actor, scaling.radius(1.0), configuration.gain_limit)
    task_critics = Weights((inputs, *hidden, 1), 2 * seeds)
    cost_critic = Weights((inputs, *hidden, method.cost_outputs), seeds) if method.cost_outputs else None
    return Agent(
        actor=TrainedNetwork(actor),
        task_critics=TrainedNetwork(task_critics.draw(generator)),
        cost_critic=None if cost_critic is None else TrainedNetwork(cost_critic.draw(generator)),
        embedding=embedding,
        value_range=torch.zeros(4, seeds),
    )


def spread(observation: torch.Tensor, count: int) -> torch.Tensor:
    """Return some of the states of a batch ``(S, B, n)``, from its mirrored half as from the other: ``(S, C, n)``."""
    return observation[:, :: max(observation.shape[1] // count, 1)][:, :count]


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

    Attributes
    ----------
    progress : float
        Which part of the run is done, for what changes on its way.
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
        self.unit_error = scaling.radius(1.0)
        self.generator = generator
        self.updates = 0
        self.progress = 0.0

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

    def penalties(self, batch: Batch) -> Penalties:
        """Return what the actor's loss has beside values and costs: a weight and ``(S,)`` a metric each, by name."""
        options, actor = self.configuration, self.agent.actor.weights
        found: Penalties = {}
        weight = options.reachability_weight * self._grown()
        if weight:
            states = spread(batch.observation, options.reachability_states)
            widths = action_width(actor, states, self.radius)
            found["action_width"] = weight, _FORMS[options.reachability_form](widths).mean((1, 2))
        if options.jump_penalty:
            other = jumped(batch.observation, self.bins, self.generator)
            found["action_jump"] = options.jump_penalty, restlessness(actor, batch.observation, other)
        return found

    def keep_limits(self) -> Metrics:
        """Bring the actor and its target, of which a mean of limited networks is none, back to the gain's limit."""
        limit, actor = self.configuration.gain_limit, self.agent.actor
        if limit is None:
            return {}
        for weights in (actor.weights, actor.target):
            limit_gain(weights, self.unit_error, limit)
        return {"action_gain": action_gain(actor.target, self.unit_error).amax(1)}

    def _grown(self) -> float:
        """Return which part of the weight of the reachable sets counts by now."""
        start, full = self.configuration.reachability_start, self.configuration.reachability_full
        if full <= start:
            return float(self.progress >= start)
        return min(max((self.progress - start) / (full - start), 0.0), 1.0)

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
                penalties=self.penalties(batch),
            )
            update_targets(agent, options.target_rate)
            metrics |= self.keep_limits()
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
