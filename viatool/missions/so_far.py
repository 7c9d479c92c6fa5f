"""What is known of missions while others are still to be judged: as much as a gate asks of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from viatool.missions.verdicts import Mission, count_verdicts


@dataclass(frozen=True)
class MissionsKnown:
    """Verdicts of the missions that were judged.

    Parameters
    ----------
    verdicts : mapping
        How many missions have each verdict.
    unjudged : int
        How many have none yet.
    """

    verdicts: Mapping[str, int]
    unjudged: int

    @classmethod
    def of(cls, judged: Sequence[Mission], total: int) -> MissionsKnown:
        """Return what is known when the first of all missions are judged."""
        return cls(count_verdicts(judged), total - len(judged))


Enough = Callable[[MissionsKnown], bool]
