"""What many driven episodes say of a policy: shares with their uncertainty, times, lengths and clearances."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from viatool.arrays import Floats, Indices
from viatool.motion.kinematics import motion_of
from viatool.setting.setting import Setting
from viatool.simulate.roll_out import Drive
from viatool.trajectory import Trajectory

_QUANTILE = 1.959963984540054  # of the standard normal distribution at 97.5 %
_BIN = 0.1  # width of a bin of the clearance histogram, in metres
_LAST = 3.0  # where its last bin, which has no end, begins


@dataclass(frozen=True)
class Proportion:
    """How many of all.

    Parameters
    ----------
    count, total : int
        Of `total`, `count` have the property.
    """

    count: int
    total: int

    @property
    def rate(self) -> float:
        """Return the share."""
        return self.count / self.total

    @property
    def interval(self) -> tuple[float, float]:
        """Return the 95 % interval of Wilson, which holds for small numbers and near 0 and 1 too."""
        n, z = self.total, _QUANTILE
        middle = (self.rate + z * z / (2 * n)) / (1 + z * z / n)
        half = z / (1 + z * z / n) * math.sqrt(self.rate * (1 - self.rate) / n + z * z / (4 * n * n))
        # At the ends of the range the formula gives 0 and 1 only up to rounding.
        low = 0.0 if self.count == 0 else max(0.0, middle - half)
        high = 1.0 if self.count == n else min(1.0, middle + half)
        return low, high


def sign_test(one: int, other: int) -> float:
    """Return the probability of so uneven a count, to either side, among equals: the exact sign test."""
    count = one + other
    tail = sum(math.comb(count, number) for number in range(min(one, other) + 1))
    return float(min(1.0, 2 * tail / 2**count))


@dataclass(frozen=True)
class Spread:
    """Some numbers in short.

    Parameters
    ----------
    count : int
        How many there are.
    mean, least, median, largest : float
        NaN if there are none.
    """

    count: int
    mean: float
    least: float
    median: float
    largest: float

    @classmethod
    def of(cls, values: Floats) -> Spread:
        """Return the spread of values (N,)."""
        if not len(values):
            return cls(0, *(math.nan,) * 4)
        return cls(len(values), *(float(f(values)) for f in (np.mean, np.min, np.median, np.max)))


@dataclass(frozen=True, eq=False)
class Statistics:
    """The figures of N driven episodes.

    Parameters
    ----------
    success, collision, timeout : Proportion
        Of the episodes.
    average_cost : float
        Steps within the danger clearance, per episode.
    clearance_edges, clearance_counts : ndarray
        Left edges of the bins of a histogram, in metres, and how many steps ended with such a clearance; the last
        bin has no end.
    least_clearance : Spread
        Of the smallest clearance of each episode, in metres.
    time_to_goal : Spread
        Of the successful episodes, in seconds.
    path_ratio : Spread
        Of the successful episodes: length driven over the straight distance between the ends of the path.
    clipped : Proportion
        Commands that the policy gave beyond the robot's limits, of all its commands.
    """

    success: Proportion
    collision: Proportion
    timeout: Proportion
    average_cost: float
    clearance_edges: Floats
    clearance_counts: Indices
    least_clearance: Spread
    time_to_goal: Spread
    path_ratio: Spread
    clipped: Proportion


def summarise_drive(drive: Drive, setting: Setting) -> Statistics:
    """Return the statistics of driven episodes.

    Parameters
    ----------
    drive : Drive
        N episodes.
    setting : Setting
        The robot that drove, and what makes commands of its policy's actions.
    """
    trajectory = drive.trajectory
    total = trajectory.episodes
    shares = {
        name: Proportion(int((trajectory.outcomes == name).sum()), total)
        for name in ("success", "collision", "timeout")
    }
    won = trajectory.outcomes == "success"
    edges = np.arange(0.0, _LAST + 0.5 * _BIN, _BIN)
    bins = np.minimum((drive.clearances / _BIN + 1e-9).astype(np.int64), len(edges) - 1)
    robot, asked = setting.robot, setting.sent(trajectory.observations, trajectory.actions)
    beyond = (np.abs(motion_of(robot).clip(asked, robot) - asked) > 1e-6).any(axis=1)
    return Statistics(
        **shares,
        average_cost=float(trajectory.costs.mean()),
        clearance_edges=edges,
        clearance_counts=np.bincount(bins, minlength=len(edges)),
        least_clearance=Spread.of(drive.least_clearance),
        time_to_goal=Spread.of((episode_steps(trajectory) * robot.control_interval)[won]),
        path_ratio=Spread.of(path_ratios(drive)[won]),
        clipped=Proportion(int(beyond.sum()), len(asked)),
    )


def episode_steps(trajectory: Trajectory) -> Indices:
    """Return how many decisions each episode took, (N,)."""
    return np.bincount(trajectory.episode, minlength=trajectory.episodes)


def path_ratios(drive: Drive) -> Floats:
    """Return the length of each path over the straight distance between its ends, (N,); 1 for no distance."""
    trajectory = drive.trajectory
    places, episode = trajectory.poses[:, :2], trajectory.episode
    last = np.append(episode[1:] != episode[:-1], True)
    following = np.append(places[1:], places[-1:], axis=0)
    following[last] = drive.ends[episode[last], :2]
    pieces = np.hypot(*(following - places).T)
    lengths = np.bincount(episode, weights=pieces, minlength=trajectory.episodes)
    starts = np.zeros_like(drive.ends[:, :2])
    first = np.append(True, last[:-1])
    starts[episode[first]] = places[first]
    straight = np.hypot(*(drive.ends[:, :2] - starts).T)
    return np.where(straight > 1e-9, lengths / np.maximum(straight, 1e-9), 1.0)
