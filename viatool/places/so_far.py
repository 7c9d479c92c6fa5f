"""What is known of cells while other roots are still to be examined: as much as a gate asks of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from viatool.places.findings import REFUTED, STATUSES, UNKNOWN, CellFindings
from viatool.places.tree import Lattice


@dataclass(frozen=True)
class CellsKnown:
    """Volumes of the roots that were examined, in smallest cells, as integers.

    Parameters
    ----------
    units : mapping
        The volume of each status.
    refuted, unknown : int
        How many leaves are so.
    unjudged : int
        The volume of the other roots, any part of which may become of any status.
    """

    units: Mapping[str, int]
    refuted: int
    unknown: int
    unjudged: int

    @property
    def contested(self) -> tuple[int, int]:
        """Return the certified and all of the contested volume."""
        units = self.units
        return units["certified"], units["certified"] + units["refuted"] + units["unknown"]

    @property
    def free(self) -> tuple[int, int]:
        """Return the safe and all of the free volume: uncontested or certified, and these with the rest."""
        certified, contested = self.contested
        return self.units["uncontested"] + certified, self.units["uncontested"] + contested


Enough = Callable[[CellsKnown], bool]


def volume_of(lattice: Lattice, found: CellFindings) -> NDArray[np.int64]:
    """Return the volume of each status (5,) in smallest cells."""
    each = lattice.units(found.nodes)
    return np.array([each[found.status == kind].sum() for kind in range(len(STATUSES))], dtype=np.int64)


class CellCount:
    """Counts what is found in the first roots, and asks whether that will do.

    Parameters
    ----------
    lattice : Lattice
        All roots.
    enough : callable
        Told of the cells so far, once some place is free: of none there is nothing to decide.
    """

    def __init__(self, lattice: Lattice, enough: Enough) -> None:
        self._lattice, self._enough = lattice, enough
        self._parts, self.satisfied = 0, False
        self._volume = np.zeros(len(STATUSES), dtype=np.int64)
        self._leaves = np.zeros(len(STATUSES), dtype=np.int64)

    def __call__(self, parts: Sequence[CellFindings]) -> bool:
        """Return whether the first parts will do; those of the call before are known."""
        for part in parts[self._parts :]:
            self._volume += volume_of(self._lattice, part)
            self._leaves += np.bincount(part.status, minlength=len(STATUSES))
        self._parts = len(parts)
        known = self.known
        self.satisfied = known.free[1] > 0 and self._enough(known)
        return self.satisfied

    @property
    def known(self) -> CellsKnown:
        """Return what is known; leaves fill the roots that were examined, so what they lack is of the others."""
        volume, leaves = self._volume.tolist(), self._leaves.tolist()
        left = self._lattice.whole - sum(volume)
        return CellsKnown(dict(zip(STATUSES, volume, strict=True)), leaves[REFUTED], leaves[UNKNOWN], left)
