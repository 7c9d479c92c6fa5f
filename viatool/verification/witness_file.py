"""Counterexamples as a file that stands by itself, and their replay through the deployed program."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from viatool.arrays import Booleans, Floats
from viatool.errors import ConfigurationError, InputError
from viatool.loop.horizon import Crashes
from viatool.policy import Policy
from viatool.policy.command_map import CommandMap
from viatool.safety.counterexamples import Witnesses
from viatool.safety.judged_states import JudgedStates
from viatool.safety.nearest import describe_nearest
from viatool.safety.scene_poses import Movers, ScenePoses
from viatool.setting.explanation import explain, with_scans
from viatool.setting.rules import Rules
from viatool.setting.scanned import changed_scans
from viatool.setting.setting import Setting
from viatool.setting.wishes import Wishes
from viatool.trajectory import Trajectory, read_scenario, write_scenario
from viatool.verification.result import Result
from viatool.verification.rules_document import read_rules, rules_document
from viatool.verification.run_entries import is_late_again, motion_begun, read_arrival, run_before
from viatool.world import Capsules, Scenario, Scenes, WorldMap
from viatool.world.capsules import NOWHERE

SCHEMA_VERSION = 1

_USUAL_KINDS = ("linear", "angular")
"""What files name that do not say it."""


@dataclass(frozen=True, eq=False)
class WitnessFile:
    """W recorded counterexamples.

    Parameters
    ----------
    policy, world_map : dict
        ``path`` and ``sha256`` of the policy and of the map.
    rules : Rules
        What they violate.
    columns : tuple of int
        Which actions of the policy make up the command.
    kinds : tuple of str
        What these are.
    entries : tuple of dict
        One for each counterexample, as in the file.
    poses, observations : ndarray
        (W, 3) and (W, n): where the robot stood, and what it observed.
    under_way : ndarray
        (W, commands, A) what was on its way to the motors then, the oldest first.
    scenarios : tuple
        W scenarios, None for the bare map.
    velocity : tuple of ndarray, optional
        (W, 3) ends of the velocity that the robot was measured to have, NaN where it was not.
    begun : ndarray
        (W, 2, S) ends of the state of the motion then.
    """

    policy: Mapping[str, str]
    world_map: Mapping[str, str]
    rules: Rules
    columns: tuple[int, ...]
    kinds: tuple[str, ...]
    entries: tuple[Mapping[str, Any], ...]
    poses: Floats
    under_way: Floats
    observations: Floats
    scenarios: tuple[Scenario | None, ...]
    begun: Floats
    velocity: tuple[Floats, Floats] | None = None

    def __len__(self) -> int:
        """Return the number of counterexamples."""
        return len(self.entries)

    @property
    def late(self) -> tuple[int, ...]:
        """Return which entries are runs that do not arrive."""
        return tuple(row for row, entry in enumerate(self.entries) if "late" in entry)

    def judged(self, world_map: WorldMap) -> JudgedStates:
        """Return the states of the counterexamples within a map, under the rules of the file."""
        placed = ScenePoses.of(world_map, self.scenarios, self.poses, np.arange(len(self)))
        around = placed.among(_moved(self.entries))
        return JudgedStates(self.rules, around, self.under_way, self.velocity, self.begun)


@dataclass(frozen=True, eq=False)
class Replay:
    """What happened when W counterexamples were run again.

    Parameters
    ----------
    actions : ndarray
        (W, A) commands that onnxruntime computed, as the robot carries them out.
    seconds, clearance : ndarray
        (W,) instant of the closest approach, and the metres that are left then.
    poses : ndarray
        (W, 3) where the robot is then.
    violates : ndarray
        (W,) bool: the clearance is not more than the collision distance; of a run that was late, it is late again.
    nearest : tuple of str
        W descriptions of the obstacle.
    """

    actions: Floats
    seconds: Floats
    clearance: Floats
    poses: Floats
    violates: Booleans
    nearest: tuple[str, ...]


class StatesExamined(Protocol):
    """Recorded states, and what was asked of them."""

    @property
    def trajectory(self) -> Trajectory:
        """The N states."""

    @property
    def setting(self) -> Setting:
        """What was asked."""

    @property
    def world_map(self) -> WorldMap:
        """Where."""

    @property
    def rules(self) -> Rules:
        """What had to hold."""

    @property
    def under_way(self) -> Floats:
        """Commands before each state, (N, W, A)."""

    @property
    def begun(self) -> Floats:
        """Ends of the state of the motion, (N, 2, S)."""

    @property
    def velocity(self) -> Floats | None:
        """Ends of the velocity that was measured, (N, 2, 3), as far as that counts."""


def witness_document(result: Result) -> dict[str, Any]:
    """Return the counterexamples of a result as plain data."""
    entries = state_entries(result, result.witnesses)
    if result.horizon is not None:
        crashes = result.horizon.crashes
        entries += state_entries(result, crashes.last, crashes)
    if result.close is not None:
        entries += [{**entry, "close": True} for entry in state_entries(result.close, result.close.witnesses)]
    return compose_witnesses(
        result.policy_path,
        result.policy_sha256,
        result.world_map,
        result.setting.command_map,
        result.rules,
        entries,
    )


def state_entries(
    result: StatesExamined, found: Witnesses, crashes: Crashes | None = None
) -> list[dict[str, Any]]:
    """Return counterexamples as plain data; those at the end of runs with the intervals before."""
    trajectory = result.trajectory
    entries = []
    for row, state in enumerate(found.state.tolist()):
        scenario = trajectory.scenarios[trajectory.episode[state]]
        about = {
            "state": state,
            "episode": int(trajectory.episode[state]),
            "time": float(trajectory.time[state]),
            "pose": found.start[row].tolist(),
            **commands_before(result.under_way[state]),
            **({"motion": result.begun[state].tolist()} if result.rules.kinematics.state else {}),
        }
        if result.velocity is not None:
            about["velocity"] = _plain(result.velocity[state])
        if crashes is not None:
            step = int(crashes.step[row])
            about["time"] += step * result.rules.interval
            about["pose"] = crashes.poses[row, step].tolist()
            about |= motion_begun(crashes, row)
            about["before"] = run_before(crashes, row)
        if crashes is None:
            about |= _errors(result, found, row, state)
        violation = found.violation(row, result.world_map, scenario, result.rules.footprint)
        entries.append(about | violation | {"scenario": json.loads(write_scenario(scenario) or "null")})
    return entries


def _errors(result: StatesExamined, found: Witnesses, row: int, state: int) -> dict[str, Any]:
    """Return which errors make a counterexample of what was recorded, where they are not within eps alone."""
    setting, recorded, told = result.setting, result.trajectory.poses[state], dict[str, Any]()
    drifted = None
    scenario, first = result.trajectory.scenarios[result.trajectory.episode[state]], np.zeros(1, np.int64)
    if setting.pose_radii.any():
        believed = found.believed[row]
        told |= {"recorded_pose": recorded.tolist(), "believed_pose": believed.tolist()}
        if scenario is not None:
            scenes, goals = Scenes.of(result.world_map, [scenario]), setting.goals([scenario])
            drifted = setting.drifted(scenes, first, recorded[None], believed[None], goals)[0]
    scans = setting.reading_errors.scans
    if scans:
        flaws = found.start[row, None], found.turn[row, None], found.passed[row, None]
        moved = changed_scans(setting, [scenario], first, *flaws)[0]
        drifted = moved if drifted is None else drifted + moved
    observation = result.trajectory.observations[state]
    errors = explain(setting.reading_errors, observation, found.observation[row], drifted) or {}
    if scans:
        errors = with_scans(errors, setting.reading_errors, found.turn[row], found.passed[row])
    return told | ({"errors": errors} if errors else {})


def compose_witnesses(
    policy_path: Path,
    policy_sha256: str,
    world_map: WorldMap,
    command_map: CommandMap,
    rules: Rules,
    entries: Sequence[Mapping[str, Any]],
) -> dict[str, Any]:
    """Return a witness file as plain data, around its entries."""
    return {
        "schema_version": SCHEMA_VERSION,
        "policy": {"path": str(policy_path), "sha256": policy_sha256},
        "map": {"path": str(world_map.path), "sha256": world_map.sha256},
        "columns": list(command_map.columns),
        "kinds": list(command_map.kinds),
        "rules": rules_document(rules),
        "witnesses": list(entries),
    }


def load_witnesses(path: str | os.PathLike[str]) -> WitnessFile:
    """Read a witness file.

    Raises
    ------
    ConfigurationError
        If the file is missing or is not a witness file.
    """
    path = Path(path)
    try:
        return _read(json.loads(path.read_text(encoding="utf-8")))
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not a text file"
        raise ConfigurationError(f"cannot read the witnesses '{path}': {reason}", "check the path") from error
    except (ValueError, KeyError, TypeError, IndexError, AttributeError, StopIteration, InputError) as error:
        raise ConfigurationError(
            f"'{path}' is not a witness file ({error!r})",
            "write one with viatool verify ... --output witnesses:PATH",
        ) from error


def replay(policy: Policy, world_map: WorldMap, file: WitnessFile) -> Replay:
    """Run counterexamples again: each alone through onnxruntime, along its exact path.

    Parameters
    ----------
    policy : Policy
        n inputs; its digest should be the one in the file.
    world_map : WorldMap
        The map; the clearances, footprint and limits of the file count.
    file : WitnessFile
        W counterexamples.

    Returns
    -------
    Replay
        Of W counterexamples.
    """
    count, size = len(file), file.observations.shape[1]
    if count and size != policy.input_size:
        raise ConfigurationError(
            f"the witnesses have {size} observation entries, the policy takes {policy.input_size}",
            "replay them with the policy that they were found for",
        )
    setting = Setting.of(policy, world_map, 0.0, _wishes(file.rules), ())
    command_map = setting.command_map
    recorded = (file.columns, file.kinds)
    if recorded != (command_map.columns, command_map.kinds):
        raise ConfigurationError(
            f"the witnesses name the actions {list(file.columns)} ({', '.join(file.kinds)}), the specification of the "
            f"policy {list(command_map.columns)} ({', '.join(command_map.kinds)})",
            "replay them with the policy and the --spec that they were found for",
        )
    driven = setting.driven(policy)
    commands = [driven.run(row[None])[0] for row in file.observations]
    axes = len(file.rules.kinematics.axes)
    actions = file.rules.clip(np.array(commands, dtype=np.float64).reshape(count, axes))
    clearance, seconds, poses = (
        found[:, 0] for found in file.judged(world_map).closest_approach(actions[:, None])
    )
    nearest = tuple(
        describe_nearest(world_map, scenario, pose, file.rules.footprint)
        if "moved" not in entry["closest"]
        else str(entry["closest"]["obstacle"])
        for entry, scenario, pose in zip(file.entries, file.scenarios, poses, strict=True)
    )
    violates = clearance <= file.rules.clearance.collision
    for row in file.late:
        violates[row] = is_late_again(file.entries[row], driven, file.rules)
    return Replay(actions, seconds, clearance, poses, violates, nearest)


def _wishes(rules: Rules) -> Wishes:
    """Return the rules of a file as what counts, whatever policy and map say."""
    return Wishes(
        criterion=rules.criterion,
        clearance=rules.clearance.collision,
        danger=rules.clearance.danger,
        interval=rules.interval,
        footprint=rules.footprint,
        delay=rules.delay,
        deceleration=rules.deceleration,
        prefer={"": "map"},
    )


def _read(document: Mapping[str, Any]) -> WitnessFile:
    entries = tuple(document["witnesses"])
    scenarios = tuple(
        read_scenario("" if e["scenario"] is None else json.dumps(e["scenario"])) for e in entries
    )
    rules = read_rules(document["rules"])
    for entry in entries:
        if "late" in entry:
            read_arrival(entry["late"])
    return WitnessFile(
        policy={name: str(document["policy"][name]) for name in ("path", "sha256")},
        world_map={name: str(document["map"][name]) for name in ("path", "sha256")},
        rules=rules,
        columns=tuple(int(column) for column in document["columns"]),
        kinds=tuple(map(str, document.get("kinds", _USUAL_KINDS))),
        entries=entries,
        poses=_stacked([entry["pose"] for entry in entries], 3),
        under_way=_under_way(entries, rules),
        observations=_stacked([entry["observation"] for entry in entries]),
        scenarios=scenarios,
        velocity=_velocity(entries),
        begun=_begun(entries, rules),
    )


def _velocity(entries: Sequence[Mapping[str, Any]]) -> tuple[Floats, Floats] | None:
    """Return the ends (W, 3) of measured velocities; None where no entry has one."""
    if not any("velocity" in entry for entry in entries):
        return None
    rows = np.array([entry["velocity"] for entry in entries], dtype=np.float64).reshape(len(entries), 2, 3)
    return rows[:, 0], rows[:, 1]


def _plain(numbers: Floats) -> list[Any]:
    """Return an array as lists, with null for what is not known."""
    return [
        _plain(one) if one.ndim else (None if np.isnan(one) else float(one))
        for one in map(np.asarray, numbers)
    ]


def _moved(entries: Sequence[Mapping[str, Any]]) -> list[Movers]:
    """Return the points that have moved in counterexamples, each as fast as it did; none where nothing has."""
    rows = [entry["closest"].get("moved") for entry in entries]
    if not any(rows):
        return []
    place, speed = np.full(len(rows), NOWHERE), np.zeros(len(rows))
    for row, moved in enumerate(rows):
        if moved is not None:
            place[row] = complex(*moved["from"])
            speed[row] = float(np.hypot(*moved["velocity"]))
    if not (np.isfinite(place) & np.isfinite(speed)).all():
        raise ValueError("a point that moves is not finite")
    label = " or ".join(dict.fromkeys(moved["what"] for moved in rows if moved is not None))
    points = Capsules(place[None], place[None], np.zeros((1, len(rows))), speed[None], (label,))
    return [Movers(points, np.arange(len(rows)))]


def commands_before(under_way: Floats) -> dict[str, Any]:
    """Return what an entry says of the commands on their way, (W, 2): the newest one, and all if there are several."""
    if not len(under_way):
        return {"previous": None}
    every = {"under_way": _plain(under_way)} if len(under_way) > 1 else {}
    return {"previous": _plain(under_way[-1]), **every}


def _under_way(entries: Sequence[Mapping[str, Any]], rules: Rules) -> Floats:
    """Return the commands on their way, (W, commands, A); without `under_way` all are the command before."""
    count, machine = rules.commands_before, rules.machine
    rows = [entry["under_way"] if "under_way" in entry else [entry["previous"]] * count for entry in entries]
    found = np.array(rows, dtype=np.float64).reshape(len(rows), count, len(rules.kinematics.axes))
    acting = count if machine is None else machine.timing.commands
    if not np.isfinite(found[:, count - acting :]).all():
        raise ValueError("a command on its way is not finite")
    return found


def _begun(entries: Sequence[Mapping[str, Any]], rules: Rules) -> Floats:
    """Return the ends of the state of the motion, (W, 2, S)."""
    size = len(rules.kinematics.state)
    rows = [entry["motion"] if size else [[], []] for entry in entries]
    found = np.array(rows, dtype=np.float64).reshape(len(rows), 2, size)
    if not np.isfinite(found).all():
        raise ValueError("a state of the motion is not finite")
    return found


def _stacked(rows: list[list[float]], size: int | None = None) -> Floats:
    """Return rows of one length as (W, size), (0, 0) without any."""
    size = size if size is not None else len(rows[0]) if rows else 0
    array = np.array(rows, dtype=np.float64).reshape(len(rows), size)
    if not np.isfinite(array).all():
        raise ValueError("a number is not finite")
    return array
