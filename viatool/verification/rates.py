"""Safety rates as integers: how many states are safe, of how many."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

OUTCOMES = ("success", "collision", "timeout")


@dataclass(frozen=True)
class Rate:
    """Safe states among all that count.

    Parameters
    ----------
    safe, total : int
        ``0 <= safe <= total``.
    """

    safe: int
    total: int

    def __post_init__(self) -> None:
        if not 0 <= self.safe <= self.total:
            raise ValueError(f"{self.safe} safe states of {self.total}")

    @property
    def rate(self) -> float | None:
        """Return the share; None when no state counts, and below 1.0 unless every state is safe."""
        if self.total == 0:
            return None
        share = self.safe / self.total
        return share if self.safe == self.total else min(share, float(np.nextafter(1.0, 0.0)))

    def __str__(self) -> str:
        """Write the rate rounded down, so that 100 % means every state."""
        if self.total == 0:
            return "no states"
        whole, hundredths = divmod(self.safe * 10_000 // self.total, 100)
        return f"{whole}.{hundredths:02d} % ({self.safe} of {self.total})"

    def to_json(self) -> dict[str, int | float | None]:
        """Return the form that the report JSON holds."""
        return {"safe": self.safe, "total": self.total, "rate": self.rate}

    @classmethod
    def of(cls, safe: NDArray[np.bool_], counted: NDArray[np.bool_]) -> Rate:
        """Count the safe states (N,) among those that count (N,)."""
        return cls(int((safe & counted).sum()), int(counted.sum()))


@dataclass(frozen=True)
class RateByOutcome:
    """A rate over all states, and over the states of the episodes with each outcome.

    Episodes whose outcome is unknown count in `overall` alone.
    """

    overall: Rate
    success: Rate
    collision: Rate
    timeout: Rate

    @classmethod
    def of(
        cls, safe: NDArray[np.bool_], outcome: NDArray[np.str_], counted: NDArray[np.bool_] | None = None
    ) -> RateByOutcome:
        """Count states.

        Parameters
        ----------
        safe : ndarray
            (N,) bool.
        outcome : ndarray
            (N,) outcome of each state's episode.
        counted : ndarray, optional
            (N,) bool, the states that count; all by default.
        """
        everything = np.ones(safe.shape, dtype=bool) if counted is None else counted
        named = {name: Rate.of(safe, everything & (outcome == name)) for name in OUTCOMES}
        return cls(overall=Rate.of(safe, everything), **named)

    def __float__(self) -> float:
        """Return the overall rate; NaN when there are no states."""
        rate = self.overall.rate
        return float("nan") if rate is None else rate

    def __str__(self) -> str:
        """Write the overall rate."""
        return str(self.overall)

    def to_json(self) -> dict[str, dict[str, int | float | None]]:
        """Return the form that the report JSON holds."""
        return {name: getattr(self, name).to_json() for name in ("overall", *OUTCOMES)}
