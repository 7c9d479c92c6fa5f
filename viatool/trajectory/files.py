"""Trajectory files: npz, which keeps everything, csv, which a spreadsheet opens, and bags, to be read only."""

from __future__ import annotations

import logging
import os
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from viatool.errors import TrajectoryError
from viatool.trajectory.bag import SUFFIXES as BAGS
from viatool.trajectory.bag import is_bag
from viatool.trajectory.columns import MOTION
from viatool.trajectory.recording import BagSettings, load_bag
from viatool.trajectory.scenario_text import read_scenario, write_scenario
from viatool.trajectory.table import load_table, write_table
from viatool.trajectory.trajectory import Trajectory
from viatool.whole_file import whole_file

if TYPE_CHECKING:
    from viatool.policy import PolicySpecification

_log = logging.getLogger(__name__)


def load_trajectory(
    path: str | os.PathLike[str],
    specification: PolicySpecification | None = None,
    bag: BagSettings | None = None,
) -> Trajectory:
    """Read a trajectory from an npz or csv file, or from a ROS 1 or ROS 2 bag.

    Parameters
    ----------
    path : path
        Ends in .npz or .csv; a bag ends in .bag, .mcap or .db3, or is the folder of a ROS 2 bag.
    specification : PolicySpecification, optional
        Names the observation and action columns of a csv; without it they are observation_0, action_0, ...
        A bag cannot be read without it.
    bag : BagSettings, optional
        The goal, and names of topics and frames, for a bag.

    Returns
    -------
    Trajectory
        N states. A file without states gives N = 0.

    Raises
    ------
    TrajectoryError
        If the file is missing, cut off, not of its format, lacks a column or topic or holds a NaN or infinity.
    EmptyEvaluationError
        If a bag holds nothing that can be evaluated.

    Notes
    -----
    The npz arrays are `pose`, `observation`, `action`, `episode`, `time`, `outcome`, `cost`, `people` and `scenario`
    (JSON); only the first two are needed, so the state table of a verification is a trajectory as well. What a robot
    had besides its pose stands in arrays or columns `motion_v` (m/s), `motion_omega` (rad/s), `motion_steering` (rad).
    An npz may hold `steps`, see `Trajectory`.
    """
    path = Path(path)
    if is_bag(path) and path.exists():
        return _named(path, lambda: load_bag(path, specification, bag or BagSettings()))
    if path.is_dir():
        raise TrajectoryError(
            f"trajectory '{path}' is a folder without metadata.yaml and without a {', '.join(BAGS)} file",
            "give the folder of a ROS 2 bag, or a file",
        )
    if not path.is_file():
        raise TrajectoryError(f"trajectory '{path}' is not a file", "check the path")
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise TrajectoryError(
            f"trajectory '{path}' ends in '{path.suffix}', expected {', '.join((*_READERS, *BAGS))}",
            "convert it to npz or csv",
        )
    trajectory = _named(path, lambda: reader(path, specification))
    _log.info("trajectory %s read: %d states of %d episodes", path, len(trajectory), trajectory.episodes)
    twice = trajectory.repeated()
    if not twice:
        return trajectory
    note = f"{twice:,} rows are the same as the one before in their episode, and count again"
    return replace(trajectory, notes=(*trajectory.notes, note))


def _named(path: Path, read: Callable[[], Trajectory]) -> Trajectory:
    """Read, with the path before every complaint about the file."""
    try:
        return read()
    except TrajectoryError as error:
        raise TrajectoryError(f"{path}: {error.message}", error.hint) from error


def write_trajectory(
    path: str | os.PathLike[str], trajectory: Trajectory, specification: PolicySpecification | None = None
) -> None:
    """Write a trajectory to an npz or csv file, whole or not at all.

    Parameters
    ----------
    path : path
        Ends in .npz or .csv.
    trajectory : Trajectory
        N states.
    specification : PolicySpecification, optional
        Names the observation and action columns of a csv.
    """
    path = Path(path)
    if path.suffix.lower() not in _READERS:
        raise TrajectoryError(
            f"trajectory '{path}' ends in '{path.suffix}', expected {' or '.join(_READERS)}",
            "choose one of them",
        )
    with whole_file(path) as draft:
        if path.suffix.lower() == ".csv":
            write_table(draft, trajectory, specification)
        else:
            _write_arrays(draft, trajectory)


def _write_arrays(path: Path, trajectory: Trajectory) -> None:
    motion: dict[str, Any] = {MOTION + name: own for name, own in trajectory.motion.items()}
    if trajectory.steps is not None:
        motion["steps"] = trajectory.steps
    with path.open("wb") as stream:
        np.savez_compressed(
            stream,
            pose=trajectory.poses,
            observation=trajectory.observations,
            action=trajectory.actions,
            episode=trajectory.episode,
            time=trajectory.time,
            outcome=trajectory.outcomes,
            cost=trajectory.costs,
            people=trajectory.people,
            scenario=np.array([write_scenario(scenario) for scenario in trajectory.scenarios], dtype=np.str_),
            **motion,
        )


def _load_arrays(path: Path, specification: PolicySpecification | None) -> Trajectory:
    try:
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as archive:
            motion = {name: archive[name] for name in archive.files if name.startswith(MOTION)}
            arrays = {name: archive[name] for name in archive.files if name in _ARRAYS}
    except (zipfile.BadZipFile, ValueError, OSError, EOFError, AttributeError, TypeError) as error:
        raise TrajectoryError(f"not a readable npz archive ({error})", "write it with numpy.savez") from error
    missing = [name for name in ("pose", "observation") if name not in arrays]
    if missing:
        raise TrajectoryError(
            f"the archive lacks the array '{missing[0]}'", f"give the arrays {', '.join(sorted(_ARRAYS))}"
        )
    states = arrays["pose"].shape[0] if arrays["pose"].ndim else 0
    episode = arrays.get("episode", np.zeros(states, dtype=np.int64))
    episodes = int(episode.max()) + 1 if episode.size and episode.dtype.kind in "iu" else 0
    outcomes = arrays.get("outcome", np.full(episodes, "unknown"))
    scenarios = arrays.get("scenario", np.full(outcomes.shape, ""))
    try:
        return Trajectory(
            poses=arrays["pose"],
            observations=arrays["observation"],
            actions=arrays.get("action", np.zeros((states, 0))),
            episode=episode,
            time=arrays.get("time", _position_in_episode(episode)),
            outcomes=outcomes,
            costs=arrays.get("cost", np.full(outcomes.shape, np.nan)),
            scenarios=tuple(read_scenario(str(text)) for text in scenarios.ravel()),
            clocked="time" in arrays,
            steps=arrays.get("steps"),
            people=arrays.get("people", np.zeros((states, 0, 5))),
            motion={name.removeprefix(MOTION): own for name, own in motion.items()},
        )
    except (ValueError, TypeError) as error:
        raise TrajectoryError(
            f"an array has the wrong type ({error})", "give numbers, and text for the outcome"
        ) from error


def _position_in_episode(episode: np.ndarray) -> np.ndarray:
    """Return a clock that counts the rows, for files that recorded none."""
    return np.arange(episode.shape[0], dtype=np.float64)


_ARRAYS = {
    "pose",
    "observation",
    "action",
    "episode",
    "time",
    "outcome",
    "cost",
    "scenario",
    "people",
    "steps",
}
_READERS = {".npz": _load_arrays, ".csv": load_table}
