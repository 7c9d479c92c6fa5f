"""What sets of robots with motors and timing hold behind poses: commands that may still act, and the velocity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from viatool.arrays import Floats, Hull
from viatool.motion.actuated import ActuatedMotion, Machine
from viatool.motion.law import Axis
from viatool.motion.twists import PARTS
from viatool.rounding import SLIGHTLY_MORE
from viatool.sets.states import StateBoxes


def carried_axes(machine: Machine) -> tuple[Axis, ...]:
    """Return what sets of states hold behind poses: the command before, older ones that may act, and the velocity."""
    axes = machine.kinematics.axes
    older = range(2, machine.timing.commands + 1)
    names = [f"{{}}, {back} before" for back in older] + (
        [] if machine.actuation.at_once else ["{} that it has"]
    )
    return axes + tuple(replace(axis, name=name.format(axis.name)) for name in names for axis in axes)


def motion_of_sets(machine: Machine, cells: StateBoxes) -> ActuatedMotion:
    """Return what robots (C,) may do of which boxes are known of all that `carried_axes` names."""
    axes, acting = len(machine.kinematics.axes), machine.timing.commands
    ends = cells.previous_lower, cells.previous_upper
    before = tuple(end[:, : acting * axes].reshape(len(cells), acting, axes)[:, ::-1] for end in ends)
    velocity = None
    if not machine.actuation.at_once:
        velocity = machine.velocities(ends[0][:, -axes:], ends[1][:, -axes:])
    return ActuatedMotion(machine, (before[0], before[1]), velocity)


def recorded_ends(
    machine: Machine, previous: Floats, under_way: Floats, measured: Hull | None = None
) -> tuple[Floats, Floats]:
    """Return the ends (B, K) of what `carried_axes` names in recorded states.

    Parameters
    ----------
    machine : Machine
        The robot.
    previous : ndarray
        (B, A) the command before, as far as it counts for what is observed alone.
    under_way : ndarray
        (B, H, A) the commands before that count (`Rules.commands_before`), the oldest first; NaN for unknown ones.
    measured : tuple of ndarray, optional
        (B, 3) ends of the velocity that was measured.

    Notes
    -----
    Sound: yes; a command that is not known may be any, and a velocity what these commands allow.
    """
    acting, parts = machine.timing.commands, []
    if acting:
        newest = under_way[:, ::-1][:, :acting]
        known = np.isfinite(newest)
        ends = [np.where(known, newest, end).reshape(len(newest), -1) for end in machine.limits]
        parts.append((ends[0], ends[1]))
    else:
        parts.append((previous, previous))
    if not machine.actuation.at_once:
        had = ActuatedMotion(machine, (under_way, under_way), measured).observed
        parts.append((in_axes(machine, had[0]), in_axes(machine, had[1])))
    return np.concatenate([low for low, _ in parts], axis=1), np.concatenate(
        [high for _, high in parts], axis=1
    )


def farthest(machine: Machine) -> tuple[float, float]:
    """Return how fast robots are at most, in m/s, and how far they get from an observation on, in metres, at most."""
    largest = np.maximum(*np.abs(machine.reachable))
    fastest = float(np.hypot(largest[0], largest[1])) * (1.0 + machine.actuation.slip) * SLIGHTLY_MORE
    return fastest, float(unknown_motion(machine).longest[0])


def unknown_motion(machine: Machine) -> ActuatedMotion:
    """Return what one robot may do of which nothing is known."""
    before = np.full((1, machine.timing.commands, len(machine.kinematics.axes)), np.nan)
    return ActuatedMotion(machine, (before, before))


def in_axes(machine: Machine, parts: Floats) -> Floats:
    """Return the entries of commands (..., A) of velocities (..., 3)."""
    return parts[..., [PARTS.index(part) for part in machine.kinematics.velocity]]
