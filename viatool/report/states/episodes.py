"""What the reports say of each episode: its name, its outcome and its verdicts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from viatool.report.palette import VERDICTS

if TYPE_CHECKING:
    from viatool.verification.result import Result


@dataclass(frozen=True)
class Episode:
    """One episode.

    Parameters
    ----------
    index : int
        Its number in the trajectory.
    name : str
        Of its scenario, or its number.
    outcome : str
        success, collision, timeout or unknown.
    seconds : float
        How long it drove.
    safe, unsafe, unknown : int
        States with that verdict.
    first_unsafe : int or None
        Index of its first unsafe state among all states.
    """

    index: int
    name: str
    outcome: str
    seconds: float
    safe: int
    unsafe: int
    unknown: int
    first_unsafe: int | None

    @property
    def states(self) -> int:
        """Return how many states were judged."""
        return self.safe + self.unsafe + self.unknown


def summarise_episodes(result: Result) -> list[Episode]:
    """Return every episode of a result, in order."""
    trajectory, verdicts = result.trajectory, result.verdict
    counts = {
        verdict: np.bincount(trajectory.episode[verdicts == verdict], minlength=trajectory.episodes)
        for verdict in VERDICTS
    }
    longest = np.zeros(trajectory.episodes)
    np.maximum.at(longest, trajectory.episode, trajectory.time)
    unsafe = np.flatnonzero(verdicts == "unsafe")
    first = {int(trajectory.episode[state]): int(state) for state in unsafe[::-1]}
    return [
        Episode(
            index=index,
            name=trajectory.name_of(index),
            outcome=str(trajectory.outcomes[index]),
            seconds=float(longest[index]),
            first_unsafe=first.get(index),
            **{verdict: int(counts[verdict][index]) for verdict in VERDICTS},
        )
        for index in range(trajectory.episodes)
    ]
