"""TD3 without a constraint (Fujimoto, van Hoof and Meger, 2018): the backbone alone."""

from __future__ import annotations

from viatool.train.methods.method import EpochCosts, Method


class Td3(Method):
    """Maximises the reward; costs are recorded and ignored."""

    constrained = False

    def slack(self, costs: EpochCosts) -> None:
        """Return None: there is no multiplier."""
        return
