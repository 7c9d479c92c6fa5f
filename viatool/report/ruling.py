"""What a gate makes of all that a report tells: the one place that decides what is an error, and what a warning.

A part of a run is an error exactly if a condition that fails the gate counts it. Below that, and under ``--exit-zero``,
what is not safe is a warning. So exit codes, JUnit, SARIF and annotations cannot disagree.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from functools import cached_property

from viatool.report.sections import Annotation, Case, Check, Finding, Key

_LEVELS = {"passed": "notice", "warning": "warning", "failure": "error", "error": "error"}


class Ruling:
    """The decided conditions of a gate, and what they mean for each part of the run.

    Parameters
    ----------
    checks : sequence of Check
        The conditions; none for a report without a gate, in which nothing is an error.
    """

    def __init__(self, checks: Sequence[Check]) -> None:
        self.checks = checks

    @property
    def names(self) -> list[str]:
        """Return what each condition is called: as it is asked, with a number where that is asked again."""
        asked = [check.condition for check in self.checks]
        again = [asked[:place].count(name) for place, name in enumerate(asked)]
        return [f"{name} ({times + 1})" if times else name for name, times in zip(asked, again, strict=True)]

    @property
    def outcome(self) -> str:
        """Return unfounded, empty, failed or passed: the gravest comes first, and decides the exit code."""
        if any(check.unfounded for check in self.checks):
            return "unfounded"
        if any(check.empty for check in self.checks):
            return "empty"
        return "failed" if any(check.outcome == "failure" for check in self.checks) else "passed"

    @cached_property
    def _conditions(self) -> Mapping[Key, Sequence[Check]]:
        """Return the conditions that do not hold because of a part of the run, waived ones among them."""
        found: dict[Key, list[Check]] = {}
        for check in self.checks:
            for key in dict.fromkeys(finding.key for finding in check.failing):
                found.setdefault(key, []).append(check)
        return found

    @cached_property
    def _failing(self) -> frozenset[Key]:
        return frozenset(
            finding.key for check in self.checks if check.outcome == "failure" for finding in check.failing
        )

    def conditions(self, keys: Collection[Key]) -> list[str]:
        """Return the conditions that do not hold because of some parts of the run, in the order of the gate."""
        there = {id(check) for key in keys for check in self._conditions.get(key, ())}
        return [check.condition for check in self.checks if id(check) in there]

    def fails(self, keys: Collection[Key]) -> bool:
        """Return whether the gate fails because of one of some parts of the run."""
        return bool(self._failing) and not self._failing.isdisjoint(keys)

    def of_case(self, case: Case) -> str:
        """Return passed, warning, failure or skipped."""
        if self.fails(case.subjects):
            return "failure"
        return case.outcome if case.outcome in ("passed", "skipped") else "warning"

    def of_finding(self, finding: Finding, level: str) -> str:
        """Return the level of a finding whose rule has a level: error, or at most warning."""
        return "error" if self.fails((finding.key,)) else "warning" if level == "error" else level

    def of_annotation(self, annotation: Annotation) -> str:
        """Return the level of a remark: error, or at most warning."""
        if self.fails(annotation.subjects):
            return "error"
        return "warning" if annotation.level == "error" else annotation.level

    @staticmethod
    def of_check(check: Check) -> str:
        """Return the level of a condition: error, warning, or notice if it holds."""
        return _LEVELS[check.outcome]

    def found_besides(self, findings: Collection[Finding]) -> list[Finding]:
        """Return what makes conditions fail and is not among the findings that a report has without a gate."""
        known = {finding.key for finding in findings}
        besides = {f.key: f for check in self.checks for f in check.failing if f.key not in known}
        return list(besides.values())
