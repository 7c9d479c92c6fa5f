"""What the policy sees and commands: the specification of a map's robot, and its scaling for the networks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import torch
from torch import Tensor

from viatool.arrays import Floats, Indices
from viatool.channels import Quantities
from viatool.policy import ActionChannel, ObservationChannel, PolicySpecification
from viatool.setting.setting import Setting
from viatool.simulate import navigation_channels
from viatool.train.networks import ActorView, Bend, HiddenActivation, Weights
from viatool.world import Robot, WorldMap

LIDAR_CENTRE, LIDAR_SCALE = 2.0, 2.0  # metres
GOAL_CENTRE, GOAL_SCALE = 3.0, 3.0  # metres
SOFTNESS = (
    2.0  # of a soft saturation: how deep in tanh its range ends; the slope there is 1 - tanh(2)^2 = 0.07
)


@dataclass(frozen=True)
class ActorLayout:
    """What of an observation the actors see; critics see all of it.

    Parameters
    ----------
    lidar_range : float, optional
        Metres; what is farther is seen as this far. None where all that the LiDAR gives is seen.
    previous : bool
        Whether the command of the step before is seen.
    soft : bool
        Whether readings up to that range are seen bent, ``height * tanh(reading / height)`` with `height`.
    """

    lidar_range: float | None = None
    previous: bool = True
    soft: bool = False

    @property
    def height(self) -> float | None:
        """Return what bent readings stay below, in metres; None where they are seen as they are."""
        return self.lidar_range / SOFTNESS if self.soft and self.lidar_range is not None else None

    def sees(self, channel: ObservationChannel) -> bool:
        """Tell whether a channel is seen."""
        return self.previous or not channel.kind.startswith("previous_")


EVERYTHING = ActorLayout()
"""All of an observation."""


@dataclass(frozen=True, eq=False)
class UnitScaling:
    """Affine maps between physical units and the networks' units.

    Parameters
    ----------
    channels : tuple of ObservationChannel
        What the n numbers of an observation mean, the budget included as the last entry.
    offset, factor : ndarray
        ``(n,)``; the networks see ``(observation - offset) * factor``.
    action_offset, action_factor : ndarray
        ``(A,)``; the robot gets ``action_offset + action_factor * tanh output``.
    layout : ActorLayout
        What actors see of the observation.
    """

    channels: tuple[ObservationChannel, ...]
    offset: Floats
    factor: Floats
    action_offset: Floats
    action_factor: Floats
    layout: ActorLayout = EVERYTHING

    @cached_property
    def seen(self) -> Indices:
        """Which of the n numbers actors see, (k,)."""
        kept = [np.full(channel.size, self.layout.sees(channel)) for channel in self.channels]
        return np.flatnonzero(np.concatenate(kept))

    @cached_property
    def ceiling(self) -> Floats:
        """Up to what actors see each of the n numbers, (n,) in its unit; infinite where all of it."""
        ceiling = np.full(len(self.offset), np.inf)
        if self.layout.lidar_range is not None:
            ceiling[: self.bins] = self.layout.lidar_range
        return ceiling

    def actor(self, hidden: Sequence[int], seeds: int, activation: HiddenActivation) -> Weights:
        """Return actors of S seeds with all weights 0, whose first layer gets what they see."""
        sizes = (len(self.seen), *hidden, len(self.action_offset))
        if self.layout == EVERYTHING:
            return Weights(sizes, seeds, activation)
        ceiling = ((self.ceiling - self.offset) * self.factor)[self.seen].astype(np.float32)
        view = ActorView(torch.from_numpy(self.seen), torch.from_numpy(ceiling), self._bend)
        return Weights(sizes, seeds, activation, view)

    @property
    def _bend(self) -> Bend | None:
        """Return what a soft saturation makes of the bins, which are the first numbers that are seen."""
        height = self.layout.height
        if height is None:
            return None
        bends = height / LIDAR_SCALE, -LIDAR_CENTRE / LIDAR_SCALE
        return Bend(self.bins, LIDAR_SCALE / height, LIDAR_CENTRE / height, *bends)

    @property
    def bins(self) -> int:
        """Return how many LiDAR bins an observation begins with."""
        return sum(lidar.channel.size for lidar, _ in Quantities.of(self.channels).lidars)

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


def make_specification(
    robot: Robot, budget: float, training: dict[str, Any], layout: ActorLayout = EVERYTHING
) -> PolicySpecification:
    """Describe a trained policy; its budget channel is fixed to `budget`, the final u."""
    return PolicySpecification(
        observation=[
            *filter(layout.sees, navigation_channels(robot.lidar)),
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


def training_setting(world_map: WorldMap, budget: float = 0.0) -> Setting:
    """Return what is asked of the policies that are trained on a map, by the specification that they will carry."""
    specification = make_specification(world_map.robot, budget, {})
    return Setting.of_specification(specification, world_map, 0.0, name="the policy to be trained")


def make_scaling(robot: Robot, budget_limit: float, layout: ActorLayout = EVERYTHING) -> UnitScaling:
    """Return the scaling for a robot: inputs about in [-1, 1] where it matters, actions in its limits."""
    bins = robot.lidar.bins
    middle = (robot.max_linear + robot.min_linear) / 2
    half = (robot.max_linear - robot.min_linear) / 2
    return UnitScaling(
        channels=tuple(make_specification(robot, 0.0, {}).observation),
        offset=np.array([LIDAR_CENTRE] * bins + [GOAL_CENTRE, 0.0, 0.0, middle, 0.0, 0.0]),
        factor=1.0
        / np.array([LIDAR_SCALE] * bins + [GOAL_SCALE, 1.0, 1.0, half, robot.max_angular, budget_limit]),
        action_offset=np.array([middle, 0.0]),
        action_factor=np.array([half, robot.max_angular]),
        layout=layout,
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
    channels : sequence of ObservationChannel
        Of the observation; n columns.

    Raises
    ------
    PolicyError
        If a channel has no mirror image.
    """

    def __init__(self, channels: Sequence[ObservationChannel]) -> None:
        columns, signs = Quantities.of(channels).require("mirror").mirror()
        self._columns = torch.from_numpy(columns)
        self._signs = torch.from_numpy(signs.astype(np.float32))
        self._action_signs = torch.tensor([1.0, -1.0])

    def observation(self, observation: Tensor) -> Tensor:
        """Return mirrored observations ``(..., n)``, normalised or not."""
        return observation.index_select(-1, self._columns) * self._signs

    def action(self, action: Tensor) -> Tensor:
        """Return mirrored actions ``(..., A)``."""
        return action * self._action_signs
