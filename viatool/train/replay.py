"""The replay buffer: one preallocated array of records for all seeds, sampled in one gather."""

from __future__ import annotations

from typing import NamedTuple

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
        seeds = self.records.shape[0]
        slots = torch.randint(self.size, (seeds, batch_size), generator=generator) + self._rows
        flat = self.records.view(seeds * self.capacity, -1).index_select(0, slots.view(-1))
        parts = torch.split(flat.view(seeds, batch_size, -1), self._widths, dim=-1)
        return Batch(*parts[:3], *(part.squeeze(-1) for part in parts[3:]))
