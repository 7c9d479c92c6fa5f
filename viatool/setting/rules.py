"""What is asked of a state: the criterion, the distances, and the robot whose motion is judged."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from viatool.arrays import Floats
from viatool.errors import ConfigurationError
from viatool.motion.actuated import Machine
from viatool.motion.actuation import IDEAL_MOTORS, Actuation
from viatool.motion.carried import carried_axes
from viatool.motion.command_errors import CommandErrors, Strayed
from viatool.motion.dead_time import DeadTime
from viatool.motion.kinematics import DIFFERENTIAL, motion_of
from viatool.motion.law import Axis, Kinematics
from viatool.motion.manoeuvre import Manoeuvre
from viatool.motion.second_order import Unicycle
from viatool.motion.timing import Timing
from viatool.motion.twists import HeldTwist
from viatool.setting.criteria import PROVING, SAMPLED, Criterion, criterion_of
from viatool.setting.motors import actuation_of, command_errors_of, timing_of
from viatool.uncertainty import ErrorModel
from viatool.world import Clearance, Footprint, WorldMap

_ALIKE = 1e-9
MOST_COMMANDS = 1000
"""On their way to the motors at once; more is a slip of the keyboard."""


@dataclass(frozen=True, eq=False)
class Rules:
    """What every state must fulfil.

    Parameters
    ----------
    criterion : str
        Name of the criterion, see `viatool.setting.criteria`.
    clearance : Clearance
        Distances that the footprint must exceed: collision and danger.
    footprint : Footprint
        Outline in the robot's frame.
    lower, upper : ndarray
        (A,) the commands that the robot carries out, of a differential drive v in m/s and omega in rad/s; others are
        clipped to them.
    interval : float
        Seconds for which a command is held.
    deceleration : float
        Largest braking, in m/s^2.
    delay : float
        Dead time in seconds, for which the commands before go on.
    kinematics : Kinematics
        How the robot moves.
    actuation : Actuation
        How its motors follow commands.
    timing : Timing or None
        When commands act, if that varies; None for exactly `delay` and `interval`.
    command_errors : CommandErrors or None
        What acts beside a command of a robot whose motion has a state; None for nothing.
    """

    criterion: str
    clearance: Clearance
    footprint: Footprint
    lower: Floats
    upper: Floats
    interval: float
    deceleration: float
    delay: float = 0.0
    kinematics: Kinematics = DIFFERENTIAL
    actuation: Actuation = IDEAL_MOTORS
    timing: Timing | None = None
    command_errors: CommandErrors | None = None

    @classmethod
    def of(
        cls,
        world_map: WorldMap,
        criterion: str = "swept",
        *,
        interval: float | None = None,
        footprint: Footprint | str | float | Sequence[Sequence[float]] | None = None,
        delay: float = 0.0,
        errors: ErrorModel | None = None,
    ) -> Rules:
        """Return the rules of a map and its robot, with what the user overrides.

        Raises
        ------
        ConfigurationError
            If the criterion or the robot's kinematics is not known, or a number is out of its range.
        """
        errors = errors or ErrorModel()
        robot = world_map.robot
        kinematics = motion_of(robot)
        lower, upper = kinematics.limits(robot)
        _check_finite(kinematics, lower, upper)
        _check_state(kinematics)
        asked = criterion_of(criterion)
        interval = robot.control_interval if interval is None else interval
        if not 0.0 < interval < math.inf:
            raise ConfigurationError(
                f"the control interval is {interval} s", "give a positive time in seconds"
            )
        if not 0.0 <= delay < math.inf:
            raise ConfigurationError(f"the delay is {delay} s", "give a time of 0 s or more")
        if not delay <= MOST_COMMANDS * interval:
            raise ConfigurationError(
                f"the delay is {delay} s, more than {MOST_COMMANDS} control intervals of {interval} s",
                "give a shorter delay, in seconds",
            )
        asked.check(robot)
        actuation, beside = actuation_of(errors, kinematics), command_errors_of(errors, kinematics)
        timing, delay = timing_of(errors, interval, delay)
        if kinematics.state:
            _refuse_unfollowed(kinematics, errors, delay, timing)
        if beside is not None and asked.name != "swept":
            raise ConfigurationError(
                f"{errors.source}: criterion '{criterion}' does not take errors of commands into account",
                "choose swept, or leave the section actuation out",
            )
        if not asked.proves and (timing is not None or not actuation.is_ideal):
            raise ConfigurationError(
                f"{errors.source}: criterion '{criterion}' does not take motors and timing into account",
                f"choose one of {', '.join(PROVING)}",
            )
        return cls(
            criterion=asked.name,
            clearance=world_map.clearance,
            footprint=robot.footprint if footprint is None else as_footprint(footprint),
            lower=lower,
            upper=upper,
            interval=interval,
            deceleration=robot.deceleration,
            delay=delay,
            kinematics=kinematics,
            actuation=actuation,
            timing=timing,
            command_errors=beside,
        )

    @property
    def asked(self) -> Criterion:
        """Return the criterion itself."""
        return criterion_of(self.criterion)

    @cached_property
    def sampled(self) -> Rules:
        """Return the same rules by the paper's criterion, which is reported beside every other."""
        return replace(self, criterion=SAMPLED.name)

    @cached_property
    def manoeuvre(self) -> Manoeuvre:
        """Return the path on which the clearance counts."""
        held = Manoeuvre(self.interval, kinematics=self.kinematics, begins=self.delay)
        return self.asked.path(held, self.deceleration, self.footprint)

    @property
    def moves_as(self) -> str:
        """Return in words what moves, and whether its wheels slip."""
        slips = self.actuation.slip > 0.0
        words = self.kinematics.description
        return words.replace("without slip", "with slip as the error model says") if slips else words

    @property
    def varies(self) -> bool:
        """Tell whether velocities differ from what is commanded, or commands from when they are expected."""
        return self.timing is not None or not self.actuation.is_ideal

    @cached_property
    def machine(self) -> Machine | None:
        """Return the robot whose velocities vary within bounds; None for one that has those it is told to have."""
        return self._made() if self.varies and self.asked.proves else None

    def _made(self) -> Machine:
        """Return the robot with its motors and its timing, whether or not these vary."""
        assert isinstance(self.kinematics, HeldTwist)
        timing = self.timing or Timing((self.interval, self.interval), (self.delay, self.delay))
        path = self.manoeuvre
        return Machine(
            self.kinematics, (self.lower, self.upper), self.actuation, timing, path.deceleration, path.rim
        )

    @cached_property
    def over_time(self) -> Machine | None:
        """Return the robot as it is followed over time: as `machine`, and as well if its commands act late alone."""
        return self._made() if self.varies or self.delay > 0.0 else None

    @property
    def carried(self) -> tuple[Axis, ...]:
        """Return what sets of states hold behind poses that are followed over time."""
        return self.kinematics.before if self.over_time is None else carried_axes(self.over_time)

    def seconds_after(self, intervals: int) -> tuple[float, float]:
        """Return how many seconds have passed since an observation when so many others have followed, at the ends."""
        timing = self.timing or Timing((self.interval, self.interval))
        return (
            max(intervals * timing.interval[0] - timing.age, 0.0),
            intervals * timing.interval[1] + timing.age,
        )

    def intervals_within(self, seconds: float) -> int:
        """Return how many intervals are surely over after some time."""
        timing = self.timing or Timing((self.interval, self.interval))
        return math.floor((seconds - timing.age) / timing.interval[1] * (1.0 + _ALIKE))

    @property
    def nominal(self) -> Rules:
        """Return the same of a robot that has the velocities it is told to have, when it is told."""
        return replace(self, actuation=IDEAL_MOTORS, timing=None)

    def strayed(self, lower: Floats, upper: Floats) -> Strayed | None:
        """Return how far errors of commands lead, over boxes of what is held (C, A + S); None where there are none."""
        if self.command_errors is None:
            return None
        assert isinstance(self.kinematics, Unicycle)
        return self.kinematics.strayed(self.command_errors, lower, upper, self.interval)

    @cached_property
    def commands_before(self) -> int:
        """Return how many of the commands before the new one count."""
        return self.dead_time.commands if self.machine is None else self.machine.history

    def queue(self, given: Floats) -> Floats:
        """Return the commands before if one was given again and again: (B, A) as (B, commands, A)."""
        return np.repeat(given[:, None], self.commands_before, axis=1)

    @cached_property
    def dead_time(self) -> DeadTime:
        """Return which commands act before the new one does, and for how long."""
        return DeadTime(self.delay, self.interval)

    @cached_property
    def longest_way(self) -> tuple[float, float]:
        """Return how far any command leads at most, waits included, in metres; and until when that counts, in s.

        Of a robot without a state of its motion that has the velocity it is told to have.
        """
        lower, upper, once = self.lower[None], self.upper[None], np.ones(1)
        way = self.manoeuvre.longest(lower, upper) + sum(wait.longest(lower, upper) for wait in self.waiting)
        return float(way[0]), float(self.manoeuvre.counted_between(lower, lower, upper, once, once)[1][0])

    @cached_property
    def waiting(self) -> tuple[Manoeuvre, ...]:
        """Return the W paths that the commands on their way add before the new one acts, the oldest first."""
        acting, durations = self.manoeuvre, self.dead_time.durations
        begins = np.cumsum(durations) - durations
        return tuple(
            replace(acting, interval=seconds, deceleration=None, begins=float(begin))
            for seconds, begin in zip(durations, begins, strict=True)
        )

    def to_json(self) -> dict[str, Any]:
        """Return the rules as plain data, by which stored work is told from that of other rules."""
        move, plain = self.kinematics, asdict(replace(self, kinematics=DIFFERENTIAL))
        plain["kinematics"] = {"name": move.name, **move.parameters} if move.parameters else move.name
        document: dict[str, Any] = json.loads(json.dumps(plain, default=lambda value: value.tolist()))
        return document

    def begun(self, lower: Floats, upper: Floats, begun: Floats) -> tuple[Floats, Floats]:
        """Return boxes of commands (C, A) together with those of the state (C, 2, S) in which they are given."""
        return np.concatenate([lower, begun[:, 0]], axis=1), np.concatenate([upper, begun[:, 1]], axis=1)

    def standing(self, count: int) -> Floats:
        """Return commands (C, A), with the state behind them if the motion has one, under which a robot stands."""
        return np.zeros((count, len(self.lower) + len(self.kinematics.state)))

    def clip(self, actions: Floats) -> Floats:
        """Return commands (..., A) as the robot carries them out; monotone, so ends of a box map to ends."""
        return np.clip(actions, self.lower, self.upper)


