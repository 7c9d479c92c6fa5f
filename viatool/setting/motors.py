"""Motors and timing of an error model in the terms of `viatool.motion`, and what contradicts the rest."""

from __future__ import annotations

import math

from viatool.errors import ConfigurationError
from viatool.motion.actuation import Actuation, Bounds, Response
from viatool.motion.law import Kinematics
from viatool.motion.timing import Timing
from viatool.motion.twists import HeldTwist
from viatool.uncertainty import ErrorModel
from viatool.uncertainty.error_model import AxisTerms

_ALIKE = 1e-9


def actuation_of(errors: ErrorModel, kinematics: Kinematics) -> Actuation:
    """Return how the motors of a robot follow commands.

    Raises
    ------
    ConfigurationError
        If a robot that does not slide has terms of a lateral axis, or a command is not a velocity.
    """
    stated = errors.actuation
    if stated.lateral != AxisTerms() and kinematics.axis("lateral") is None:
        raise ConfigurationError(
            f"{errors.source}: actuation.lateral is of a speed to the left that is commanded, which kinematics "
            f"'{kinematics.name}' does not take",
            "leave it out; what the wheels slide to the side is actuation.slip",
        )
    found = Actuation(
        linear=_response(stated.linear),
        lateral=_response(stated.lateral),
        angular=_response(stated.angular),
        slip=stated.slip or 0.0,
    )
    if not found.is_ideal and not isinstance(kinematics, HeldTwist):
        raise ConfigurationError(
            f"{errors.source}: motors are followed where a command is a velocity, which it is not for kinematics "
            f"'{kinematics.name}'",
            "leave the section actuation out",
        )
    return found


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
