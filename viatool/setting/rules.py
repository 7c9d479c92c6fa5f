"""What is asked of a state: the criterion, the distances, and the robot whose motion is judged."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from viatool.arrays import Floats
from viatool.errors import ConfigurationError
from viatool.motion.dead_time import DeadTime
from viatool.motion.manoeuvre import Manoeuvre
from viatool.world import Clearance, Footprint, WorldMap

Criterion = Literal["sampled", "swept", "braking"]
CRITERIA: tuple[Criterion, ...] = get_args(Criterion)


@dataclass(frozen=True, eq=False)
class Rules:
    """What every state must fulfil.

    Parameters
    ----------
    criterion : str
        "sampled" (the paper's nine actions), "swept" (every action, every instant) or "braking" (swept, and
        a full stop after it).
    clearance : Clearance
        Distances that the footprint must exceed: collision and danger.
    footprint : Footprint
        Outline in the robot's frame.
    lower, upper : ndarray
        (2,) the commands that the robot carries out, v in m/s and omega in rad/s; others are clipped to them.
    interval : float
        Seconds for which a command is held.
    deceleration : float
        Largest braking, in m/s^2.
    delay : float
        Dead time in seconds, for which the commands before go on.
    """

    criterion: Criterion
    clearance: Clearance
    footprint: Footprint
    lower: Floats
    upper: Floats
    interval: float
    deceleration: float
    delay: float = 0.0

    @classmethod
    def of(
        cls,
        world_map: WorldMap,
        criterion: str = "swept",
        *,
        interval: float | None = None,
        footprint: Footprint | str | float | Sequence[Sequence[float]] | None = None,
        delay: float = 0.0,
    ) -> Rules:
        """Return the rules of a map and its robot, with what the user overrides.

        Raises
        ------
        ConfigurationError
            If the criterion is not known, or a number is out of its range.
        """
        robot = world_map.robot
        if criterion not in CRITERIA:
            raise ConfigurationError(
                f"criterion '{criterion}' is not known", f"choose one of {', '.join(CRITERIA)}"
            )
        interval = robot.control_interval if interval is None else interval
        if not 0.0 < interval < math.inf:
            raise ConfigurationError(
                f"the control interval is {interval} s", "give a positive time in seconds"
            )
        if not 0.0 <= delay < math.inf:
            raise ConfigurationError(f"the delay is {delay} s", "give a time of 0 s or more")
        if criterion == "braking" and not 0.0 < robot.deceleration < math.inf:
            raise ConfigurationError(
                f"the robot's deceleration is {robot.deceleration} m/s^2, so it never stops",
                "give the map's robot a positive deceleration",
            )
        return cls(
            criterion=next(name for name in CRITERIA if name == criterion),
            clearance=world_map.clearance,
            footprint=robot.footprint if footprint is None else as_footprint(footprint),
            lower=np.array([robot.min_linear, -robot.max_angular]),
            upper=np.array([robot.max_linear, robot.max_angular]),
            interval=interval,
            deceleration=robot.deceleration,
            delay=delay,
        )

    @property
    def manoeuvre(self) -> Manoeuvre:
        """Return the path on which the clearance counts."""
        if self.criterion != "braking":
            return Manoeuvre(self.interval)
        rim = self.footprint.reach if self.footprint.kind == "polygon" else 0.0
        return Manoeuvre(self.interval, self.deceleration, rim)

    @property
    def dead_time(self) -> DeadTime:
        """Return which commands act before the new one does, and for how long."""
        return DeadTime(self.delay, self.interval)

    @property
    def waiting(self) -> tuple[Manoeuvre, ...]:
        """Return the W paths that the commands on their way add before the new one acts, the oldest first."""
        return tuple(Manoeuvre(seconds) for seconds in self.dead_time.durations)

    def clip(self, actions: Floats) -> Floats:
        """Return commands (..., 2) as the robot carries them out; monotone, so ends of a box map to ends."""
        return np.clip(actions, self.lower, self.upper)


def as_footprint(footprint: Footprint | str | float | Sequence[Sequence[float]]) -> Footprint:
    """Return a footprint from "point", a radius in metres, or the corners of a polygon.

    Raises
    ------
    ConfigurationError
        If it is none of them; MapError if a polygon is not simple.
    """
    if isinstance(footprint, Footprint):
        return footprint
    if isinstance(footprint, str):
        if footprint == "point":
            return Footprint()
        raise ConfigurationError(
            f"footprint '{footprint}' is not known",
            "give 'point', a radius in metres, or the corners of a polygon",
        )
    if isinstance(footprint, (int, float)):
        if not 0.0 < footprint < math.inf:
            raise ConfigurationError(f"the footprint's radius is {footprint} m", "give a positive radius")
        return Footprint("circle", radius=float(footprint))
    corners = np.asarray(footprint, dtype=np.float64)
    if corners.ndim != 2 or corners.shape[1] != 2 or not np.isfinite(corners).all():
        raise ConfigurationError(
            "the footprint is not a list of corners (x, y)", "give at least three corners"
        )
    return Footprint("polygon", polygon=corners)
