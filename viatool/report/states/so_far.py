"""What a gate asks of a report on states, before there is one: while states are still being judged."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from viatool.report.document import LeftOut
from viatool.report.sections import Count, Finding, Share
from viatool.report.states.document import StatesDocument
from viatool.report.states.stopped import left_out_of
from viatool.verification.so_far import SoFar


class StatesSoFar(StatesDocument):
    """The states that were judged so far, as far as a gate counts them.

    Parameters
    ----------
    found : SoFar
        Their counts.
    """

    def __init__(self, found: SoFar) -> None:
        self.found = found

    @property
    def rates(self) -> Mapping[str, Share]:
        """Return every rate but that of close places."""
        return {name: Share(rate.safe, rate.total) for name, rate in self.found.rates.items()}

    @property
    def limited(self) -> Mapping[str, Count]:
        """Return how many states are unsafe, unknown and contested."""
        return {
            "unsafe": Count(self.found.unsafe, "unsafe"),
            "unknown": Count(self.found.unknown, "unknown"),
            "contested": Count(self.found.rates["contested"].total, "contested"),
        }

    @property
    def left_out(self) -> Mapping[str, LeftOut]:
        """Return how many states each rate and limit may yet count."""
        return left_out_of(self.found.unjudged)

    @property
    def incomplete(self) -> str:
        """Say nothing: what is left out is counted."""
        return ""

    @property
    def size(self) -> int:
        """Return how many states were judged."""
        return self.found.rates["overall"].total

    def nothing(self, rate: str) -> str:
        """Say that there are none."""
        return self.EMPTY

    def counted(self, name: str) -> Iterator[Finding]:
        """Name no state: conditions are decided again when all is known."""
        return iter(())
