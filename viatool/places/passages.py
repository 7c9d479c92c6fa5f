"""Where cells lead: the cells that the closed loop may be in after one control interval, after two, and so on.

Every look at the set of cells costs a rounding outward to whole cells. So a cell is followed for several intervals as
it is, a linear form of its own pose, and it is enough that it lies within the set after one of them, if it kept its
clearance until then.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Booleans, Floats, Indices
from viatool.loop.closed_loop import ClosedLoop
from viatool.loop.successor import LoopStep, fold, select, states_of, step
from viatool.places.blocks import Blocks
from viatool.places.mesh import CellSet, Mesh, Ranges
from viatool.schedule import check_time
from viatool.sets.forms import Forms

_BRANCHES = 32
"""Ways that a part may have gone, by what was chosen in each interval, to be followed still further."""
_WIDEST = 0.5
"""A set that is wider than this share of the cells, along x, y or the headings, has been lost."""
STILL = 0.01
"""A robot stands still in an interval in which it is told to drive no faster than so many m/s, and to turn no faster
than so many rad/s."""
_SYMBOLS = 12
"""Of a set that is followed: one of each side of its cell, those of the last commands, and what rests weigh."""


@dataclass(frozen=True, eq=False)
class Passages:
    """What became of P parts of cells.

    Parameters
    ----------
    owner : ndarray
        (P,) the cell, or the first one of a block; its parts are together all of it, and all that may be chosen there.
    ranges : sequence of Ranges
        M, one for each interval: where the part is after it.
    kept : ndarray
        (P,) int, for how many intervals every free pose of the part keeps its clearance; ranges hold up to there.
    moved : ndarray
        (P,) int, in how many of these, from the first on, no run stands still.
    """

    owner: Indices
    ranges: Sequence[Ranges]
    kept: NDArray[np.int16]
    moved: NDArray[np.int16]

    def __len__(self) -> int:
        """Return the number of parts."""
        return len(self.owner)

    @property
    def intervals(self) -> int:
        """Return M."""
        return len(self.ranges)

    def select(self, which: Indices | Booleans) -> Passages:
        """Return some of the parts."""
        ranges = [each.select(which) for each in self.ranges]
        return Passages(self.owner[which], ranges, self.kept[which], self.moved[which])

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Return the arrays by name; ranges are stacked, (M, P, 5)."""
        ends = {name: [getattr(each, name) for each in self.ranges] for name in ("first", "last")}
        none = np.zeros((0, len(self), 5), np.int16)
        stacked = {name: np.stack(part) if part else none for name, part in ends.items()}
        return {"owner": self.owner, "kept": self.kept, "moved": self.moved, **stacked}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> Passages:
        """Return what `to_arrays` gave."""
        ranges = [Ranges(*ends) for ends in zip(arrays["first"], arrays["last"], strict=True)]
        return cls(arrays["owner"], ranges, arrays["kept"], arrays["moved"])


def follow(
    loop: ClosedLoop,
    mesh: Mesh,
    cells: Indices,
    *,
    intervals: int,
    parts: tuple[int, int, int, int, int] = (1, 1, 1, 1, 1),
    known: CellSet | None = None,
    side: NDArray[np.int8] | None = None,
    certified: Booleans | None = None,
) -> Passages:
    """Follow the closed loop from cells.

    Parameters
    ----------
    loop : ClosedLoop
        The closed loop.
    mesh : Mesh
        The cells.
    cells : ndarray
        (C,) numbers of cells.
    intervals : int
        M, for how many control intervals at most.
    parts : tuple
        Into how many parts each side of a cell is cut.
    known : CellSet, optional
        A set in which no cell needs to be followed further.
    side : ndarray, optional
        (C,) int8, how many cells along x, y and theta are followed as one from each of these; by default it alone.
    certified : ndarray, optional
        (C,) bool, which are certified or uncontested: the next interval keeps its clearance. By default all are.

    Returns
    -------
    Passages
        Of all parts of all cells.

    Notes
    -----
    Sound: yes. From every free pose of a part, with every previous command of it and every observation that the
    sensors may give, the loop keeps its clearance for `kept` intervals and is then in the ranges.
    """
    blocks = Blocks.cells_of(mesh, cells) if side is None else Blocks(mesh, cells, side)
    proved = np.ones(len(cells), bool) if certified is None else certified
    lower, upper = blocks.bounds()
    lower, upper = _cut(lower, upper, np.array(parts))
    each = int(np.prod(parts))
    found, proved = _Followed.of(np.repeat(cells, each)), np.repeat(proved, each)
    start = mesh.boxes(lower, upper)
    states, ends = states_of(start), (lower[:, :3], upper[:, :3])
    going = np.arange(len(found.owner))
    for _ in range(intervals):
        check_time()
        after = step(loop, states, jumps=0)
        holds = proved[after.origin]
        rest = np.flatnonzero(~holds)
        holds[rest] = loop.holds(after.start.select(rest), after.lower[rest], after.upper[rest])
        reached = after.bounds(*ends)
        there = mesh.ranges(*reached)
        going = found.branched(going[after.origin])
        found.lead(going, there, holds, _moves(after))
        open_ = holds if known is None else holds & ~known.covers(there)
        open_ &= found.few(going) & _narrow(mesh, *reached)
        going = going[open_]
        states, proved = _shortened(after, open_), np.zeros(len(going), bool)
        ends = reached[0][open_, :3], reached[1][open_, :3]
        if not len(going):
            break
    return Passages(found.owner, found.ranges, found.kept, found.moved)


