"""Motors and timing of an error model in the terms of `viatool.motion`, and what contradicts the rest."""

from __future__ import annotations

import math

import numpy as np

from viatool.errors import ConfigurationError
from viatool.motion.actuation import IDEAL_MOTORS, Actuation, Bounds, Response
from viatool.motion.command_errors import CommandErrors
from viatool.motion.law import Kinematics
from viatool.motion.second_order import Unicycle
from viatool.motion.timing import Timing
from viatool.uncertainty import ErrorModel
from viatool.uncertainty.error_model import ActuationTerms, AxisTerms, CommandTerms

_ALIKE = 1e-9


def actuation_of(errors: ErrorModel, kinematics: Kinematics) -> Actuation:
    """Return how the motors of a robot follow commands.

    Raises
    ------
    ConfigurationError
        If a robot that does not slide has terms of a lateral axis, or one is stated of a command that it does not take.
    """
    stated = errors.actuation
    if kinematics.state:
        return IDEAL_MOTORS  # what is stated is `command_errors_of`
    for kind in ("linear_acceleration", "angular_acceleration"):
        if getattr(stated, kind) != CommandTerms():
            raise _not_taken(errors, kind, kinematics)
    if stated.lateral != AxisTerms() and kinematics.axis("lateral") is None:
        raise ConfigurationError(
            f"{errors.source}: actuation.lateral is of a speed to the left that is commanded, which kinematics "
            f"'{kinematics.name}' does not take",
            "leave it out; what the wheels slide to the side is actuation.slip",
        )
    return Actuation(
        linear=_response(stated.linear),
        lateral=_response(stated.lateral),
        angular=_response(stated.angular),
        slip=stated.slip or 0.0,
    )


def command_errors_of(errors: ErrorModel, kinematics: Kinematics) -> CommandErrors | None:
    """Return what acts beside the commands of a robot whose motion has a state; None if nothing does.

    Raises
    ------
    ConfigurationError
        If something is stated of a command that it does not take, or of anything but its commands.
    """
    stated = errors.actuation
    if not kinematics.state or stated == ActuationTerms():
        return None
    kinds = [axis.kind for axis in kinematics.axes]
    for place, term, _, _ in errors.only("actuation").stated():
        _, kind, *_ = place.split(".")
        if kind not in kinds or not isinstance(kinematics, Unicycle):
            raise _not_taken(errors, place.removeprefix("actuation."), kinematics)
        if term not in ("actuation.relative", "actuation.absolute"):
            raise ConfigurationError(
                f"{errors.source}: {place}: motors are followed where a command is a velocity, which it is not for "
                f"kinematics '{kinematics.name}'",
                "leave the term out",
            )
    relative, absolute = (
        np.array([getattr(getattr(stated, kind), name) or 0.0 for kind in kinds])
        for name in ("relative", "absolute")
    )
    return CommandErrors(relative, absolute) if relative.any() or absolute.any() else None


def check_motors(beside: CommandErrors | None, errors: ErrorModel, job: str) -> None:
    """Refuse motors that a job does not follow: missions alone follow errors of commands of robots with a state.

    Raises
    ------
    ConfigurationError
        Names the model and the job.
    """
    if beside is not None and job != "mission":
        raise ConfigurationError(
            f"{errors.source}: errors of the commands of a robot that is told how to accelerate are followed by "
            f"viatool mission alone, not by {job or 'this job'}",
            "leave the section actuation out",
        )


def _not_taken(errors: ErrorModel, place: str, kinematics: Kinematics) -> ConfigurationError:
    """Return the refusal of what is stated of a command that a robot does not take."""
    taken = ", ".join(axis.kind for axis in kinematics.axes)
    return ConfigurationError(
        f"{errors.source}: actuation.{place} is not followed for kinematics '{kinematics.name}', whose commands are "
        f"{taken}",
        "leave it out",
    )


def timing_of(errors: ErrorModel, interval: float, delay: float) -> tuple[Timing | None, float]:
    """Return when commands act, None where that does not vary, and the delay, the longest one of several.

    Raises
    ------
    ConfigurationError
        If the interval does not lie within those of the model, or the delay is given twice.
    """
    stated = errors.timing
    if stated.delay is not None and delay > 0.0:
        raise ConfigurationError(
            f"{errors.source}: timing.delay is {stated.delay[0]:g} to {stated.delay[1]:g} s, and --delay {delay:g} is "
            "given as well",
            "leave one of them out",
        )
    least, most = stated.interval or (interval, interval)
    if not least <= interval * (1.0 + _ALIKE) or not interval * (1.0 - _ALIKE) <= most:
        raise ConfigurationError(
            f"{errors.source}: timing.interval is {least:g} to {most:g} s, the control interval {interval:g} s",
            "correct one of them; the interval may come from the policy, the map or --interval",
        )
    found = Timing((least, most), stated.delay or (delay, delay), stated.sensing or 0.0)
    exact = found.interval == (interval, interval) and found.delay[0] == found.latest
    return (None if exact else found), found.delay[1]


def _response(terms: AxisTerms) -> Response:
    speeding = _limits(terms.acceleration)
    slowing = speeding if terms.deceleration is None else _limits(terms.deceleration)
    return Response(speeding, slowing, terms.lag or (0.0, 0.0), terms.relative or 0.0, terms.absolute or 0.0)


def _limits(stated: float | Bounds | None) -> Bounds:
    """Return the least and the largest change of a velocity; one number is the least."""
    if stated is None:
        return math.inf, math.inf
    return stated if isinstance(stated, tuple) else (stated, math.inf)
