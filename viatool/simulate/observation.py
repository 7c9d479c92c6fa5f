"""What a robot observes: the columns of an observation, each channel by itself, with the errors of the sensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import reduce

import numpy as np

from viatool.arrays import Floats, Reals, Singles
from viatool.channels import Fan, Frames, LidarReadings, LidarSpecification, Quantities, View
from viatool.errors import ConfigurationError
from viatool.policy.specification import ObservationChannel
from viatool.simulate.noise import draw_normal
from viatool.world import Lidar, Robot


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
    frames : Frames, optional
        How many whole observations are stacked.

    Attributes
    ----------
    quantities : Quantities
        What the channels observe; n numbers.
    lidars : tuple of LidarReadings
        The LiDARs of the channels; the robot's own where no channel reads one.

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
        frames: Frames | None = None,
    ) -> None:
        self.dropout = dropout
        self.quantities = Quantities.of(channels, robot, frames).require("measure")
        seen = [lidar for lidar, _ in self.quantities.lidars]
        self.lidars = tuple(seen) or (LidarReadings(navigation_channels(robot.lidar)[0], robot),)
        self.noise = robot.lidar.noise if noise is None else noise
        if not 0.0 <= self.noise < np.inf:
            raise ConfigurationError(
                f"LiDAR noise is {noise} m, expected 0 or more", "give a standard deviation in metres"
            )

    @property
    def size(self) -> int:
        """Return n, the number of columns."""
        return self.quantities.size

    @property
    def fans(self) -> tuple[Fan, ...]:
        """Return the rays of each LiDAR."""
        return tuple(lidar.fan for lidar in self.lidars)

    def disturb(self, ranges: Reals, fan: Fan, rng: np.random.Generator) -> Reals:
        """Add noise to true ranges (B, R) of a fan and drop some, in place.

        Parameters
        ----------
        ranges : ndarray
            (B, R) metres, in the order of the fan's directions; overwritten.
        fan : Fan
            Of which LiDAR.
        rng : numpy.random.Generator
            Source of the errors.
        """
        limit = fan.lidar.maximum_range
        if self.noise > 0.0:
            error = draw_normal(rng, *ranges.shape)
            error *= np.float32(self.noise)
            error *= ranges < limit  # a ray that hits nothing has no error
            ranges += error
        if self.dropout > 0.0:
            ranges[rng.random(ranges.shape, dtype=np.float32) < self.dropout] = limit
        return ranges

    def observe(self, view: View, rng: np.random.Generator) -> Floats:
        """Return observations, (B, n), with errors of the LiDARs.

        Parameters
        ----------
        view : View
            The B robots and what is around them.
        rng : numpy.random.Generator
            Source of the errors.
        """

        def eyes(fan: Fan, now: View) -> Reals:
            return self.disturb(view.eyes(fan, now), fan, rng)

        return self.quantities.measure(replace(view, eyes=eyes))

    def nearest(self, view: View, readings: Floats) -> Singles:
        """Return the smallest reading of all LiDARs, (B,) m, of readings (B, m); of the robot's if none is read."""
        seen: list[Reals] = [readings[:, columns] for _, columns in self.quantities.lidars]
        parts = seen or [lidar.measure(view) for lidar in self.lidars]
        least: Singles = reduce(np.minimum, (part.min(axis=1) for part in parts)).astype(np.float32)
        return least
