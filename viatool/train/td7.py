"""The learner of TD7: embedded critics, LAP replay, clipped targets and hard target updates."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.autograd import grad

from viatool.train.agent import Learner
from viatool.train.replay import Batch, PrioritisedReplay
from viatool.train.updates import Metrics, critic_input, saturation, smoothed_action, twin_values

PRIORITY_EXPONENT = 0.4
LEAST_PRIORITY = 1.0


def lap_huber(error: Tensor) -> Tensor:
    """Return ``e^2 / 2`` below `LEAST_PRIORITY` and ``LEAST_PRIORITY |e|`` above, elementwise.

    Sampling in proportion to ``max(|e|, 1)^0.4`` together with this loss has the expected gradient of uniform
    sampling with another loss, so that no importance weights are needed (Fujimoto, Meger and Precup, 2020).
    """
    size = error.abs()
    return torch.where(size < LEAST_PRIORITY, 0.5 * error.square(), LEAST_PRIORITY * size)


def priority(errors: Tensor) -> Tensor:
    """Return ``max(|e|, 1)^0.4`` of the larger error of both critics, ``(2, S, B)`` to ``(S, B)``."""
    return errors.abs().amax(0).clamp(min=LEAST_PRIORITY).pow(PRIORITY_EXPONENT)


class Td7Learner(Learner):
    """As `Learner`, with what TD7 adds; see docs/methods.md for the deviations."""

    def _critic_input(self, observation: Tensor, action: Tensor, *, older: bool = False) -> Tensor:
        assert self.agent.embedding is not None
        codes = self.agent.embedding.codes(observation, action, older=older)
        return critic_input(torch.cat([self._features(observation), codes], dim=-1), action)

    def update(self, multiplier: Tensor, learning_rate: float, *, measure: bool = False) -> Metrics:
        """Take one step of all networks; `multiplier` is not used."""
        options, agent, replay = self.configuration, self.agent, self.replay
        assert agent.embedding is not None
        assert isinstance(replay, PrioritisedReplay)
        self.updates += 1
        with torch.no_grad():
            batch, slots = replay.sample_by_priority(options.batch_size, self.generator)
            batch = self._mirrored(batch)
        loss = agent.embedding.update(batch.observation, batch.action, batch.next_observation, learning_rate)
        metrics = {"embedding_loss": loss} | self._update_critics(batch, slots, replay, learning_rate)
        if self.updates % options.policy_delay == 0:
            metrics |= self._update_actor(batch, learning_rate)
        if self.updates % options.hard_target_interval == 0:
            for network in (agent.actor, agent.task_critics):
                network.follow(1.0)
            agent.embedding.renew()
            replay.forget_largest()
            agent.value_range[2:] = agent.value_range[:2]
        return metrics

    def _update_critics(
        self, batch: Batch, slots: Tensor, replay: PrioritisedReplay, learning_rate: float
    ) -> Metrics:
        options, agent = self.configuration, self.agent
        with torch.no_grad():
            noise = (options.target_noise, options.target_noise_limit)
            next_action = smoothed_action(agent.actor.target, batch.next_observation, *noise, self.generator)
            next_input = self._critic_input(batch.next_observation, next_action, older=True)
            smallest = twin_values(agent.task_critics.target, next_input).amin(0)
            low, high = agent.value_range[2:].unsqueeze(-1)  # (S, 1) each
            target = batch.reward + batch.discount * torch.clamp(smallest, low, high)
            extremes = torch.stack([target.amin(1), target.amax(1)])
            agent.value_range[0] = torch.minimum(agent.value_range[0], extremes[0])
            agent.value_range[1] = torch.maximum(agent.value_range[1], extremes[1])
        values = twin_values(agent.task_critics.weights, self._critic_input(batch.observation, batch.action))
        errors = values - target
        loss = lap_huber(errors).mean(-1)  # (2, S)
        agent.task_critics.descend(grad(loss.sum(), agent.task_critics.weights.layers), learning_rate)
        replay.set_priority(slots, priority(errors.detach()))
        return {"task_critic_loss": loss.detach().sum(0), "task_value": values.detach().mean((0, 2))}

    def _update_actor(self, batch: Batch, learning_rate: float) -> Metrics:
        agent, observation = self.agent, batch.observation
        raw = agent.actor.weights(observation)
        values = twin_values(agent.task_critics.weights, self._critic_input(observation, raw.tanh()))
        value = values.mean((0, 2))
        loss = self.configuration.saturation_penalty * saturation(raw) - value
        penalties = self.penalties(batch)
        for weight, metric in penalties.values():
            loss = loss + weight * metric
        agent.actor.descend(grad(loss.sum(), agent.actor.weights.layers), learning_rate)
        measured = {name: metric.detach() for name, (_, metric) in penalties.items()}
        return {"actor_value": value.detach(), **measured, **self.keep_limits()}
