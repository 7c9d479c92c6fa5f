"""What velocities and commands have in common: each is one part of a motion, ahead, to the left or turning."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

import numpy as np

from viatool.arrays import Floats, Indices
from viatool.channels.quantity import Quantity
from viatool.channels.views import Extent


class PartOfMotion(Quantity):
    """One number of a velocity or a command, between limits of the robot."""

    believes = False
    placed = False
    sign: ClassVar[float] = 1.0
    """Of the number in the scene's mirror image."""

    @property
    @abstractmethod
    def limits(self) -> tuple[float, float]:
        """Return the least and the largest number that the robot has."""

    def bounds(self, extent: Extent) -> tuple[float, float]:
        """Return the robot's limits."""
        return self.limits

    def mirror(self) -> tuple[Indices, Floats]:
        """Return the speed ahead as it is, the others turned round."""
        return np.arange(1), np.full(1, self.sign)
