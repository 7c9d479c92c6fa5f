"""The kinematic engine: many robots at once by their kinematics, without a loop over robots."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from viatool.arrays import Booleans, Floats, Indices
from viatool.errors import ConfigurationError
from viatool.motion.arcs import drive_arc
from viatool.motion.twists import HeldTwist
from viatool.simulate.models import track_of
from viatool.simulate.motor_flaws import MotorFlaws, chosen_of, placed
from viatool.simulate.simulator import Simulator
from viatool.world import WorldMap

CHOICES = 6
"""Of errors of the motors and clocks, among which an adversary chooses in each interval."""
_FINE = 0.01  # seconds over which a changing speed is taken as its mean


class NavigationSimulator(Simulator):
    """Robots that move as their kinematics says, those with wheels also within an acceleration of their own.

    Parameters
    ----------
    world_map : WorldMap
        Arena, obstacles, robot and clearances.
    robots : int
        E.
    **settings
        As for `Simulator`.

    Notes
    -----
    With an acceleration limit, each wheel's rim speed changes at that rate until it has the speed that the
    command asks of it; it has to be known how far these are apart (`Robot.track`).
    """

    def __init__(self, world_map: WorldMap, robots: int, **settings: Any) -> None:
        super().__init__(world_map, robots, **settings)
        self._track = track_of(self.robot) if self.conditions.acceleration is not None else 0.0
        self._rims = np.zeros((robots, 2))  # speeds of both wheels' rims, right and left, in m/s
        self._touching = np.zeros(robots, dtype=bool)  # bodies are not modelled
        self._motors = self._flawed()
        if self._motors is not None:
            self._state = self._motors.at_rest(self.poses)

    def _flawed(self) -> MotorFlaws | None:
        """Return how motors and clocks err; None for ideal ones."""
        stated = {term.partition(".")[0] for _, term, _, _ in self.errors.stated()}
        if not stated & {"actuation", "timing"}:
            return None
        kinematics, interval = self.kinematics, self.robot.control_interval
        if not isinstance(kinematics, HeldTwist):
            raise ConfigurationError(
                f"{self.errors.source}: says how motors and clock err, which is not followed for a robot that moves as "
                f"'{kinematics.name}'",
                "leave actuation and timing out, or choose a robot that is commanded with speeds",
            )
        if self.conditions.acceleration is not None:
            raise ConfigurationError(
                f"{self.errors.source}: says how motors and clock err, and an acceleration of wheels is given as well",
                "leave one of them out",
            )
        return MotorFlaws(kinematics, self.errors, interval, self.conditions.delay)

    def keep(self, which: Booleans) -> None:
        """Go on with some of the robots only, (E,) bool; the others leave the simulation."""
        super().keep(which)
        self._rims, self._touching = self._rims[which], self._touching[which]
        if self._motors is not None:
            self._state = self._state.select(which)

    def _place(self, index: Indices) -> None:
        self._rims[index] = 0.0
        if self._motors is not None:
            self._state = placed(self._state, index, self._motors.at_rest(self.poses[index]))

    def _drive(self, before: Floats) -> Booleans:
        """Let all robots follow their commands until the next observation, with motors that err."""
        motors = self._motors
        if motors is None:
            return super()._drive(before)
        outcomes = []
        for _ in range(CHOICES if self.adversary else 1):
            choice = motors.choose(len(self), self._chance, corners=self.adversary)
            given = motors.give(self._state, self.previous, choice)
            outcomes.append((motors.follow(given, choice), choice.interval + given.age))
        states = [state for state, _ in outcomes]
        clearance = [self.clearance(state.poses) for state in states]
        worst = np.stack(clearance).argmin(axis=0)
        self._state = chosen_of(states, worst)
        passed = np.stack([seconds for _, seconds in outcomes])[worst, np.arange(len(self))] - self._state.age
        self.time = self.time + passed
        self.poses, self._velocity = self._state.poses, self._state.velocity
        return self._touching

    def _move(self, commands: Sequence[tuple[float, Floats]]) -> tuple[Floats, Booleans]:
        poses = self.poses
        for seconds, command in commands:
            if self.conditions.acceleration is None:
                states = self.kinematics.advance(
                    np.concatenate([poses, self.motion], axis=1), command, seconds
                )
                poses, self.motion = states[:, :3], states[:, 3:]
            else:
                poses = self._accelerate(poses, command, seconds, self.conditions.acceleration)
        return poses, self._touching

    def _accelerate(self, poses: Floats, command: Floats, seconds: float, acceleration: float) -> Floats:
        """Move while the rims of the wheels approach the speeds that a command asks for."""
        half = 0.5 * self._track
        targets = command[:, :1] + command[:, 1:] * (half, -half)
        pieces = math.ceil(seconds / _FINE - 1e-9)
        fine = seconds / pieces
        for _ in range(pieces):
            before = self._rims
            self._rims = before + np.clip(targets - before, -acceleration * fine, acceleration * fine)
            changing = np.abs(self._rims - before) / (acceleration * fine)  # share of the time
            right, left = (self._rims - 0.5 * changing * (self._rims - before)).T  # means over the time
            poses = drive_arc(poses, 0.5 * (right + left), (right - left) / self._track, fine)
        return poses
