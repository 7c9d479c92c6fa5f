"""States from a bag: where the robot was, and what its policy saw there, at the time of every scan."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from viatool.arrays import Booleans, Floats, Indices
from viatool.channels import Channel, Quantities, RecordedInstants
from viatool.errors import ConfigurationError, EmptyEvaluationError, PolicyError, TrajectoryError
from viatool.trajectory.bag import Bag, Topics, are_stamped, open_bag
from viatool.trajectory.placing import Mount, Placing
from viatool.trajectory.rows import Rows
from viatool.trajectory.scans import Readings, Scans, bin_scans
from viatool.trajectory.trajectory import Trajectory

if TYPE_CHECKING:
    from viatool.policy import PolicySpecification
    from viatool.world import Scenario


_REASONS = (
    "without a pose at their time",
    "with a bin that measured nothing",
    "without a recent command",
    "without the frames before",
)
"""Why scans are left out."""


@dataclass(frozen=True)
class BagSettings:
    """What a bag does not tell.

    Parameters
    ----------
    goal : tuple of float, optional
        x, y in the map frame, in metres; needed when the policy observes a goal.
    topics : Topics
        Names of topics, where they are not the usual ones.
    frame : str
        The frame that is the map's. The odometry's own name, such as ``odom``, is the explicit word that no
        transform is needed.
    gap : float
        Seconds over which poses are interpolated and a command counts as the previous one.

    Raises
    ------
    ConfigurationError
        If the goal is not finite.
    """

    goal: tuple[float, float] | None = None
    topics: Topics = field(default_factory=Topics)
    frame: str = "map"
    gap: float = 0.5

    def __post_init__(self) -> None:
        if self.goal is not None and not np.isfinite(self.goal).all():
            raise ConfigurationError(
                f"the goal of the bag is {self.goal}, expected finite numbers", "give metres"
            )


def load_bag(path: Path, specification: PolicySpecification | None, settings: BagSettings) -> Trajectory:
    """Read the states of a bag: one for every scan whose pose, command and readings are known.

    Parameters
    ----------
    path : Path
        ROS 1 bag, ROS 2 folder, mcap or sqlite3 file.
    specification : PolicySpecification or None
        Says what is observed.
    settings : BagSettings
        Goal, topics and frame.

    Returns
    -------
    Trajectory
        One episode of unknown outcome, without actions, and without what the policy remembered; `notes` tell what was
        assumed and left out.

    Raises
    ------
    TrajectoryError
        If the bag is unreadable or does not hold what the policy observes.
    ConfigurationError
        If the policy observes a goal and none is given.
    EmptyEvaluationError
        If no scan is left.
    """
    observed, interval = _observed(specification, settings)
    with open_bag(path, settings.topics, commands="command" in observed.needs) as bag:
        gathered = _Gathered(bag, observed, settings, interval)
        columns = Rows(1, np.int64), Rows(3), Rows(observed.size), Rows(1, np.int64)
        for scans in bag.scans:
            for column, part in zip(columns, gathered.states(scans), strict=True):
                column.add(part)
    if not gathered.scans or not len(bag.odometry.stamps):
        empty = "odometry" if gathered.scans else "scans"
        raise EmptyEvaluationError(
            f"{path}: the bag holds no {empty}", "record at least one scan and its pose"
        )
    notes = gathered.notes()
    stamps, poses, observations, told = (column.table() for column in columns)
    if not len(stamps):
        raise EmptyEvaluationError(
            f"{path}: no scan is left ({'; '.join(notes)})",
            "record odometry, transforms and commands throughout",
        )
    return Trajectory(
        poses=poses,
        observations=observations,
        actions=np.zeros((len(poses), 0)),
        episode=np.zeros(len(poses), dtype=np.int64),
        time=(stamps[:, 0] - gathered.first) * 1e-9,
        outcomes=np.array(["unknown"]),
        costs=np.array([np.nan]),
        scenarios=(_scenario(path, poses[0], settings.goal),),
        notes=tuple(notes),
        commanded=told[:, 0] > 0,
        motion=gathered.motion(stamps[:, 0]),
        began=gathered.first,
    )


def _observed(specification: PolicySpecification | None, settings: BagSettings) -> tuple[Quantities, float]:
    """Return what a policy observes and how often it acts, refusing what no bag can give."""
    if specification is None:
        raise PolicyError(
            "a bag is read with the policy's specification, but the policy has none",
            "describe it with --spec robot.yaml",
        )
    observed = Quantities.of(specification.sensed, frames=specification.frames).require("record")
    several = [lidar.channel.name for lidar, _ in observed.lidars]
    if len(several) > 1:
        raise PolicyError(
            f"observation channels {', '.join(map(repr, several))} are LiDARs, but a bag is read with only one",
            "record the states as a table, or give all but one a fixed `value` in the specification",
        )
    if "goal" in observed.needs and settings.goal is None:
        raise ConfigurationError("the policy observes its goal, which a bag does not hold", "give --goal X,Y")
    return observed, specification.control_interval


class _Gathered:
    """Makes states of scans, some at a time, and remembers what was assumed and left out.

    Parameters
    ----------
    bag : Bag
        Its odometry, commands and transforms.
    observed : Quantities
        What the policy observes; n numbers.
    settings : BagSettings
        Goal, topics and frame.
    interval : float
        Seconds from one frame to the next, where several are observed.
    """

    def __init__(self, bag: Bag, observed: Quantities, settings: BagSettings, interval: float) -> None:
        self.bag, self.observed, self.settings, self.interval = bag, observed, settings, interval
        self.placing = Placing(bag.odometry, bag.transforms, settings.frame.removeprefix("/"), settings.gap)
        self._stamps, self._readings = np.zeros(0, np.int64), np.zeros((0, 1))
        self.first = self.scans = self.kept = self.waiting = 0
        self.lost = dict.fromkeys(_REASONS, 0)
        self.mounted: Mount | None = None
        self.seen: dict[str, Readings] = {}

    def _require_stamps(self, scans: Scans) -> None:
        """Refuse messages that nobody stamped: which pose belongs to which scan is then not known."""
        parts = {"scans": scans.stamps, "odometry": self.bag.odometry.stamps}
        bare = [name for name, stamps in parts.items() if len(stamps) > 1 and not are_stamped(stamps)]
        if bare:
            raise TrajectoryError(
                f"the headers of {' and '.join(bare)} have no stamps (all are 0), which tell what belongs together",
                "stamp the messages where they are published, and record again",
            )

    def states(self, scans: Scans) -> tuple[Indices, Floats, Floats, Indices]:
        """Return stamps (K,), poses (K, 3) and observations (K, n) of those scans of which all is known.

        The fourth is 1 where the command before the scan was recorded, else 0, (K,).
        """
        if not self.scans:
            self.first = int(scans.stamps[0])
        self._require_stamps(scans)
        self.scans += len(scans)
        if not len(self.bag.odometry.stamps):
            return scans.stamps[:0], np.zeros((0, 3)), np.zeros((0, 0)), scans.stamps[:0]
        poses, located = self.placing.locate(scans.stamps)
        previous, commanded, told = self._previous(scans)
        complete = np.ones(len(scans), dtype=bool)

        def scan(channel: Channel) -> Floats:
            bins = self._see(scans, channel)
            complete[~np.isfinite(bins).all(axis=1)] = False
            return bins

        goal = None if self.settings.goal is None else np.array(self.settings.goal)
        recorded = RecordedInstants(poses, goal, previous, self._velocities(scans.stamps), scan)
        readings = self.observed.record(recorded)
        complete &= np.isfinite(readings).all(axis=1)
        readings[~(located & complete & commanded)] = np.nan
        past = self._past(scans.stamps, readings)
        observations = self.observed.observe(readings, past)
        remembered = np.isfinite(past).all(axis=(1, 2))
        known = dict(zip(_REASONS, (located, complete, commanded, remembered), strict=True))
        keep = np.logical_and.reduce(list(known.values()))
        self.kept += int(keep.sum())
        for reason, which in known.items():
            self.lost[reason] += int((~which).sum())
        return scans.stamps[keep], poses[keep], observations[keep], told[keep].astype(np.int64)

    def motion(self, at: Indices) -> dict[str, Floats]:
        """Return what the odometry measured of the motion at some instants, by name, (S,) each."""
        ahead, _, turn = self._velocities(at).T
        return {"v": ahead, "omega": turn}

    def _velocities(self, at: Indices) -> Floats:
        """Return the measured velocities at some instants, (S, 3), between those that were recorded."""
        odometry = self.bag.odometry
        return np.stack([np.interp(at, odometry.stamps, part) for part in odometry.velocities.T], axis=1)

    def _past(self, stamps: Indices, readings: Floats) -> Floats:
        """Return what was read in each of the T control intervals before scans, (S, T, m); NaN where it is not known.

        That of an interval is the scan which is nearest to its time, at most half an interval away.
        """
        inputs = self.observed.inputs
        past = np.zeros((len(stamps), inputs.memory, readings.shape[1]))
        if not inputs.memory:
            return past
        self._stamps = np.concatenate([self._stamps, stamps])
        self._readings = np.concatenate([self._readings.reshape(-1, readings.shape[1]), readings])
        for age in np.unique(inputs.age[inputs.age > 0]):
            at = stamps - round(1e9 * age * self.interval)
            after = np.clip(np.searchsorted(self._stamps, at), 0, len(self._stamps) - 1)
            before = np.maximum(after - 1, 0)
            nearer = np.abs(self._stamps[before] - at) < np.abs(self._stamps[after] - at)
            nearest = np.where(nearer, before, after)
            there = np.abs(self._stamps[nearest] - at) <= 0.5e9 * self.interval
            past[:, age - 1] = np.where(there[:, None], self._readings[nearest], np.nan)
        recent = self._stamps >= stamps[-1] - round(1e9 * (inputs.memory + 1) * self.interval)
        self._stamps, self._readings = self._stamps[recent], self._readings[recent]
        return past

    def _see(self, scans: Scans, channel: Channel) -> Floats:
        """Return the bins of every scan, (S, bins), for a LiDAR channel; NaN where nothing was measured."""
        assert channel.lidar is not None  # refused before
        if self.mounted is None:
            self.mounted = self.placing.mount(scans.frame)
        seen = self.seen.setdefault(channel.name, Readings())
        return bin_scans(scans, channel.lidar, self.mounted.yaw, self.mounted.side, seen)

    def _previous(self, scans: Scans) -> tuple[Floats, Booleans, Booleans]:
        """Return the command before each scan, (S, 3), whether it may be used, and whether it was recorded.

        Before the first command the robot is taken to stand still, which is not recorded.
        """
        found, known = np.zeros((len(scans), 3)), np.ones(len(scans), dtype=bool)
        commands = self.bag.commands
        if commands is None:
            return found, known, ~known
        at = scans.received if commands.received else scans.stamps
        last = np.searchsorted(commands.stamps, at, side="left") - 1
        some = last >= 0
        found[some] = commands.values[last[some]]
        known[some] = (at[some] - commands.stamps[last[some]]) * 1e-9 <= self.settings.gap
        self.waiting += int((~some).sum())
        return found, known, some

    def notes(self) -> list[str]:
        """Say in words what was assumed, how many scans were left out, and why; one may lack several things."""
        frame, odometry = self.placing.frame, self.bag.odometry.frame
        if odometry == frame:
            notes = [f"odometry is given in the frame '{frame}', taken as the map's"]
        else:
            notes = [f"odometry in '{odometry}', moved by the recorded transform from '{frame}'"]
        mounted = self.mounted or Mount()
        if mounted.away > 1e-3:
            notes.append(
                f"the LiDAR stands {mounted.away:.3f} m from the robot's origin; poses are the origin's"
            )
        if mounted.side < 0:
            notes.append("the LiDAR is mounted upside down; its rays count from the other side")
        for lidar, _ in self.observed.lidars:
            if lidar.channel.lidar is not None and lidar.channel.name in self.seen:
                notes += self.seen[lidar.channel.name].notes(lidar.channel.lidar)
        if self.waiting:
            notes.append(f"previous command 0 before the first one (scans: {self.waiting:,})")
        lost = ", ".join(f"{count:,} {reason}" for reason, count in self.lost.items() if count)
        if not lost:
            return [*notes, f"all {self.scans:,} scans of the bag"]
        return [*notes, f"{self.kept:,} of {self.scans:,} scans of the bag; left out: {lost}"]


def _scenario(path: Path, start: Floats, goal: tuple[float, float] | None) -> Scenario | None:
    if goal is None:
        return None
    from viatool.world import Scenario

    x, y, theta = start.tolist()
    return Scenario(path.stem, (x, y, theta), goal)
