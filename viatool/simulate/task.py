"""The navigation task: when an episode ends, what a step earns and what it costs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Booleans, Floats


@dataclass(frozen=True)
class NavigationTask:
    """The task of the paper, with the reward of the public environment that it uses.

    Parameters
    ----------
    horizon : int
        Steps after which an episode is truncated.
    goal_radius : float
        The goal is reached when the robot is nearer than this, in metres.
    goal_reward, collision_reward : float
        Of the step that ends the episode.
    turn_penalty : float
        Per rad/s of turning, either way.
    proximity_penalty : float
        Per metre that the smallest reading is below `proximity_range`.
    proximity_range : float
        In metres.
    """

    horizon: int = 300
    goal_radius: float = 0.5
    goal_reward: float = 100.0
    collision_reward: float = -100.0
    turn_penalty: float = 0.5
    proximity_penalty: float = 0.5
    proximity_range: float = 1.35

    def reward(
        self, actions: Floats, nearest: NDArray[np.floating], success: Booleans, collision: Booleans
    ) -> Floats:
        """Return the reward of a step.

        Parameters
        ----------
        actions : ndarray
            (B, 2) commands as carried out, m/s and rad/s.
        nearest : ndarray
            (B,) smallest reading of the LiDAR after the step, in metres.
        success, collision : ndarray
            (B,) bool; never both.

        Returns
        -------
        ndarray
            (B,).
        """
        near = np.maximum(0.0, self.proximity_range - nearest)
        driving = actions[:, 0] - self.turn_penalty * np.abs(actions[:, 1]) - self.proximity_penalty * near
        return np.where(success, self.goal_reward, np.where(collision, self.collision_reward, driving))
