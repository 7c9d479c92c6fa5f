"""What is known of states while others are still to be judged: as much as a gate asks of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.verification.findings import StateFindings
from viatool.verification.rates import OUTCOMES, Rate

Unjudged = Mapping[str, int]
"""How many states were not judged: `overall`, and of the episodes with each outcome."""


@dataclass(frozen=True)
class SoFar:
    """Counts of the states that were judged.

    Parameters
    ----------
    rates : mapping
        The rates of safe states by what a gate calls them.
    unsafe, unknown : int
        How many states have such a verdict.
    unjudged : mapping
        How many have none yet: `overall`, and of the episodes with each outcome.
    """

    rates: Mapping[str, Rate]
    unsafe: int
    unknown: int
    unjudged: Unjudged


Enough = Callable[[SoFar], bool]


def unjudged_of(outcome: NDArray[np.str_]) -> Unjudged:
    """Count states by the outcomes (N,) of their episodes."""
    return {"overall": len(outcome), **{name: int((outcome == name).sum()) for name in OUTCOMES}}


class JudgedCount:
    """Counts what is found in consecutive states, and asks whether that will do.

    Parameters
    ----------
    outcome : ndarray
        (N,) outcome of each state's episode.
    enough : callable
        Told of the states so far.
    """

    def __init__(self, outcome: NDArray[np.str_], enough: Enough) -> None:
        self._outcome, self._enough = outcome, enough
        self._parts = self._states = 0
        self._counts: dict[str, NDArray[np.int64]] = {}
        self._verdicts = np.zeros(2, dtype=np.int64)

    def __call__(self, parts: Sequence[StateFindings]) -> bool:
        """Return whether the first parts will do; those of the call before are known."""
        for part in parts[self._parts :]:
            self._add(part)
        self._parts = len(parts)
        return self._enough(self.so_far)

    @property
    def so_far(self) -> SoFar:
        """Return what is known."""
        rates = {name: Rate(int(safe), int(total)) for name, (safe, total) in self._counts.items()}
        unsafe, unknown = self._verdicts.tolist()
        return SoFar(rates, unsafe, unknown, unjudged_of(self._outcome[self._states :]))

    def _add(self, part: StateFindings) -> None:
        safe = part.judgement.safe
        outcome = self._outcome[self._states : self._states + len(safe)]
        every = np.ones(len(safe), dtype=bool)
        lasting: dict[str, Any] = {} if part.tubes is None else {"horizon": (part.tubes.safe, every)}
        for name, (good, counted) in {
            "overall": (safe, every),
            "danger": (part.judgement.danger, every),
            "sampled": (part.judgement.sampled, every),
            "contested": (safe, part.contested.collision),
            **{name: (safe, outcome == name) for name in OUTCOMES},
            **lasting,
        }.items():
            found = np.array([(good & counted).sum(), counted.sum()])
            self._counts[name] = self._counts.get(name, np.zeros(2, dtype=np.int64)) + found
        unknown = ~safe
        unknown[part.witnesses.state - self._states] = False
        self._verdicts += (len(part.witnesses.state), int(unknown.sum()))
        self._states += len(safe)
