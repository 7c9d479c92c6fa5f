"""Volumes by place and heading: what became of each square of the map, whatever the sizes of its cells are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from viatool.arrays import Floats
from viatool.places.findings import STATUSES, CellFindings
from viatool.places.tree import Lattice


@dataclass(frozen=True, eq=False)
class Raster:
    """Squares of the map, cut into slices of headings.

    Parameters
    ----------
    volumes : ndarray
        (5, S, X, Y) m^2 rad of each status; slices begin at theta = -pi. Nothing where nothing was examined.
    origin, size : ndarray
        (2,) metres: the lower corner of the first square, and the sides of a square.
    """

    volumes: Floats
    origin: Floats
    size: Floats

    def gathered(self, sectors: int) -> Raster:
        """Return fewer sectors; a slice counts where its middle is."""
        kinds, slices, *squares = self.volumes.shape
        volumes = np.zeros((kinds, sectors, *squares))
        for at in range(slices):
            volumes[:, int((at + 0.5) / slices * sectors)] += self.volumes[:, at]
        return Raster(volumes, self.origin, self.size)

    @property
    def middles(self) -> Floats:
        """Return the middles of the squares, (X, Y, 2) metres."""
        x, y = (
            self.origin[axis] + self.size[axis] * (np.arange(self.volumes.shape[2 + axis]) + 0.5)
            for axis in (0, 1)
        )
        return np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Return least and largest x, least and largest y."""
        far = self.origin + self.size * self.volumes.shape[2:]
        return float(self.origin[0]), float(far[0]), float(self.origin[1]), float(far[1])

    def safe_share(self) -> Floats:
        """Return the uncontested or certified share of the free volume by square, (X, Y); nan where none is free."""
        free, safe = self.volumes[1:].sum(axis=(0, 1)), self.volumes[1:3].sum(axis=(0, 1))
        return np.asarray(np.where(free > 0.0, safe / np.where(free > 0.0, free, 1.0), np.nan))


def rasterise(lattice: Lattice, findings: CellFindings, slices: int, most: int) -> Raster:
    """Sum up the volumes of leaves by square and slice of headings.

    Parameters
    ----------
    lattice, findings
        The cells and what became of them.
    slices : int
        How many there are at least, if the grain is as fine; the edges of cells are edges of slices.
    most : int
        How many squares times slices there are at most, unless the roots are more. Squares are those of the
        grain, or larger ones.
    """
    level = lattice.grain[:3].copy()
    level[2] = min(level[2], int(np.ceil(np.log2(max(slices / lattice.count[2], 1.0)))))
    while level[:2].max() > 0 and np.prod(lattice.count[:3] << level) > most:
        level[:2] = np.maximum(level[:2] - 1, 0)
    count = lattice.count[:3] << level
    shape = (len(STATUSES), int(count[2]), int(count[0]), int(count[1]))
    nodes, status = findings.nodes, findings.status.astype(np.int64)
    own = np.minimum(nodes.level[:, :3], level)
    place = nodes.index[:, :3].astype(np.int64) >> (nodes.level[:, :3] - own)
    volume, flat = lattice.volumes(nodes), np.zeros(int(np.prod(shape)))
    for coarse in np.unique(own, axis=0):
        there = np.flatnonzero((own == coarse).all(axis=1))
        spread = level - coarse
        share, first = volume[there] / np.exp2(spread.sum()), place[there] << spread
        for offset in np.ndindex(*(1 << spread)):
            x, y, heading = (first + offset).T
            np.add.at(flat, np.ravel_multi_index((status[there], heading, x, y), shape), share)
    size = lattice.size[:2] * np.exp2(-level[:2].astype(np.float64))
    return Raster(flat.reshape(shape), lattice.origin[:2], size)
