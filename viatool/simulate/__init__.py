"""Simulators of the navigation task, and roll-outs that record what a policy does in them."""

from __future__ import annotations

from viatool.simulate.agreement import Agreement, compare_with_map
from viatool.simulate.conditions import Conditions
from viatool.simulate.engines import ENGINES, make_simulator
from viatool.simulate.kinematic import NavigationSimulator
from viatool.simulate.observation import Observer, navigation_channels
from viatool.simulate.places import Places, observe_places
from viatool.simulate.roll_out import Drive, drive, roll_out
from viatool.simulate.simulation import Simulation, simulate
from viatool.simulate.simulator import Simulator, Step
from viatool.simulate.statistics import Proportion, Spread, Statistics, summarise_drive
from viatool.simulate.task import NavigationTask

__all__ = [
    "ENGINES",
    "Agreement",
    "Conditions",
    "Drive",
    "NavigationSimulator",
    "NavigationTask",
    "Observer",
    "Places",
    "Proportion",
    "Simulation",
    "Simulator",
    "Spread",
    "Statistics",
    "Step",
    "compare_with_map",
    "drive",
    "make_simulator",
    "navigation_channels",
    "observe_places",
    "roll_out",
    "simulate",
    "summarise_drive",
]
