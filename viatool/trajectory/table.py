"""Trajectories as csv: one row per state, with named columns."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from viatool.errors import TrajectoryError
from viatool.trajectory.columns import action_columns, numbered, observation_columns
from viatool.trajectory.scenario_text import read_scenario, write_scenario
from viatool.trajectory.trajectory import Trajectory

if TYPE_CHECKING:
    from viatool.policy import PolicySpecification
    from viatool.world import Scenario

Cells = NDArray[np.object_]

_BASE = ("episode", "time", "x", "y", "theta")
_EPISODE = ("outcome", "cost", "scenario")


def write_table(path: Path, trajectory: Trajectory, specification: PolicySpecification | None) -> None:
    """Write a csv whose floats read back exactly; the scenario stands in the first row of its episode."""
    observed, commanded = _names(specification, trajectory.observations.shape[1], trajectory.actions.shape[1])
    scenarios = [write_scenario(scenario) for scenario in trajectory.scenarios]
    numbers = np.column_stack(
        [trajectory.time, trajectory.poses, trajectory.observations, trajectory.actions]
    )
    with path.open("w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream)
        table.writerow([*_BASE, *observed, *commanded, *_EPISODE])
        for episode, row in zip(trajectory.episode.tolist(), numbers.tolist(), strict=True):
            cost = trajectory.costs[episode]
            ending = [trajectory.outcomes[episode], "" if np.isnan(cost) else float(cost), scenarios[episode]]
            table.writerow([episode, *row, *ending])
            scenarios[episode] = ""


def load_table(path: Path, specification: PolicySpecification | None) -> Trajectory:
    """Read a csv as `write_table` writes it; actions, outcome, cost and scenario may be absent."""
    header, rows = _read_rows(path)
    observed, commanded = _find_columns(header, specification)
    _require(header, (*_BASE, *observed))
    column = {name: index for index, name in enumerate(header)}
    cells = np.array(rows, dtype=object).reshape(len(rows), len(header))
    time, x, y, theta = (_numbers(cells[:, [column[name]]], [name])[:, 0] for name in _BASE[1:])
    first, episode = _number_episodes(cells[:, column["episode"]])
    return Trajectory(
        poses=np.column_stack([x, y, theta]),
        observations=_numbers(cells[:, [column[name] for name in observed]], observed),
        actions=_numbers(cells[:, [column[name] for name in commanded]], commanded),
        episode=episode,
        time=time,
        outcomes=_outcomes(cells, column, episode, first),
        costs=_costs(cells, column, first),
        scenarios=_scenarios(cells, column, first),
    )


def _number_episodes(labels: Cells) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return (E,) the first row of each episode and (N,) its index, in the order of appearance."""
    names, first, episode = np.unique(labels.astype(np.str_), return_index=True, return_inverse=True)
    if "" in names:
        raise TrajectoryError("a row has no episode", "number the episode in every row")
    order = np.argsort(first)
    return first[order], np.argsort(order)[episode.reshape(-1)]


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
    return observation_columns(specification), commanded if len(present) == len(commanded) else []


def _numbered_columns(name: str, found: Sequence[str]) -> list[str]:
    """Return name_0 ... in order, also when the file shuffles them."""
    return [f"{name}_0"] if len(found) == 1 else numbered(name, len(found)) if found else []


def _read_rows(path: Path) -> tuple[list[str], list[list[str]]]:
    """Return the header and the rows, refusing files that are no rectangular table."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as stream:
            lines = [line for line in csv.reader(stream) if line]
    except (UnicodeDecodeError, csv.Error) as error:
        raise TrajectoryError(f"not a csv table ({error})", "write it as UTF-8 text with commas") from error
    if not lines:
        raise TrajectoryError("the table is empty, expected a header", "record at least the column names")
    header = [name.strip() for name in lines[0]]
    if len(set(header)) < len(header):
        twice = next(name for name in header if header.count(name) > 1)
        raise TrajectoryError(f"the table has the column '{twice}' twice", "name every column once")
    for number, line in enumerate(lines[1:], start=1):
        if len(line) != len(header):
            raise TrajectoryError(
                f"row {number} has {len(line)} cells, the header {len(header)}",
                "check that the file is complete",
            )
    return header, lines[1:]


def _require(header: Sequence[str], names: Sequence[str]) -> None:
    missing = [name for name in names if name not in header]
    if missing:
        more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
        raise TrajectoryError(
            f"the table lacks the column '{missing[0]}'{more}",
            "name the columns episode, time, x, y, theta and as the policy's specification does",
        )


def _numbers(cells: Cells, names: Sequence[str]) -> NDArray[np.float64]:
    """Return cells (N, C) as floats, naming the first cell that is none."""
    try:
        return cells.astype(np.float64)
    except ValueError:
        for row, line in enumerate(cells.tolist(), start=1):
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


def _outcomes(
    cells: Cells, column: dict[str, int], episode: NDArray[np.int64], first: NDArray[np.int64]
) -> NDArray[np.str_]:
    """Return (E,) outcomes, refusing an episode that tells two."""
    if "outcome" not in column:
        return np.full(first.shape, "unknown")
    told = np.where(cells[:, column["outcome"]] == "", "unknown", cells[:, column["outcome"]])
    outcomes = told[first]
    differs = np.flatnonzero(told != outcomes[episode])
    if differs.size:
        row = int(differs[0])
        raise TrajectoryError(
            f"row {row + 1} tells the outcome '{told[row]}', the first row of its episode "
            f"'{outcomes[episode[row]]}'",
            "write one outcome in all rows of an episode",
        )
    return np.asarray(outcomes, dtype=np.str_)


def _costs(cells: Cells, column: dict[str, int], first: NDArray[np.int64]) -> NDArray[np.float64]:
    if "cost" not in column:
        return np.full(first.shape, np.nan)
    told = cells[first, column["cost"]]
    return _numbers(np.where(told == "", "nan", told)[:, None], ["cost"])[:, 0]


def _scenarios(cells: Cells, column: dict[str, int], first: NDArray[np.int64]) -> tuple[Scenario | None, ...]:
    if "scenario" not in column:
        return (None,) * len(first)
    return tuple(read_scenario(str(text)) for text in cells[first, column["scenario"]])
