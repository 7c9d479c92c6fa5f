"""When commands act: intervals and delays that vary within bounds, and commands that are computed late.

Time counts from the observation. Its command is number 0; number k was given k intervals before it. An interval lasts
between dt- and dt+. A command is computed from an observation that is up to S seconds old, and is on its way for
between d- and d+ seconds, so it begins to act between d- and ``D = d+ + S`` after the observation it was computed
from. Commands do not overtake each other, and one acts until the next one does. Hence, at the time t, command 0 may
act from d- on, and command k >= 1

    at ``d- - k dt+`` at the earliest, and until ``D - (k - 1) dt-`` at the latest.

`phases` cuts the time where the set of commands that may act changes. The next command acts at ``D + dt+`` at the
latest (`last`); a robot that shall stop instead begins to between ``d- + dt-`` (`first`) and then.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

from viatool.errors import ConfigurationError

_SAME = 1e-12  # relative to an interval: two instants, up to rounding; far less than what distances allow for


@dataclass(frozen=True)
class Phase:
    """A time in which the same commands may act.

    Parameters
    ----------
    start, end : float
        Seconds since the observation.
    commands : tuple of int
        Which may act: 0 for the new one, k for the one that was given k intervals before it.
    stopping : bool
        Whether the robot may have begun to stop instead.
    """

    start: float
    end: float
    commands: tuple[int, ...]
    stopping: bool = False


@dataclass(frozen=True)
class Timing:
    """When commands act.

    Parameters
    ----------
    interval : tuple of float
        dt- and dt+: shortest and longest time between two commands, in seconds.
    delay : tuple of float
        d- and d+: shortest and longest time on the way to the motors, in seconds.
    age : float
        S: how old an observation is at most when a command is computed from it, in seconds.

    Raises
    ------
    ConfigurationError
        If a bound is negative, not finite or above the other one, or an interval may be 0.
    """

    interval: tuple[float, float]
    delay: tuple[float, float] = (0.0, 0.0)
    age: float = 0.0

    def __post_init__(self) -> None:
        for name, (least, most) in (
            ("interval", self.interval),
            ("delay", self.delay),
            ("age", (0.0, self.age)),
        ):
            if not 0.0 <= least <= most < math.inf:
                raise ConfigurationError(
                    f"the {name} of commands is {least:g} to {most:g} s, expected finite times of 0 or more, the least "
                    "first",
                    f"correct the {name}",
                )
        if self.interval[0] <= 0.0:
            raise ConfigurationError(
                f"the interval of commands is {self.interval[0]:g} s at least, expected a positive time",
                "give the shortest time between two commands, in seconds",
            )

    @property
    def words(self) -> str:
        """Return it in words."""
        least, most = self.delay
        old = f" on observations up to {self.age:g} s old" if self.age else ""
        return f"{least:g} to {most:g} s{old}, commands {self.interval[0]:g} to {self.interval[1]:g} s apart"

    @property
    def latest(self) -> float:
        """Return D, after how many seconds a command acts at the latest."""
        return self.delay[1] + self.age

    @property
    def first(self) -> float:
        """Return after how many seconds the next command acts at the earliest."""
        return self.delay[0] + self.interval[0]

    @property
    def last(self) -> float:
        """Return after how many seconds the next command acts at the latest."""
        return self.latest + self.interval[1]

    @property
    def observed(self) -> tuple[float, float]:
        """Return after how many seconds the robot observes next, at the earliest and at the latest.

        The present observation and the next one may each be up to S old when commands are computed from them.
        """
        return max(self.interval[0] - self.age, 0.0), self.interval[1] + self.age

    @property
    def commands(self) -> int:
        """Return W, how many of the commands before may still act after the observation."""
        return math.ceil(self.latest / self.interval[0] - _SAME)

    def span(self, command: int) -> tuple[float, float]:
        """Return when a command (k >= 1 given before) may act at the earliest and at the latest."""
        shortest, longest = self.interval
        return self.delay[0] - command * longest, self.latest - (command - 1) * shortest

    def known_from(self, commands: int) -> float:
        """Return from when on only the last so many commands and the new one may act; at most 0, the observation."""
        return min(0.0, self.span(commands + 1)[1])

    def phases(self, commands: int, *, stops: bool) -> tuple[Phase, ...]:
        """Cut the time until the next command acts, or the robot has begun to stop, where something changes.

        Parameters
        ----------
        commands : int
            How many of the commands before are known, at least `commands`.
        stops : bool
            Whether the robot begins to stop instead of receiving the next command.
        """
        if commands < self.commands:
            raise ValueError(f"{commands} commands before are given, {self.commands} may still act")
        begin, tiny = self.known_from(commands), _SAME * self.interval[0]
        spans = {0: (self.delay[0], self.last)} | {k: self.span(k) for k in range(1, commands + 1)}
        changes = {begin, 0.0, self.last} | {at for span in spans.values() for at in span}
        if stops:
            changes.add(self.first)
        edges = [begin]
        for at in sorted(at for at in changes if begin < at <= self.last):
            if at > edges[-1] + tiny:
                edges.append(at)
            elif at in (0.0, self.last):
                edges[-1] = at
        phases = []
        for start, end in pairwise(edges):
            acting = tuple(
                k for k, (first, last) in spans.items() if first < end - tiny and last > start + tiny
            )
            phases.append(Phase(start, end, acting, stops and self.first < end - tiny))
        return tuple(phases)
