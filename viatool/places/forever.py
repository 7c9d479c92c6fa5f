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
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Booleans, Indices
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
    """

    mesh: Mesh
    exempt: Booleans
    passages: Passages

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
        owner = self.passages.owner
        members = np.zeros(len(self.mesh), bool)
        members[owner] = True
        members |= done
        rows = np.flatnonzero(~done[owner])
        while True:
            check_time()
            rows = rows[members[owner[rows]]]
            within = CellSet(self.mesh, members)
            lost = rows[~self._leads(rows, [within] * self.passages.intervals, lasts)]
            if not len(lost):
                return members
            members[owner[lost]] = False

    def arrival(self) -> NDArray[np.int16]:
        """Return within how many intervals every run of each cell is in the goal, (N,); 0 where that is not known."""
        passages, kept = self.passages, self.passages.kept
        count = np.zeros(len(self.mesh), np.int16)
        arrived = self.exempt.copy()
        parts = np.bincount(passages.owner, minlength=len(self.mesh))  # of each cell, that have not arrived
        followed = parts > 0
        rows, latest = np.arange(len(passages)), 0
        earlier: list[CellSet] = []
        for number in range(1, FOR_EVER):
            earlier = [CellSet(self.mesh, arrived), *earlier][: passages.intervals]
            there = self._leads(rows, earlier, kept)
            np.subtract.at(parts, passages.owner[rows[there]], 1)
            rows = rows[~there]
            new = followed & (parts == 0) & ~arrived
            count[new], arrived[new] = number, True
            latest = number if new.any() else latest
            if (
                number - latest >= passages.intervals or time_is_up()
            ):  # fewer cells than there are may be claimed
                break
        return count

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
        alive[passages.owner] = True
        rows = np.flatnonzero(~for_ever[passages.owner])
        whole = alive | self.exempt  # S_0
        earlier = [CellSet(self.mesh, whole)]
        for number in range(1, most + 1):
            rows = rows[alive[passages.owner[rows]]]
            lasts = passages.kept[rows] >= number
            rest = rows[~lasts]
            lost = rest[~self._leads(rest, earlier, passages.kept)]
            alive[passages.owner[lost]] = False
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
