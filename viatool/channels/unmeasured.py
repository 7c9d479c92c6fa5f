"""What no sensor measures: constants, the time that is left, and what only who runs the policy knows."""

from __future__ import annotations

import numpy as np

from viatool.arrays import Floats, Indices, Reals
from viatool.channels.channel import Channel
from viatool.channels.quantity import Quantity, observes, refuse_lidar
from viatool.channels.views import View


@observes("budget")
class Budget(Quantity):
    """The budget of the CVaR constraint; training gives it."""

    def mirror(self) -> tuple[Indices, Floats]:
        """Return the budget as it is."""
        return np.arange(1), np.ones(1)


@observes("constant")
class ConstantNumbers(Quantity):
    """Numbers that never change."""

    @classmethod
    def check(cls, channel: Channel) -> None:
        """Accept any size, with a value."""
        refuse_lidar(channel)
        if channel.value is None:
            raise ValueError(f"channel '{channel.name}' of kind 'constant' needs its `value`")


@observes("steps_left")
class StepsLeft(Quantity):
    """How many control intervals are left until the episode ends."""

    def measure(self, view: View) -> Reals:
        """Return the intervals that are left; all of them before an episode."""
        horizon = 0 if view.horizon is None else view.horizon
        return (
            np.full(len(view), float(horizon)) if view.steps is None else (horizon - view.steps).astype(float)
        )

    def mirror(self) -> tuple[Indices, Floats]:
        """Return the time as it is."""
        return np.arange(1), np.ones(1)


@observes("other")
class Other(Quantity):
    """Numbers of which nothing is known."""

    @classmethod
    def check(cls, channel: Channel) -> None:
        """Accept any size."""
        refuse_lidar(channel)
