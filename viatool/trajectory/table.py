"""Trajectories as csv: one row per state, with named columns."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from viatool.channels.inputs import numbered
from viatool.errors import TrajectoryError
from viatool.trajectory.columns import (
    MOTION,
    action_columns,
    memory_columns,
    observation_columns,
)
from viatool.trajectory.rows import Rows
from viatool.trajectory.scenario_text import read_scenario, write_scenario
from viatool.trajectory.trajectory import Trajectory

if TYPE_CHECKING:
    from viatool.policy import PolicySpecification
    from viatool.world import Scenario

Cells = NDArray[np.object_]

_POSE = ("x", "y", "theta")
_BASE = ("episode", "time", *_POSE)
_EPISODE = ("outcome", "cost", "scenario")
_PERSON = ("x", "y", "vx", "vy", "radius")
_ROWS = 8192  # that are text at the same time


def write_table(path: Path, trajectory: Trajectory, specification: PolicySpecification | None) -> None:
    """Write a csv whose floats read back exactly; the scenario stands in the first row of its episode."""
    observed, commanded = _names(specification, trajectory.observations.shape[1], trajectory.actions.shape[1])
    scenarios = [write_scenario(scenario) for scenario in trajectory.scenarios]
    motion = [MOTION + name for name in trajectory.motion]
    own = np.stack([np.zeros(len(trajectory)), *trajectory.motion.values()], axis=1)[:, 1:]
    persons = trajectory.people.reshape(len(trajectory), int(np.prod(trajectory.people.shape[1:])))
    columns = (
        trajectory.time[:, None],
        trajectory.poses,
        trajectory.observations,
        trajectory.actions,
        persons,
        own,
    )
    with path.open("w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream)
        walking = _person_columns(trajectory.people.shape[1])
        table.writerow([*_BASE, *observed, *commanded, *walking, *motion, *_EPISODE])
        for start in range(0, len(trajectory), _ROWS):
            some = slice(start, start + _ROWS)
            numbers = np.hstack([column[some] for column in columns]).tolist()
            for episode, row in zip(trajectory.episode[some].tolist(), numbers, strict=True):
                cost = trajectory.costs[episode]
                ending = ["" if np.isnan(cost) else float(cost), scenarios[episode]]
                table.writerow([episode, *row, trajectory.outcomes[episode], *ending])
                scenarios[episode] = ""


def load_table(path: Path, specification: PolicySpecification | None) -> Trajectory:
    """Read a csv as `write_table` writes it, some rows at a time; actions, outcome, cost and scenario may be absent."""
    with _opened(path) as lines:
        header = _header(lines)
        observed, commanded = _find_columns(header, specification)
        _require(header, (*_BASE, *observed))
        motion = [name for name in header if name.startswith(MOTION) and name not in (*observed, *commanded)]
        groups = {
            "time": ["time"],
            "pose": _POSE,
            "observation": observed,
            "action": commanded,
            "people": _find_people(header),
            "motion": motion,
        }
        table = _Table(header, groups)
        while batch := list(islice(lines, _ROWS)):
            table.add(batch)
    return table.trajectory()


class _Table:
    """Gathers the rows of a table as numbers, and what the first row of an episode tells of it.

    Parameters
    ----------
    header : list of str
        Names of the columns.
    groups : mapping
        The columns of numbers by what they are: time, pose, observation, action, motion.
    """

    def __init__(self, header: list[str], groups: Mapping[str, Sequence[str]]) -> None:
        self.header, self.groups = header, groups
        self.column = {name: index for index, name in enumerate(header)}
        self.rows = 0
        self.numbers = {group: Rows(len(names)) for group, names in groups.items()}
        self.episode = Rows(1, np.int64)
        self.labels: dict[str, int] = {}
        self.outcomes: list[str] = []
        self.costs: list[float] = []
        self.scenarios: list[Scenario | None] = []

    def add(self, lines: list[list[str]]) -> None:
        """Add some rows."""
        for number, line in enumerate(lines, start=self.rows + 1):
            if len(line) != len(self.header):
                raise TrajectoryError(
                    f"row {number} has {len(line)} cells, the header {len(self.header)}",
                    "check that the file is complete",
                )
        cells = np.array(lines, dtype=object)
        for group, names in self.groups.items():
            own = cells[:, [self.column[name] for name in names]]
            self.numbers[group].add(_numbers(own, names, self.rows))
        episode = self._number_episodes(cells)
        self.episode.add(episode)
        self._compare_outcomes(cells, episode)
        self.rows += len(lines)

    def _number_episodes(self, cells: Cells) -> NDArray[np.int64]:
        """Return the index of each row's episode, in the order in which they appear in the file."""
        labels = cells[:, self.column["episode"]].tolist()
        episode = np.zeros(len(labels), dtype=np.int64)
        for row, label in enumerate(labels):
            if label not in self.labels:
                self._begin_episode(label, cells[row], self.rows + row + 1)
            episode[row] = self.labels[label]
        return episode

    def _begin_episode(self, label: str, line: Cells, number: int) -> None:
        """Note what the first row of an episode tells."""
        if label == "":
            raise TrajectoryError("a row has no episode", "number the episode in every row")
        self.labels[label] = len(self.labels)
        told = {name: str(line[self.column[name]]) for name in _EPISODE if name in self.column}
        self.outcomes.append(told.get("outcome") or "unknown")
        self.costs.append(_number(told.get("cost") or "nan", "cost", number))
        self.scenarios.append(read_scenario(told.get("scenario", "")))

    def _compare_outcomes(self, cells: Cells, episode: NDArray[np.int64]) -> None:
        """Refuse an episode that tells two outcomes."""
        if "outcome" not in self.column:
            return
        told, known = cells[:, self.column["outcome"]], np.array(self.outcomes, dtype=object)[episode]
        told = np.where(told == "", "unknown", told)
        differs = np.flatnonzero(told != known)
        if differs.size:
            row = int(differs[0])
            raise TrajectoryError(
                f"row {self.rows + row + 1} gives the outcome '{told[row]}', the first row of its episode "
                f"'{known[row]}'",
                "write the same outcome in all rows of an episode",
            )

    def trajectory(self) -> Trajectory:
        """Return all rows."""
        numbers = {group: rows.table() for group, rows in self.numbers.items()}
        return Trajectory(
            poses=numbers["pose"],
            observations=numbers["observation"],
            actions=numbers["action"] if self.groups["action"] else np.zeros((self.rows, 0)),
            episode=self.episode.table()[:, 0],
            time=numbers["time"][:, 0],
            outcomes=np.array(self.outcomes, dtype=np.str_),
            costs=np.array(self.costs),
            scenarios=tuple(self.scenarios),
            people=numbers["people"].reshape(
                self.rows, len(self.groups["people"]) // len(_PERSON), len(_PERSON)
            ),
            motion={
                name.removeprefix(MOTION): own
                for name, own in zip(self.groups["motion"], numbers["motion"].T, strict=True)
            },
        )


