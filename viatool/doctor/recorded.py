"""Recorded commands against those of a policy under other readings of its specification; nothing is simulated."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from viatool.arrays import Floats, Indices
from viatool.channels import LidarSpecification
from viatool.doctor.evidence import Compared
from viatool.errors import EmptyEvaluationError, TrajectoryError
from viatool.motion.law import Axis, Kinematics
from viatool.policy import Policy, PolicySpecification
from viatool.policy.command_map import command_map
from viatool.policy.specification import ObservationChannel
from viatool.policy.specified import name_of
from viatool.trajectory import BagSettings, Trajectory, load_trajectory
from viatool.world import Robot

_LATE = 2.5
"""Control intervals within which a command answers a scan of a bag."""
_ALIKE = 1e-6
"""Seconds within which two times are those of the same scan."""


@dataclass(frozen=True, eq=False)
class Commander:
    """Says what a policy commands its robot under a specification.

    Parameters
    ----------
    policy : Policy
        Whose program is asked.
    kinematics : Kinematics
        Of the robot; A axes.
    robot : Robot
        Its limits, and its wheels.
    """

    policy: Policy
    kinematics: Kinematics
    robot: Robot

    def of_actions(self, spec: PolicySpecification, actions: Floats) -> Floats:
        """Return the commands (N, A) of recorded actions (N, O), or of commands as they are."""
        made = command_map(spec, self.kinematics, self.robot, name_of(self.policy))
        return made(actions) if actions.shape[1] == made.actions else actions

    def compare(self, spec: PolicySpecification, inputs: Floats, commands: Floats) -> Compared:
        """Compare what the policy commands under a specification with what was commanded.

        Parameters
        ----------
        spec : PolicySpecification
            By which the policy's outputs are commands.
        inputs : ndarray
            (N, n) what its network takes; NaN where that is not known.
        commands : ndarray
            (N, A) what was commanded; NaN where nothing was.
        """
        known = np.isfinite(inputs).all(axis=1) & np.isfinite(commands).all(axis=1)
        each = np.full(commands.shape, np.nan)
        if known.any():
            found = self.of_actions(spec, replace(self.policy, spec=spec).run(inputs[known]))
            each[known] = np.abs(self._carried_out(found) - self._carried_out(commands[known]))
        lower, upper = self.kinematics.limits(self.robot)
        ranges = np.where(upper > lower, upper - lower, 1.0)
        return Compared((each / ranges).max(axis=1), tuple(axis.name for axis in self.axes), each)

    @property
    def axes(self) -> tuple[Axis, ...]:
        """Return the entries of a command."""
        return self.kinematics.axes

    def _carried_out(self, commands: Floats) -> Floats:
        return self.kinematics.clip(commands, self.robot)


@dataclass(frozen=True, eq=False)
class RecordedTable:
    """Recorded observations and commands of a table, read again under other specifications.

    Parameters
    ----------
    commander : Commander
        Of the policy.
    spec : PolicySpecification
        By which the observations were recorded: they are what it says.
    observations : ndarray
        (N, n).
    commands : ndarray
        (N, A) what the robot was commanded.
    """

    commander: Commander
    spec: PolicySpecification
    observations: Floats
    commands: Floats

    def __call__(self, spec: PolicySpecification) -> Compared:
        """Return how far the recorded commands are from the policy's if another specification is right."""
        return self.commander.compare(spec, read_again(self.spec, spec, self.observations), self.commands)


