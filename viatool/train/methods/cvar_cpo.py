"""CVaR-CPO (Zhang et al., 2024) on TD3: as VIA, but the critic's own V_C(s_0) drives the multiplier."""

from __future__ import annotations

from viatool.train.methods.method import EpochCosts
from viatool.train.methods.via import Via


class CvarCpo(Via):
    """Differs from VIA in the multiplier alone, as the paper describes it."""

    def slack(self, costs: EpochCosts) -> float:
        """Return ``b - u - V_C(s_0, pi(s_0))``."""
        return self.options.cost_limit - costs.var - costs.start
