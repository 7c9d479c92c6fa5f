"""What holds beyond the next action: for how long the safe cells stay certified, and which ones reach the goal."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Booleans, Indices
from viatool.errors import ConfigurationError
from viatool.loop.closed_loop import ClosedLoop
from viatool.places.findings import BLOCKED, CERTIFIED, SETTLED, CellFindings
from viatool.places.forever import CellTransitions
from viatool.places.lasting import LastingCells, Lookahead, Round
from viatool.places.mesh import CellSet, Mesh
from viatool.places.passages import Passages, follow, join
from viatool.places.tree import Lattice
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

_POSES_AT_ONCE = 1 << 17
_MOST_CELLS = 60_000_000
_GOAL_ROUNDING = 1e-9
_LOOPS = 0.1
"""Of a budget in seconds: half of it before the deadline, no cell is followed further, so that what was found can be
put together; so much after it, that ends as well, with what it has."""


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
            "leave out the section obstacles, or --steps, --forever and --arrive",
        )
    if rules.varies:
        raise ConfigurationError(
            "with motors and timing of an error model it is not known for how long cells stay certified",
            "leave out the sections actuation and timing, or --steps, --forever and --arrive",
        )
    if rules.delay:
        raise ConfigurationError(
            "with a delay it is not known for how long cells stay certified",
            "leave out --delay, or --steps, --forever and --arrive",
        )
    if rules.kinematics.state:
        raise ConfigurationError(
            f"how long cells stay certified is not followed for a {rules.kinematics.description}",
            "leave out --steps, --forever and --arrive",
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
    """Find out for how long the safe cells of a certification stay certified, and which ones reach the goal.

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
    One that starts in a cell that arrives is within the goal at the end of one of as many intervals as the cell says.
    One that starts in a cell of those that move does not stand still before it is in the goal, or in a cell that
    arrives.
    """
    mesh = check_lookahead(lookahead, loop.rules, lattice)
    status = mesh.statuses(lattice, findings)
    status[_without_free_pose(loop, mesh) & (status > BLOCKED)] = BLOCKED  # parts of larger leaves
    reached = _within(mesh, goal, lookahead.goal_radius) & (status != BLOCKED)
    exempt = reached | (status == BLOCKED)
    safe = np.flatnonzero(((status == SETTLED) | (status == CERTIFIED)) & ~reached)
    rounds, open_ = [], safe
    passages: list[Passages] = []
    held, arrives = np.zeros(len(mesh), bool), np.zeros(len(mesh), np.int16)
    for intervals in lookahead.rounds:
        if not len(open_) or until.passed:
            break
        before = time.perf_counter()
        done = exempt | (arrives > 0 if lookahead.arrive else held)
        work = FollowWork(loop, mesh, open_, intervals, done)
        kept = campaign.within(f"follow-{digest_of(work.describe())[:16]}")
        found = kept.carry_out(work, tell, until=until.moved(-_LOOPS / 2.0))
        followed = np.zeros(len(mesh), bool)
        followed[open_[: found.units]] = True
        passages = [*(part.select(~followed[part.owner]) for part in passages), found.part]
        loops = CellTransitions(mesh, exempt, join(passages))
        with within(until.moved(_LOOPS)), suppress(TimeUp):  # what was found before holds still
            arrives = loops.arrival() if lookahead.arrive else arrives
            held |= arrives > 0
            held = loops.for_ever()
            open_ = safe[loops.go_on(intervals, exempt | (arrives > 0 if lookahead.arrive else held))[safe]]
        rounds.append(
            Round(
                intervals,
                found.units,
                int(held.sum()),
                int((arrives > 0).sum()),
                time.perf_counter() - before,
            )
        )
    loops, moves = CellTransitions(mesh, exempt, join(passages)), np.zeros(len(mesh), bool)
    with within(until.moved(_LOOPS)):
        count = loops.intervals(lookahead.steps, held)
        if lookahead.arrive:
            with suppress(TimeUp):
                moves = loops.moving(arrives > 0)
    return LastingCells(mesh, status, reached, count, lookahead, rounds, arrives, moves)


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
