"""What was found of the margins of states, as arrays that can be joined and stored."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Floats, Indices
from viatool.safety import Witnesses

Arrays = dict[str, NDArray[Any]]
_SECONDS, _WITNESS = "seconds.", "witnesses."


@dataclass(frozen=True, eq=False)
class MarginFindings:
    """What is known of the C contested ones of some states.

    Parameters
    ----------
    state : ndarray
        (C,) which of all states of the run.
    certified, refuted : ndarray
        (C,) the largest error with a proof, minus infinity where there is none; the smallest with a counterexample,
        infinite where there is none.
    witnesses : Witnesses
        These counterexamples; their states are counted over the whole run.
    distance : ndarray
        (C,) metres from the footprint to the nearest obstacle.
    weight : ndarray
        (C, n) which part of what the errors do is due to each entry of the observation.
    seconds : mapping
        Time that each stage took.
    """

    state: Indices
    certified: Floats
    refuted: Floats
    witnesses: Witnesses
    distance: Floats
    weight: Floats
    seconds: Mapping[str, float]

    @classmethod
    def none(cls, size: int, axes: int, seconds: Mapping[str, float]) -> MarginFindings:
        """Return that no state is contested: of n observation entries, and A axes of a command."""
        empty, none = np.zeros(0), Witnesses.none(size, axes)
        return cls(np.zeros(0, np.int64), empty, empty, none, empty, np.zeros((0, size)), seconds)

    @classmethod
    def join(cls, parts: Sequence[MarginFindings]) -> MarginFindings:
        """Return the findings of consecutive states as one."""
        joined: dict[str, Any] = {
            name: np.concatenate([getattr(part, name) for part in parts]) for name in _COLUMNS
        }
        found = [part.witnesses for part in parts]
        witnesses = Witnesses.join(found, found[0].observation.shape[1], found[0].action.shape[1])
        stages = dict.fromkeys(stage for part in parts for stage in part.seconds)
        seconds = {stage: sum(part.seconds.get(stage, 0.0) for part in parts) for stage in stages}
        return cls(**joined, witnesses=witnesses, seconds=seconds)

    def moved(self, count: int) -> MarginFindings:
        """Return the same of states that stand behind so many others."""
        witnesses = replace(self.witnesses, state=self.witnesses.state + count)
        return replace(self, state=self.state + count, witnesses=witnesses)

    def to_arrays(self) -> Arrays:
        """Return everything by name."""
        columns = {name: getattr(self, name) for name in _COLUMNS}
        columns |= {_WITNESS + one.name: getattr(self.witnesses, one.name) for one in fields(Witnesses)}
        return columns | {_SECONDS + stage: np.array(spent) for stage, spent in self.seconds.items()}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> MarginFindings:
        """Return what `to_arrays` was called on."""
        seconds = {
            name.removeprefix(_SECONDS): float(spent)
            for name, spent in arrays.items()
            if name.startswith(_SECONDS)
        }
        witnesses = Witnesses(*(arrays[_WITNESS + one.name] for one in fields(Witnesses)))
        return cls(**{name: arrays[name] for name in _COLUMNS}, witnesses=witnesses, seconds=seconds)


_COLUMNS: tuple[Any, ...] = ("state", "certified", "refuted", "distance", "weight")
