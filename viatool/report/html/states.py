"""The states as compact arrays for the page: which of them it holds, and what it knows of each."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Booleans, Floats, Indices
from viatool.channels import Quantities
from viatool.motion.manoeuvre import Manoeuvre
from viatool.policy import PolicySpecification
from viatool.report.foreign import one_line
from viatool.report.palette import VERDICTS
from viatool.report.sections import Check
from viatool.report.states.closest_call import closest_state

if TYPE_CHECKING:
    from viatool.setting.rules import Rules
    from viatool.verification.result import Result
    from viatool.world import Obstacles, Robot, WorldMap


MOST_STATES = 20_000
MOST_BYTES = 5_000_000  # of the arrays, before base64; the page stays below 10 MB with the plotting library
LONGEST_NAME = 120
_FIXED_BYTES = 60  # of a state, besides its observation


def keep_states(result: Result, most: int = MOST_STATES, failing: Booleans | None = None) -> Indices:
    """Choose the states that the page holds, in their order.

    Parameters
    ----------
    result : Result
        N states.
    most : int
        How many, at most; fewer if the observations are long.
    failing : ndarray, optional
        (N,) bool: those that a failed condition of the gate counts.

    Returns
    -------
    ndarray
        Indices. All states if they fit; else first the unsafe ones, then the unknown ones, then those that fail the
        gate or without the danger distance proved, then the others. Of the kind that no longer fits, evenly spread
        ones are taken.
    """
    total = len(result.trajectory)
    room = min(most, MOST_BYTES // (_FIXED_BYTES + 2 * result.observations.shape[1]))
    if total <= room:
        return np.arange(total)
    near = ~result.judgement.danger if failing is None else ~result.judgement.danger | failing
    rank = np.select([result.verdict == "unsafe", result.verdict == "unknown", near], [0, 1, 2], 3)
    kept: list[Indices] = []
    for level in range(4):
        found = np.flatnonzero(rank == level)
        left = room - sum(map(len, kept))
        if len(found) > left:
            found = (
                found[np.linspace(0, len(found) - 1, left).round().astype(np.int64)] if left else found[:0]
            )
        kept.append(found)
    return np.sort(np.concatenate(kept))


def pack(array: NDArray[Any], kind: str) -> dict[str, Any]:
    """Return an array in the form that the page reads: its little-endian bytes in base64, by rows."""
    content = np.ascontiguousarray(array, dtype=np.dtype(kind).newbyteorder("<"))
    return {"kind": np.dtype(kind).name, "bytes": b64encode(content.tobytes()).decode("ascii")}


def pack_coarsely(array: Floats) -> dict[str, Any]:
    """Return (N, n) numbers as 16-bit steps between the least and the largest of each column."""
    lower = array.min(axis=0, initial=np.inf) if len(array) else np.zeros(array.shape[1])
    step = (array.max(axis=0, initial=-np.inf) - lower if len(array) else lower) / 65535.0
    whole = np.rint((array - lower) / np.where(step > 0.0, step, 1.0))
    return {**pack(whole, "uint16"), "lower": lower.tolist(), "step": step.tolist()}


def failing_rows(checks: Sequence[Check], result: Result, driven: int) -> Booleans:
    """Return which states each of C conditions that do not hold counts, (N, C); behind the driven ones close places."""
    keys = [("", row) for row in range(driven)]
    keys += [("close_", row) for row in range(len(result.trajectory) - driven)]
    failed = [{finding.key for finding in check.failing} for check in checks if not check.passed]
    fails = np.array([[key in failing for failing in failed] for key in keys], dtype=np.bool_)
    return fails.reshape(len(keys), len(failed))


def page_data(
    result: Result, kept: Indices, *, driven: Result | None = None, checks: Sequence[Check] = ()
) -> dict[str, Any]:
    """Return all that the page's script needs to draw the kept states; behind the driven ones stand close places."""
    trajectory = result.trajectory
    count = len(trajectory if driven is None else driven.trajectory)
    episodes, episode = np.unique(trajectory.episode[kept], return_inverse=True)
    first = closest_state(result if driven is None else driven)
    return {
        "states": _states(result, kept, episode.reshape(-1), count),
        "witnesses": _witnesses(result, kept),
        "episodes": [_episode(result, int(index)) for index in episodes],
        "channels": channel_list(result.setting.spec, result.radii),
        "fans": fans_of(result.setting.spec, result.world_map.robot),
        "rules": rules_of(result.rules),
        "world": world_of(result.world_map),
        "actions": [
            {"name": one_line(action.name), "unit": one_line(action.unit)} for action in result.actions
        ],
        "verdicts": list(VERDICTS),
        "conditions": sum(not check.passed for check in checks),
        "fails": pack(failing_rows(checks, result, count)[kept], "uint8"),
        "connected": trajectory.connected,
        "first": 0 if first is None else int(np.searchsorted(kept, first)) % max(len(kept), 1),
    }


