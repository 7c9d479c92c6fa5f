"""What every kind of report says of what was not judged, because the outcome of the gate was certain before."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from viatool.report.document import Document, LeftOut
from viatool.report.numbers import count, counted
from viatool.report.sections import Count, Facts, Finding, Share

CERTAIN = "the outcome of the gate was certain before"


def not_judged(left: int, judged: int, subject: str) -> str:
    """Say how many subjects were not judged; nothing if all were."""
    return f"{count(left)} of {counted(left + judged, subject)} not judged" if left else ""


def behind(left_out: str, figures: str) -> str:
    """Return figures in words behind what was left out of them, see `not_judged`; alone if nothing was."""
    return f"stopped early, {left_out}; of the others: {figures}" if left_out else figures


def stopped(
    subjects: str, left: str, figures: str = "", others: Sequence[tuple[str, str]] = ()
) -> Sequence[Facts]:
    """Return what was left out, and of what figures are; nothing if `left`, which says how many, is empty."""
    if not left:
        return []
    of = f"of the {subjects} that were judged, the first ones{figures}"
    pairs = ((f"{subjects} not judged", left), *others, ("why", CERTAIN), ("figures", of))
    return [Facts("Stopped early", pairs)]


class JudgedSoFar(Document):
    """What a gate asks of a report before there is one; the kind of report that it becomes is the other base.

    Parameters
    ----------
    rates, limited : mapping
        Of what was judged, see `Document`.
    left_out : mapping
        What each of them may yet count.
    size : int
        How many subjects were judged.
    """

    def __init__(
        self,
        rates: Mapping[str, Share],
        limited: Mapping[str, Count],
        left_out: Mapping[str, LeftOut],
        size: int,
    ) -> None:
        self._rates, self._limited, self._left_out, self._size = rates, limited, left_out, size

    @property
    def rates(self) -> Mapping[str, Share]:
        """Return the rates that are known."""
        return self._rates

    @property
    def limited(self) -> Mapping[str, Count]:
        """Return what limits count."""
        return self._limited

    @property
    def left_out(self) -> Mapping[str, LeftOut]:
        """Return what each rate and limit may yet count."""
        return self._left_out

    @property
    def incomplete(self) -> str:
        """Say nothing: what is left out is counted."""
        return ""

    @property
    def size(self) -> int:
        """Return how many subjects were judged."""
        return self._size

    def nothing(self, rate: str) -> str:
        """Say that there are none."""
        return self.EMPTY

    def counted(self, name: str) -> Iterator[Finding]:
        """Name nothing: conditions are decided again when all is known."""
        return iter(())
