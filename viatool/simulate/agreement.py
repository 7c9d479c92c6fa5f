"""Whether recorded LiDAR readings are those that the map shows at the recorded poses.

Another map, a wrong frame, a mirrored scan and a map that is out of date all look alike: readings that contradict the
map, and verdicts about states that never were. An honest recording has some as well. Gaussian noise of a standard
deviation of eps puts a third of the readings beyond eps, and hardly one in a million beyond eps and 5 cm; a small thing
that is not on the map, and rays without an echo, hide a few of many readings. Hence a recording is in doubt when more
than one reading in twenty is farther off than eps and 5 cm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from viatool.arrays import Floats, Indices
from viatool.channels import Frames, LidarReadings, Quantities, View
from viatool.uncertainty.error_model import SensorTerms
from viatool.world import Scenes, WorldMap

if TYPE_CHECKING:
    from viatool.policy import ObservationChannel
    from viatool.trajectory import Trajectory
    from viatool.uncertainty import ErrorModel

MARGIN = 0.05
"""Metres beyond eps from which on a reading contradicts the map: less is what maps and poses are off by anyway."""
DOUBTFUL = 0.05
"""Share of contradicting readings above which a recording is in doubt."""
_MOST = (
    2_000  # states that are compared, drawn at random with a fixed seed: the share is known to 1 % by then
)
_TRIED = 60  # of them, on which causes are tried
_SEED = 20


@dataclass(frozen=True)
class Agreement:
    """How far recorded readings of a LiDAR are from what the map shows.

    Parameters
    ----------
    channel : str
        Of the observation.
    compared, states : int
        States that were compared, and of how many.
    readings, off, contradicting : int
        Readings that were compared, those farther than eps from what the map shows, and farther than eps and `MARGIN`.
    median_difference : float
        Of the distances between reading and map, in metres.
    cause : str
        In words, what would make the readings fit the map clearly better; empty if nothing that was tried does.
    """

    channel: str
    compared: int
    states: int
    readings: int
    off: int
    contradicting: int
    median_difference: float
    cause: str = ""

    @property
    def share(self) -> float:
        """Return the share of the readings that are farther than eps from what the map shows."""
        return self.off / self.readings if self.readings else 0.0

    @property
    def doubtful(self) -> bool:
        """Tell whether so many readings contradict the map that the recording is in doubt."""
        return self.contradicting > DOUBTFUL * self.readings

    @property
    def words(self) -> str:
        """Say in words how the readings agree with the map."""
        seen = (
            ""
            if self.compared == self.states
            else f", in {self.compared:,} of {self.states:,} states at random"
        )
        return (
            f"{self.off:,} of {self.readings:,} readings of '{self.channel}' ({100.0 * self.share:.1f} %) are farther "
            f"than eps from what the map shows at the recorded poses, {self.contradicting:,} of them by more than "
            f"another {100.0 * MARGIN:g} cm; median difference {self.median_difference:.3g} m{seen}"
        )

    @property
    def warning(self) -> str:
        """Say that the recording is in doubt, and what may have caused it."""
        asked = "check that the map, its frame and the channel are those of the recording"
        return f"the recording contradicts the map: {self.words}; {self.cause or asked}"

    def __str__(self) -> str:
        """Return the warning, or how the readings agree."""
        return self.warning if self.doubtful else self.words

    def to_json(self) -> dict[str, Any]:
        """Return plain data for a report."""
        return {
            "channel": self.channel,
            "states": self.compared,
            "readings": self.readings,
            "off": self.off,
            "share": self.share,
            "contradicting": self.contradicting,
            "median_difference": self.median_difference,
            "doubtful": self.doubtful,
            "cause": self.cause,
        }


def compare_with_map(
    channels: Sequence[ObservationChannel],
    trajectory: Trajectory,
    world_map: WorldMap,
    radii: Floats,
    frames: Frames | None = None,
    errors: ErrorModel | None = None,
) -> tuple[Agreement, ...]:
    """Compare the LiDAR readings of recorded states with what a map shows there.

    Parameters
    ----------
    channels : sequence of ObservationChannel
        What the n entries of an observation are.
    trajectory : Trajectory
        N states with their poses; the obstacles of their scenarios count.
    world_map : WorldMap
        The map.
    radii : ndarray
        (n,) eps of every entry of an observation.
    frames : Frames, optional
        How many whole observations are stacked.
    errors : ErrorModel, optional
        What else readings and poses may be off by, which is then no contradiction.

    Returns
    -------
    tuple of Agreement
        One for each channel of a LiDAR; none where nothing tells how the readings are binned.

    Notes
    -----
    At most 2,000 states are compared, so time and memory do not grow with N.
    """
    count = len(trajectory)
    if not count:
        return ()
    rng = np.random.default_rng(_SEED)
    chosen = np.arange(count) if count <= _MOST else np.sort(rng.choice(count, _MOST, replace=False))
    episodes, scene = np.unique(trajectory.episode[chosen], return_inverse=True)
    scenes = Scenes.of(world_map, [trajectory.scenarios[episode] for episode in episodes])
    poses = trajectory.poses[chosen]
    found = []
    quantities = Quantities.of(channels, world_map.robot, frames)
    least, most = quantities.inputs.readings(trajectory.observations[chosen])
    for lidar, _ in quantities.lidars:
        if not lidar.described:
            continue
        sight, columns = _Sight(lidar, scenes), quantities.inputs.newest(lidar.channel.name)
        recorded, eps = (least[:, columns], most[:, columns]), radii[columns]
        shown = sight.shows(poses, scene)
        apart = _apart(recorded, shown)
        if errors is not None:
            apart = np.maximum(apart - _allowed(errors, lidar.channel.name, shown), 0.0)
        agreement = Agreement(
            channel=lidar.channel.name,
            compared=len(chosen),
            states=count,
            readings=apart.size,
            off=int((~(apart <= eps + 1e-5)).sum()),  # 1e-5 m: both are float32, measured along other sums
            contradicting=_contradicting(apart, eps),
            median_difference=float(np.median(apart)),
        )
        if agreement.doubtful:
            tried = rng.permutation(len(chosen))[:_TRIED]
            some = (recorded[0][tried], recorded[1][tried])
            cause = _likely_cause(sight, some, eps, poses[tried], scene[tried])
            agreement = Agreement(**{**vars(agreement), "cause": cause})
        found.append(agreement)
    return tuple(found)


def _apart(recorded: tuple[Floats, Floats], shown: Floats) -> Floats:
    """Return how far what a map shows is from what was recorded, of which the least and the largest are known."""
    least, most = recorded
    return np.maximum(np.maximum(least - shown, shown - most), 0.0)  # NaN stays NaN


def _allowed(errors: ErrorModel, channel: str, shown: Floats) -> Floats:
    """Return how far readings (B, bins) may be from what a map shows beside eps, about: at edges turns do more."""
    stated, pose = errors.sensor.get(channel, SensorTerms()), errors.pose
    turned = (stated.angle or 0.0) + (pose.theta or 0.0)
    moved = np.hypot(pose.x or 0.0, pose.y or 0.0)
    return np.asarray((stated.bias or 0.0) + moved + ((stated.relative or 0.0) + turned) * shown)


def _contradicting(apart: Floats, eps: Floats) -> int:
    """Count the readings that contradict the map; one that is not a number does."""
    return int((~(apart <= eps + MARGIN)).sum())


@dataclass(frozen=True, eq=False)
class _Sight:
    """What a LiDAR would read in some scenes, without noise."""

    lidar: LidarReadings
    scenes: Scenes

    def shows(self, poses: Floats, scene: Indices, turn: float = 0.0, *, mirrored: bool = False) -> Floats:
        """Return the readings (B, bins) at poses, of a sensor that is turned by so many radians and mirrored."""
        turned = poses + np.array([0.0, 0.0, turn])
        nowhere = np.zeros((len(poses), 2))
        view = View(self.scenes, turned, scene, nowhere, nowhere)
        read = self.lidar.measure(view).astype(np.float64)
        return read[:, self.lidar.mirror()[0]] if mirrored else read


def _likely_cause(
    sight: _Sight, recorded: tuple[Floats, Floats], eps: Floats, poses: Floats, scene: Indices
) -> str:
    """Return in words which turn of the sensor, mirrored or not, fits readings (B, bins) clearly better; or nothing."""

    def misfit(turn: int, mirrored: bool) -> tuple[int, float]:
        apart = _apart(recorded, sight.shows(poses, scene, np.radians(turn), mirrored=mirrored))
        return _contradicting(apart, eps), float(apart.mean())

    plain = misfit(0, False)
    coarse = [
        (misfit(turn, mirrored), turn, mirrored) for turn in range(0, 360, 6) for mirrored in (False, True)
    ]
    _, middle, mirrored = min(coarse, key=lambda tried: tried[0][1])
    fine = [(misfit(turn, mirrored), turn) for turn in range(middle - 5, middle + 6)]
    (left, _), turn = min(fine, key=lambda tried: tried[0][1])
    turn = (turn + 180) % 360 - 180
    if 2 * left > plain[0] or (turn == 0 and not mirrored):
        return ""
    parts = ["mirrored (its rays run the other way round)"] if mirrored else []
    parts += [f"turned by {abs(turn)} degrees{_side(turn)}"] if turn else []
    share = 100.0 * left / recorded[0].size
    return f"it looks {' and '.join(parts)}: read that way, {share:.1f} % of the readings contradict the map"


def _side(turn: int) -> str:
    """Say to which side a sensor is turned by so many degrees, unless it looks backwards."""
    return "" if turn == -180 else " to the left" if turn > 0 else " to the right"
