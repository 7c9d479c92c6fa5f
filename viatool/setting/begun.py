"""The state of the motion in which recorded states begin: what was recorded of it, or what the policy measured."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from viatool.arrays import Floats
from viatool.channels import Quantities
from viatool.channels.velocities import MeasuredVelocity
from viatool.errors import ConfigurationError, TrajectoryError
from viatool.motion.law import Axis
from viatool.motion.steered import STEEPEST
from viatool.setting.setting import Setting

_KINDS = {"linear": "ahead", "angular": "turn"}
"""Which measured part of a velocity a number of the state is, by the kind of its axis."""


def states_begun(setting: Setting, observations: Floats, motion: Mapping[str, Floats]) -> Floats:
    """Return the ends of the state of the motion in each of N states, (N, 2, S); without one, (N, 2, 0).

    Parameters
    ----------
    setting : Setting
        Says which numbers that are, and how far they are measured.
    observations : ndarray
        (N, n) as the network received them.
    motion : mapping
        What was recorded of the state, (N,) each, by the names of its axes.

    Raises
    ------
    ConfigurationError
        If it is neither recorded nor measured.
    TrajectoryError
        If wheels stand where a car does not turn.

    Notes
    -----
    Sound: yes, in that nothing is guessed: a number that was recorded is taken as exact, as the pose is. One that the
    policy measured is off by no more than its sensor errs; where its channel is clipped it may be any that the robot
    can have, and is not known (NaN) where nothing limits it, or where it was measured beyond the limits.
    """
    kinematics = setting.rules.kinematics
    begun = np.empty((len(observations), 2, len(kinematics.state)))
    lower, upper = kinematics.state_range
    for number, axis in enumerate(kinematics.state):
        recorded = motion.get(axis.name)
        if recorded is not None:
            begun[:, :, number] = recorded[:, None]
        else:
            begun[:, :, number] = _measured(setting, observations, axis, (lower[number], upper[number]))
        if axis.kind == "steering" and (np.abs(begun[:, :, number]) > STEEPEST).any():
            raise TrajectoryError(
                f"the wheels were recorded at {np.abs(begun[:, :, number]).max():g} rad, expected at most "
                f"{STEEPEST:g} rad",
                "record the angle of the front wheels in radians",
            )
    return np.where(np.isfinite(begun), begun, np.nan)


def _measured(setting: Setting, observations: Floats, axis: Axis, limits: tuple[float, float]) -> Floats:
    """Return the ends (N, 2) of what the policy measured of a number of the state."""
    channel = _channel_of(setting, axis)
    if channel is None:
        raise ConfigurationError(
            f"a robot of kinematics '{setting.rules.kinematics.name}' goes on from the {axis.name} that it has, which "
            "is neither recorded nor measured by the policy",
            f"record it in {axis.unit} as column or array `motion_{axis.name}`, or drive in simulation",
        )
    column = int(setting.spec.inputs.newest(channel)[0])
    lower, upper = setting.observed(observations)
    ends = [
        part[:, column]
        for end in (np.nextafter(lower, -np.inf), np.nextafter(upper, np.inf))
        for part in setting.spec.inputs.readings(end)
    ]
    least, most = np.minimum.reduce(ends), np.maximum.reduce(ends)
    found: Floats = np.stack(
        [np.where(np.isneginf(least), limits[0], least), np.where(np.isposinf(most), limits[1], most)], axis=1
    )
    return np.where((found[:, 0] <= found[:, 1])[:, None], found, np.nan)


def _channel_of(setting: Setting, axis: Axis) -> str | None:
    """Return the name of the channel that measures a number of the state, as it is and not its reciprocal."""
    part = _KINDS.get(axis.kind)
    for quantity in Quantities.of(setting.spec.observation, setting.robot, setting.spec.frames):
        measures = isinstance(quantity, MeasuredVelocity) and quantity.part == part
        if measures and not quantity.channel.reciprocal:
            return quantity.channel.name
    return None
