"""For how long cells stay certified: backward iteration over where they lead, and its limit, which holds for ever.

Let a cell's parts lead to the ranges ``R_1 .. R_j`` after one to j intervals, for which they keep their clearance. With
F the cells that need no proof (their free poses have reached the goal, or they have none), a cell belongs to

    S_k      if each of its parts keeps its clearance for k intervals, or has an ``R_i`` within ``S_(k-i)`` and F,
    S_for_ever, the largest set S of cells each of whose parts has an ``R_i`` within S and F.

The first says that the loop stays certified for k intervals unless it reaches the goal before. The second is found by
removing, from all safe cells, those that do not fulfil the condition, until none is left to remove: no run leaves
what remains except by reaching the goal, and each of its intervals keeps its clearance, by induction.
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
        passages = self.passages
        members = self.exempt.copy()
        members[passages.owner] = True
        members[passages.owner[passages.kept < 1]] = False
        rows = np.arange(len(passages))
        while True:
            check_time()
            rows = rows[members[passages.owner[rows]]]
            within = CellSet(self.mesh, members)
            lost = rows[~self._leads(rows, [within] * passages.intervals)]
            if not len(lost):
                return members & ~self.exempt
            members[passages.owner[lost]] = False

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
            lost = rest[~self._leads(rest, earlier)]
            alive[passages.owner[lost]] = False
            count[alive & (count < number)] = number
            if not len(rows) or time_is_up():  # fewer intervals than there are may be claimed
                break
            earlier = [CellSet(self.mesh, alive | self.exempt), *earlier[: passages.intervals - 1]]
        return count

    def _leads(self, rows: Indices, sets: list[CellSet]) -> Booleans:
        """Tell which parts are after some interval within the set for that interval, (R,)."""
        leads = np.zeros(len(rows), bool)
        for index, (ranges, members) in enumerate(zip(self.passages.ranges, sets, strict=False)):
            open_ = np.flatnonzero(~leads & (self.passages.kept[rows] > index))
            leads[open_] = members.covers(ranges.select(rows[open_]))
        return leads
