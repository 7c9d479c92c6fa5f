"""What no sensor measures: constants, the time that is left, and what only who runs the policy knows."""

from __future__ import annotations

import numpy as np

from viatool.arrays import Floats, Hull, Indices, Reals
from viatool.channels.channel import Channel
from viatool.channels.quantity import Quantity, observes, refuse_lidar
from viatool.channels.views import BoxView, View
from viatool.errors import PolicyError
from viatool.sets.forms import Forms


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

    believes = False
    placed = False
    needs = frozenset({"time"})

    def measure(self, view: View) -> Reals:
        """Return the intervals that are left; all of them before an episode."""
        horizon = 0 if view.horizon is None else view.horizon
        return (
            np.full(len(view), float(horizon)) if view.steps is None else (horizon - view.steps).astype(float)
        )

    def enclose(self, view: BoxView) -> Forms:
        """Return what is left in each set, or what makes a difference to the channel, see `Channel.told_apart`.

        Raises
        ------
        PolicyError
            If neither bounds it.
        """
        left = np.array([[0.0, np.inf]]) if view.left is None else view.left
        return view.between(*self.require_limits(*left.T))

    def require_limits(self, lower: Floats, upper: Floats) -> Hull:
        """Return ends of what may be left, where they make a difference to the channel.

        Raises
        ------
        PolicyError
            If one of them is infinite.
        """
        ends = np.clip(lower, *self.channel.told_apart), np.clip(upper, *self.channel.told_apart)
        if not np.isfinite(ends).all():
            raise PolicyError(
                f"{self.channel} is not known over a set of poses: nothing tells how long an episode is",
                "give the channel a `clip` or a fixed `value` in the specification, or verify recorded states alone",
            )
        return ends

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