@dataclass(frozen=True, eq=False)
class RecordedBag:
    """A bag, whose scans are read again under every specification.

    Parameters
    ----------
    commander : Commander
        Of the policy.
    path : Path
        Of the bag.
    settings : BagSettings
        Goal, topics and frame.
    time : ndarray
        (N,) seconds of the scans that are asked about.
    """

    commander: Commander
    path: Path
    settings: BagSettings
    time: Floats

    @classmethod
    def of(
        cls, commander: Commander, spec: PolicySpecification, path: Path, settings: BagSettings
    ) -> RecordedBag:
        """Return a bag with the scans of which the policy's own specification makes an observation."""
        whole = cls(commander, path, settings, np.zeros(0))
        return replace(whole, time=whole._read(spec)[0].time)

    def __call__(self, spec: PolicySpecification) -> Compared:
        """Return how far the recorded commands are from the policy's if a specification is right."""
        inputs = np.full((len(self.time), spec.observation_size), np.nan)
        commands = np.full((len(self.time), len(self.commander.axes)), np.nan)
        try:
            read, answers = self._read(spec)
        except (EmptyEvaluationError, TrajectoryError):  # its rays are not in the scans
            return self.commander.compare(spec, inputs, commands)
        at = np.minimum(np.searchsorted(self.time, read.time - _ALIKE), len(self.time) - 1)
        same = np.abs(self.time[at] - read.time) < _ALIKE
        inputs[at[same]] = read.observations[same]
        commands[at[same]] = answers[same]
        return self.commander.compare(spec, inputs, commands)

    def _read(self, spec: PolicySpecification) -> tuple[Trajectory, Floats]:
        """Return the states under a specification, and the command that followed each, (N, A); NaN where none did."""
        heard = [
            ObservationChannel(name=f"command {axis.kind}", kind=f"previous_{axis.kind}")
            for axis in self.commander.axes
        ]
        listening = spec.model_copy(update={"observation": [*spec.observation, *heard]})
        read = load_trajectory(self.path, listening, self.settings)
        newest = np.concatenate([listening.inputs.newest(channel.name) for channel in heard])
        before = read.observations[:, newest]
        answers = np.full(before.shape, np.nan)
        soon = np.flatnonzero(np.diff(read.time) <= _LATE * spec.control_interval)
        answers[soon] = before[soon + 1]
        observed = np.flatnonzero(listening.inputs.channel < len(spec.observation))
        return replace(read, observations=read.observations[:, observed]), answers


def read_again(own: PolicySpecification, spec: PolicySpecification, observations: Floats) -> Floats:
    """Return what the network would have been given if another specification is right.

    Parameters
    ----------
    own, spec : PolicySpecification
        By which the observations were recorded, and the other one; the same channels by name.
    observations : ndarray
        (N, n).

    Returns
    -------
    ndarray
        (N, n); NaN where the other one needs a ray that was not recorded.

    Notes
    -----
    What was clipped is read as the end of the clip.
    """
    least, most = own.inputs.readings(observations)
    readings = np.where(np.isfinite(least), least, most)
    where = {place: column for column, place in enumerate(_places(own))}
    sources = {channel.name: _sources(own.channel(channel.name), channel) for channel in spec.observation}
    found = np.full(observations.shape, np.nan)
    for column, (name, index, age) in enumerate(_places(spec)):
        source = int(sources[name][index])
        if source >= 0:
            found[:, column] = readings[:, where[name, source, age]]
    for number, channel in enumerate(spec.observation):
        columns = np.flatnonzero(spec.inputs.channel == number)
        found[:, columns] = channel.encoding.apply(found[:, columns])
    return found


def _places(spec: PolicySpecification) -> list[tuple[str, int, int]]:
    """Return of each input its channel, which of the channel's readings it holds, and of how many intervals ago."""
    inputs = spec.inputs
    columns = (inputs.channel.tolist(), inputs.reading.tolist(), inputs.age.tolist())
    return [
        (spec.observation[number].name, reading - inputs.places[number].start, age)
        for number, reading, age in zip(*columns, strict=True)
    ]


def _sources(own: ObservationChannel, other: ObservationChannel) -> Indices:
    """Return which reading of a channel is each reading of it as another one says, (k,); -1 for none."""
    if own.lidar is None or other.lidar is None:
        return np.arange(other.size)
    was, now = _centres(own.lidar), _centres(other.lidar)
    apart = np.abs(np.angle(now[:, None] / was))
    width = 2.0 * np.pi if len(was) < 2 else float(np.median(np.abs(np.angle(was[1:] / was[:-1]))))
    return np.where(apart.min(axis=1) <= 0.51 * width, apart.argmin(axis=1), -1)


def _centres(lidar: LidarSpecification) -> Floats:
    """Return where the bins look on average, (bins,) complex numbers of size 1."""
    middle = np.exp(1j * lidar.lidar().angles()).reshape(lidar.bins, -1).sum(axis=1)
    return np.asarray(middle / np.abs(middle))
