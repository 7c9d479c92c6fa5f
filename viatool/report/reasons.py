"""Why states are not safe, as every kind of report tells it: data, and the table of the worst."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from viatool.errors import ConfigurationError
from viatool.report.numbers import count
from viatool.report.records import Amount, Count, ReportPart
from viatool.report.sections import Table

_SHOWN = 3
"""Rows of the table."""


class CommandEnds(ReportPart):
    """Ends of commands, as the robot carries them out."""

    lower: list[float]
    upper: list[float]


class SafeUpTo(ReportPart):
    """The largest share of eps, in sixteenths, up to which a state is safe, and what that is."""

    share: Amount
    eps: Any


class ReasonRecord(ReportPart):
    """Why a state is not safe.

    `cause` is "pose" (it stands too near already, `standing` metres are left there), "policy" (it fails without any
    error as well), "errors" (it fails by them), or of an unknown state "bounds" (what was found attained is safe, so
    that tighter bounds may prove it), "commands" (what was found attained fails, taken together, so that they cannot),
    "open" (neither) or "unobserved" (what was commanded before is not known). `command` is that of the counterexample,
    or what cannot be excluded that comes nearest to the `obstacle`, of the ends and middles of all axes: with
    `clearance` metres left after `seconds`, `at` that pose, where more than `distance` has to be kept. `bound` holds
    the commands that cannot be excluded, `attained` those that were found, and `gap` is how far the one reaches beyond
    the other. `needs` is the least set of errors without which the state is safe, `alternatives` are others that do as
    well, each by itself; `without_errors` is the verdict without any error, None where that was not asked. `refined`
    tells whether ``--refine split`` proves it. `brief` and `words` say it all.
    """

    state: Count
    verdict: Literal["unsafe", "unknown"]
    scenario: str
    time: float
    pose: tuple[float, float, float]
    criterion: str
    distance: Amount
    cause: Literal["pose", "policy", "errors", "bounds", "commands", "open", "unobserved"]
    obstacle: str | None
    command: list[float] | None
    clearance: Amount | None
    seconds: Amount | None
    at: list[float] | None
    bound: CommandEnds | None
    attained: CommandEnds | None
    attained_clearance: Amount | None
    standing: float | None
    gap: list[Amount] | None
    without_errors: Literal["safe", "unsafe", "unknown"] | None
    needs: list[str]
    alternatives: list[str]
    safe_up_to: SafeUpTo | None
    refined: bool | None
    brief: str
    words: str

    @property
    def place(self) -> str:
        """Return in words where the state is."""
        x, y, heading = self.pose
        return f"scenario {self.scenario} at {self.time:.2f} s, x {x:.3f} m, y {y:.3f} m, heading {heading:.3f} rad"


@dataclass(frozen=True)
class Failing:
    """States, or close places, of which some are not safe.

    Parameters
    ----------
    what : str
        What one of them is called.
    size : int
        How many there are.
    unsafe : frozenset of int
        Those with a counterexample.
    reasons : mapping or None
        Why they are not safe, the worst first; None where a report does not say.
    left_out : int
        Of how many that are not safe it is not told.
    proved : str
        What makes one safe: "proved", or less.
    """

    what: str
    size: int
    unsafe: frozenset[int]
    reasons: Mapping[int, ReasonRecord] | None
    left_out: int
    proved: str

    @property
    def worst(self) -> Table:
        """Return the worst of them."""
        reasons = list((self.reasons or {}).values())
        total = len(reasons) + self.left_out
        rows = tuple((str(one.state), one.verdict, one.brief) for one in reasons[:_SHOWN])
        more = "" if len(rows) == total else f"the worst {count(len(rows))} of {count(total)}; "
        remark = f"{more}viatool explain tells more of a report in JSON"
        return Table((self.what, "verdict", "why"), rows, f"Why {self.what}s are not safe", remark, texts=2)

    def rows(self) -> Iterator[tuple[str, ...]]:
        """Yield all of them."""
        for one in self._told.values():
            yield (f"{self.what} {one.state}", one.scenario, f"{one.time:.2f}", one.verdict, one.brief)

    def explain(self, number: int) -> str:
        """Return why one of them is not safe, by its number."""
        if not 0 <= number < self.size:
            some = f"{self.what}s 0 to {count(self.size - 1)}" if self.size else f"no {self.what}s"
            raise ConfigurationError(
                f"there is no {self.what} {number}: the report is on {some}", "give one of these numbers"
            )
        name, told = f"{self.what} {number}", self._told
        if (found := told.get(number)) is not None:
            return f"{name[0].upper()}{name[1:]} is {found.verdict}: {found.place}.\n\n{found.words}"
        if self.left_out:
            known = "is unsafe, but it" if number in self.unsafe else "may be safe or unknown: it"
            raise ConfigurationError(
                f"{name} {known} is none of the {count(len(told))} worst, of which the report says why",
                "verify fewer scenarios, its own among them",
            )
        return f"{name[0].upper()}{name[1:]} is {self.proved} safe: nothing to explain."

    @property
    def _told(self) -> Mapping[int, ReasonRecord]:
        """Return why they are not safe; ConfigurationError where the report does not say."""
        if self.reasons is None:
            raise ConfigurationError(
                f"the report does not say why {self.what}s are not safe: an older viatool wrote it",
                "write it again with viatool verify ... --output json:PATH",
            )
        return self.reasons
