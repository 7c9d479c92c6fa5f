"""How long the stages of a run take."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager


class Clock:
    """Measures stages by the clock on the wall.

    Attributes
    ----------
    seconds : dict
        Of each stage that has ended.
    """

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def timed(self, stage: str) -> Iterator[None]:
        """Measure a block as one stage."""
        start = time.perf_counter()
        yield
        self.seconds[stage] = time.perf_counter() - start

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
