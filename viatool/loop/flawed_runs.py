"""Runs of the deployed program on robots with motors and timing of an error model, drawn at its corners."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from viatool.arrays import Floats
from viatool.loop.closed_loop import ClosedLoop
from viatool.loop.runs import Runs
from viatool.loop.told import NOTHING, Told
from viatool.loop.tube import TubeFollower
from viatool.motion.twists import HeldTwist
from viatool.simulate.motor_flaws import MotorFlaws, MotorState


def drive_flawed(
    follower: TubeFollower, poses: Floats, before: Floats, errors: Floats, told: Told = NOTHING, *, seed: int
) -> tuple[Runs, Floats]:
    """Drive the deployed program on robots that follow late, too fast or aside, and observe now and then.

    Parameters
    ----------
    follower : TubeFollower
        Policy, sensors and goal.
    poses, before : ndarray
        (R, 3) where the runs begin, and (R, K) what stands behind (`Rules.carried`); the robots have done as the
        command before said, for long.
    errors : ndarray
        (R, K, n) what is added to what perfect sensors read.
    told : Told
        What else is known where the runs begin.
    seed : int
        Of what motors and clocks do.

    Returns
    -------
    tuple of Runs and ndarray
        R of them, whose clearance is that where intervals begin and end, and (R, K) seconds since they began at the
        end of each.

    Notes
    -----
    Everything that is drawn lies within the model.
    """
    loop, rules = follower.loop, follower.loop.rules
    assert isinstance(rules.kinematics, HeldTwist)
    flaws = MotorFlaws(rules.kinematics, loop.setting.uncertainty, rules.interval, rules.delay)
    generator, axes = np.random.default_rng(seed), len(rules.lower)
    command, raw = before[:, :axes], None
    state, groups = _begun(flaws, poses, command), len(rules.carried) // axes
    driving = ~follower.ended(np.concatenate([poses, before], axis=1))
    found: list[tuple[Floats, ...]] = []
    passed, clock = [], np.zeros(len(poses))
    for k in range(errors.shape[1]):
        here, sensors = state.poses, loop.sensors
        readings = sensors.read(here, command, told=told.after(k).given(raw)) + errors[:, k]
        seen = sensors.encode(readings).astype(loop.setting.number).astype(np.float64)
        command = rules.clip(np.asarray(loop.driven.run(seen)))
        raw = loop.policy.outputs(seen) if sensors.recollection.outputs is not None else None
        choice = flaws.choose(len(here), generator, corners=True)
        begun, state = state, flaws.follow(flaws.give(state, command, choice), choice)
        clock = clock + choice.interval + begun.age - state.age
        passed.append(clock)
        left = np.where(driving, np.minimum(_clearance(loop, here), _clearance(loop, state.poses)), np.inf)
        behind = np.tile(command, groups)
        found.append((here, seen, command, command[:, :0], state.poses, behind, left))
        driving = driving & ~follower.ended(np.concatenate([state.poses, behind], axis=1))
    runs = Runs(*(np.stack(part, axis=1) for part in zip(*found, strict=True)))
    return runs, np.stack(passed, axis=1)


def _begun(flaws: MotorFlaws, poses: Floats, command: Floats) -> MotorState:
    """Return robots that have done as commands (R, A) say for long."""
    rest = flaws.at_rest(poses)
    velocity = np.stack(flaws.kinematics.parts(command), axis=1)
    return replace(rest, velocity=velocity, commands=np.repeat(command[:, None], flaws.pending, axis=1))


def _clearance(loop: ClosedLoop, poses: Floats) -> Floats:
    """Return the clearance of the footprint at poses (R, 3), in metres."""
    at = loop.geometry.throughout(poses)
    return at.footprint_clearance(loop.rules.footprint, np.zeros(len(poses)))[0]
