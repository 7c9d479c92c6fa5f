"""What sensors that err as a whole read at poses: a believed pose that is off, turned scans, rays that pass.

For counterexamples: every reading is cast anew, in float64, as a LiDAR meets what is around that is turned as it is,
and whose rays pass what they pass; nothing is bounded.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from viatool.arrays import Booleans, Floats, Indices
from viatool.channels import LidarReadings, View, see_precisely
from viatool.loop.closed_loop import ClosedLoop
from viatool.setting.admissible import KnownReadings
from viatool.setting.explanation import explain_known, with_scans
from viatool.setting.setting import Setting
from viatool.world import Scenes
from viatool.world.scenes import own_of

_WITHIN = 1.0 - 1e-9
"""Of each bound, so that no rounding leads beyond it."""


@dataclass(frozen=True, eq=False)
class Deceptions:
    """How sensors err as a whole, in each of B states.

    Parameters
    ----------
    believed : ndarray
        (B, 3) where the robot believes to be.
    turn : ndarray
        (B, T) by how much each scan that errs as a whole is turned, in radians.
    passed : ndarray
        (B, n) bool: bins whose rays pass thin obstacles.
    """

    believed: Floats
    turn: Floats
    passed: Booleans

    def __len__(self) -> int:
        """Return B."""
        return len(self.believed)

    def select(self, which: Indices) -> Deceptions:
        """Return those of some states."""
        return Deceptions(self.believed[which], self.turn[which], self.passed[which])

    @classmethod
    def choose(cls, which: Indices, ways: Sequence[Deceptions]) -> Deceptions:
        """Return one of several ways for each of B states, (B,) by number."""
        rows = np.arange(len(which))
        parts = (np.stack([getattr(way, one.name) for way in ways])[which, rows] for one in fields(cls))
        return cls(*parts)

    @classmethod
    def none(cls, setting: Setting, poses: Floats) -> Deceptions:
        """Return none at poses (B, 3)."""
        scans, size = len(setting.reading_errors.scans), setting.spec.inputs.size
        return cls(poses, np.zeros((len(poses), scans)), np.zeros((len(poses), size), dtype=bool))

    @classmethod
    def drawn(cls, setting: Setting, poses: Floats, generator: np.random.Generator) -> Deceptions:
        """Return some at poses (B, 3), as large as they may be."""
        errors, found = setting.reading_errors, cls.none(setting, poses)

        def side(*shape: int) -> Floats:
            return np.asarray(generator.choice([-1.0, 1.0], size=shape))

        believed = poses + _WITHIN * setting.pose_radii * side(*poses.shape)
        turn = _WITHIN * np.array([scan.angle for scan in errors.scans]) * side(*found.turn.shape)
        passed, every = generator.random(found.passed.shape) < 0.5, generator.random((len(poses), 1)) < 0.5
        thin = np.isin(
            errors.inputs.reading, [column for scan in errors.scans if scan.thin for column in scan.columns]
        )
        return cls(believed, turn, (passed | every) & thin)


def known_readings(
    loop: ClosedLoop, poses: Floats, previous: Floats, deceived: Deceptions, *, lossless: bool = False
) -> KnownReadings:
    """Return what sensors that err as a whole, and by nothing else, read at poses (B, 3) after commands (B, A).

    With what they read when rays return nothing, unless it is not needed.
    """
    setting, sensors = loop.setting, loop.sensors
    errors, readings = setting.reading_errors, sensors.read(poses, previous, believed=deceived.believed)
    scans = {int(scan.columns[0]): number for number, scan in enumerate(errors.scans)}
    losses = () if lossless else errors.missing
    missing = {int(scan.columns[0]): number for number, scan in enumerate(losses)}
    losing: dict[int, Floats] = {}
    for lidar, place in sensors.quantities.lidars:
        number = scans.get(place.start)
        lost = missing.get(int(np.flatnonzero(errors.inputs.reading == place.start)[0]))
        if number is None and lost is None:
            continue
        rays = _cast(loop, lidar, poses, deceived, number)  # (B, R, bins)
        readings[:, place] = _read(lidar, rays)
        if lost is not None:
            losing[lost] = _without_nearest(lidar, rays, errors.missing[lost].count)
    inputs = errors.inputs.reading
    return KnownReadings(readings[:, inputs], tuple(losing[number] for number in range(len(losses))))


def errors_of(
    loop: ClosedLoop, poses: Floats, previous: Floats, deceived: Deceptions, observations: Floats
) -> list[dict[str, Any]]:
    """Return which errors make observations (B, n) at poses (B, 3) after commands (B, A), as witness files say them."""
    errors = loop.setting.reading_errors
    if errors.is_box and not loop.setting.pose_radii.any():
        return [{} for _ in poses]
    known, told = known_readings(loop, poses, previous, deceived), []
    for row, seen in enumerate(observations):
        found = explain_known(errors, known, row, seen) or {}
        found = with_scans(found, errors, deceived.turn[row], deceived.passed[row])
        believed = {"believed_pose": deceived.believed[row].tolist()} if loop.setting.believes else {}
        told.append(believed | ({"errors": found} if found else {}))
    return told


def _cast(
    loop: ClosedLoop, lidar: LidarReadings, poses: Floats, deceived: Deceptions, scan: int | None
) -> Floats:
    """Return the ranges of rays (B, R, bins), of a scan that errs as a whole or of one that does not."""
    fan, sensors = lidar.fan, loop.sensors
    turned = poses if scan is None else poses + deceived.turn[:, scan, None] * [0.0, 0.0, 1.0]
    none = np.zeros((len(poses), 2))
    view = View(sensors.scenes, turned, np.zeros(len(poses), np.int64), none, none, eyes=see_precisely)

    def by_bin(seen: View) -> Floats:
        rays = np.asarray(seen.eyes(fan, seen), dtype=np.float64)
        return rays.reshape(len(poses), -1, fan.lidar.bins)

    rays = by_bin(view)
    error = None if scan is None else loop.setting.reading_errors.scans[scan]
    if error is None or not error.thin > 0.0:
        return rays
    bare = Scenes.around(loop.setting.world_map, own_of([loop.scenario]), error.thin)
    passed = deceived.passed[:, np.isin(loop.setting.reading_errors.inputs.reading, error.columns)]
    return np.where(passed[:, None], by_bin(replace(view, scenes=bare)), rays)


def _without_nearest(lidar: LidarReadings, rays: Floats, count: int) -> Floats:
    """Return what bins read without the nearest 1, ... `count` of their rays (B, R, bins), (count, B, bins)."""
    found = np.full((count, len(rays), rays.shape[2]), np.nan)
    rays = np.sort(rays, axis=1)
    for number in range(min(count, rays.shape[1])):
        rays[:, number] = lidar.fan.lidar.maximum_range
        found[number] = _read(lidar, rays)
    return found


def _read(lidar: LidarReadings, rays: Floats) -> Floats:
    return np.asarray(lidar.fan.read(rays.reshape(len(rays), -1).copy()), dtype=np.float64)