def _names(
    specification: PolicySpecification | None, observation_size: int, action_size: int
) -> tuple[list[str], list[str]]:
    """Return the observation and action columns to write."""
    if specification is None:
        observed = [f"observation_{index}" for index in range(observation_size)]
        return observed, [f"action_{index}" for index in range(action_size)]
    observed, commanded = observation_columns(specification), action_columns(specification)
    if len(observed) != observation_size or action_size not in (0, len(commanded)):
        raise TrajectoryError(
            f"the trajectory has {observation_size} observation and {action_size} action columns, "
            f"the specification {len(observed)} and {len(commanded)}",
            "write it with the specification of the policy that drove it",
        )
    return observed, commanded[:action_size]


def _find_columns(
    header: Sequence[str], specification: PolicySpecification | None
) -> tuple[list[str], list[str]]:
    """Return the observation and action columns of a file: named by the specification, or numbered."""
    plain = [name for name in header if name.startswith("observation_")]
    actions = [name for name in header if name.startswith("action_")]
    if specification is None or plain:
        if not plain:
            raise TrajectoryError(
                "the table has no column observation_0",
                "pass the policy's specification, which names the columns",
            )
        return _numbered_columns("observation", plain), _numbered_columns("action", actions)
    commanded = action_columns(specification)
    present = [name for name in commanded if name in header]
    observed, remembered = observation_columns(specification), memory_columns(specification)
    if not {*remembered} & {*header}:  # then it is computed from what is sensed
        observed = observed[: len(observed) - len(remembered)]
    return observed, commanded if len(present) == len(commanded) else []


def _person_columns(count: int) -> list[str]:
    """Return the columns of so many people: person_0_x, person_0_y, ..."""
    return [f"person_{number}_{name}" for number in range(count) for name in _PERSON]


def _find_people(header: Sequence[str]) -> list[str]:
    """Return the columns of people in a file, refusing a person of whom one is missing."""
    told = {name.split("_")[1] for name in header if re.fullmatch(r"person_\d+_[a-z]+", name)}
    wanted = _person_columns(len(told))
    _require(header, wanted)
    return wanted


def _numbered_columns(name: str, found: Sequence[str]) -> list[str]:
    """Return name_0 ... in order, also when the file shuffles them."""
    return [f"{name}_0"] if len(found) == 1 else numbered(name, len(found)) if found else []


@contextmanager
def _opened(path: Path) -> Iterator[Iterator[list[str]]]:
    """Give the lines of a file that are not empty, refusing what is not a table."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            yield (line for line in csv.reader(stream) if line)
    except (UnicodeDecodeError, csv.Error) as error:
        raise TrajectoryError(f"not a csv table ({error})", "write it as UTF-8 text with commas") from error


def _header(lines: Iterator[list[str]]) -> list[str]:
    """Return the names of the columns, from the first line."""
    line = next(lines, None)
    if line is None:
        raise TrajectoryError("the table is empty, expected a header", "record at least the column names")
    header = [name.strip() for name in line]
    if len(set(header)) < len(header):
        twice = next(name for name in header if header.count(name) > 1)
        raise TrajectoryError(f"the table has the column '{twice}' twice", "name every column once")
    return header


def _require(header: Sequence[str], names: Sequence[str]) -> None:
    missing = [name for name in names if name not in header]
    if missing:
        more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        raise TrajectoryError(
            f"the table lacks the column '{missing[0]}'{more}",
            "name the columns episode, time, x, y, theta and as the policy's specification does",
        )


def _numbers(cells: Cells, names: Sequence[str], before: int) -> NDArray[np.float64]:
    """Return cells (N, C) as floats, naming the first cell that is not one; `before` rows stand above."""
    try:
        return cells.astype(np.float64)
    except ValueError:
        for row, line in enumerate(cells.tolist(), start=before + 1):
            for name, cell in zip(names, line, strict=True):
                _number(cell, name, row)
        raise


def _number(cell: str, name: str, row: int) -> float:
    try:
        return float(cell)
    except ValueError as error:
        raise TrajectoryError(
            f"row {row}, column '{name}' holds '{cell}', expected a number",
            "leave out rows that were not observed",
        ) from error
