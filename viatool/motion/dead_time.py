"""Dead time: how long a command is on its way to the motors, and which ones act until it arrives."""

from __future__ import annotations

from dataclasses import dataclass

_SAME = 1e-9  # relative to the interval: a dead time of whole intervals, up to rounding


@dataclass(frozen=True)
class DeadTime:
    """A command that is given now acts after `delay`, for one `interval`; those before it act until then.

    Parameters
    ----------
    delay : float
        Seconds on the way; 0 for commands that act at once.
    interval : float
        Seconds between two commands.
    """

    delay: float
    interval: float

    @property
    def whole(self) -> int:
        """Return how many whole intervals the dead time holds."""
        return int(self.delay / self.interval + _SAME)

    @property
    def rest(self) -> float:
        """Return the seconds of the dead time beyond its whole intervals."""
        rest = self.delay - self.whole * self.interval
        return 0.0 if rest < _SAME * self.interval else rest

    @property
    def durations(self) -> tuple[float, ...]:
        """Return for how long each of the W commands on their way still acts, the oldest first; in sum, `delay`."""
        oldest = (self.rest,) if self.rest else ()
        return (*oldest, *([self.interval] * self.whole))

    @property
    def commands(self) -> int:
        """Return W, how many commands are on their way."""
        return len(self.durations)
