"""Simulators of the navigation task, and roll-outs that record what a policy does in them."""

from __future__ import annotations

from viatool.simulate.motion import advance, wrap_angle
from viatool.simulate.observation import Observer, Situation, measure_goals, navigation_channels
from viatool.simulate.places import Places, observe_places
from viatool.simulate.roll_out import roll_out
from viatool.simulate.simulator import NavigationSimulator, Step
from viatool.simulate.task import NavigationTask

__all__ = [
    "NavigationSimulator",
    "NavigationTask",
    "Observer",
    "Places",
    "Situation",
    "Step",
    "advance",
    "measure_goals",
    "navigation_channels",
    "observe_places",
    "roll_out",
    "wrap_angle",
]
