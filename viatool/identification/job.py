"""The job of ``viatool measure-errors``: a recording and a map give an error model."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from viatool.arrays import Floats, Indices
from viatool.errors import ConfigurationError, TrajectoryError
from viatool.identification.clocks import interval_findings, sensing_findings
from viatool.identification.findings import Bounding, Finding, Identification, UnmeasuredTerm
from viatool.identification.ranges import RangeErrors
from viatool.identification.tracking import signals_of, tracking_findings
from viatool.policy import PolicySpecification
from viatool.trajectory import BagSettings, is_bag
from viatool.trajectory.bag import BagParts, RecordedOdometry, are_stamped, open_parts
from viatool.trajectory.placing import Placing
from viatool.trajectory.transforms import turns_between
from viatool.world import WorldMap

_MOVED = 0.05  # m: a robot that moved so far and measured no velocity measures none
_ELSEWHERE = (
    ("start", "it is where missions begin, not an error of the robot"),
    ("obstacles", "what moves near the robot is not on the map"),
)


def measure_errors(
    recording: str | os.PathLike[str],
    world_map: WorldMap,
    *,
    spec: PolicySpecification | None = None,
    bag: BagSettings | None = None,
    bounding: Bounding | None = None,
) -> Identification:
    """Measure the errors of a robot from a recording.

    Parameters
    ----------
    recording : path
        A ROS 1 or 2 bag.
    world_map : WorldMap
        Where it was recorded.
    spec : PolicySpecification, optional
        Of the policy that the error model is for; names the channel of the LiDAR.
    bag : BagSettings, optional
        Topics and frame.
    bounding : Bounding, optional
        How bounds are taken from samples.

    Returns
    -------
    Identification
        Terms that were measured, and those that were not and why.

    Raises
    ------
    TrajectoryError
        If the recording is no bag, cannot be read, or lacks a topic that was named.
    ConfigurationError
        If the policy reads several LiDARs.
    """
    path, bag, bounding = Path(recording), bag or BagSettings(), bounding or Bounding()
    if not is_bag(path):
        raise TrajectoryError(
            f"'{path}' is no ROS bag", "give a .bag, .mcap or .db3 file, or the folder of a ROS 2 bag"
        )
    name = _lidar_channel(spec)
    findings: list[Finding] = []
    notes: list[str] = []
    with open_parts(path, bag.topics) as parts:
        measured, received, ranges = _scans(parts, world_map, bag, findings, name)
        if ranges is not None:
            findings += ranges.findings(name, bounding)
            notes += ranges.notes()
        findings += _commanded(parts, measured, received, bounding, notes)
    findings += [UnmeasuredTerm(place, reason) for place, reason in _ELSEWHERE]
    return Identification(str(path), str(world_map.path), bounding, tuple(findings), tuple(notes))


def _lidar_channel(spec: PolicySpecification | None) -> str:
    """Return the name of the channel that reads the LiDAR."""
    names = [] if spec is None else [one.name for one in spec.observation if one.kind == "lidar"]
    if len(names) > 1:
        raise ConfigurationError(
            f"the policy reads {len(names)} LiDARs ({', '.join(names)}), a bag has one",
            "leave the policy out, and copy the measured section to each channel that it is true of",
        )
    return names[0] if names else "lidar"


def _scans(
    parts: BagParts, world_map: WorldMap, bag: BagSettings, findings: list[Finding], name: str
) -> tuple[Indices, Indices, RangeErrors | None]:
    """Go through the scans: when they were measured and received, (S,) ns, and how their readings err."""
    none = np.zeros(0, np.int64)
    ranges, reason = None, ""
    if parts.scans is None:
        findings.append(UnmeasuredTerm(f"sensor.{name}, pose, timing.sensing", parts.missing["scan"]))
        return none, none, None
    if parts.odometry is None:
        reason = parts.missing["odometry"]
    elif not are_stamped(parts.odometry.stamps):
        reason = "the odometry has no stamps"
    else:
        placing = Placing(parts.odometry, parts.transforms, bag.frame.removeprefix("/"), bag.gap)
        ranges = RangeErrors(world_map, placing)
    stamps = []
    for scans in parts.scans:
        stamps.append((scans.stamps, scans.received))
        if ranges is not None and not are_stamped(scans.stamps):
            ranges, reason = None, "the scans have no stamps"
        if ranges is not None:
            try:
                ranges.add(scans)
            except TrajectoryError as error:  # frames that nothing connects
                ranges, reason = None, error.message
    if ranges is None:
        findings.append(UnmeasuredTerm(f"sensor.{name}, pose", reason))
    if not stamps:
        return none, none, ranges
    measured, received = (np.concatenate(each) for each in zip(*stamps, strict=True))
    return measured, received, ranges


def _commanded(
    parts: BagParts, measured: Indices, received: Indices, bounding: Bounding, notes: list[str]
) -> Iterator[Finding]:
    """Yield what the commands tell."""
    commands, odometry = parts.commands, parts.odometry
    if commands is None:
        yield UnmeasuredTerm("actuation, timing", parts.missing["command"])
        return
    if len(commands.stamps) == 0 or not are_stamped(commands.stamps):
        yield UnmeasuredTerm("actuation, timing", "the commands have no stamps, or there are none")
        return
    yield from interval_findings(commands, bounding)
    if len(measured) and are_stamped(measured):
        yield from sensing_findings(commands, measured, received, bounding)
    elif len(measured):
        yield UnmeasuredTerm("timing.sensing", "the scans have no stamps")
    if odometry is None or len(odometry.stamps) < 3 or not are_stamped(odometry.stamps):
        reason = parts.missing.get("odometry", "the odometry has no stamps, or fewer than 3 messages")
        yield UnmeasuredTerm("actuation, timing.delay", reason)
        return
    at, velocities = _velocities(odometry, notes)
    start = commands.stamps[0]
    given = (commands.stamps - start) * 1e-9
    yield from tracking_findings(
        signals_of(given, commands.values, (at - start) * 1e-9, velocities), bounding
    )


def _velocities(odometry: RecordedOdometry, notes: list[str]) -> tuple[Indices, Floats]:
    """Return the velocities that odometry measured, (M, 3), and when, in ns; from its poses if it tells none."""
    stamps, poses = odometry.stamps, odometry.poses
    new = np.concatenate([[True], np.diff(stamps) > 0])
    stamps, poses, velocities = stamps[new], poses[new], odometry.velocities[new]
    if np.any(velocities) or np.ptp(poses[:, :2], axis=0).max() < _MOVED:
        return stamps, velocities
    notes.append("odometry tells no velocities; they were taken from its poses")
    seconds = np.diff(stamps) * 1e-9
    turned = turns_between(poses[:-1, 2], poses[1:, 2])
    moved = (np.diff(poses[:, 0]) + 1j * np.diff(poses[:, 1])) * np.exp(-1j * (poses[:-1, 2] + 0.5 * turned))
    middle = stamps[:-1] + np.diff(stamps) // 2
    return middle, np.stack([moved.real / seconds, moved.imag / seconds, turned / seconds], axis=1)
