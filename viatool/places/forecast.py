"""How long a certificate will take, judged by a few of its roots before it is begun."""

from __future__ import annotations

import time

import numpy as np

from viatool.places.campaign import RootWork
from viatool.schedule import Progress
from viatool.schedule.durations import duration

_ROOTS = 128
"""Drawn at random; a batch of as many takes each half as long again as one of a whole piece does."""
_LONG = 60.0
"""Seconds; of less nobody is told."""


def foretell(work: RootWork, workers: int, tell: Progress) -> None:
    """Tell how long all roots take, and which share of them takes a minute; nothing if all of them take no longer.

    Parameters
    ----------
    work : RootWork
        N roots in random order.
    workers : int
        Who share them.
    tell : Progress
        Is given a line.
    """
    count = len(work)
    if count < 8 * _ROOTS:
        return
    begun = time.perf_counter()
    work.function(np.sort(work.order[-_ROOTS:]))
    seconds = (time.perf_counter() - begun) * count / (_ROOTS * workers)
    if seconds > _LONG:
        share = work.share * _LONG / seconds
        tell(
            work.stage, 0, count,
            f"{work.stage}: about {duration(seconds)} for {count:,}, judging by {_ROOTS} drawn at random; "
            f"--sample {share:.1g} takes about a minute and estimates the volumes, --budget-seconds stops in time",
        )  # fmt: skip
