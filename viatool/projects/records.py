"""What is known of a cell that was run, and of a project: typed, and stored as JSON."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

SCHEMA_VERSION = 1
ORDER = (3, 2, 5, 1, 0)
"""Exit codes, the worst first."""
OUTCOMES = {
    0: "passed",
    1: "gate failed",
    2: "unusable input",
    3: "internal error",
    5: "nothing evaluated",
}
NOT_RUN = "not run"
_SETTLED = (0, 1, 5)
"""Exit codes that the same inputs lead to again."""


def worst(codes: Iterable[int]) -> int:
    """Return the worst of some exit codes, in the order 3, 2, 5, 1, 0; one that is none of them is as bad as 3.

    Without any code nothing was evaluated, which is 5.
    """
    found = {code if code in ORDER else 3 for code in codes}
    return next((code for code in ORDER if code in found), 5)


class _Record(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore")


class ConditionRecord(_Record):
    """One decided condition of a cell's gate."""

    condition: str
    passed: bool
    figures: str
    empty: bool = False
    unfounded: bool = False


class CellRecord(_Record):
    """What became of a cell."""

    name: str
    check: str
    kind: str
    policy: str
    map: str
    axes: dict[str, Any] = {}
    command: list[str] = Field(default=[], description="the words that run the cell by itself")
    code: int | None = Field(default=None, description="its exit code; null if it was not run yet")
    outcome: str = NOT_RUN
    stake: str = Field(default="", description="in how many states the policy was put to the test")
    headline: str = ""
    figures: str = ""
    conditions: list[ConditionRecord] = []
    message: str = Field(default="", description="what was said on stderr when it failed")
    seconds: Annotated[float, Field(ge=0.0)] = 0.0
    inputs: str = Field(default="", description="digest of all that its outcome depends on")
    reports: dict[str, str] = Field(
        default={}, description="its files by format, relative to the folder of the project"
    )
    run: bool = Field(default=False, description="whether it was asked for, and counts for the exit code")
    reused: bool = Field(default=False, description="whether it was finished before, with the same inputs")

    @property
    def settled(self) -> bool:
        """Return whether it need not be run again while its inputs are the same."""
        return self.code in _SETTLED

    @property
    def exit_code(self) -> int:
        """Return what it counts for; what was asked for and not run is an internal error."""
        return 3 if self.code is None else self.code

    @property
    def accepted(self) -> list[ConditionRecord]:
        """Return what became of its accepted findings."""
        return [one for one in self.conditions if one.condition.startswith("accepted until ")]


def outcome_of(code: int, conditions: Iterable[ConditionRecord]) -> str:
    """Return in words how a cell ended."""
    conditions = list(conditions)
    if code == 0 and not conditions:
        return "no gate"
    if code == 0 and not all(one.passed for one in conditions):
        return "gate failed, exit zero"
    return OUTCOMES.get(code, OUTCOMES[3])


class ProjectSummary(_Record):
    """What became of a project: every cell, and the exit code of those that were asked for."""

    schema_version: Annotated[int, Field(ge=1, le=1)] = SCHEMA_VERSION
    project: str
    viatool: str
    exit_code: int
    cells: list[CellRecord]

    @property
    def counted(self) -> list[CellRecord]:
        """Return the cells that were asked for."""
        return [cell for cell in self.cells if cell.run]
