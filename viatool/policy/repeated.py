"""Policies some of whose inputs are one and the same number, as those that take each of their numbers once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from viatool.arrays import Floats, Indices
from viatool.policy.assembly import renumbered
from viatool.policy.network import Affine, Input, Network
from viatool.policy.weights import placed


@dataclass(frozen=True, eq=False)
class RepeatingPolicy:
    """A policy of n inputs, as one of the k different numbers that stand in them.

    Parameters
    ----------
    policy : Policy
        n inputs.
    first : tuple of int
        n of them: which is the first input that holds the number of each.

    Notes
    -----
    What is bounded of it holds for the observations in which those inputs are equal, and for no others.
    """

    policy: Any
    first: tuple[int, ...]

    @cached_property
    def kept(self) -> Indices:
        """The first input of each number, (k,), ascending."""
        return np.unique(self.first)

    @cached_property
    def source(self) -> Indices:
        """Which of the k numbers each input holds, (n,)."""
        return np.searchsorted(self.kept, self.first)

    @cached_property
    def network(self) -> Network:
        """The network, of k inputs."""
        return taking_once(self.policy.network, self.source)

    @cached_property
    def rewritten(self) -> tuple[Network, ...]:
        """What its runtime runs in the network's place, of k inputs each."""
        return tuple(taking_once(other, self.source) for other in getattr(self.policy, "rewritten", ()))

    @property
    def spec(self) -> Any:
        """What its actions mean."""
        return self.policy.spec

    @property
    def runtime(self) -> Any:
        """The program."""
        return self.policy.runtime

    def run(self, numbers: Floats) -> Floats:
        """Run the deployed program on numbers (B, k); see `Policy.run`."""
        actions: Floats = self.policy.run(numbers[:, self.source])
        return actions


@lru_cache(maxsize=64)
def repeating(policy: Any, first: tuple[int, ...]) -> Any:
    """Return a policy as one that takes each number once; the policy itself where no input repeats another."""
    return policy if first == tuple(range(len(first))) else RepeatingPolicy(policy, first)


def taking_once(network: Network, source: Sequence[int] | Indices) -> Network:
    """Return the network of k numbers, of which input i of a network of n inputs takes number ``source[i]``.

    Notes
    -----
    Sound: yes; copies are exact in every precision.
    """
    which = np.asarray(source, dtype=np.int64)
    given, size = network.nodes[0], int(which.max()) + 1
    copies = placed(np.arange(len(which)), which, np.ones(len(which)), (len(which), size))
    number = {old: old + 1 for old in range(len(network.nodes))}
    nodes = (
        Input(size, given.precision),
        Affine((0,), (copies,), np.zeros(len(which)), given.precision),
        *(renumbered(node, number) for node in network.nodes[1:]),
    )
    return Network(nodes, ("", "", *network.calls[1:]) if network.calls else ())
