"""Recorded states in the terms of a setting: observations as the program receives them, and commands on their way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from viatool.arrays import Booleans, Floats
from viatool.channels import PreviousCommand, Quantities
from viatool.channels.velocities import MeasuredVelocity
from viatool.errors import ConfigurationError, EmptyEvaluationError, TrajectoryError
from viatool.motion.twists import PARTS
from viatool.rounding import AS_RECEIVED
from viatool.setting.setting import Setting
from viatool.trajectory import Trajectory

_ROWS = 65536  # states that are converted together, so that no second copy of all exists
_ALIKE = 1e-3  # m/s and rad/s by which a command may differ between what was recorded and what was observed
LATE = 0.1  # of an interval by which two rows may be early or late and still follow one another


def as_received(setting: Setting, trajectory: Trajectory) -> Trajectory:
    """Return a trajectory whose observations are the numbers that the program receives, mostly float32.

    Channels that the specification fixes take their value, whatever was recorded (the paper's budget).

    Raises
    ------
    EmptyEvaluationError
        If there is no state.
    TrajectoryError
        If the observations have another size than the policy's.
    """
    size, expected = trajectory.observations.shape[1], setting.spec.observation_size
    if len(trajectory) == 0:
        raise EmptyEvaluationError("the trajectory has no states", "record or drive at least one step")
    if size != expected:
        raise TrajectoryError(
            f"the trajectory has {size} observation entries, the policy takes {expected}",
            "verify with the policy that drove, or give the trajectory the columns of this one",
        )
    check_people(setting, told=trajectory.people.shape[1] > 0)
    received = np.empty(trajectory.observations.shape)
    for start in range(0, len(trajectory), _ROWS):
        rows = slice(start, start + _ROWS)
        received[rows] = numbers_received(setting, trajectory.observations[rows])
    return replace(trajectory, observations=received)


def numbers_received(setting: Setting, observations: Floats) -> Floats:
    """Return observations (B, n) as the program receives them; the first m of their entries, of (B, m)."""
    fixed = setting.fixed[: observations.shape[1]]
    named = np.where(np.isnan(fixed), observations, fixed)
    return np.asarray(named.astype(setting.number), dtype=np.float64)


def check_people(setting: Setting, *, told: bool) -> None:
    """Refuse people of whom the error model does not say that they move, and a term about people without any."""
    model = setting.uncertainty
    if told and model.obstacles.people is None:
        raise ConfigurationError(
            "the states tell of people, and nobody says how they move",
            "state obstacles.people in an error model and give it with --errors; 0 for the speed that they have",
        )
    if not told and model.obstacles.people is not None:
        raise ConfigurationError(
            f"{model.source}: obstacles.people: the states tell of no people",
            "give a trajectory with `people`, or leave the term out",
        )


def commands_under_way(setting: Setting, trajectory: Trajectory) -> Floats:
    """Return the commands before each state that count, the oldest first: those on their way, and for the velocity.

    Parameters
    ----------
    setting : Setting
        Says how long a command is on its way: W of them are.
    trajectory : Trajectory
        N states.

    Returns
    -------
    ndarray
        (N, W, A), as the robot carries them out; NaN where a command is not known: before the first state of a
        recording, behind a gap in it, and where what was recorded contradicts what was observed.

    Raises
    ------
    ConfigurationError
        If commands matter, but are neither observed nor recorded.
    TrajectoryError
        If commands are longer on their way than the whole recording lasts, so that none of its states tells them.

    Notes
    -----
    Sound: yes, in that nothing is guessed. The newest command is the one that was recorded in the state before, or that
    the policy observed as its previous one; older ones are those of the states before. Before a simulated episode the
    robot stands. Poses that were picked have no history: all commands on their way are the observed one; of a robot
    with motors and timing of its own that one alone is then known.
    """
    count, machine = setting.rules.commands_before, setting.rules.machine
    if not count:
        return np.zeros((len(trajectory), 0, _axes(setting)))
    if machine is not None and not machine.timing.commands and not _told(setting, trajectory):
        return np.full((len(trajectory), count, _axes(setting)), np.nan)
    newest = commands_before(setting, trajectory)
    if not trajectory.connected and machine is None:
        return setting.rules.queue(newest)
    queue = np.full((len(newest), count, _axes(setting)), np.nan)
    if not trajectory.connected:
        queue[:, -1] = newest
        return queue
    rows, follows = np.arange(len(newest)), follows_before(setting, trajectory)
    begins = _begins(trajectory)
    known = np.ones(len(newest), dtype=bool)
    for back in range(count):
        at = np.maximum(rows - back, 0)
        queue[known, count - 1 - back] = newest[at[known]]
        queue[known & begins[at], : count - 1 - back] = 0.0
        known = known & follows[at]
    _require_told(setting, trajectory, queue)
    return queue


def _require_told(setting: Setting, trajectory: Trajectory, queue: Floats) -> None:
    """Refuse recordings in no state of which it is known what is on its way, as the delay is longer than they are."""
    machine = setting.rules.machine
    acting = queue.shape[1] if machine is None else machine.timing.commands
    delay = setting.rules.delay if machine is None else machine.timing.delay[1]
    last = np.append(np.flatnonzero(np.diff(trajectory.episode)), len(trajectory) - 1)
    first = np.append(0, last[:-1] + 1)
    longest = float((trajectory.time[last] - trajectory.time[first]).max())
    if delay > longest and np.isnan(queue[:, queue.shape[1] - acting :]).any(axis=(1, 2)).all():
        raise TrajectoryError(
            f"commands act up to {delay:g} s after their observation, and the longest episode of the recording takes "
            f"{longest:g} s, so no state of it tells which commands were on their way",
            "give a longer recording, or a delay in seconds that the robot really has",
        )


def commands_observed(setting: Setting, trajectory: Trajectory) -> Floats:
    """Return the command before each state as far as the policy observes it, (N, A); 0 where it does not."""
    if not _previous_columns(setting):
        return np.zeros((len(trajectory), _axes(setting)))
    return commands_before(setting, trajectory)


def commands_before(setting: Setting, trajectory: Trajectory) -> Floats:
    """Return the command before each state, (N, A), as the robot carried it out; NaN where it is not known.

    Raises
    ------
    ConfigurationError
        If it is neither observed nor recorded.
    """
    observed, recorded = _observed(setting, trajectory), _recorded(setting, trajectory)
    if observed is not None and trajectory.commanded is not None:
        observed = np.where(trajectory.commanded[:, None], observed, np.nan)
    if observed is None and recorded is None:
        raise ConfigurationError(
            "a delay or a horizon needs the previous command, which is neither observed nor recorded",
            "record the actions, or verify without --delay and --horizon",
        )
    if observed is None or recorded is None:
        either = recorded if observed is None else observed
        assert either is not None
        return setting.rules.clip(either)
    observed, recorded = setting.rules.clip(observed), setting.rules.clip(recorded)
    either = np.where(np.isnan(recorded), observed, recorded)
    contradicts = np.abs(either - observed) > _ALIKE  # False for NaN: there is nothing to compare
    return np.where(contradicts.any(axis=1, keepdims=True), np.nan, either)


def _told(setting: Setting, trajectory: Trajectory) -> bool:
    """Tell whether the command before is observed or recorded at all."""
    return _observed(setting, trajectory) is not None or _recorded(setting, trajectory) is not None


def velocities_measured(setting: Setting, observations: Floats) -> tuple[Floats, Floats] | None:
    """Return the ends (N, 3) of the velocity that the robot has in each state, as far as the policy observes it.

    Parameters
    ----------
    setting : Setting
        Says how far a measured velocity errs: by the eps of its channel, and by what its sensor's terms add.
    observations : ndarray
        (N, n) as the network received them.

    Returns
    -------
    tuple of ndarray or None
        Ahead, to the left, and turning; NaN where it is not measured. None if nothing is, or none of it counts.

    Notes
    -----
    Sound: yes, if the velocity is within eps of what was recorded; its rounding to float32 is counted.
    """
    if setting.rules.machine is None:
        return None
    quantities = setting.quantities
    lower, upper = np.full((2, len(observations), 3), np.nan)
    least, most = setting.inputs.readings(observations)
    for one in quantities:
        if isinstance(one, MeasuredVelocity) and one.channel.value is None:
            column = int(quantities.inputs.newest(one.channel.name)[0])
            part, low, high = PARTS.index(one.part), least[:, column], most[:, column]
            largest = np.maximum(np.abs(low), np.abs(high))
            error = setting.radii[column] + AS_RECEIVED * (1.0 + largest)
            stated = setting.uncertainty.sensor.get(one.channel.name)
            if stated is not None:  # of the true velocity, which is at most (|m| + e) / (1 - share)
                share, error = stated.relative or 0.0, error + (stated.bias or 0.0)
                error = error + share * (largest + error) / (1.0 - share)
            lower[:, part], upper[:, part] = low - error, high + error
    return None if np.isnan(lower).all() else (lower, upper)


def _observed(setting: Setting, trajectory: Trajectory) -> Floats | None:
    """Return the previous commands as the policy observed them, (N, A); None unless all are, and not fixed."""
    found, columns = np.full((len(trajectory), _axes(setting)), np.nan), _previous_columns(setting)
    if {axis for axis, _ in columns} != set(range(_axes(setting))):
        return None
    least, most = setting.spec.inputs.readings(trajectory.observations)
    for axis, column in columns:
        first = next(other for which, other in columns if which == axis)
        seen = least[:, column]
        known = most[:, column] - seen <= _ALIKE  # else it was clipped
        agrees = known & (np.abs(seen - least[:, first]) <= _ALIKE)
        found[:, axis] = np.where(agrees, seen, np.nan)
    return found


def _previous_columns(setting: Setting) -> list[tuple[int, int]]:
    """Return which number of a command, and in which column, the policy observes of the command before."""
    quantities = Quantities.of(setting.spec.observation, setting.robot, setting.spec.frames)
    return [
        (one.axis, int(quantities.inputs.newest(one.channel.name)[0]))
        for one in quantities
        if isinstance(one, PreviousCommand)
    ]


def _recorded(setting: Setting, trajectory: Trajectory) -> Floats | None:
    """Return the commands recorded in the states before, (N, A), NaN where there was none; None without any."""
    if trajectory.actions.shape[1] != setting.spec.action_size:
        return None
    if (
        setting.choice is not None
        and setting.choice.actions == _axes(setting)
        and not np.any(trajectory.from_rest)
    ):
        return None  # as many values as numbers in a command: which of both was recorded, nothing tells
    before = np.full((len(trajectory), _axes(setting)), np.nan)
    follows = follows_before(setting, trajectory)
    last = np.flatnonzero(follows) - 1
    before[follows] = setting.sent(trajectory.observations[last], trajectory.actions[last])
    before[_begins(trajectory)] = 0.0
    return before


def _axes(setting: Setting) -> int:
    """Return A, the number of entries of a command."""
    return len(setting.rules.kinematics.axes)


def _begins(trajectory: Trajectory) -> Booleans:
    """Tell before which rows the robot is known to have stood, (N,): those with which simulated episodes begin."""
    return np.asarray((trajectory.time == 0.0) & trajectory.from_rest)


def follows_before(setting: Setting, trajectory: Trajectory) -> Booleans:
    """Tell which rows come one control interval after the row before them, (N,)."""
    interval, timing = setting.rules.interval, setting.rules.timing
    least, most = (interval, interval) if timing is None else timing.interval
    passed = np.diff(trajectory.time)
    follows = np.zeros(len(trajectory), dtype=bool)
    in_time = (passed - most < LATE * interval) & (least - passed < LATE * interval)
    follows[1:] = (np.diff(trajectory.episode) == 0) & in_time
    follows &= trajectory.clocked
    return follows
