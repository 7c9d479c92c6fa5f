"""How long the stages of a run take."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

_log = logging.getLogger(__name__)


class Clock:
    """Measures stages by the clock on the wall.

    Parameters
    ----------
    noted : bool
        Whether each stage is noted for ``--verbose``: not those of the many pieces of long work.

    Attributes
    ----------
    seconds : dict
        Of each stage that has ended.
    """

    def __init__(self, *, noted: bool = True) -> None:
        self.seconds: dict[str, float] = {}
        self._noted = noted

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Measure a block as one stage."""
        start = time.perf_counter()
        yield
        self.seconds[stage] = time.perf_counter() - start
        if self._noted:
            _log.info("%s: took %.3f s", stage, self.seconds[stage])

    def share_out(self, stage: str, parts: Mapping[str, float]) -> None:
        """Replace a stage by its parts, which went on side by side: each gets its share of the time.

        Parameters
        ----------
        stage : str
            A stage that has ended.
        parts : mapping
            The time that all workers together spent on each part.
        """
        elapsed, spent = self.seconds.pop(stage), sum(parts.values())
        for name, seconds in parts.items():
            self.seconds[name] = elapsed * seconds / spent if spent else 0.0
            _log.info("%s: of that %s %.3f s", stage, name, self.seconds[name])
