"""What a gate asks of a report on missions, before there is one: while missions are still being judged."""

from __future__ import annotations

from viatool.missions.so_far import MissionsKnown
from viatool.report.missions.document import MissionsDocument, left_out_of
from viatool.report.sections import Count, Share
from viatool.report.stopped import JudgedSoFar


class MissionsSoFar(JudgedSoFar, MissionsDocument):
    """The missions that were judged so far, as far as a gate counts them.

    Parameters
    ----------
    found : MissionsKnown
        Their verdicts.
    """

    def __init__(self, found: MissionsKnown) -> None:
        verdicts = found.verdicts
        share = Share(verdicts["proved"], sum(verdicts.values()))
        limited = {
            "unsafe": Count(verdicts["refuted"], "refuted missions"),
            "unknown": Count(verdicts["unknown"], "unknown missions"),
        }
        rates = dict.fromkeys(self.RATES, share)
        super().__init__(rates, limited, left_out_of(found.unjudged), share.total)
