"""What a gate asks of a certificate, before there is one: while roots are still being examined."""

from __future__ import annotations

from viatool.places.so_far import CellsKnown
from viatool.report.places.document import PlacesDocument, left_out_of
from viatool.report.sections import Count, Share
from viatool.report.stopped import JudgedSoFar


class PlacesSoFar(JudgedSoFar, PlacesDocument):
    """The cells that were judged so far, as far as a gate counts them; of what holds later it knows nothing.

    Parameters
    ----------
    found : CellsKnown
        Their volumes.
    """

    def __init__(self, found: CellsKnown) -> None:
        rates = {"contested": Share(*found.contested), "overall": Share(*found.free)}
        limited = {
            "unsafe": Count(found.refuted, "refuted cells"),
            "unknown": Count(found.unknown, "unknown cells"),
        }
        super().__init__(rates, limited, left_out_of(found.unjudged), sum(found.units.values()))
