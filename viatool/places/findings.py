"""What became of cells: leaves of the tree with their status, and the counterexamples of those that are refuted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Booleans, Floats
from viatool.loop.refuting import Refutations
from viatool.places.tree import AXES, Nodes

BLOCKED, SETTLED, CERTIFIED, REFUTED, UNKNOWN = range(5)
STATUSES = ("blocked", "uncontested", "certified", "refuted", "unknown")


@dataclass(frozen=True, eq=False)
class CellFindings:
    """N leaves, of which R are refuted.

    Parameters
    ----------
    level, index : ndarray
        (N, 5) the nodes.
    status : ndarray
        (N,) int8, an index of `STATUSES`.
    pose, previous, action : ndarray
        (R, 3), (R, A), (R, A): of the counterexamples, in the order of the refuted leaves.
    observation : ndarray
        (R, n) float32 or float64, as the program receives it.
    seconds, clearance : ndarray
        (R,) when the robot comes nearest, and how near.
    closest : ndarray
        (R, 3) where it is then.
    believed, turn, passed : ndarray
        (R, 3), (R, T), (R, n): how sensors err as a whole, as in `Witnesses`.
    """

    level: NDArray[np.int8]
    index: NDArray[np.int32]
    status: NDArray[np.int8]
    pose: Floats
    previous: Floats
    action: Floats
    observation: NDArray[np.floating[Any]]
    seconds: Floats
    clearance: Floats
    closest: Floats
    believed: Floats
    turn: Floats
    passed: Booleans

    def __len__(self) -> int:
        """Return the number of leaves."""
        return len(self.status)

    @property
    def nodes(self) -> Nodes:
        """Return the leaves as nodes of the tree."""
        return Nodes(self.level, self.index)

    @classmethod
    def of(cls, nodes: Nodes, status: NDArray[Any], found: Refutations | None = None) -> CellFindings:
        """Return leaves with their status; refuted ones come in the order of their counterexamples."""
        kind = status.astype(np.int8)
        if found is None:
            return cls(nodes.level, nodes.index, kind, *_NONE)
        seen = found.witnesses
        small = seen.observation.astype(np.float32)
        exact = bool((small == seen.observation).all())
        return cls(
            nodes.level, nodes.index, kind, found.poses, found.previous, seen.action,
            small if exact else seen.observation, seen.seconds, seen.clearance, seen.pose, seen.believed, seen.turn,
            seen.passed,
        )  # fmt: skip

    @classmethod
    def join(cls, parts: Sequence[CellFindings]) -> CellFindings:
        """Return all parts as one."""
        none = np.zeros((0, len(AXES)))
        every = [cls(none.astype(np.int8), none.astype(np.int32), np.zeros(0, np.int8), *_NONE), *parts]
        joined = {}
        for name in (part.name for part in fields(cls)):
            arrays = [getattr(found, name) for found in every]
            widest = max(arrays, key=lambda array: array.shape[1:])  # what is empty may not know its width
            joined[name] = np.concatenate([array for array in arrays if len(array)] or [widest])
        return cls(**joined)

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Return the arrays by name."""
        return {part.name: getattr(self, part.name) for part in fields(self)}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> CellFindings:
        """Return what `to_arrays` gave."""
        return cls(**{part.name: arrays[part.name] for part in fields(cls)})


_NONE = (
    np.zeros((0, 3)), np.zeros((0, 2)), np.zeros((0, 2)), np.zeros((0, 0), np.float32), np.zeros(0), np.zeros(0),
    np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 0)), np.zeros((0, 0), dtype=bool),
)  # fmt: skip
