"""Cells of the state space as nodes of a binary tree: exact volumes, and children that meet without gaps.

The axes are x, y, theta, and v and omega of the step before, or up to two numbers of the state of the motion. A node
is a level and an index for every axis: at level l each root is cut into 2^l equal parts. Bounds of neighbours come from
the same float64 numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Floats, Indices
from viatool.rounding import SLIGHTLY_MORE, SPARE
from viatool.sets.forms import PoseBoxes
from viatool.sets.states import StateBoxes

AXES = ("x", "y", "theta", "v", "omega")


@dataclass(frozen=True, eq=False)
class Nodes:
    """N nodes of a tree.

    Parameters
    ----------
    level : ndarray
        (N, 5) int8, how often each axis was halved.
    index : ndarray
        (N, 5) int32, which part of the axis.
    """

    level: NDArray[np.int8]
    index: NDArray[np.int32]

    def __len__(self) -> int:
        """Return the number of nodes."""
        return len(self.level)

    def select(self, which: NDArray[Any] | slice) -> Nodes:
        """Return some of the nodes."""
        return Nodes(self.level[which], self.index[which])

    def halved(self, axis: Indices) -> Nodes:
        """Return both halves of every node, cut across its given axis (N,), side by side."""
        cut = axis[:, None] == np.arange(len(AXES))
        level = np.repeat(self.level + cut.astype(np.int8), 2, axis=0)
        index = np.repeat(np.where(cut, 2 * self.index, self.index), 2, axis=0)
        index[1::2] += cut
        return Nodes(level, index)

    @classmethod
    def join(cls, parts: Sequence[Nodes]) -> Nodes:
        """Return all parts as one."""
        none = cls(np.zeros((0, len(AXES)), np.int8), np.zeros((0, len(AXES)), np.int32))
        every = [none, *parts]
        return cls(
            np.concatenate([part.level for part in every]), np.concatenate([part.index for part in every])
        )


@dataclass(frozen=True, eq=False)
class Lattice:
    """The roots of the tree and how far they are cut.

    Parameters
    ----------
    origin, size : ndarray
        (5,) lower corner of the first root, and the extent of a root.
    count : ndarray
        (5,) int, roots along each axis.
    grain : ndarray
        (5,) levels at which the question what is contested is settled.
    deepest : ndarray
        (5,) levels of the smallest cells.
    numbers : int
        K, of what stands behind the pose, at most two of which are cut.
    beyond : ndarray
        (K - 2, 2) ends of the commands before along further axes, which are never cut: every cell takes all of them.
    """

    origin: Floats
    size: Floats
    count: Indices
    grain: Indices
    deepest: Indices
    beyond: Floats = field(default_factory=lambda: np.zeros((0, 2)))
    numbers: int = 2

    @classmethod
    def over(
        cls,
        bounds: tuple[float, float, float, float],
        commands: tuple[Floats, Floats],
        smallest: tuple[float, float, int],
        grain: int = 1,
    ) -> Lattice:
        """Cut a map into roots of eight smallest cells along x, y and theta.

        Parameters
        ----------
        bounds : tuple
            Smallest x, y and largest x, y of the map, in metres.
        commands : tuple of ndarray
            (K,) each: the smallest and the largest command, v and omega first, or state of the motion.
        smallest : tuple
            Largest side in metres and opening in radians of the smallest cells; how often commands may be halved.
        grain : int
            How often the cells in which contested volume is counted may be halved along each axis.
        """
        side, opening, halvings = smallest
        widths = np.array([bounds[2] - bounds[0], bounds[3] - bounds[1], 2.0 * np.pi])
        levels = 3
        count = np.ceil(widths / (np.array([side, side, opening]) * 2**levels) - 1e-9).astype(np.int64)
        size = widths / count
        lower, upper = commands
        cut = min(2, len(lower))
        none = np.zeros(2 - cut)
        return cls(
            origin=np.concatenate([bounds[:2], [-np.pi], lower[:2], none]),
            size=np.concatenate([size, (upper - lower)[:2], none]),
            count=np.concatenate([count, [1, 1]]),
            grain=np.array([levels - grain] * 3 + [0, 0]),
            deepest=np.array([levels] * 3 + [halvings] * cut + [0] * (2 - cut)),
            beyond=np.column_stack([lower[2:], upper[2:]]),
            numbers=len(lower),
        )

    def roots(self) -> Nodes:
        """Return all roots."""
        axes = np.meshgrid(*(np.arange(number) for number in self.count), indexing="ij")
        index = np.stack([axis.ravel() for axis in axes], axis=1).astype(np.int32)
        return Nodes(np.zeros(index.shape, np.int8), index)

    def units(self, nodes: Nodes) -> Indices:
        """Return the volumes of nodes (N,) in smallest cells, as integers."""
        return np.asarray(np.left_shift(np.int64(1), self.halvings(nodes).astype(np.int64)), dtype=np.int64)

    @property
    def whole(self) -> int:
        """Return the volume of all roots in smallest cells."""
        return int(np.prod(self.count)) << int(self.deepest.sum())

    def bounds(self, nodes: Nodes) -> tuple[Floats, Floats]:
        """Return lower and upper ends of nodes, (N, 5)."""
        step = self.size * np.exp2(-nodes.level.astype(np.float64))
        return self.origin + nodes.index * step, self.origin + (nodes.index + 1) * step

    def halvings(self, nodes: Nodes) -> Indices:
        """Return how often nodes can be halved, (N,); 0 for smallest ones."""
        return np.asarray((self.deepest - nodes.level).sum(axis=1))

    def cells(self, nodes: Nodes) -> StateBoxes:
        """Return the cells of nodes, rounded outward."""
        lower, upper = self.bounds(nodes)
        middle = 0.5 * (lower + upper)
        radius = np.maximum(upper - middle, middle - lower) * SLIGHTLY_MORE + SPARE
        whole = np.broadcast_to(self.beyond.T[:, None], (2, len(nodes), len(self.beyond)))
        before = [
            np.concatenate([end[:, 3:], rest], axis=1)[:, : self.numbers]
            for end, rest in ((lower, whole[0]), (upper, whole[1]))
        ]
        return StateBoxes(PoseBoxes(middle[:, :3], radius[:, :3]), *before)

    def volumes(self, nodes: Nodes) -> Floats:
        """Return the volumes in m^2 rad; slices of the previous command count with their share of its range."""
        root = float(np.prod(self.size[:3]))
        return np.asarray(root * np.exp2(-nodes.level.sum(axis=1, dtype=np.float64)))
