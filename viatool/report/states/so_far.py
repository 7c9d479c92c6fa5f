"""What a gate asks of a report on states, before there is one: while states are still being judged."""

from __future__ import annotations

from viatool.report.sections import Count, Share
from viatool.report.states.document import StatesDocument
from viatool.report.states.stopped import left_out_of
from viatool.report.stopped import JudgedSoFar
from viatool.verification.so_far import SoFar


class StatesSoFar(JudgedSoFar, StatesDocument):
    """The states that were judged so far, as far as a gate counts them; of close places it knows nothing.

    Parameters
    ----------
    found : SoFar
        Their counts.
    """

    def __init__(self, found: SoFar) -> None:
        rates = {name: Share(rate.safe, rate.total) for name, rate in found.rates.items()}
        limited = {
            "unsafe": Count(found.unsafe, "unsafe"),
            "unknown": Count(found.unknown, "unknown"),
            "contested": Count(rates["contested"].total, "contested"),
        }
        super().__init__(rates, limited, left_out_of(found.unjudged), rates["overall"].total)
