"""How the simulated robot differs from an ideal one: its sensor, its odometry, its motors and its delays."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from viatool.errors import ConfigurationError

PERSON = 0.25
"""Metres: the radius of a simulated person."""
MOST_PEOPLE = 100
"""In an episode at once."""


@dataclass(frozen=True)
class Conditions:
    """What a policy has to cope with; the defaults are an ideal robot with the map's sensor noise.

    Parameters
    ----------
    noise : float, optional
        Standard deviation of the LiDAR's rays that hit something, in metres; None is the map's.
    dropout : float
        Share of the rays that return nothing, at random, and so read the maximum range; in [0, 1).
    lidar_rate : float, optional
        Scans per second; None is a new scan for every command. A slower LiDAR repeats its last scan.
    delay : float
        Seconds until a command reaches the motors; until then the ones before it go on.
    drift : float
        Standard deviation of the relative error of each wheel's odometry, constant over an episode. The goal
        is observed from where odometry says the robot is.
    acceleration : float, optional
        Largest change of a wheel's rim speed in m/s^2; None means no limit in the kinematic engine, and that of
        the robot's motors in the physics engine.
    people : int
        How many people walk about in each episode, as discs of `PERSON` metres, as fast as the error model says
        (`obstacles.people`).
    """

    noise: float | None = None
    dropout: float = 0.0
    lidar_rate: float | None = None
    delay: float = 0.0
    drift: float = 0.0
    acceleration: float | None = None
    people: int = 0

    def __post_init__(self) -> None:
        self._check("noise", "m", self.noise, 0.0)
        self._check("drift", "(relative)", self.drift, 0.0)
        self._check("delay", "s", self.delay, 0.0)
        self._check("LiDAR rate", "Hz", self.lidar_rate, 0.0, above=True)
        self._check("acceleration", "m/s^2", self.acceleration, 0.0, above=True)
        if not 0 <= self.people <= MOST_PEOPLE:
            raise ConfigurationError(
                f"{self.people} people, expected 0 to {MOST_PEOPLE}", "correct the number of people"
            )
        if not 0.0 <= self.dropout < 1.0:
            raise ConfigurationError(
                f"dropout is {self.dropout}, expected a share of at least 0 and below 1",
                "give the share of rays that are lost, such as 0.02",
            )

    @staticmethod
    def _check(name: str, unit: str, value: float | None, least: float, *, above: bool = False) -> None:
        if value is None:
            return
        if not least <= value < math.inf or (above and value == least):
            wanted = "above 0" if above else "of at least 0"
            raise ConfigurationError(
                f"{name} is {value} {unit}, expected a finite number {wanted}", f"correct the {name}"
            )

    def with_noise(self, noise: float | None) -> Conditions:
        """Return the same conditions with another sensor noise; None changes nothing."""
        return self if noise is None else replace(self, noise=noise)

    def words(self) -> list[str]:
        """Return what is out of the ordinary, in words, for reports."""
        told = {
            "noise": (self.noise, "LiDAR noise {:g} m"),
            "dropout": (self.dropout or None, "dropout {:g}"),
            "lidar_rate": (self.lidar_rate, "LiDAR at {:g} Hz"),
            "delay": (self.delay or None, "delay {:g} s"),
            "drift": (self.drift or None, "odometry drift {:g}"),
            "people": (self.people or None, "people: {:g}"),
            "acceleration": (self.acceleration, "wheel acceleration {:g} m/s^2"),
        }
        return [text.format(value) for value, text in told.values() if value is not None]
