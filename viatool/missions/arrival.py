"""Where the runs of a scenario arrive, in the numbers of the states that their sets hold."""

from __future__ import annotations

import numpy as np

from viatool.loop.destination import Destination, NearPlace, StatesInPolygon, StatesReached
from viatool.sets.states import POSE
from viatool.setting.setting import Setting
from viatool.world import Scenario


def destination_of(scenario: Scenario, setting: Setting, goal_radius: float) -> Destination:
    """Return where every run of a scenario has to arrive: near its goal, within metres, or in its states."""
    waits = scenario.arrive == "at"
    if scenario.region is None:
        return NearPlace(waits, np.array(scenario.goal), goal_radius)
    (lower, upper), outline = scenario.region.ends(names_of_state(setting)), scenario.region.outline
    if outline:
        return StatesInPolygon(waits, lower, upper, np.array(outline))
    return StatesReached(waits, lower, upper)


def names_of_state(setting: Setting) -> tuple[str, ...]:
    """Return what the numbers of a state are called: the same for older commands, and for the velocity."""
    names = tuple(axis.name for axis in setting.rules.kinematics.before)
    return POSE + names * (len(setting.rules.carried) // len(names))
