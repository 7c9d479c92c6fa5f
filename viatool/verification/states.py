"""The states to be examined, cut into blocks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from viatool.arrays import Floats, Indices
from viatool.schedule import Span
from viatool.setting.begun import states_begun
from viatool.setting.received import commands_observed, commands_under_way, velocities_measured
from viatool.setting.setting import Setting
from viatool.trajectory import Trajectory
from viatool.world import Scenario

_MOST_STATES = 1024
_MOST_FOLLOWED = 128  # over a horizon, where each takes some ten milliseconds
_MOST_FLOATS = 2**22


@dataclass(frozen=True, eq=False)
class States:
    """B consecutive states with all that is known of them.

    Parameters
    ----------
    first : int
        Index of the first one among all states of the run.
    poses, observations : ndarray
        (B, 3) and (B, n).
    episode : ndarray
        (B,) index of each state's entry in `scenarios`.
    scenarios : tuple
        What the episodes add to the map, or None.
    previous : ndarray or None
        (B, 2) commands of the step before, NaN where they are not known; None where they are of no consequence.
    under_way : ndarray
        (B, W, 2) commands on their way to the motors, the oldest first; NaN where they are not known.
    rows : ndarray
        (B,) how many states of its episode come before each.
    steps : ndarray
        (B,) control intervals since the beginning of its episode, where frames that reach farther back are known to
        repeat the first reading; else NaN.
    people : ndarray
        (B, P, 5) people around each state, see `Trajectory`.
    velocity : ndarray or None
        (B, 2, 3) ends of the velocity that was measured, NaN where it was not; None where it is of no consequence.
    begun : ndarray
        (B, 2, S) ends of the state of the motion, NaN where it is not known.
    radii : ndarray or None
        (B, n) how far the readings of each state may be off; None where the setting says it of all.
    most : int
        States of a block at most.
    """

    first: int
    poses: Floats
    observations: Floats
    episode: Indices
    scenarios: tuple[Scenario | None, ...]
    previous: Floats | None
    under_way: Floats
    rows: Indices
    steps: Floats
    people: Floats
    begun: Floats
    velocity: Floats | None = None
    radii: Floats | None = None
    most: int = _MOST_STATES

    @classmethod
    def of(
        cls,
        trajectory: Trajectory,
        under_way: Floats,
        previous: Floats | None = None,
        velocity: tuple[Floats, Floats] | None = None,
        begun: Floats | None = None,
    ) -> States:
        """Return the states of a whole trajectory; arrays are shared. Blocks are small if each is followed."""
        return cls(
            0,
            trajectory.poses,
            trajectory.observations,
            trajectory.episode,
            trajectory.scenarios,
            previous,
            under_way,
            _rows_of_episodes(trajectory),
            _steps_of_episodes(trajectory),
            trajectory.people,
            np.zeros((len(trajectory), 2, 0)) if begun is None else begun,
            None if velocity is None else np.stack(velocity, axis=1),
            None,
            _MOST_STATES if previous is None else _MOST_FOLLOWED,
        )

    def select(self, rows: Indices) -> States:
        """Return some of the states, by their rows; counterexamples count from the first of them."""
        picked: dict[str, Any] = {
            one.name: value[rows]
            for one in fields(self)
            if isinstance(value := getattr(self, one.name), np.ndarray)
        }
        return replace(self, first=0, **picked)

    def __len__(self) -> int:
        """Return B."""
        return len(self.poses)

    @property
    def block_size(self) -> int:
        """Return how many states are examined together.

        A block is the unit of determinism. The last digit of a batched result may depend on what else is in the
        batch, so batches never reach beyond a block, and blocks are cut at the same places whoever works on them.
        """
        return max(1, min(self.most, _MOST_FLOATS // int(self.observations.shape[1])))

    @property
    def block_count(self) -> int:
        """Return the number of blocks, the last of which may be smaller."""
        return -(-len(self) // self.block_size)

    def blocks(self, span: Span) -> States:
        """Return the states of some blocks, counted from the first of these states, with their scenarios alone."""
        rows = slice(span.first * self.block_size, span.last * self.block_size)
        present, episode = np.unique(self.episode[rows], return_inverse=True)
        return States(
            self.first + rows.start,
            self.poses[rows],
            self.observations[rows],
            episode.reshape(-1),
            tuple(self.scenarios[index] for index in present.tolist()),
            None if self.previous is None else self.previous[rows],
            self.under_way[rows],
            self.rows[rows],
            self.steps[rows],
            self.people[rows],
            self.begun[rows],
            None if self.velocity is None else self.velocity[rows],
            None if self.radii is None else self.radii[rows],
            self.most,
        )

    @property
    def measured(self) -> tuple[Floats, Floats] | None:
        """Return the ends (B, 3) of the velocity that was measured."""
        return None if self.velocity is None else (self.velocity[:, 0], self.velocity[:, 1])

    def each_block(self) -> Iterator[States]:
        """Yield the blocks one by one."""
        for index in range(self.block_count):
            yield self.blocks(Span(index, index + 1))


def states_of(setting: Setting, trajectory: Trajectory, *, followed: bool = False) -> States:
    """Return the states of a trajectory with all that a setting needs to know of them, in small blocks if followed."""
    previous = commands_observed(setting, trajectory) if followed else None
    under_way, seen = commands_under_way(setting, trajectory), trajectory.observations
    velocity, begun = velocities_measured(setting, seen), states_begun(setting, seen, trajectory.motion)
    return States.of(trajectory, under_way, previous, velocity, begun)


def _steps_of_episodes(trajectory: Trajectory) -> Floats:
    """Return how many control intervals after the beginning of its episode each state was, (N,); NaN if unknown."""
    steps = trajectory.steps
    return np.full(len(trajectory), np.nan) if steps is None else steps.astype(np.float64)


def _rows_of_episodes(trajectory: Trajectory) -> Indices:
    """Return how many states of its episode come before each, (N,); none before a pose that was picked."""
    rows, episode = np.arange(len(trajectory)), trajectory.episode
    begins = np.ones(len(rows), dtype=bool)
    if trajectory.connected:
        begins[1:] = episode[1:] != episode[:-1]
    return np.asarray(rows - np.maximum.accumulate(np.where(begins, rows, 0)))
