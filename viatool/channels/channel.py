"""What a specification says of one channel of the observation."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field, FiniteFloat, model_validator

from viatool.world.fields import Strict

Positive = Annotated[FiniteFloat, Field(gt=0)]
NonNegative = Annotated[FiniteFloat, Field(ge=0)]


class LidarSpecification(Strict):
    """How the LiDAR channel was made: rays over a field of view, binned by their minimum.

    Parameters
    ----------
    field_of_view : float
        Total opening in radians, symmetric about forward.
    rays, bins : int
        Rays that are cast, and numbers that are left after taking the minimum of consecutive rays.
    minimum_range, maximum_range : float
        In metres; nothing hit reads ``maximum_range``.
    """

    field_of_view: Annotated[FiniteFloat, Field(gt=0, le=2 * np.pi + 1e-9)]
    rays: Annotated[int, Field(ge=1)]
    bins: Annotated[int, Field(ge=1)]
    minimum_range: NonNegative = 0.0
    maximum_range: Positive

    @model_validator(mode="after")
    def _consistent(self) -> LidarSpecification:
        if self.rays % self.bins:
            raise ValueError(f"{self.rays} rays do not divide into {self.bins} bins of equal size")
        if self.minimum_range >= self.maximum_range:
            raise ValueError(
                f"minimum_range {self.minimum_range} must be below maximum_range {self.maximum_range}"
            )
        return self


class Channel(Strict):
    """What stands in a specification; `viatool.policy.ObservationChannel` says what it means, and checks it."""

    name: Annotated[str, Field(min_length=1)]
    size: Annotated[int, Field(ge=1)] = 1
    unit: str = ""
    kind: str = "other"
    value: FiniteFloat | None = None
    eps: NonNegative | None = None
    lidar: LidarSpecification | None = None

    def __str__(self) -> str:
        """Return how messages name the channel."""
        return f"observation channel '{self.name}' of kind '{self.kind}'"
