"""What the policy sees and commands: the specification of a map's robot, and its scaling for the networks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from viatool.arrays import Floats
from viatool.policy import ActionChannel, LidarSpecification, ObservationChannel, PolicySpecification
from viatool.world import Robot

LIDAR_CENTRE, LIDAR_SCALE = 2.0, 2.0  # metres
GOAL_CENTRE, GOAL_SCALE = 3.0, 3.0  # metres


@dataclass(frozen=True, eq=False)
class Scaling:
    """Affine maps between physical units and the networks' units.

    Parameters
    ----------
    offset, factor : ndarray
        ``(n,)``; the networks see ``(observation - offset) * factor``, the budget included as the last entry.
    action_offset, action_factor : ndarray
        ``(A,)``; the robot gets ``action_offset + action_factor * tanh output``.
    """

    offset: Floats
    factor: Floats
    action_offset: Floats
    action_factor: Floats

    @property
    def bins(self) -> int:
        """Return how many LiDAR bins an observation begins with."""
        return len(self.offset) - 6

    def radius(self, eps: float) -> Tensor:
        """Return ``(n,)`` the half widths of a box of `eps` in every channel's unit, 0 for the budget."""
        return torch.from_numpy(np.append(eps * self.factor[:-1], 0.0).astype(np.float32))

    def normalise(self, observation: Floats, budget: Floats) -> Tensor:
        """Join physical observations ``(N, n - 1)`` and budgets ``(N,)`` to network inputs ``(N, n)``."""
        joined = np.concatenate([observation, budget[:, None]], axis=1)
        return torch.from_numpy(((joined - self.offset) * self.factor).astype(np.float32))

    def physical_action(self, action: Floats) -> Floats:
        """Scale actions ``(N, A)`` in [-1, 1] to m/s and rad/s."""
        return self.action_offset + self.action_factor * action


def make_specification(robot: Robot, budget: float, training: dict[str, Any]) -> PolicySpecification:
    """Describe a trained policy; its budget channel is fixed to `budget`, the final u."""
    lidar = LidarSpecification(
        field_of_view=robot.lidar.field_of_view,
        rays=robot.lidar.rays,
        bins=robot.lidar.bins,
        minimum_range=robot.lidar.minimum_range,
        maximum_range=robot.lidar.maximum_range,
    )
    return PolicySpecification(
        observation=[
            ObservationChannel(name="lidar", size=lidar.bins, unit="m", kind="lidar", lidar=lidar),
            ObservationChannel(name="goal_distance", unit="m", kind="goal_distance"),
            ObservationChannel(name="goal_cosine", kind="goal_cosine"),
            ObservationChannel(name="goal_sine", kind="goal_sine"),
            ObservationChannel(name="previous_linear", unit="m/s", kind="previous_linear"),
            ObservationChannel(name="previous_angular", unit="rad/s", kind="previous_angular"),
            ObservationChannel(name="budget", kind="budget", value=budget),
        ],
        action=[
            ActionChannel(
                name="v", unit="m/s", lower=robot.min_linear, upper=robot.max_linear, kind="linear"
            ),
            ActionChannel(
                name="omega", unit="rad/s", lower=-robot.max_angular, upper=robot.max_angular, kind="angular"
            ),
        ],
        robot=robot.name,
        control_interval=robot.control_interval,
        training=training,
    )


def make_scaling(robot: Robot, budget_limit: float) -> Scaling:
    """Return the scaling for a robot: inputs about in [-1, 1] where it matters, actions in its limits."""
    bins = robot.lidar.bins
    middle = (robot.max_linear + robot.min_linear) / 2
    half = (robot.max_linear - robot.min_linear) / 2
    return Scaling(
        offset=np.array([LIDAR_CENTRE] * bins + [GOAL_CENTRE, 0.0, 0.0, middle, 0.0, 0.0]),
        factor=1.0
        / np.array([LIDAR_SCALE] * bins + [GOAL_SCALE, 1.0, 1.0, half, robot.max_angular, budget_limit]),
        action_offset=np.array([middle, 0.0]),
        action_factor=np.array([half, robot.max_angular]),
    )


def near_features(observation: Tensor, bins: int, decay: float = 4.0) -> Tensor:
    """Append ``exp(-decay (range - 0.5 m))`` of every LiDAR bin: ``(..., n)`` to ``(..., n + bins)``.

    Collisions are decided within a few decimetres, a small part of the LiDAR's normalised range. Only critics
    see these features: the actor stays a plain perceptron of the raw observation.
    """
    ranges = observation[..., :bins] * LIDAR_SCALE + LIDAR_CENTRE
    return torch.cat([observation, torch.exp(-decay * (ranges - 0.5))], dim=-1)


class Mirror:
    """Shows transitions as in a mirror, left for right: the robot and its task are the same there.

    Parameters
    ----------
    bins : int
        LiDAR bins, the first columns of an observation; then goal distance, cosine and sine, the previous
        linear and angular velocity, and the budget.
    """

    def __init__(self, bins: int) -> None:
        rest = torch.arange(bins, bins + 6)
        self._columns = torch.cat([torch.arange(bins).flip(0), rest])
        self._signs = torch.ones(bins + 6)
        self._signs[[bins + 2, bins + 4]] = -1.0  # sine of the goal's bearing, previous angular velocity
        self._action_signs = torch.tensor([1.0, -1.0])

    def observation(self, observation: Tensor) -> Tensor:
        """Return mirrored observations ``(..., n)``, normalised or not."""
        return observation.index_select(-1, self._columns) * self._signs

    def action(self, action: Tensor) -> Tensor:
        """Return mirrored actions ``(..., A)``."""
        return action * self._action_signs