def _states(result: Result, kept: Indices, episode: Indices, driven: int) -> dict[str, Any]:
    trajectory, close = result.trajectory, kept >= driven
    verdict = np.select([result.verdict == name for name in VERDICTS], range(len(VERDICTS)))
    packed = {
        "number": pack(np.where(close, kept - driven, kept), "uint32"),
        "close": pack(close, "uint8"),
        "episode": pack(episode, "uint32"),
        "time": pack(trajectory.time[kept], "float32"),
        "pose": pack(trajectory.poses[kept], "float32"),
        "lower": pack(result.lower[kept], "float32"),
        "upper": pack(result.upper[kept], "float32"),
        "verdict": pack(verdict[kept], "uint8"),
        "danger": pack(result.judgement.danger[kept], "uint8"),
        "sampled": pack(result.judgement.sampled[kept], "uint8"),
        "contested": pack(result.contested.collision[kept], "uint8"),
        "clearance": pack(clearances(result)[kept], "float32"),
        "observation": pack_coarsely(result.observations[kept]),
    }
    if result.rules.delay:
        packed["under_way"] = pack(result.under_way[kept], "float32")
    return packed


def clearances(result: Result) -> Floats:
    """Return the clearance of the footprint at the pose of each state, (N,) metres."""
    from viatool.world import Scenes

    trajectory = result.trajectory
    scenes = Scenes.of(result.world_map, trajectory.scenarios)
    found = scenes.footprint_clearance(trajectory.poses, result.rules.footprint, trajectory.episode)
    return np.asarray(found, dtype=np.float64)


def _witnesses(result: Result, kept: Indices) -> dict[str, Any]:
    found = result.witnesses
    chosen = np.flatnonzero(np.isin(found.state, kept))
    return {
        "row": pack(np.searchsorted(kept, found.state[chosen]), "uint32"),
        "observation": pack(found.observation[chosen], "float32"),
        "action": pack(found.action[chosen], "float32"),
        "seconds": pack(found.seconds[chosen], "float32"),
        "pose": pack(found.pose[chosen], "float32"),
        "clearance": pack(found.clearance[chosen], "float64"),
    }


def _episode(result: Result, index: int) -> dict[str, Any]:
    trajectory, scenario = result.trajectory, result.trajectory.scenarios[index]
    return {
        "number": index,
        "outcome": str(trajectory.outcomes[index]),
        "name": one_line(trajectory.name_of(index))[:LONGEST_NAME],
        "goal": None if scenario is None else list(scenario.goal),
        **({"circles": [], "polygons": []} if scenario is None else shapes(scenario.obstacles)),
    }


def shapes(obstacles: Obstacles) -> dict[str, Any]:
    """Return circles (x, y, radius) and the corners of polygons, rounded to a tenth of a millimetre."""
    return {
        "circles": obstacles.circles.round(4).tolist(),
        "polygons": [polygon.round(4).tolist() for polygon in obstacles.polygons],
    }


def world_of(world_map: WorldMap) -> dict[str, Any]:
    """Return what of a map has corners or a radius: its obstacles and the border of its arena, not its cells."""
    found = shapes(world_map.obstacles)
    return {**found, "polygons": [*found["polygons"], world_map.arena.round(4).tolist()]}


def channel_list(spec: PolicySpecification, radii: Floats) -> list[dict[str, Any]]:
    """Return the channels of an observation, with the column at which the newest reading of each one starts."""
    listed = []
    for channel in spec.observation:
        start = int(spec.inputs.newest(channel.name)[0])
        listed.append(
            {
                "name": one_line(channel.name)[:LONGEST_NAME],
                "unit": one_line(channel.unit),
                "kind": channel.kind,
                "start": start,
                "size": channel.size,
                "eps": radii[start : start + channel.size].tolist(),
            }
        )
    return listed


def fans_of(spec: PolicySpecification, robot: Robot) -> list[dict[str, Any]]:
    """Return where the bins of each LiDAR channel look, and how its readings are encoded; none without a LiDAR."""
    found = []
    for lidar, _ in Quantities.of(spec.observation, robot).lidars:
        if lidar.described:
            right, left = lidar.fan.lidar.wedges()
            encoding = lidar.channel.encoding
            found.append(
                {
                    "start": int(spec.inputs.newest(lidar.channel.name)[0]),
                    "right": right.round(6).tolist(),
                    "left": left.round(6).tolist(),
                    "scale": encoding.scale,
                    "offset": encoding.offset,
                    "reciprocal": encoding.reciprocal,
                }
            )
    return found


def rules_of(rules: Rules) -> dict[str, Any]:
    """Return what the script needs to draw paths and distances."""
    manoeuvre, footprint = rules.manoeuvre, rules.footprint
    if rules.kinematics.state:  # the script draws paths of speeds alone: it shows where robots stand
        manoeuvre = Manoeuvre(0.0)
    return {
        "collision": rules.clearance.collision,
        "danger": rules.clearance.danger,
        "interval": manoeuvre.interval,
        "deceleration": manoeuvre.deceleration,
        "rim": manoeuvre.rim,
        "waits": rules.dead_time.durations,
        "lower": rules.lower.tolist(),
        "upper": rules.upper.tolist(),
        "radius": footprint.radius if footprint.kind == "circle" else 0.0,
        "polygon": footprint.polygon.tolist() if footprint.kind == "polygon" else [],
    }
