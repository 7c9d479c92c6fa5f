"""For how long cells stay certified, for ever or until they arrive: fixed points of where cells lead.

Let a cell's parts lead to the ranges ``R_1 .. R_j`` after one to j intervals, for which they keep their clearance. With
F the cells that need no proof (their free poses have reached the goal, or they have none), a cell belongs to

    S_k      if each of its parts keeps its clearance for k intervals, or has an ``R_i`` within ``S_(k-i)`` and F,
    S_for_ever, the largest set S of cells each of whose parts has an ``R_i`` within S and F,
    A_k      if each of its parts has an ``R_i`` within ``A_(k-i)`` and F, where ``A_0`` is F,
    M, the largest set of cells each of whose parts has an ``R_i`` within M, all ``A_k`` and F, and stands still in no
             interval up to there.

The first says that the loop stays certified for k intervals unless it reaches the goal before. The second is found by
removing, from all safe cells, those that do not fulfil the condition, until none is left to remove: no run leaves
what remains except by reaching the goal, and each of its intervals keeps its clearance, by induction.

The third grows from the goal. After i intervals a run is at a free pose of ``R_i``: within the goal, as all free poses
of F are, or in a cell of ``A_(k-i)``. So by induction every run from ``A_k`` is within the goal at the end of one of
its first k intervals, unless it was so before. ``A_k`` is part of the second set. M says of what else holds that its
runs go on moving, for ever or up to the goal or cells that arrive.

Several cells may be followed as one block. It is in one of these sets with all of its cells, or with none of them but
those that need no proof.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Booleans, Indices
from viatool.places.blocks import Blocks
from viatool.places.mesh import CellSet, Mesh
from viatool.places.passages import Passages
from viatool.schedule import check_time, time_is_up

FOR_EVER = np.iinfo(np.int16).max
"""Intervals of a cell that is left only towards the goal."""


@dataclass(frozen=True, eq=False)
class CellTransitions:
    """The closed loop over the cells of a mesh.

    Parameters
    ----------
    mesh : Mesh
        N cells.
    exempt : ndarray
        (N,) bool: cells whose free poses have all reached the goal, and cells without any.
    passages : Passages
        Where the others lead; nothing is claimed of a cell without parts.
    side : ndarray, optional
        (N,) int8, how long the sides of the block are that begins with each cell; by default each cell is one.
    """

    mesh: Mesh
    exempt: Booleans
    passages: Passages
    side: NDArray[np.int8] | None = None

    def blocks(self, first: Indices) -> Blocks:
        """Return the blocks that begin with cells, (B,)."""
        return (
            Blocks.cells_of(self.mesh, first)
            if self.side is None
            else Blocks(self.mesh, first, self.side[first])
        )

    def for_ever(self) -> Booleans:
        """Return the greatest set that is left only towards the goal, without the exempt cells, (N,)."""
        return self._greatest(self.passages.kept, self.exempt) & ~self.exempt

    def moving(self, arriving: Booleans) -> Booleans:
        """Return the greatest set in which no run stands still until it leads to the goal, or to cells that arrive.

        Parameters
        ----------
        arriving : ndarray
            (N,) bool, which cells arrive.

        Returns
        -------
        ndarray
            (N,) bool, without the arriving and the exempt cells.
        """
        done = self.exempt | arriving
        return self._greatest(np.minimum(self.passages.kept, self.passages.moved), done) & ~done

    def _greatest(self, lasts: NDArray[np.int16], done: Booleans) -> Booleans:
        """Return the greatest set that leads within itself and `done` (N,), each part as long as it `lasts` (P,)."""
        owner, followed = self.passages.owner, self._followed
        members = done.copy()
        members[followed.cells] = True
        open_ = self._named(followed.select(~followed.every(done)))
        rows = np.flatnonzero(open_[owner])
        while True:
            check_time()
            rows = rows[open_[owner[rows]]]
            within = CellSet(self.mesh, members)
            lost = rows[~self._leads(rows, [within] * self.passages.intervals, lasts)]
            if not len(lost):
                return members
            blocks = self.blocks(np.unique(owner[lost]))
            open_[blocks.first] = False
            cells = blocks.cells
            members[cells] = done[cells]

    def arrival(self) -> NDArray[np.int16]:
        """Return within how many intervals every run of each cell is in the goal, (N,); 0 where that is not known."""
        passages, kept = self.passages, self.passages.kept
        count = np.zeros(len(self.mesh), np.int16)
        arrived = self.exempt.copy()
        parts = np.bincount(passages.owner, minlength=len(self.mesh))  # of each block, that have not arrived
        rows, latest = np.arange(len(passages)), 0
        earlier: list[CellSet] = []
        for number in range(1, FOR_EVER):
            earlier = [CellSet(self.mesh, arrived), *earlier][: passages.intervals]
            there = self._leads(rows, earlier, kept)
            new = self._whole(parts, passages.owner[rows[there]]).cells
            rows = rows[~there]
            new = new[~arrived[new]]
            count[new], arrived[new] = number, True
            latest = number if len(new) else latest
            if (
                number - latest >= passages.intervals or time_is_up()
            ):  # fewer cells than there are may be claimed
                break
        return count

    def spread(self, arrived: Booleans) -> Booleans:
        """Return the cells that arrive, those of `arrived` (N,) among them, (N,), however many intervals it takes."""
        passages, followed = self.passages, self._followed
        arrived = arrived | self.exempt
        parts = np.bincount(passages.owner, minlength=len(self.mesh))
        rows = np.flatnonzero(self._named(followed.select(~followed.every(arrived)))[passages.owner])
        while True:
            there = self._leads(rows, [CellSet(self.mesh, arrived)] * passages.intervals, passages.kept)
            new = self._whole(parts, passages.owner[rows[there]]).cells
            if not len(new) or time_is_up():
                return arrived
            arrived[new], rows = True, rows[~there]

    def hopeful(self, arrived: Booleans, share: float) -> Blocks:
        """Return blocks each part of which leads, with some share of its range, to cells that arrive, and that may not.

        Parameters
        ----------
        arrived : ndarray
            (N,) bool, which cells arrive, and those that need not.
        share : float
            Of the cells of the range in which the share is largest.
        """
        owner, within = self.passages.owner, CellSet(self.mesh, arrived)
        followed = self._followed
        open_ = followed.select(~followed.every(arrived))
        rows = np.flatnonzero(self._named(open_)[owner])
        best = np.zeros(len(rows))
        for index, ranges in enumerate(self.passages.ranges):
            known = np.flatnonzero(np.maximum(self.passages.kept[rows], 1) > index)
            best[known] = np.maximum(best[known], within.share(ranges.select(rows[known])))
        hopeless = np.zeros(len(self.mesh), bool)
        hopeless[owner[rows[~(best >= share)]]] = True
        return open_.select(~hopeless[open_.first])

    @property
    def _followed(self) -> Blocks:
        """Return the blocks that have parts."""
        return self.blocks(np.unique(self.passages.owner))

    def _named(self, blocks: Blocks) -> Booleans:
        """Tell which cells name some blocks, (N,)."""
        named = np.zeros(len(self.mesh), bool)
        named[blocks.first] = True
        return named

    def _whole(self, parts: Indices, owner: Indices) -> Blocks:
        """Count off parts (P,) by their blocks from those of each (N,), and return the blocks that have none left."""
        np.subtract.at(parts, owner, 1)
        first = np.unique(owner)
        return self.blocks(first[parts[first] == 0])

    def go_on(self, intervals: int, done: Booleans) -> Booleans:
        """Tell of which cells (N,) more may be known if they are followed for more than some intervals.

        Parameters
        ----------
        intervals : int
            For how many they were followed at most; what ended before, ends there again.
        done : ndarray
            (N,) bool, where nothing needs to be followed further.
        """
        kept, open_ = self.passages.kept, np.zeros(len(self.mesh), bool)
        rows = np.flatnonzero(kept >= intervals)
        leads = self._leads(rows, [CellSet(self.mesh, done)] * self.passages.intervals, kept)
        open_[self.passages.owner[rows[~leads]]] = True
        return open_ & ~done

    def intervals(self, most: int, for_ever: Booleans) -> NDArray[np.int16]:
        """Return for how many intervals each cell stays certified, (N,): up to `most`, or `FOR_EVER`.

        Parameters
        ----------
        most : int
            Where to stop counting.
        for_ever : ndarray
            (N,) bool, from `for_ever`; they need no counting.
        """
        passages = self.passages
        count = np.where(for_ever | self.exempt, FOR_EVER, 0).astype(np.int16)
        alive = np.zeros(len(self.mesh), bool)
        alive[self._followed.cells] = True
        rows = np.flatnonzero(~for_ever[passages.owner])
        whole = alive | self.exempt  # S_0
        earlier = [CellSet(self.mesh, whole)]
        for number in range(1, most + 1):
            rows = rows[alive[passages.owner[rows]]]
            lasts = passages.kept[rows] >= number
            rest = rows[~lasts]
            lost = rest[~self._leads(rest, earlier, passages.kept)]
            alive[self.blocks(np.unique(passages.owner[lost])).cells] = False
            count[alive & (count < number)] = number
            if not len(rows) or time_is_up():  # fewer intervals than there are may be claimed
                break
            earlier = [CellSet(self.mesh, alive | self.exempt), *earlier[: passages.intervals - 1]]
        return count

    def _leads(self, rows: Indices, sets: list[CellSet], lasts: NDArray[np.int16]) -> Booleans:
        """Tell which parts are after some interval for which they last within the set for that interval, (R,)."""
        leads = np.zeros(len(rows), bool)
        for index, (ranges, members) in enumerate(zip(self.passages.ranges, sets, strict=False)):
            open_ = np.flatnonzero(~leads & (lasts[rows] > index))
            leads[open_] = members.covers(ranges.select(rows[open_]))
        return leads
