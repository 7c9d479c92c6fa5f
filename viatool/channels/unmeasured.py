"""What only who runs the policy knows: such channels are fixed to a value, or recorded."""

from __future__ import annotations

import numpy as np

from viatool.arrays import Floats, Indices
from viatool.channels.channel import Channel
from viatool.channels.quantity import Quantity, observes, refuse_lidar


@observes("budget")
class Budget(Quantity):
    """The budget of the CVaR constraint; training gives it."""

    def mirror(self) -> tuple[Indices, Floats]:
        """Return the budget as it is."""
        return np.arange(1), np.ones(1)


@observes("other")
class Other(Quantity):
    """Numbers of which nothing is known."""

    @classmethod
    def check(cls, channel: Channel) -> None:
        """Accept any size."""
        refuse_lidar(channel)
