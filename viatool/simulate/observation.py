"""What a robot observes: the columns of an observation, assembled by the kinds of their channels.

Training, roll-outs and checks of sampled poses share it; recordings share the columns, `assemble`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Floats, Indices
from viatool.errors import ConfigurationError, PolicyError
from viatool.policy.specification import LidarSpecification, ObservationChannel
from viatool.simulate.noise import draw_normal
from viatool.trajectory import assemble, polar_goals
from viatool.world import Lidar, Robot, Scenes


@dataclass(frozen=True, eq=False)
class Situation:
    """B robots and what they head for.

    Parameters
    ----------
    poses : ndarray
        (B, 3) x, y, theta; metres and radians.
    scene : ndarray
        (B,) index of the geometry around each of them.
    goals : ndarray
        (B, 2) metres.
    previous : ndarray
        (B, 2) the command of the step before, m/s and rad/s.
    believed : ndarray, optional
        (B, 3) where the robots think they are, if that differs from where they are; goals are seen from there.
    """

    poses: Floats
    scene: Indices
    goals: Floats
    previous: Floats
    believed: Floats | None = None


def navigation_channels(lidar: Lidar) -> tuple[ObservationChannel, ...]:
    """Return the channels of the navigation task: LiDAR bins, goal in polar form, previous command.

    Parameters
    ----------
    lidar : Lidar
        Of the robot.

    Returns
    -------
    tuple of ObservationChannel
        ``lidar.bins + 5`` columns.
    """
    specification = LidarSpecification(
        field_of_view=lidar.field_of_view,
        rays=lidar.rays,
        bins=lidar.bins,
        minimum_range=lidar.minimum_range,
        maximum_range=lidar.maximum_range,
    )
    return (
        ObservationChannel(name="lidar", size=lidar.bins, unit="m", kind="lidar", lidar=specification),
        ObservationChannel(name="goal_distance", unit="m", kind="goal_distance"),
        ObservationChannel(name="goal_cosine", kind="goal_cosine"),
        ObservationChannel(name="goal_sine", kind="goal_sine"),
        ObservationChannel(name="previous_linear", unit="m/s", kind="previous_linear"),
        ObservationChannel(name="previous_angular", unit="rad/s", kind="previous_angular"),
    )


class Observer:
    """Fills observation vectors.

    Parameters
    ----------
    channels : sequence of ObservationChannel
        In the order of the columns.
    robot : Robot
        Whose LiDAR is used where the LiDAR channel does not describe one, and whose noise.
    noise : float, optional
        Standard deviation of the rays in metres; None is the robot's.
    dropout : float
        Share of the rays that return nothing, at random, and so read the maximum range.

    Attributes
    ----------
    directions : ndarray
        (2, R) float32 unit vectors of the rays in the robot's frame, in the order in which ranges are read.

    Raises
    ------
    PolicyError
        If a channel can neither be simulated nor has a fixed value, or the number of bins is unclear.
    ConfigurationError
        If the noise is negative or not finite.
    """

    def __init__(
        self,
        channels: Sequence[ObservationChannel],
        robot: Robot,
        noise: float | None = None,
        dropout: float = 0.0,
    ) -> None:
        self.dropout = dropout
        self.channels = tuple(channels)
        self.size = sum(channel.size for channel in channels)
        self.lidar = _lidar(self.channels, robot)
        self.noise = self.lidar.noise if noise is None else noise
        if not 0.0 <= self.noise < np.inf:
            raise ConfigurationError(
                f"LiDAR noise is {noise} m, expected 0 or more", "give a standard deviation in metres"
            )
        per_bin = self.lidar.rays // self.lidar.bins
        # First rays of all bins, second rays of all bins, ...: a minimum over the first axis is fast.
        order = np.arange(self.lidar.rays).reshape(self.lidar.bins, per_bin).T.ravel()
        self.directions = self.lidar.directions()[:, order].astype(np.float32)
        for channel in self.channels:
            if channel.kind in ("other", "budget") and channel.value is None:
                raise PolicyError(
                    f"observation channel '{channel.name}' of kind '{channel.kind}' cannot be simulated",
                    "give the channel a fixed `value` in the specification, or a recorded trajectory",
                )

    def cast(self, scenes: Scenes, situation: Situation) -> NDArray[np.float32]:
        """Return the true ranges of the rays, (B, R) m."""
        ranges: NDArray[np.float32] = scenes.cast(
            situation.poses, situation.scene, self.lidar, directions=self.directions
        )
        return ranges

    def read(self, ranges: NDArray[np.float32], rng: np.random.Generator) -> NDArray[np.float32]:
        """Return the smallest reading of each bin, noisy and clipped to the LiDAR's range.

        Parameters
        ----------
        ranges : ndarray
            (B, R) true ranges in metres, in the order of `directions`; overwritten.
        rng : numpy.random.Generator
            Source of the sensor noise.

        Returns
        -------
        ndarray
            (B, bins) metres.
        """
        lidar = self.lidar
        if self.noise > 0.0:
            error = draw_normal(rng, *ranges.shape)
            error *= np.float32(self.noise)
            error *= ranges < lidar.maximum_range  # a ray that hits nothing has no error
            ranges += error
        if self.dropout > 0.0:
            ranges[rng.random(ranges.shape, dtype=np.float32) < self.dropout] = lidar.maximum_range
        binned = ranges.reshape(len(ranges), -1, lidar.bins).min(axis=1)
        clipped: NDArray[np.float32] = np.clip(binned, lidar.minimum_range, lidar.maximum_range)
        return clipped

    def measure(
        self, scenes: Scenes, situation: Situation, rng: np.random.Generator
    ) -> dict[str, NDArray[Any]]:
        """Return the values of each kind of channel: (B, bins) for the LiDAR, else (B,).

        Parameters
        ----------
        scenes : Scenes
            The geometry.
        situation : Situation
            Where the B robots are.
        rng : numpy.random.Generator
            Source of the sensor noise.
        """
        return {"lidar": self.read(self.cast(scenes, situation), rng), **measure_goals(situation)}

    def observe(self, scenes: Scenes, situation: Situation, rng: np.random.Generator) -> Floats:
        """Return observations, (B, size): `measure`, then `assemble`."""
        return self.assemble(self.measure(scenes, situation, rng))

    def assemble(self, measured: Mapping[str, NDArray[Any]]) -> Floats:
        """Put measured values into the columns of their channels.

        Parameters
        ----------
        measured : mapping
            For each kind of channel (B, size) or (B,); fixed channels take their `value` instead.

        Returns
        -------
        ndarray
            (B, size) float64 holding float32 numbers: the very values that a float32 policy receives.
        """
        return assemble(self.channels, measured)


def measure_goals(situation: Situation) -> dict[str, Floats]:
    """Return the values of the channels that need no LiDAR, by kind, (B,) each."""
    poses = situation.poses if situation.believed is None else situation.believed
    return {
        **polar_goals(poses, situation.goals),
        "previous_linear": situation.previous[:, 0],
        "previous_angular": situation.previous[:, 1],
    }


def _lidar(channels: Sequence[ObservationChannel], robot: Robot) -> Lidar:
    """Return the LiDAR that the channels ask for, with the robot's noise."""
    for channel in channels:
        if channel.kind == "lidar" and channel.value is None:
            asked = channel.lidar
            if asked is not None:
                return replace(robot.lidar, **asked.model_dump())
            if channel.size == robot.lidar.bins:
                return robot.lidar
            raise PolicyError(
                f"observation channel '{channel.name}' has {channel.size} numbers, "
                f"but the LiDAR of {robot.name} has {robot.lidar.bins} bins",
                "describe the LiDAR in the policy's specification",
            )
    return robot.lidar
