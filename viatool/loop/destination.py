"""Where runs are to arrive: near a place, in a box of states or in a polygon; as soon as they are, or at a deadline."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Booleans, Floats
from viatool.rounding import SPARE

if TYPE_CHECKING:
    from shapely import Polygon

_NEAR = 1e-9
"""By how much a run that is driven may miss a range and still counts as arrived."""


@dataclass(frozen=True, eq=False)
class Destination(ABC):
    """Where runs arrive.

    Parameters
    ----------
    deadline_only : bool
        Whether runs go on, wherever they are, until the deadline; else they end as soon as they have arrived.
    """

    deadline_only: bool

    @abstractmethod
    def surely(self, lower: Floats, upper: Floats) -> Booleans:
        """Tell in which boxes of states (P, 3 + K) every state has arrived, (P,). **Sound:** yes."""

    @abstractmethod
    def possibly(self, lower: Floats, upper: Floats) -> Booleans:
        """Tell in which boxes of states (P, 3 + K) some state may have arrived, (P,). **Sound:** yes."""

    @abstractmethod
    def holds(self, states: Floats) -> Booleans:
        """Tell which states (..., 3 + K) have arrived, (...)."""


@dataclass(frozen=True, eq=False)
class NearPlace(Destination):
    """Nearer to a place (2,) than a radius, in metres."""

    place: Floats
    radius: float

    def surely(self, lower: Floats, upper: Floats) -> Booleans:
        """See `Destination`."""
        away = np.maximum(np.abs(lower[:, :2] - self.place), np.abs(upper[:, :2] - self.place))
        return np.asarray(np.hypot(*away.T) * (1.0 + SPARE) < self.radius)

    def possibly(self, lower: Floats, upper: Floats) -> Booleans:
        """See `Destination`."""
        outside = np.maximum(np.maximum(lower[:, :2] - self.place, self.place - upper[:, :2]), 0.0)
        return np.asarray(np.hypot(*outside.T) * (1.0 - SPARE) < self.radius)

    def holds(self, states: Floats) -> Booleans:
        """See `Destination`."""
        return np.asarray(np.hypot(*np.moveaxis(states[..., :2] - self.place, -1, 0)) < self.radius)


@dataclass(frozen=True, eq=False)
class StatesReached(Destination):
    """Between ends (3 + K,) of states, infinite where nothing is asked; headings count up to whole turns."""

    lower: Floats
    upper: Floats

    def surely(self, lower: Floats, upper: Floats) -> Booleans:
        """See `Destination`."""
        spare = SPARE * (1.0 + np.abs(upper[:, 2:3])) * (np.arange(lower.shape[1]) == 2)
        lower, upper = self._near(lower, upper)
        return np.asarray(((lower - spare >= self.lower) & (upper + spare <= self.upper)).all(axis=1))

    def possibly(self, lower: Floats, upper: Floats) -> Booleans:
        """See `Destination`."""
        lower, upper = self._near(lower, upper)
        turns = np.ones(len(lower), dtype=bool)
        for turn in (
            -2.0 * np.pi,
            0.0,
            2.0 * np.pi,
        ):  # a range beside the nearest turn may reach into the next
            shift = turn * (np.arange(lower.shape[1]) == 2)
            apart = (lower + shift > self.upper + _NEAR) | (upper + shift < self.lower - _NEAR)
            turns &= apart.any(axis=1)
        return ~turns

    def holds(self, states: Floats) -> Booleans:
        """See `Destination`."""
        flat = states.reshape(-1, states.shape[-1])
        near, _ = self._near(flat, flat)
        found = ((near >= self.lower - _NEAR) & (near <= self.upper + _NEAR)).all(axis=1)
        return np.asarray(found.reshape(states.shape[:-1]))

    def _near(self, lower: Floats, upper: Floats) -> tuple[Floats, Floats]:
        """Return boxes turned by whole circles so that their headings are nearest to those that are asked for."""
        ends = np.array([self.lower[2], self.upper[2]])
        if not np.isfinite(ends).all():
            return lower, upper
        shift = np.zeros_like(lower)
        away = 0.5 * (lower[:, 2] + upper[:, 2]) - 0.5 * (ends[0] + ends[1])
        shift[:, 2] = 2.0 * np.pi * np.round(away / (2.0 * np.pi))
        return lower - shift, upper - shift


@dataclass(frozen=True, eq=False)
class StatesInPolygon(StatesReached):
    """The same with a place in a simple polygon as well.

    Parameters
    ----------
    outline : ndarray
        (n, 2) its corners, in metres.

    Notes
    -----
    Sound: predicates of shapely are exact for the floats that they get; boxes are wider by what may have been rounded.
    """

    outline: Floats

    @cached_property
    def _polygon(self) -> Polygon:
        import shapely

        polygon = shapely.Polygon(self.outline)
        shapely.prepare(polygon)
        return polygon

    def surely(self, lower: Floats, upper: Floats) -> Booleans:
        """See `Destination`."""
        import shapely

        found = super().surely(lower, upper)
        rows = np.flatnonzero(found & self._are_finite(lower, upper))
        inside = np.zeros(len(found), dtype=bool)
        inside[rows] = shapely.contains(self._polygon, self._places(lower[rows], upper[rows]))
        return inside

    def possibly(self, lower: Floats, upper: Floats) -> Booleans:
        """See `Destination`."""
        import shapely

        found = super().possibly(lower, upper)
        rows = np.flatnonzero(found & self._are_finite(lower, upper))
        found[rows] = shapely.intersects(self._polygon, self._places(lower[rows], upper[rows]))
        return found

    def holds(self, states: Floats) -> Booleans:
        """See `Destination`."""
        import shapely

        return np.asarray(
            super().holds(states) & shapely.dwithin(self._polygon, shapely.points(states[..., :2]), _NEAR)
        )

    @staticmethod
    def _are_finite(lower: Floats, upper: Floats) -> Booleans:
        return np.asarray(np.isfinite(lower[:, :2]).all(axis=1) & np.isfinite(upper[:, :2]).all(axis=1))

    @staticmethod
    def _places(lower: Floats, upper: Floats) -> NDArray[Any]:
        """Return boxes of places, (P,), slightly wider."""
        import shapely

        spare = SPARE * (1.0 + np.maximum(np.abs(lower[:, :2]), np.abs(upper[:, :2])))
        low, high = lower[:, :2] - spare, upper[:, :2] + spare
        return np.asarray(shapely.box(low[:, 0], low[:, 1], high[:, 0], high[:, 1]))
