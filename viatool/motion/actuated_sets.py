"""Where sets of robots with motors and timing are when they observe next: forms of where they are now.

A set holds the pose, the command before, older ones that may still act, and the velocity that the robot has unless its
motors are at once. From an observation to the next one pass T seconds, between T- and T+ (`Timing.observed`). Time is
cut into *stages*, in which the same commands may act. In a stage u is the newest of them, and ``v = u + xi``.

1. *Velocities.* A velocity is drawn to targets ``w``, each within its errors of one of the commands that may act. Seen
   from u, ``xi`` is drawn to ``w - u`` by the same law, but for which of the limits counts (`Actuation.either_way`
   takes the slower one as the least and the faster one as the most), so it keeps to the bounds that
   `viatool.motion.actuation` derives, from those of the differences between commands. These are forms of the same
   symbols, so a command that varies over the set does not widen ``xi``. Where another command becomes u, ``xi`` changes
   by the difference of both. Bounds of v alone, which know the limits apart, hold beside them.
2. *The reference path* of each state of the set is that of the velocity ``u + c`` in each stage, c the middle of the
   bounds of ``xi``. It is one arc after another, which `Kinematics.successor` encloses as forms.
3. *Other paths.* As in `viatool.motion.profile`, with half-widths a, b, r of the bounds of ``xi`` and what slips to the
   side in b: headings are at most ``Theta(t) = int r`` apart, and places

       int (a, b) e(theta_ref) + int |v| min(Theta, 2)

   For a direction M of the whole set, from which headings of reference paths are at most psi away, the first is ``int
   a`` along M and ``int b`` across, each a symbol of its own, up to ``int |(a, b)| min(psi, 2)`` in any direction.
4. *When it ends.* With T = T_m + z D, T_m the middle of T- and T+, D half of what is between and z a symbol of its own,
   the reference path is z D times its velocity beyond where it is at T_m. Between T- and T+ that differs from one
   velocity c e(phi) of the set by at most ``|v - c| + |c| |theta - phi|``.

All of it holds for each value of the symbols, whatever else the errors do from instant to instant.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from viatool.arrays import Floats, Hull
from viatool.motion.actuated import Machine
from viatool.motion.arcs import cosine_range
from viatool.motion.carried import in_axes
from viatool.motion.seen_velocities import (
    KnownVelocities,
    Parts,
    Stage,
    hull_of,
    stages_until_observed,
    sum_of,
)
from viatool.rounding import SLIGHTLY, SLIGHTLY_MORE
from viatool.sets.forms import Forms
from viatool.sets.states import POSE, StateBoxes

_HEADING = 2
_FARTHEST_APART = 2.0
"""Of two directions."""


@dataclass(frozen=True, eq=False)
class NextStates:
    """Where C sets are when they observe next.

    Parameters
    ----------
    states : Forms
        (C, 3 + K), in the symbols of the command and some of its own.
    added : tuple of ndarray
        (C, 3) ends of what is added to x, y and theta.
    before : tuple of ndarray
        (C, K) ends of what stands behind the pose.
    """

    states: Forms
    added: Hull
    before: Hull


def enclose_next(
    machine: Machine, states: Forms, command: Forms, cells: StateBoxes, held: Hull, slack: Floats
) -> NextStates:
    """Enclose where sets of robots are when they observe next.

    Parameters
    ----------
    machine : Machine
        The robot.
    states : Forms
        (C, 3 + K) x, y, theta and what `carried_axes` names, in S symbols, without rests.
    command : Forms
        (C, A) the new command, in these and more symbols.
    cells : StateBoxes
        C boxes around the sets.
    held : tuple of ndarray
        (C, A) ends of the new command.
    slack : ndarray
        (C,) metres that cover rounding.

    Returns
    -------
    NextStates
        Of C sets.

    Notes
    -----
    Sound: yes, see the module.
    """
    known = KnownVelocities.of(machine, states, command, cells, held)
    stages, last = stages_until_observed(machine, known)
    pose = _pose(states, command)
    moved = _moved(machine, known, stages, pose, slack)
    first, behind = len(POSE), _behind(machine, known, states, command, last)
    more = moved.slope.shape[1] - command.slope.shape[1]
    slope = np.pad(behind.slope, ((0, 0), (0, more), (0, 0)))
    after = Forms(
        np.concatenate([moved.centre, behind.centre], axis=1),
        np.concatenate([moved.slope, slope], axis=2),
        np.concatenate([moved.rest, behind.rest], axis=1),
    )
    axes = len(machine.kinematics.axes)
    kept = max(machine.timing.commands - 1, 0) * axes
    ends = [
        [
            held[side],
            end[:, :kept],
            *([] if machine.actuation.at_once else [in_axes(machine, last.box[side])]),
        ]
        for side, end in enumerate((cells.previous_lower, cells.previous_upper))
    ]
    assert after.centre.shape[1] == first + sum(end.shape[1] for end in ends[0])
    before = np.concatenate(ends[0], axis=1), np.concatenate(ends[1], axis=1)
    return NextStates(after, _added(machine, stages, cells), before)


def _pose(states: Forms, command: Forms) -> Forms:
    """Return the poses of sets in the symbols of the command."""
    more, first = command.slope.shape[1] - states.slope.shape[1], len(POSE)
    slope = np.pad(states.slope[:, :, :first], ((0, 0), (0, more), (0, 0)))
    return Forms(states.centre[:, :first], slope, states.rest[:, :first])


def _moved(
    machine: Machine, known: KnownVelocities, stages: list[Stage], pose: Forms, slack: Floats
) -> Forms:
    """Return the poses (C, 3) of sets at the next observation; see the module."""
    least, most = machine.timing.observed
    count, middle = len(slack), 0.5 * (least + most)
    turning = sum(stage.seconds * 0.5 * (stage.box[0] + stage.box[1])[:, _HEADING] for stage in stages)
    direction = pose.centre[:, _HEADING] + 0.5 * turning
    lengths, apart, aside = np.zeros((2, count)), np.zeros(count), np.zeros(count)
    nominal, late = pose, []
    for stage in stages:
        command, here = known.commands[stage.command], pose
        pose = machine.kinematics.successor(_told(machine, command, stage, pose), stage.seconds, slack)
        headings = hull_of([(one.lower[:, _HEADING], one.upper[:, _HEADING]) for one in (here, pose)])
        if stage.end <= middle:
            nominal = pose
        if stage.end > least:
            late.append((command.lower + stage.middle, command.upper + stage.middle, *headings))
        radius, fastest = _radii(machine, stage)
        away = np.minimum(np.maximum(headings[1] - direction, direction - headings[0]), _FARTHEST_APART)
        own = radius[:, 2] * stage.seconds
        swung = np.minimum((apart + 0.5 * own) * stage.seconds, _FARTHEST_APART * stage.seconds)
        apart = apart + own
        aside = aside + fastest * swung + np.hypot(radius[:, 0], radius[:, 1]) * away * stage.seconds
        lengths = lengths + stage.seconds * radius[:, :2].T
    unit = np.exp(1j * direction) * np.array([[1.0], [1j]]) * lengths  # ahead, and to the left
    pushes = [np.stack([one.real, one.imag, np.zeros(count)], axis=1) for one in unit]
    place, turn = aside, apart
    if least < most:
        push, own_place, own_turn = _late(late, 0.5 * (most - least))
        pushes, place, turn = [*pushes, push], place + own_place, turn + own_turn
    rest = nominal.rest + np.stack([place, place, turn], axis=1) * SLIGHTLY_MORE
    slope = np.concatenate([nominal.slope, SLIGHTLY_MORE * np.stack(pushes, axis=1)], axis=1)
    return Forms(nominal.centre, slope, rest)


def _told(machine: Machine, command: Parts, stage: Stage, pose: Forms) -> Forms:
    """Return poses with the velocities of the reference paths, as commands, (C, 3 + A)."""
    forms = command.forms
    return Forms(
        np.concatenate([pose.centre, in_axes(machine, forms.centre + stage.middle)], axis=1),
        np.concatenate([pose.slope, in_axes(machine, forms.slope)], axis=2),
        np.concatenate([pose.rest, in_axes(machine, forms.rest)], axis=1),
    )


def _radii(machine: Machine, stage: Stage) -> tuple[Floats, Floats]:
    """Return by how much velocities differ from those of reference paths, (C, 3), and how fast they are, (C,)."""
    largest = np.maximum(np.abs(stage.box[0]), np.abs(stage.box[1]))
    speed, slip = np.hypot(largest[:, 0], largest[:, 1]), machine.actuation.slip * SLIGHTLY_MORE
    radius = np.maximum(stage.off[1] - stage.middle, stage.middle - stage.off[0]) * SLIGHTLY_MORE
    return radius + np.outer(slip * speed, [0.0, 1.0, 0.0]), speed * (1.0 + slip)


def _late(late: list[tuple[Floats, Floats, Floats, Floats]], half: float) -> tuple[Floats, Floats, Floats]:
    """Return what half of the time in which observations may be adds to poses, (C, 3), and rests of place and turn."""
    low, high = hull_of([(one[0], one[1]) for one in late])
    right, left = hull_of([(one[2], one[3]) for one in late])
    centre, radius = 0.5 * (low + high), 0.5 * (high - low)
    velocity, heading = centre[:, 0] + 1j * centre[:, 1], 0.5 * (left + right)
    push = half * velocity * np.exp(1j * heading)
    swung = np.abs(velocity) * np.minimum(0.5 * (left - right), _FARTHEST_APART)
    place = half * (np.hypot(radius[:, 0], radius[:, 1]) + swung)
    return np.stack([push.real, push.imag, half * centre[:, 2]], axis=1), place, half * radius[:, 2]


def _behind(machine: Machine, known: KnownVelocities, states: Forms, command: Forms, last: Stage) -> Forms:
    """Return what stands behind poses at the next observation, (C, K), in the symbols of the command."""
    axes, first = len(machine.kinematics.axes), len(POSE)
    kept = slice(first, first + max(machine.timing.commands - 1, 0) * axes)
    more = command.slope.shape[1] - states.slope.shape[1]
    parts = [
        command,
        Forms(
            states.centre[:, kept],
            np.pad(states.slope[:, :, kept], ((0, 0), (0, more), (0, 0))),
            states.rest[:, kept],
        ),
    ]
    if not machine.actuation.at_once:
        seen = known.commands[last.command].forms
        half = np.maximum(last.off[1] - last.middle, last.middle - last.off[0])
        rest = (seen.rest + half + SLIGHTLY * np.abs(seen.centre)) * SLIGHTLY_MORE
        velocity = seen.centre + last.middle, seen.slope, rest
        parts.append(Forms(*(in_axes(machine, part) for part in velocity)))
    return Forms(
        np.concatenate([part.centre for part in parts], axis=1),
        np.concatenate([part.slope for part in parts], axis=2),
        np.concatenate([part.rest for part in parts], axis=1),
    )


def _added(machine: Machine, stages: list[Stage], cells: StateBoxes) -> Hull:
    """Bound what is added to x, y and theta by the speeds and headings of each stage, (C, 3) each.

    A robot without speed adds exactly 0 to its place; everything else is rounded outward.
    """
    least, poses = machine.timing.observed[0], cells.poses
    lower, upper = np.zeros((2, len(cells), 3))
    begins = poses.centre[:, 2] - poses.radius[:, 2], poses.centre[:, 2] + poses.radius[:, 2]
    for stage in stages:
        low, high = (stage.seconds * end for end in stage.box)
        slip = machine.actuation.slip * SLIGHTLY_MORE
        aside = slip * np.hypot(*np.maximum(np.abs(low), np.abs(high))[:, :2].T)
        right = begins[0] + lower[:, 2] + np.minimum(low[:, 2], 0.0)
        left = begins[1] + upper[:, 2] + np.maximum(high[:, 2], 0.0)
        found = [
            sum_of(
                _product((low[:, 0], high[:, 0]), cosine_range(right - quarter, left - quarter)),
                _product(
                    (low[:, 1] - aside, high[:, 1] + aside),
                    cosine_range(right + 0.5 * np.pi - quarter, left + 0.5 * np.pi - quarter),
                ),
            )
            for quarter in (0.0, 0.5 * np.pi)
        ]
        most = np.stack([*(one[1] for one in found), high[:, 2]], axis=1)
        fewest = np.stack([*(one[0] for one in found), low[:, 2]], axis=1)
        if stage.end > least:  # it may be over at any instant
            fewest, most = np.minimum(fewest, 0.0), np.maximum(most, 0.0)
        lower, upper = lower + fewest, upper + most
    return lower - SLIGHTLY * np.abs(lower), upper + SLIGHTLY * np.abs(upper)


def _product(one: Hull, other: Hull) -> Hull:
    """Return the ends of products."""
    every = np.stack([a * b for a in one for b in other])
    return every.min(axis=0), every.max(axis=0)
