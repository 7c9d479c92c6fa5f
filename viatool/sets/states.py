"""Boxes of states: a box of poses with a box of the commands before, or of the state of the motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Floats
from viatool.sets.bounds import require_ordered
from viatool.sets.forms import Forms, PoseBoxes

POSE = ("x", "y", "theta")
"""The quantities with which a state begins; those of `Kinematics.before` follow."""


@dataclass(frozen=True, eq=False)
class StateBoxes:
    """C boxes of states: a box of poses, and a box of commands of the step before, or of states of the motion.

    Parameters
    ----------
    poses : PoseBoxes
        C boxes.
    previous_lower, previous_upper : ndarray
        (C, K) ends of the commands, of a differential drive v in m/s and omega in rad/s. Of a robot whose motion has a
        state, of that: see `Kinematics.before`.
    """

    poses: PoseBoxes
    previous_lower: Floats
    previous_upper: Floats

    def __len__(self) -> int:
        """Return the number of cells."""
        return len(self.poses)

    def select(self, which: NDArray[Any] | slice) -> StateBoxes:
        """Return some of the cells."""
        return StateBoxes(self.poses.select(which), self.previous_lower[which], self.previous_upper[which])

    @classmethod
    def concatenate(cls, parts: Sequence[StateBoxes]) -> StateBoxes:
        """Return the cells of all parts one after the other."""
        return cls(
            PoseBoxes(
                np.concatenate([part.poses.centre for part in parts]),
                np.concatenate([part.poses.radius for part in parts]),
            ),
            np.concatenate([part.previous_lower for part in parts]),
            np.concatenate([part.previous_upper for part in parts]),
        )

    def checked(self) -> StateBoxes:
        """Return the cells themselves; BoundsError if one of them is empty, unbounded or NaN."""
        self.poses.checked()
        require_ordered("commands before", self.previous_lower, self.previous_upper, finite=True)
        return self

    @property
    def forms(self) -> Forms:
        """Return the boxes as forms (C, 3 + A) of as many symbols, one for each side."""
        middle = 0.5 * (self.previous_lower + self.previous_upper)
        half = np.maximum(self.previous_upper - middle, middle - self.previous_lower)
        radius = np.concatenate([self.poses.radius, half], axis=1)
        centre = np.concatenate([self.poses.centre, middle], axis=1)
        return Forms(centre, radius[:, :, None] * np.eye(radius.shape[1]), np.zeros_like(centre))
