"""The conditions of the gate as a page shows them: each with what makes it fail, and where the page shows that."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from viatool.report.foreign import one_line
from viatool.report.numbers import count
from viatool.report.sections import Check, Key

MOST_ITEMS = 1000
"""Of each condition; how many more there are is said."""

Address = Callable[[Key], str]
"""Where a page shows a part of the run, such as ``#state=12``; empty where it does not."""


@dataclass(frozen=True)
class ShownCondition:
    """A decided condition on a page.

    Parameters
    ----------
    check : Check
        What was decided.
    number : int or None
        Its place among those that do not hold, which is how filters call it; None if it holds.
    items : sequence of (str, str)
        What makes it fail, in a sentence, with the address; at most `MOST_ITEMS`.
    """

    check: Check
    number: int | None
    items: Sequence[tuple[str, str]]

    @property
    def tone(self) -> str:
        """Return how the style sheet calls it."""
        return "passed" if self.check.passed else "failed"

    @property
    def told(self) -> str:
        """Say how many items make it fail."""
        found = len(self.check.failing)
        first = f", the first {count(MOST_ITEMS)} of them" if found > MOST_ITEMS else ""
        return f"what fails it: {count(found)}{first}"


def conditions_of(checks: Sequence[Check], address: Address) -> list[ShownCondition]:
    """Return what a page shows of each condition."""
    shown, failed = [], 0
    for check in checks:
        items = [(one_line(one.text), address(one.key)) for one in check.failing[:MOST_ITEMS]]
        shown.append(ShownCondition(check, None if check.passed else failed, items))
        failed += not check.passed
    return shown


def no_address(_: Key) -> str:
    """Return that a page shows no part of a run by itself."""
    return ""
