"""Volumes by place and heading: what became of each square of the map, whatever the sizes of its cells."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from viatool.certify.findings import STATUSES, Findings
from viatool.certify.tree import Lattice

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Raster:
    """Squares of the map, cut into sectors of headings.

    Parameters
    ----------
    volumes : ndarray
        (5, S, X, Y) m^2 rad of each status; sectors begin at theta = -pi. Nothing where nothing was examined.
    origin, size : ndarray
        (2,) metres: the lower corner of the first square, and the sides of a square.
    """

    volumes: Floats
    origin: Floats
    size: Floats

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

    def square_of(self, places: Floats) -> Integers:
        """Return the flat number of the square that each place (N, 2) lies in, (N,)."""
        shape = self.volumes.shape[2:]
        index = np.clip(np.floor((places - self.origin) / self.size).astype(np.int64), 0, np.array(shape) - 1)
        return np.asarray(index[:, 0] * shape[1] + index[:, 1])

    def safe_share(self) -> Floats:
        """Return the uncontested or certified share of the free volume by square, (X, Y); nan where none is free."""
        free, safe = self.volumes[1:].sum(axis=(0, 1)), self.volumes[1:3].sum(axis=(0, 1))
        return np.asarray(np.where(free > 0.0, safe / np.where(free > 0.0, free, 1.0), np.nan))


def rasterise(lattice: Lattice, findings: Findings, sectors: int, most: int) -> Raster:
    """Sum up the volumes of leaves by square and sector.

    Parameters
    ----------
    lattice, findings
        The cells and what became of them.
    sectors : int
        S; a cell counts where the middle of its headings is, so that slices are exact if no cell spans two.
    most : int
        How many squares times sectors there are at most, unless the roots are more. Squares are those of the
        grain, or larger ones.
    """
    level = lattice.grain[:2].copy()
    while level.max() > 0 and np.prod(lattice.count[:2] << level) * sectors > most:
        level = np.maximum(level - 1, 0)
    shape = (len(STATUSES), sectors, *(lattice.count[:2] << level))
    nodes, status = findings.nodes, findings.status.astype(np.int64)
    heading = (nodes.index[:, 2] + 0.5) / np.exp2(nodes.level[:, 2]) / lattice.count[2]
    sector = np.minimum((heading * sectors).astype(np.int64), sectors - 1)
    own = np.minimum(nodes.level[:, :2], level)
    square = nodes.index[:, :2].astype(np.int64) >> (nodes.level[:, :2] - own)
    volume, flat = lattice.volumes(nodes), np.zeros(int(np.prod(shape)))
    for coarse in np.unique(own, axis=0):
        there = np.flatnonzero((own == coarse).all(axis=1))
        spread = level - coarse
        share = volume[there] / np.exp2(spread.sum())
        first = square[there] << spread
        for x in range(1 << spread[0]):
            for y in range(1 << spread[1]):
                at = (status[there], sector[there], first[:, 0] + x, first[:, 1] + y)
                np.add.at(flat, np.ravel_multi_index(at, shape), share)
    size = lattice.size[:2] * np.exp2(-level.astype(np.float64))
    return Raster(flat.reshape(shape), lattice.origin[:2], size)
