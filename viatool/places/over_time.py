"""What holds beyond the next action: for how long the safe cells stay certified, and which ones reach the goal."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Booleans, Indices
from viatool.errors import ConfigurationError
from viatool.loop.closed_loop import ClosedLoop
from viatool.places.blocks import Blocks
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
_HOPEFUL = 0.4
"""Of where a block may be after some interval, the share from which runs arrive that makes it worth halving."""


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
    mesh = Mesh.of(lattice, lookahead.coarser - lookahead.finer)
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
    follower = _Follower(loop, mesh, status, reached | (status == BLOCKED), campaign, tell, until)
    held, arrives = np.zeros(len(mesh), bool), np.zeros(len(mesh), np.int16)
    open_ = first = follower.begin(lookahead.finer)
    for intervals in lookahead.rounds:
        if not len(open_) or until.passed:
            break
        before = time.perf_counter()
        units = follower.follow(open_, intervals, held | (arrives > 0))
        with within(until.moved(_LOOPS)), suppress(TimeUp):  # what was found before holds still
            if lookahead.finer:
                units += follower.halve_hopeful(intervals)
            loops = follower.transitions
            arrives = loops.arrival() if lookahead.arrive else arrives
            held |= arrives > 0
            held = loops.for_ever()
            known = loops.exempt | (arrives > 0 if lookahead.arrive else held)
            open_ = first.select(loops.go_on(intervals, known)[first.first])
        arrived = int((arrives > 0).sum())
        follower.rounds.append(
            Round(intervals, units, int(held.sum()), arrived, time.perf_counter() - before)
        )
    loops, moves = follower.transitions, np.zeros(len(mesh), bool)
    with within(until.moved(_LOOPS)):
        count = loops.intervals(lookahead.steps, held)
        if lookahead.arrive:
            with suppress(TimeUp):
                moves = loops.moving(arrives > 0)
    return LastingCells(mesh, status, reached, count, lookahead, follower.rounds, arrives, moves)


@dataclass(eq=False)
class _Follower:
    """Where cells lead, as far as it is known.

    Parameters
    ----------
    loop, mesh
        The closed loop, and its cells.
    status : ndarray
        (N,) of the next action.
    exempt : ndarray
        (N,) bool, cells that need no proof.
    campaign, tell, until
        As in `look_ahead`.
    """

    loop: ClosedLoop
    mesh: Mesh
    status: NDArray[np.int8]
    exempt: Booleans
    campaign: Campaign
    tell: Progress
    until: Deadline
    rounds: list[Round] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.side = np.ones(len(self.mesh), np.int8)
        self.in_parts = np.zeros(len(self.mesh), bool)
        self.passages = join([])

    @property
    def transitions(self) -> CellTransitions:
        """Return the closed loop over the cells, as far as they were followed."""
        return CellTransitions(self.mesh, self.exempt, self.passages, self.side)

    @cached_property
    def safe(self) -> Booleans:
        """Tell which cells are safe in the next interval, (N,)."""
        return np.asarray((self.status == SETTLED) | (self.status == CERTIFIED))

    def begin(self, finer: int) -> Blocks:
        """Return what is followed first: safe cells or, where they are halved later, all blocks with a free pose."""
        if not finer:
            return Blocks.cells_of(self.mesh, np.flatnonzero(self.safe & ~self.exempt))
        blocks = Blocks.over(self.mesh, 2**finer)
        return blocks.select(~blocks.every(self.exempt) & blocks.every(self.status >= BLOCKED))

    def follow(
        self, blocks: Blocks, intervals: int, known: Booleans, stage: str = "followed", parts: int = 1
    ) -> int:
        """Follow blocks for some intervals, or to cells that are known; return how many there was time for."""
        certified = blocks.every(self.safe | (self.status == BLOCKED))
        work = FollowWork(self.loop, blocks, certified, intervals, known | self.exempt, stage, parts)
        kept = self.campaign.within(f"follow-{digest_of(work.describe())[:16]}")
        found = kept.carry_out(work, self.tell, until=self.until.moved(-_LOOPS / 2.0))
        done = blocks.first[: found.units]
        self._forget(done)
        self.side[done] = blocks.side[: found.units]
        self.passages = join([self.passages, found.part])
        return found.units

    def halve_hopeful(self, intervals: int) -> int:
        """Halve and follow blocks that lead nearly into cells that arrive, until there are none; return how many.

        Of those that are single cells the halves are parts, all of which have to arrive.
        """
        arrived, followed = self.transitions.spread(self.exempt), 0
        while not self.until.passed:
            hopeful = self.transitions.hopeful(arrived, _HOPEFUL)
            single = (hopeful.side == 1) & ~self.in_parts[hopeful.first]
            blocks, cells = hopeful.select(hopeful.side > 1), hopeful.select(single)
            if not len(blocks) + len(cells):
                break
            self._forget(blocks.first)
            halves = blocks.halved()
            halves = halves.select(~halves.every(self.exempt))
            for some, parts in ((halves, 1), (cells, 2)):
                if len(some):
                    followed += self.follow(some, intervals, arrived, "halved and followed", parts)
            self.in_parts[cells.first] = True
            arrived = self.transitions.spread(arrived)
        return followed

    def _forget(self, first: Indices) -> None:
        """Forget where blocks lead."""
        named = np.zeros(len(self.mesh), bool)
        named[first] = True
        self.passages = self.passages.select(~named[self.passages.owner])


@dataclass(frozen=True, eq=False)
class FollowWork(EvenWork[tuple[Blocks, Booleans], Passages]):
    """The blocks that one round follows.

    Parameters
    ----------
    loop : ClosedLoop
        The closed loop.
    blocks : Blocks
        C that are followed.
    certified : ndarray
        (C,) bool, which keep their clearance in the next interval.
    intervals : int
        For how many.
    known : ndarray
        (N,) bool, in which cells nothing needs to be followed further.
    done : str
        What happens to the cells, in a word.
    parts : int
        Into how many parts each side of a block is cut along x, y and theta.
    """

    loop: ClosedLoop
    blocks: Blocks
    certified: Booleans
    intervals: int
    known: Booleans
    done: str = "followed"
    parts: int = 1
    piece = 8192

    @property
    def stage(self) -> str:
        """Return what the round does."""
        return f"cells {self.done} for {self.intervals}"

    def __len__(self) -> int:
        """Return C."""
        return len(self.blocks)

    @property
    def function(self) -> Callable[[tuple[Blocks, Booleans]], Passages]:
        """Return what follows some blocks."""
        known = CellSet(self.blocks.mesh, self.known)
        return partial(_follow, self.loop, self.intervals, known, (*(self.parts,) * 3, 1, 1))

    def content(self, span: Span) -> tuple[Blocks, Booleans]:
        """Return some blocks, and which of them are certified."""
        some = slice(span.first, span.last)
        return self.blocks.select(some), self.certified[some]

    def describe(self) -> dict[str, str | int]:
        """Return everything that the passages depend on beside the search, in whose folder they are kept."""
        known = np.packbits(self.known)
        cells = self.blocks.first, self.blocks.side, self.certified
        return {"cells": digest_of((*cells, known)), "intervals": self.intervals, "parts": self.parts}

    def to_arrays(self, part: Passages) -> dict[str, NDArray[Any]]:
        """Return passages as arrays."""
        return part.to_arrays()

    def from_arrays(self, arrays: Mapping[str, NDArray[Any]]) -> Passages:
        """Return passages."""
        return Passages.from_arrays(arrays)

    def join(self, parts: Sequence[Passages]) -> Passages:
        """Return all passages as one."""
        return join(parts)


def _follow(
    loop: ClosedLoop,
    intervals: int,
    known: CellSet,
    parts: tuple[int, int, int, int, int],
    some: tuple[Blocks, Booleans],
) -> Passages:
    blocks, certified = some
    return follow(
        loop, blocks.mesh, blocks.first, intervals=intervals, parts=parts, known=known, side=blocks.side,
        certified=certified,
    )  # fmt: skip


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
