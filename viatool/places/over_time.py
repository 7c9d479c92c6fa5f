"""What holds beyond the next action: for how many intervals the safe cells stay certified, and which ones for ever."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Booleans, Floats, Indices
from viatool.errors import ConfigurationError
from viatool.loop.closed_loop import ClosedLoop
from viatool.places.findings import BLOCKED, CERTIFIED, SETTLED, CellFindings
from viatool.places.forever import FOR_EVER, CellTransitions
from viatool.places.mesh import CellSet, Mesh
from viatool.places.passages import Passages, follow, join
from viatool.places.tree import AXES, Lattice
from viatool.schedule import (
    NEVER,
    Campaign,
    Deadline,
    EvenWork,
    Progress,
    Span,
    TimeUp,
    digest_of,
    ignore,
    within,
)
from viatool.setting.rules import Rules
from viatool.simulate.task import NavigationTask

_POSES_AT_ONCE = 1 << 17
_MOST_CELLS = 60_000_000
_GOAL_ROUNDING = 1e-9
_LOOPS = 0.1
"""Of a budget in seconds: half of it before the deadline, no cell is followed further, so that what was found can be
put together; so much after it, that ends as well, with what it has."""


@dataclass(frozen=True)
class Lookahead:
    """What is asked of the time after the next action.

    Parameters
    ----------
    steps : int
        K, up to which number of control intervals cells are counted; 0 asks for none.
    for_ever : bool
        Whether to look for the set that is left only towards the goal.
    intervals : int
        For how many intervals a cell is followed as it is before it has to lie in other cells.
    goal_radius : float
        Metres within which the goal is reached, and the run over.
    coarser : int
        How often less than the smallest cells those are halved of which the sets consist: a cell is safe if all the
        leaves in it are, so that what is undecided may be cut further than where the loop leads.
    """

    steps: int = 0
    for_ever: bool = False
    intervals: int = 4
    goal_radius: float = NavigationTask.goal_radius
    coarser: int = 0

    def __post_init__(self) -> None:
        if not 0 <= self.steps < FOR_EVER:
            raise ConfigurationError(
                f"{self.steps} steps cannot be counted", f"give a number from 1 to {FOR_EVER - 1}"
            )
        if not 1 <= self.intervals <= 64:
            raise ConfigurationError(
                f"cells cannot be followed for {self.intervals} intervals", "give a number from 1 to 64"
            )
        if not 0 <= self.coarser <= 3:
            raise ConfigurationError(
                f"cells cannot be {self.coarser} times coarser than the smallest", "give a number from 0 to 3"
            )
        if not 0.0 <= self.goal_radius < math.inf:
            raise ConfigurationError(
                f"the goal's radius is {self.goal_radius} m", "give a length of 0 m or more"
            )

    @property
    def asked(self) -> bool:
        """Tell whether anything is asked."""
        return self.for_ever or self.steps > 0

    @property
    def rounds(self) -> tuple[int, ...]:
        """Return for how many intervals open cells are followed, round by round: 1, 2, 4, ..."""
        doubling = (2**power for power in range(self.intervals.bit_length()))
        return (*(number for number in doubling if number < self.intervals), self.intervals)


@dataclass(frozen=True)
class Round:
    """How cells were followed, and what it gave.

    Parameters
    ----------
    intervals : int
        For how long.
    followed, held : int
        Cells that were followed, and cells that were then known to hold for ever.
    seconds : float
        Processor time of this process, or wall time if others did the work.
    """

    intervals: int
    followed: int
    held: int
    seconds: float


@dataclass(frozen=True, eq=False)
class LastingCells:
    """What holds over time, by cells of one size.

    Parameters
    ----------
    mesh : Mesh
        N cells.
    status : ndarray
        (N,) of the next action; -1 where nothing was examined.
    goal : ndarray
        (N,) bool: all free poses have reached the goal.
    intervals : ndarray
        (N,) int16: for how many intervals a cell is certified, `FOR_EVER` if it is left only towards the goal.
    lookahead : Lookahead
        What was asked.
    rounds : sequence of Round
        How it was found.
    """

    mesh: Mesh
    status: NDArray[np.int8]
    goal: Booleans
    intervals: NDArray[np.int16]
    lookahead: Lookahead
    rounds: Sequence[Round]

    @cached_property
    def free(self) -> Booleans:
        """Return the cells with a free pose from which the goal is yet to be reached, (N,)."""
        return np.asarray((self.status > BLOCKED) & ~self.goal)

    @property
    def for_ever(self) -> Booleans:
        """Return the cells that the loop leaves only towards the goal, (N,)."""
        return np.asarray(self.free & (self.intervals == FOR_EVER))

    def by_steps(self) -> list[tuple[int, int]]:
        """Return k and the number of cells that stay certified for k intervals, for k from 1 on."""
        counted = self.intervals[self.free]
        return [(k, int((counted >= k).sum())) for k in range(1, self.lookahead.steps + 1)]

    def share_by_place(self) -> Floats:
        """Return the share of headings and commands of each place that holds for ever, (X, Y); nan if none is free."""
        shape = tuple(self.mesh.count)
        free, held = (part.reshape(shape).sum(axis=(2, 3, 4)) for part in (self.free, self.for_ever))
        return np.asarray(np.where(free > 0, held / np.maximum(free, 1), np.nan))

    @property
    def unit(self) -> float:
        """Return the volume of a cell in m^2 rad, times its share of the commands' range."""
        return float(np.prod(self.mesh.size[:3]) / np.prod(self.mesh.count[3:]))

    def to_json(self) -> dict[str, Any]:
        """Return it as plain data."""
        unit = self.unit
        total = int(self.free.sum())
        held = int(self.for_ever.sum())

        def share(part: int) -> dict[str, int | float | None]:
            return {"part": part, "total": total, "rate": part / total if total else None}

        return {
            "goal_radius": self.lookahead.goal_radius,
            "lookahead": self.lookahead.intervals,
            "cell": dict(zip(AXES, self.mesh.size.tolist(), strict=True)),
            "forever": share(held) if self.lookahead.for_ever else None,
            "volume": {
                "free": total * unit,
                "forever": held * unit if self.lookahead.for_ever else None,
                "goal": int(self.goal.sum()) * unit,
            },
            "steps": [{"steps": k, **share(part)} for k, part in self.by_steps()],
            "rounds": [
                {"intervals": r.intervals, "followed": r.followed, "forever": r.held, "seconds": r.seconds}
                for r in self.rounds
            ],
        }

    def cell_table(self) -> dict[str, NDArray[Any]]:
        """Return the cells that are certified for at least one interval, for other programs; -1 is for ever."""
        chosen = np.flatnonzero(self.free & (self.intervals > 0))
        lower, upper = self.mesh.bounds(chosen)
        steps = self.intervals[chosen].astype(np.int32)
        return {
            "steps_lower": lower,
            "steps_upper": upper,
            "steps": np.where(steps == FOR_EVER, -1, steps),
        }