def _check_finite(kinematics: Kinematics, lower: Floats, upper: Floats) -> None:
    """Refuse commands without a limit, of which no proof speaks."""
    for axis, low, high in zip(kinematics.axes, lower, upper, strict=True):
        if not (np.isfinite(low) and np.isfinite(high)):
            raise ConfigurationError(
                f"the robot's commands {axis.name} reach from {low:g} to {high:g} {axis.unit}",
                "give the map's robot finite limits; only a speed that is no command may be unlimited",
            )


def _refuse_unfollowed(
    kinematics: Kinematics, errors: ErrorModel, delay: float, timing: Timing | None
) -> None:
    """Refuse what is not followed for a robot whose motion has a state."""
    if delay > 0.0:
        names = ", ".join(axis.name for axis in kinematics.state)
        raise ConfigurationError(
            f"a delay of {delay:g} s is not followed for a robot whose motion has a state ({names}): it would be "
            "another one when the command acts",
            "leave out --delay",
        )
    stated = {"timing": timing is not None, "obstacles": errors.obstacles != ErrorModel().obstacles}
    for section, asked in stated.items():
        if asked:
            raise ConfigurationError(
                f"{errors.source}: {section} are followed where a command is a velocity, which it is not for "
                f"kinematics '{kinematics.name}'",
                f"leave the section {section} out",
            )


def _check_state(kinematics: Kinematics) -> None:
    """Refuse a kinematics that declares a state and does not say what it may be."""
    if len(kinematics.state_range[0]) != len(kinematics.state):
        names = ", ".join(axis.name for axis in kinematics.state)
        raise ConfigurationError(
            f"kinematics '{kinematics.name}' has a state of its own ({names}) without a range, which is not followed",
            "give it a `state_range` and laws that take the state behind the command",
        )


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
