"""What a robot really does with a policy: choose from its table, apply the rules around it, send a command."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from viatool.arrays import Floats
from viatool.policy import Policy
from viatool.policy.command_map import Chosen
from viatool.policy.network import Network
from viatool.policy.overrides import Overrides


@dataclass(frozen=True, eq=False)
class DrivenPolicy:
    """A policy with all that stands between its outputs and the command that is sent.

    Parameters
    ----------
    policy : Policy
        It gives commands, or what is compared to choose one.
    choice : Chosen or None
        The table, if it chooses.
    overrides : Overrides
        The rules around it.
    """

    policy: Policy
    choice: Chosen | None
    overrides: Overrides

    @property
    def network(self) -> Network:
        """The network, before choice and rules."""
        return self.policy.network

    @property
    def is_plain(self) -> bool:
        """Tell whether what the network gives is the command."""
        return self.choice is None and not self.overrides

    def run(self, observations: ArrayLike) -> Floats:
        """Return the commands (B, A) that are sent after observations (B, n), the program run by onnxruntime."""
        return self._sent(observations, self.policy.run(observations))

    def __call__(self, observations: ArrayLike) -> Floats:
        """Return the commands (B, A) that are sent after observations (B, n), the network in float64."""
        return self._sent(observations, self.policy(observations))

    def _sent(self, observations: ArrayLike, outputs: Floats) -> Floats:
        commands = outputs if self.choice is None else self.choice(outputs)
        return self.overrides.apply(np.asarray(observations, dtype=np.float64), commands)