def check_lookahead(lookahead: Lookahead, rules: Rules, lattice: Lattice, *, moving: bool = False) -> Mesh:
    """Return the cells that are to be followed.

    Raises
    ------
    ConfigurationError
        If there are too many cells, the robot acts with a delay, or something is `moving`.
    """
    if moving:
        raise ConfigurationError(
            "for how long cells stay certified is not known among things that move: they may be elsewhere by then",
            "leave out the section obstacles, or --steps and --forever",
        )
    if rules.varies:
        raise ConfigurationError(
            "with motors and timing of an error model it is not known for how long cells stay certified",
            "leave out the sections actuation and timing, or --steps and --forever",
        )
    if rules.delay:
        raise ConfigurationError(
            "with a delay it is not known for how long cells stay certified",
            "leave out --delay, --steps and --forever",
        )
    if rules.kinematics.state:
        raise ConfigurationError(
            f"how long cells stay certified is not followed for a {rules.kinematics.description}",
            "leave out --steps and --forever",
        )
    mesh = Mesh.of(lattice, lookahead.coarser)
    if len(mesh) > _MOST_CELLS:
        raise ConfigurationError(
            f"{len(mesh):,} smallest cells are too many to look ahead", "make the smallest cells larger"
        )
    if not mesh.countable:
        raise ConfigurationError(
            f"{int(mesh.count.max()):,} smallest cells side by side are too many to look ahead",
            "make the smallest cells larger",
        )
    return mesh


