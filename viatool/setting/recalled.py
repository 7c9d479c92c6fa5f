"""What a policy remembered in recorded states, where the recording does not hold it: computed by its program."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from viatool.errors import TrajectoryError
from viatool.policy.memory import CarriedMemory, Remembering
from viatool.setting.received import LATE, follows_before, numbers_received
from viatool.setting.setting import Setting
from viatool.trajectory import Trajectory

_HINT = (
    "record the memory beside the observation (columns of its name), or every control interval from the start"
)


def recalled(policy: Remembering, setting: Setting, trajectory: Trajectory) -> Trajectory:
    """Return a trajectory whose observations end with the policy's memory: as recorded, or as its program computes it.

    Parameters
    ----------
    policy : Policy
        Its `remember` (onnxruntime) goes from one state to the next.
    setting : Setting
        n observation entries, of which the last M are memory.
    trajectory : Trajectory
        N states of n entries, which are returned as they are, or of n - M.

    Raises
    ------
    TrajectoryError
        If the memory is neither recorded nor to be computed: an episode does not begin at its start, or has a gap.

    Notes
    -----
    An episode begins with the initial memory of the specification; that it did so on the robot is an assumption, of
    which a note tells.
    """
    size = len(setting.spec.initial_memory)
    sensed = setting.spec.observation_size - size
    if not size or trajectory.observations.shape[1] != sensed:
        return trajectory
    _require_whole(setting, trajectory)
    observations = np.zeros((len(trajectory), sensed + size))
    order = np.argsort(trajectory.episode, kind="stable")
    lengths = np.bincount(trajectory.episode, minlength=trajectory.episodes)
    first = np.cumsum(lengths) - lengths
    memory = CarriedMemory(setting.spec, trajectory.episodes, setting.number)
    for step in range(int(lengths.max(initial=0))):
        there = np.flatnonzero(lengths > step)
        rows = order[first[there] + step]
        observations[rows] = memory.beside(numbers_received(setting, trajectory.observations[rows]), there)
        memory.carry(policy, observations[rows], there)
    note = (
        "the policy's memory is not recorded: onnxruntime computed it over each episode, from its initial value at the "
        "first state"
    )
    return replace(trajectory, observations=observations, notes=(*trajectory.notes, note))


def _require_whole(setting: Setting, trajectory: Trajectory) -> None:
    """Refuse episodes over which a memory cannot be followed."""
    if not trajectory.clocked or not trajectory.connected:
        raise TrajectoryError(
            "the policy's memory is not recorded, and without the times of its states it cannot be computed",
            _HINT,
        )
    interval = setting.rules.interval
    begins = np.ones(len(trajectory), dtype=bool)
    begins[1:] = trajectory.episode[1:] != trajectory.episode[:-1]
    late = begins & ~(np.abs(trajectory.time) < LATE * interval)
    gap = ~begins & ~follows_before(setting, trajectory)
    if trajectory.steps is not None:
        late |= begins & (trajectory.steps != 0)
        gap[1:] |= ~begins[1:] & (np.diff(trajectory.steps.astype(np.int64)) != 1)
    if not (late | gap).any():
        return
    row = int(np.argmax(late | gap))
    name = trajectory.name_of(int(trajectory.episode[row]))
    reason = (
        f"row {row} of {name} is not one control interval ({interval:g} s) after the row before"
        if gap[row]
        else f"{name} begins at {_when(trajectory, row)} in row {row}, not at its start"
    )
    raise TrajectoryError(f"the policy's memory is not recorded, and cannot be computed: {reason}", _HINT)


def _when(trajectory: Trajectory, row: int) -> str:
    """Return at which time, and step where it was recorded, a row stands."""
    seconds = f"{trajectory.time[row]:g} s"
    return seconds if trajectory.steps is None else f"{seconds} (step {trajectory.steps[row]})"