class _Followed:
    """Parts that are being followed; a part of which one of several commands may be sent goes on as several.

    Parameters
    ----------
    owner, root : ndarray
        (P,) the cell of each part, and the number of the part of that cell with which it began.
    """

    def __init__(self, owner: Indices, root: Indices) -> None:
        self.owner, self.root = owner, root
        self.ranges: list[Ranges] = []
        self.kept, self.moved = np.zeros((2, len(owner)), np.int16)

    @classmethod
    def of(cls, owner: Indices) -> _Followed:
        """Begin with one part for each row."""
        return cls(owner, np.arange(len(owner)))

    def branched(self, rows: Indices) -> Indices:
        """Give every occurrence of a part a row of its own, with what it has behind it; return the rows, (C,)."""
        again = np.ones(len(rows), bool)
        again[np.unique(rows, return_index=True)[1]] = False
        of = rows[again]
        rows = rows.copy()
        rows[again] = len(self.owner) + np.arange(len(of))
        self.owner, self.root, self.kept, self.moved = (
            np.concatenate([part, part[of]]) for part in (self.owner, self.root, self.kept, self.moved)
        )
        self.ranges = [
            Ranges(np.concatenate([one.first, one.first[of]]), np.concatenate([one.last, one.last[of]]))
            for one in self.ranges
        ]
        return rows

    def lead(self, rows: Indices, there: Ranges, holds: Booleans, moves: Booleans) -> None:
        """Note where some parts are after one more interval, which keep their clearance in it, and which all move."""
        self.ranges.append(_scattered(there, rows, len(self.owner)))
        self.kept[rows[holds]] += 1
        self.moved[rows[moves & (self.moved[rows] == len(self.ranges) - 1)]] += 1

    def few(self, rows: Indices) -> Booleans:
        """Tell which parts are not among too many of one beginning to be followed further."""
        return np.asarray(np.bincount(self.root)[self.root[rows]] <= _BRANCHES)


def join(passages: Sequence[Passages]) -> Passages:
    """Return all passages as one; ranges beyond `kept` say nothing."""
    ranges = []
    for index in range(max((each.intervals for each in passages), default=0)):
        known = [each.ranges[index] if index < each.intervals else _nowhere(len(each)) for each in passages]
        ranges.append(
            Ranges(
                np.concatenate([each.first for each in known]), np.concatenate([each.last for each in known])
            )
        )
    none = Passages(np.zeros(0, np.int64), [], *np.zeros((2, 0), np.int16))
    every = [none, *passages]
    owner, kept, moved = (
        np.concatenate([getattr(each, name) for each in every]) for name in ("owner", "kept", "moved")
    )
    return Passages(owner, ranges, kept, moved)


def _cut(lower: Floats, upper: Floats, parts: Indices) -> tuple[Floats, Floats]:
    """Cut boxes (C, 5) into parts that meet without gaps, those of a box side by side."""
    offsets = np.indices(tuple(parts)).reshape(len(parts), -1).T  # (K, 5)
    size = (upper - lower)[:, None] / parts
    first = lower[:, None] + offsets * size
    last = np.where(offsets + 1 == parts, upper[:, None], lower[:, None] + (offsets + 1) * size)
    return first.reshape(-1, len(parts)), last.reshape(-1, len(parts))


def _moves(after: LoopStep) -> Booleans:
    """Tell which pieces stand still in no run: one number of the command is surely large, (P,)."""
    return np.asarray((np.maximum(after.lower, -after.upper) > STILL).any(axis=1))


def _narrow(mesh: Mesh, lower: Floats, upper: Floats) -> Booleans:
    """Tell which sets between two ends (P, 3 + A) are worth following, (P,)."""
    return np.asarray(((upper - lower)[:, :3] < _WIDEST * (mesh.size * mesh.count)[:3]).all(axis=1))


def _shortened(found: LoopStep, which: Booleans) -> Forms:
    """Return the states after a step from which it goes on, with few symbols."""
    return fold(select(found.states, which), _SYMBOLS)


def _scattered(ranges: Ranges, rows: Indices, count: int) -> Ranges:
    """Put ranges into rows of `count`; the others say nothing."""
    whole = _nowhere(count)
    whole.first[rows], whole.last[rows] = ranges.first, ranges.last
    return whole


def _nowhere(count: int) -> Ranges:
    return Ranges(np.zeros((count, 5), np.int16), np.zeros((count, 5), np.int16))
