"""What was found of the control intervals that follow each state."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Floats
from viatool.loop.horizon import Crashes, Horizon, Tubes
from viatool.verification.rates import Rate


@dataclass(frozen=True, eq=False)
class HorizonResult:
    """What was found of the intervals that follow N states.

    Parameters
    ----------
    horizon : Horizon
        What was asked.
    tubes : Tubes
        Where every run may be, and how far it is proved to be safe.
    crashes : Crashes
        Runs that fail.
    """

    horizon: Horizon
    tubes: Tubes
    crashes: Crashes

    @cached_property
    def verdict(self) -> NDArray[np.str_]:
        """Return the verdict of each state, (N,): safe over all K intervals, unsafe by a run that fails, or unknown."""
        verdict = np.where(self.tubes.safe, "safe", "unknown")
        verdict[self.crashes.state] = "unsafe"
        return verdict

    @property
    def meaning(self) -> str:
        """Return in words what is assumed of the runs."""
        return (
            f"Over the horizon: {self.horizon.steps} commands, each from what sensors read where the robot is, within "
            "the errors that are stated, anew in each interval, until the goal is reached"
        )

    def state_table(self, rows: slice) -> dict[str, NDArray[Any]]:
        """Return arrays of the state table, one row for each of some states."""
        tubes = self.tubes
        return {
            "tube_lower": tubes.lower[rows],
            "tube_upper": tubes.upper[rows],
            "tube_clearance": tubes.clearance[rows],
            "horizon_steps": tubes.steps[rows],
            "horizon_verdict": self.verdict[rows],
        }

    def to_json(self) -> dict[str, Any]:
        """Return the form that the report JSON holds; widths are those of the tubes that have not ended."""
        tubes, horizon, count = self.tubes, self.horizon, len(self.tubes)
        widths = tubes.upper - tubes.lower
        measured = {"position": np.hypot(widths[..., 0], widths[..., 1]), "heading": widths[..., 2]}
        clearance = np.where(np.isfinite(tubes.clearance), tubes.clearance, np.nan)
        proved = [int((tubes.steps >= step).sum()) for step in range(1, horizon.steps + 1)]
        return {
            "steps": horizon.steps,
            "pose_error": {"position": horizon.position_error, "heading": horizon.heading_error},
            "states": count,
            "verdicts": {name: int((self.verdict == name).sum()) for name in ("safe", "unsafe", "unknown")},
            "safety_rate": [Rate(safe, count).to_json() for safe in proved],
            "width": {
                name: {
                    "median": _quantiles(width, 0.5),
                    "p90": _quantiles(width, 0.9),
                    "unit": "m" if name == "position" else "rad",
                }
                for name, width in measured.items()
            },
            "least_clearance": _quantiles(clearance, 0.0),
        }


def _quantiles(values: Floats, share: float) -> list[float | None]:
    """Return a quantile of each interval over the states that have a value, None where none has."""
    columns = [column[np.isfinite(column)] for column in values.T]
    return [float(np.quantile(column, share)) if len(column) else None for column in columns]
