"""The replay buffer: one preallocated array of records for all seeds, sampled in one gather."""

from __future__ import annotations

from typing import Any, NamedTuple

import torch
from torch import Tensor


class Batch(NamedTuple):
    """n-step transitions of S seeds, see `viatool.train.returns`; observations are normalised."""

    observation: Tensor  # (S, B, n)
    next_observation: Tensor  # (S, B, n), up to n steps later
    action: Tensor  # (S, B, A) in [-1, 1]
    reward: Tensor  # (S, B), discounted sum over the steps between
    cost: Tensor  # (S, B), likewise
    discount: Tensor  # (S, B), factor of what follows: gamma^k, 0 after a termination, not after a truncation


class ReplayBuffer:
    """A ring of the latest `capacity` transitions of each seed.

    Parameters
    ----------
    seeds, capacity : int
        S, and transitions for each seed.
    observation_size, action_size : int
        n and A.
    """

    def __init__(self, seeds: int, capacity: int, observation_size: int, action_size: int) -> None:
        self.capacity = capacity
        self.size = 0
        self.position = 0
        self._widths = [observation_size, observation_size, action_size, 1, 1, 1]
        self.records = torch.zeros(seeds, capacity, sum(self._widths))
        self._rows = torch.arange(seeds).unsqueeze(1) * capacity  # (S, 1)

    def add(self, batch: Batch) -> None:
        """Append ``(S, E)`` transitions, overwriting the oldest ones when the ring is full."""
        columns = [part if part.dim() == 3 else part.unsqueeze(-1) for part in batch]
        records = torch.cat([column.to(torch.float32) for column in columns], dim=-1)
        count = records.shape[1]
        slots = (self.position + torch.arange(count)) % self.capacity
        self.records[:, slots] = records
        self.position = (self.position + count) % self.capacity
        self.size = min(self.size + count, self.capacity)

    def sample(self, batch_size: int, generator: torch.Generator) -> Batch:
        """Draw ``(S, batch_size)`` transitions uniformly, with replacement, for each seed on its own."""
        slots = torch.randint(self.size, (self.records.shape[0], batch_size), generator=generator)
        return self.take(slots)

    def take(self, slots: Tensor) -> Batch:
        """Return the transitions in given slots, ``(S, B)``, of each seed's own ring."""
        seeds, count = slots.shape
        flat = self.records.view(seeds * self.capacity, -1).index_select(0, (slots + self._rows).view(-1))
        parts = torch.split(flat.view(seeds, count, -1), self._widths, dim=-1)
        return Batch(*parts[:3], *(part.squeeze(-1) for part in parts[3:]))

    def state(self) -> dict[str, Any]:
        """Return what a resumed run needs."""
        return {"records": self.records[:, : self.size].contiguous(), "position": self.position}

    def restore(self, state: dict[str, Any]) -> None:
        """Take over what `state` returned in an earlier run."""
        self.size = state["records"].shape[1]
        self.records[:, : self.size] = state["records"]
        self.position = state["position"]


class PrioritisedReplay(ReplayBuffer):
    """A replay buffer that draws transitions in proportion to their priority; fresh ones get the largest."""

    def __init__(self, seeds: int, capacity: int, observation_size: int, action_size: int) -> None:
        super().__init__(seeds, capacity, observation_size, action_size)
        self.priority = torch.zeros(seeds, capacity)
        self.largest = torch.ones(seeds, 1)

    def add(self, batch: Batch) -> None:
        """Append transitions with the largest priority so far."""
        slots = (self.position + torch.arange(batch.reward.shape[1])) % self.capacity
        self.priority[:, slots] = self.largest.expand(-1, len(slots))
        super().add(batch)

    def sample_by_priority(self, batch_size: int, generator: torch.Generator) -> tuple[Batch, Tensor]:
        """Draw transitions and return them with their slots, ``(S, batch_size)``."""
        total = self.priority[:, : self.size].cumsum(1)
        wanted = torch.rand(total.shape[0], batch_size, generator=generator) * total[:, -1:]
        slots = torch.searchsorted(total, wanted).clamp_(max=self.size - 1)
        return self.take(slots), slots

    def set_priority(self, slots: Tensor, values: Tensor) -> None:
        """Give the transitions in ``(S, B)`` slots their new priorities."""
        self.priority.scatter_(1, slots, values)
        self.largest = torch.maximum(self.largest, values.amax(1, keepdim=True))

    def forget_largest(self) -> None:
        """Let the largest priority be that of the transitions that are there."""
        self.largest = self.priority[:, : self.size].amax(1, keepdim=True)

    def state(self) -> dict[str, Any]:
        """Return what a resumed run needs."""
        own = {"priority": self.priority[:, : self.size].contiguous(), "largest": self.largest}
        return super().state() | own

    def restore(self, state: dict[str, Any]) -> None:
        """Take over what `state` returned in an earlier run."""
        super().restore(state)
        self.priority[:, : self.size] = state["priority"]
        self.largest = state["largest"]
