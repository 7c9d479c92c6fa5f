"""An adversary who chooses, of some errors within a model, those that lead nearest to an obstacle."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from viatool.arrays import Floats
from viatool.setting.setting import Setting
from viatool.simulate.simulator import Simulator

CANDIDATES = 6
"""Observations among which the adversary chooses in each step; the motors have as many."""
_AHEAD = 3.0
"""Control intervals for which a command is followed to see where it leads."""


class Deciding(Protocol):
    """What decides."""

    def run(self, observations: ArrayLike, /) -> Floats:
        """Return actions of observations."""


def choose_observations(
    policy: Deciding, simulator: Simulator, setting: Setting, beside: Callable[[Floats], Floats]
) -> Floats:
    """Let every robot observe what makes its policy come nearest to an obstacle, of some observations.

    Parameters
    ----------
    policy : Policy
        That decides.
    simulator : Simulator
        E robots; it observes what was chosen from then on.
    setting : Setting
        How actions become commands.
    beside : callable
        Puts what else a policy takes, such as its memory, beside what robots sense, (E, m) to (E, n).

    Returns
    -------
    ndarray
        (E, m).
    """
    flat = np.concatenate([beside(sensed) for sensed in simulator.offer(CANDIDATES)])
    actions = np.asarray(policy.run(flat), dtype=np.float64)
    commands = simulator.kinematics.clip(setting.sent(flat, actions), simulator.robot)
    states = np.tile(np.concatenate([simulator.poses, simulator.motion], axis=1), (CANDIDATES, 1))
    ahead = simulator.kinematics.advance(states, commands, _AHEAD * simulator.robot.control_interval)[:, :3]
    clearance = simulator.clearance(ahead)
    return simulator.take(clearance.reshape(CANDIDATES, -1).argmin(axis=0))
