"""States from a bag: where the robot was, and what its policy saw there, at the time of every scan."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from viatool.errors import ConfigurationError, EmptyEvaluationError, PolicyError, TrajectoryError
from viatool.trajectory.assembly import assemble, polar_goals
from viatool.trajectory.bag import Bag, Commands, Topics, read_bag
from viatool.trajectory.scans import Scans, bin_scans
from viatool.trajectory.trajectory import Trajectory
from viatool.trajectory.transforms import compose, interpolate

if TYPE_CHECKING:
    from viatool.policy import LidarSpecification, PolicySpecification
    from viatool.world import Scenario

Floats = NDArray[np.float64]
Booleans = NDArray[np.bool_]

_GOALS = {"goal_distance", "goal_cosine", "goal_sine"}
_PREVIOUS = {"previous_linear", "previous_angular"}


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
    """

    goal: tuple[float, float] | None = None
    topics: Topics = field(default_factory=Topics)
    frame: str = "map"
    gap: float = 0.5


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
        One episode of unknown outcome, without actions; `notes` tell what was assumed and left out.

    Raises
    ------
    TrajectoryError
        If the bag is unreadable or does not hold what the policy observes.
    ConfigurationError
        If the policy observes a goal and none is given.
    EmptyEvaluationError
        If no scan is left.
    """
    lidar, needed = _needs(specification, settings)
    assert specification is not None  # `_needs` refuses None
    bag = read_bag(path, settings.topics, commands=bool(needed & _PREVIOUS))
    if not len(bag.scans) or not len(bag.odometry.stamps):
        empty = "scans" if not len(bag.scans) else "odometry"
        raise EmptyEvaluationError(
            f"{path}: the bag holds no {empty}", "record at least one scan and its pose"
        )
    poses, located, notes = _locate(bag, settings)
    bins, complete, told = _see(bag, lidar, poses, settings)
    previous, commanded, said = _previous(bag.commands, bag.scans, settings.gap)
    keep = located & complete & commanded
    notes = [*notes, *told, *said, *_losses(located, complete, commanded, keep)]
    if not keep.any():
        raise EmptyEvaluationError(
            f"{path}: no scan is left ({'; '.join(notes)})",
            "record odometry, transforms and commands throughout",
        )
    measured = {
        "lidar": bins[keep],
        "previous_linear": previous[keep, 0],
        "previous_angular": previous[keep, 1],
    }
    if settings.goal is not None:
        measured |= polar_goals(poses[keep], np.array(settings.goal))
    return Trajectory(
        poses=poses[keep],
        observations=assemble(specification.observation, measured),
        actions=np.zeros((int(keep.sum()), 0)),
        episode=np.zeros(int(keep.sum()), dtype=np.int64),
        time=(bag.scans.stamps[keep] - bag.scans.stamps[0]) * 1e-9,
        outcomes=np.array(["unknown"]),
        costs=np.array([np.nan]),
        scenarios=(_scenario(path, poses[keep][0], settings.goal),),
        notes=tuple(notes),
    )


def _needs(
    specification: PolicySpecification | None, settings: BagSettings
) -> tuple[LidarSpecification | None, set[str]]:
    """Return the LiDAR and the kinds of channels that a policy observes, refusing what no bag can give."""
    if specification is None:
        raise PolicyError(
            "a bag is read by the policy's specification, and there is none",
            "describe it with --spec robot.yaml",
        )
    free = [channel for channel in specification.observation if channel.value is None]
    for channel in free:
        if channel.kind in ("other", "budget"):
            raise PolicyError(
                f"observation channel '{channel.name}' of kind '{channel.kind}' is not in a bag",
                "give the channel a fixed `value` in the specification, or a table of states",
            )
        if channel.kind == "lidar" and channel.lidar is None:
            raise PolicyError(
                f"observation channel '{channel.name}' does not say how its readings are binned",
                "describe the LiDAR in the policy's specification",
            )
    needed = {str(channel.kind) for channel in free}
    if needed & _GOALS and settings.goal is None:
        raise ConfigurationError("the policy observes its goal, which a bag does not hold", "give --goal X,Y")
    return next((channel.lidar for channel in free if channel.kind == "lidar"), None), needed


def _locate(bag: Bag, settings: BagSettings) -> tuple[Floats, Booleans, list[str]]:
    """Return the pose of the robot in the map frame at every scan, (S, 3), and whether it is known."""
    odometry, at = bag.odometry, bag.scans.stamps
    poses, known = interpolate(odometry.stamps, odometry.poses, at, settings.gap)
    frame = settings.frame.removeprefix("/")
    if odometry.frame == frame:
        return poses, known, [f"odometry is given in the frame '{frame}', taken as the map's"]
    drift, seen = bag.transforms.locate(odometry.frame, frame, at, settings.gap)
    note = f"odometry in '{odometry.frame}', moved by the recorded transform from '{frame}'"
    return compose(drift, poses), known & seen, [note]


def _see(
    bag: Bag, lidar: LidarSpecification | None, poses: Floats, settings: BagSettings
) -> tuple[Floats, Booleans, list[str]]:
    """Return the bins of every scan, (S, bins), and whether each has a measurement."""
    scans, robot = bag.scans, bag.odometry.child
    if lidar is None:
        return np.zeros((len(scans), 0)), np.ones(len(scans), dtype=bool), []
    yaw, notes = 0.0, []
    if scans.frame != robot:
        mount, known = bag.transforms.locate(scans.frame, robot, scans.stamps, settings.gap)
        if not known.any():
            return np.zeros((len(scans), lidar.bins)), known, []
        mount = mount[known]
        x, y, yaw = mount[0]
        if np.abs(mount - mount[0]).max() > 1e-3:
            raise TrajectoryError(
                f"the LiDAR '{scans.frame}' moves on the robot '{robot}'",
                "record a LiDAR that is fixed to it",
            )
        away = float(np.hypot(x, y))
        if away > 1e-3:
            notes.append(f"the LiDAR stands {away:.3f} m from the robot's origin; poses are the origin's")
    bins, counted = bin_scans(scans, lidar, float(yaw))
    rays = sorted({len(ranges) for ranges in scans.ranges})
    if rays != [lidar.rays]:
        notes.append(f"scans of {', '.join(map(str, rays))} rays binned like the policy's {lidar.rays}")
    return bins, np.asarray(np.isfinite(bins).all(axis=1)), [*notes, *counted.notes(scans, lidar)]


def _previous(commands: Commands | None, scans: Scans, gap: float) -> tuple[Floats, Booleans, list[str]]:
    """Return the command before each scan, (S, 2), and whether it is known; standing still before the first."""
    found, known = np.zeros((len(scans), 2)), np.ones(len(scans), dtype=bool)
    if commands is None:
        return found, known, []
    at = scans.received if commands.received else scans.stamps
    last = np.searchsorted(commands.stamps, at, side="left") - 1
    some = last >= 0
    found[some] = commands.values[last[some]]
    known[some] = (at[some] - commands.stamps[last[some]]) * 1e-9 <= gap
    waiting = int((~some).sum())
    notes = [f"previous command 0 before the first one (scans: {waiting:,})"] if waiting else []
    return found, known, notes


def _losses(located: Booleans, complete: Booleans, commanded: Booleans, keep: Booleans) -> list[str]:
    """Say how many scans were left out, and why; one scan may lack several things."""
    reasons = (
        (located, "without a pose at their time"),
        (complete, "with a bin that measured nothing"),
        (commanded, "without a recent command"),
    )
    lost = [f"{int((~known).sum()):,} {why}" for known, why in reasons if not known.all()]
    if not lost:
        return [f"all {len(keep):,} scans of the bag"]
    return [f"{int(keep.sum()):,} of {len(keep):,} scans of the bag; left out: {', '.join(lost)}"]


def _scenario(path: Path, start: Floats, goal: tuple[float, float] | None) -> Scenario | None:
    if goal is None:
        return None
    from viatool.world import Scenario

    x, y, theta = start.tolist()
    return Scenario(path.stem, (x, y, theta), goal)