def look_ahead(
    loop: ClosedLoop,
    lattice: Lattice,
    findings: CellFindings,
    goal: tuple[float, float],
    lookahead: Lookahead,
    campaign: Campaign,
    tell: Progress = ignore,
    *,
    until: Deadline = NEVER,
) -> LastingCells:
    """Find out for how long the safe cells of a certification stay certified.

    Parameters
    ----------
    loop, lattice, findings
        The certification.
    goal : tuple of float
        Where the run ends, within the radius of `lookahead`.
    lookahead : Lookahead
        What is asked.
    campaign : Campaign
        Who does the work, and where it is kept.
    tell : Progress
        Told the stage, the cells done and the cells of the stage.
    until : Deadline
        After which no cell is followed further; what was not followed is not claimed.

    Returns
    -------
    LastingCells
        The same for every scheduler, if there was time enough.

    Raises
    ------
    ConfigurationError
        If there are too many cells, or the robot acts with a delay.

    Notes
    -----
    Sound: yes. A run that starts at a free pose of a cell that holds for ever keeps its clearance in every interval
    until it reaches the goal, if it does, whatever the sensors err within eps; for a cell with k intervals, in these.
    """
    mesh = check_lookahead(lookahead, loop.rules, lattice)
    status = mesh.statuses(lattice, findings)
    status[_without_free_pose(loop, mesh) & (status > BLOCKED)] = BLOCKED  # parts of larger leaves
    reached = _within(mesh, goal, lookahead.goal_radius) & (status != BLOCKED)
    exempt = reached | (status == BLOCKED)
    safe = np.flatnonzero(((status == SETTLED) | (status == CERTIFIED)) & ~reached)
    rounds, open_ = [], safe
    passages: list[Passages] = []
    held = np.zeros(len(mesh), bool)
    for intervals in lookahead.rounds:
        if not len(open_) or until.passed:
            break
        before = time.perf_counter()
        work = FollowWork(loop, mesh, open_, intervals, held | exempt)
        kept = campaign.within(f"follow-{digest_of(work.describe())[:16]}")
        found = kept.carry_out(work, tell, until=until.moved(-_LOOPS / 2.0))
        followed = np.zeros(len(mesh), bool)
        followed[open_[: found.units]] = True
        passages = [*(part.select(~followed[part.owner]) for part in passages), found.part]
        with within(until.moved(_LOOPS)), suppress(TimeUp):  # what held before holds still
            held = CellTransitions(mesh, exempt, join(passages)).for_ever()
        rounds.append(Round(intervals, found.units, int(held.sum()), time.perf_counter() - before))
        open_ = safe[~held[safe]]
    with within(until.moved(_LOOPS)):
        count = CellTransitions(mesh, exempt, join(passages)).intervals(lookahead.steps, held)
    return LastingCells(mesh, status, reached, count, lookahead, rounds)


@dataclass(frozen=True, eq=False)
class FollowWork(EvenWork[Indices, Passages]):
    """The cells that one round follows.

    Parameters
    ----------
    loop, mesh
        The closed loop, and its cells.
    cells : ndarray
        (C,) numbers of those that are followed.
    intervals : int
        For how many.
    known : ndarray
        (N,) bool, in which cells nothing needs to be followed further.
    """

    loop: ClosedLoop
    mesh: Mesh
    cells: Indices
    intervals: int
    known: Booleans
    piece = 8192

    @property
    def stage(self) -> str:
        """Return what the round does."""
        return f"cells followed for {self.intervals}"

    def __len__(self) -> int:
        """Return C."""
        return len(self.cells)

    @property
    def function(self) -> Callable[[Indices], Passages]:
        """Return what follows some cells."""
        known = CellSet(self.mesh, self.known)
        return partial(follow, self.loop, self.mesh, intervals=self.intervals, known=known)

    def content(self, span: Span) -> Indices:
        """Return the numbers of some cells."""
        return self.cells[span.first : span.last]

    def describe(self) -> dict[str, str | int]:
        """Return everything that the passages depend on beside the search, in whose folder they are kept."""
        known = np.packbits(self.known)
        return {"cells": digest_of((self.cells, known)), "intervals": self.intervals}

    def to_arrays(self, part: Passages) -> dict[str, NDArray[Any]]:
        """Return passages as arrays."""
        return part.to_arrays()

    def from_arrays(self, arrays: Mapping[str, NDArray[Any]]) -> Passages:
        """Return passages."""
        return Passages.from_arrays(arrays)

    def join(self, parts: Sequence[Passages]) -> Passages:
        """Return all passages as one."""
        return join(parts)


def _without_free_pose(loop: ClosedLoop, mesh: Mesh) -> Booleans:
    """Tell which cells hold no pose that keeps the collision distance, (N,)."""
    slices = int(np.prod(mesh.count[3:]))
    blocked = np.zeros(len(mesh) // slices, bool)
    for first in range(0, len(blocked), _POSES_AT_ONCE):
        numbers = np.arange(first, min(first + _POSES_AT_ONCE, len(blocked)))
        blocked[numbers] = loop.blocked(mesh.boxes(*mesh.bounds(numbers * slices)).poses)
    return np.repeat(blocked, slices)


def _within(mesh: Mesh, goal: tuple[float, float], radius: float) -> Booleans:
    """Tell of which cells every place is nearer to the goal than a radius, (N,)."""
    far = []
    for axis in (0, 1):
        index = np.arange(mesh.count[axis])
        ends = (mesh.origin[axis] + (index + more) * mesh.size[axis] for more in (0, 1))
        far.append(np.maximum(*(np.abs(end - goal[axis]) for end in ends)))
    inside = np.hypot(far[0][:, None], far[1]) < radius - _GOAL_ROUNDING
    return np.broadcast_to(inside[:, :, None, None, None], tuple(mesh.count)).ravel()
