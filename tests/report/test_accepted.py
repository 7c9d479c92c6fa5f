"""Accepted findings: they are not held against a gate, change no rate, and never hide what they do not name."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from datetime import date
from fractions import Fraction
from pathlib import Path
from typing import Any, ClassVar

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.report.toy_kind import TOY, ToyDocument
from viatool.errors import ConfigurationError
from viatool.report import Acceptance, Gate, accepted_text, evaluate, load_accepted
from viatool.report.gate import Threshold
from viatool.report.sections import Count, Finding, Share, Survivor

DAY = date(2026, 12, 1)
VERDICTS = ("safe", "unsafe", "unknown")


class States(ToyDocument):
    """States with these verdicts."""

    def __init__(self, verdicts: Sequence[str]) -> None:
        super().__init__(TOY)
        self.verdicts = verdicts

    @property
    def rates(self) -> Mapping[str, Share]:
        return {"overall": Share(self.verdicts.count("safe"), len(self.verdicts))}

    @property
    def size(self) -> int:
        return len(self.verdicts)

    @property
    def limited(self) -> Mapping[str, Count]:
        return {name: Count(self.verdicts.count(name), name) for name in VERDICTS[1:]}

    def findings(self) -> tuple[Iterable[Finding], int]:
        found = [
            Finding("toy", "", f"s/{k}", f"s/{k}", verdict, "s", k, dict.fromkeys(("overall", verdict), 1))
            for k, verdict in enumerate(self.verdicts)
            if verdict != "safe"
        ]
        return found, len(found)


def acceptance(**about: Any) -> Acceptance:
    given = {"verdict": "unsafe", "reason": "why", "expires": date(2027, 1, 31), **about}
    return Acceptance.model_validate({name.replace("_", "-"): value for name, value in given.items()})


STATES = st.lists(st.sampled_from(VERDICTS), min_size=1, max_size=12)
ACCEPTANCES = st.lists(
    st.builds(
        acceptance,
        verdict=st.sampled_from(VERDICTS[1:]),
        state=st.integers(0, 12),
        expires=st.sampled_from([date(2026, 11, 30), DAY, date(2027, 1, 31)]),
    ),
    max_size=6,
)


@given(STATES, ACCEPTANCES, st.fractions(0, 1, max_denominator=20), st.integers(0, 12), st.integers(0, 12))
def test_a_gate_passes_only_for_what_is_proved_or_named(
    verdicts: list[str], accepted: list[Acceptance], least: Fraction, unsafe: int, unknown: int
) -> None:
    document = States(verdicts)
    gate = Gate((Threshold("overall", least),), unsafe, unknown, accepted=tuple(accepted), today=DAY)
    checks = evaluate(gate, document)
    named = {
        one.state
        for one in accepted
        if one.expires >= DAY
        and one.state is not None
        and one.state < len(verdicts)
        and verdicts[one.state] in {"unsafe": ("unsafe", "unknown"), "unknown": ("unknown",)}[one.verdict]
    }
    left = [verdict for k, verdict in enumerate(verdicts) if k not in named]
    failing = sum(verdict != "safe" for verdict in left)
    assert [check.passed for check in checks[:3]] == [
        len(verdicts) - failing >= least * len(verdicts),
        left.count("unsafe") <= unsafe,
        left.count("unknown") <= unknown,
    ]
    assert f"{verdicts.count('safe')} of {len(verdicts)}" in checks[0].figures
    for one, check in zip(accepted, checks[3:], strict=True):
        assert check.passed == (one.state in named and one.expires >= DAY and _fits(one, verdicts))


def _fits(one: Acceptance, verdicts: Sequence[str]) -> bool:
    assert one.state is not None
    return verdicts[one.state] == one.verdict or (one.verdict, verdicts[one.state]) == ("unsafe", "unknown")


def test_one_finding_that_two_accept_is_one() -> None:
    twice = (acceptance(state=0), acceptance(place="s/0"))
    checks = evaluate(Gate(max_unsafe=1, accepted=twice, today=DAY), States(["unsafe"] * 3))
    assert [check.passed for check in checks] == [False, True, True]
    assert checks[0].figures == "3 unsafe, 1 accepted"


@pytest.mark.parametrize(("most", "passed"), [(1, False), (2, False), (3, True), (9, True)])
def test_a_scenario_accepts_all_of_its_findings_or_none(most: int, passed: bool) -> None:
    gate = Gate(max_unsafe=0, accepted=(acceptance(scenario="s", at_most=most),), today=DAY)
    checks = evaluate(gate, States(["unsafe", "safe", "unsafe", "unsafe"]))
    assert [check.passed for check in checks] == [passed, passed]


def test_the_last_day_counts_and_the_next_does_not() -> None:
    one = acceptance(state=0)
    for day, passed in ((date(2027, 1, 31), True), (date(2027, 2, 1), False)):
        checks = evaluate(Gate(max_unsafe=0, accepted=(one,), today=day), States(["unsafe"]))
        assert [check.passed for check in checks] == [passed, passed]


def test_a_kind_of_run_without_findings_cannot_accept_any() -> None:
    from viatool.report.states.document import StatesDocument

    stored = object.__new__(StatesDocument)
    with pytest.raises(ConfigurationError, match="cannot be accepted"):
        evaluate(Gate(accepted=(acceptance(state=0),)), stored)


def test_a_file_is_read_as_it_was_written(tmp_path: Path) -> None:
    accepted = (
        acceptance(state=0, at_most=3, cell="a/b"),
        acceptance(place='a "quoted"\n', verdict="unknown"),
    )
    (tmp_path / "accepted.toml").write_text(accepted_text(accepted), encoding="utf-8")
    assert load_accepted(tmp_path / "accepted.toml") == accepted


class Margins(ToyDocument):
    """Contested states with the errors up to which they are proved, and from which on they are refuted."""

    RADII: ClassVar[Mapping[str, str]] = {"margin": "error that every state survives"}

    def __init__(self, states: Sequence[tuple[float | None, float | None]]) -> None:
        super().__init__(TOY)
        self.states = states

    @property
    def size(self) -> int:
        return len(self.states)

    @property
    def survived(self) -> Mapping[str, Sequence[Survivor]]:
        found = [
            Survivor(f"state {k}", proved, Finding("weak", "", f"s/{k}", f"s/{k}", "", "s", k), refuted)
            for k, (proved, refuted) in enumerate(self.states)
        ]
        return {"margin": sorted(found, key=lambda one: -1.0 if one.error is None else one.error)}

    def findings(self) -> tuple[Iterable[Finding], int]:
        return (), 0


@pytest.mark.parametrize(
    ("accepted", "passed", "words"),
    [
        ((acceptance(state=1), acceptance(state=2, verdict="unknown")), True, "2 of 4 do not, 2 accepted"),
        ((acceptance(state=1),), False, "2 of 4 do not, 1 accepted"),
        ((acceptance(place="s/1", verdict="unknown"),), False, "2 of 4 do not"),
        ((acceptance(scenario="s", at_most=2),), True, "2 of 4 do not, 2 accepted"),
        ((acceptance(scenario="s", at_most=1),), False, "2 of 4 do not"),
        ((acceptance(state=1, expires=date(2026, 11, 30)), acceptance(state=2)), False, "1 accepted"),
    ],
)
def test_a_margin_that_is_too_small_can_be_accepted(
    accepted: tuple[Acceptance, ...], passed: bool, words: str
) -> None:
    document = Margins([(0.05, 0.06), (None, 0.01), (0.01, 0.03), (0.02, None)])
    least = Threshold("margin", Fraction("0.02"))
    check = evaluate(Gate((least,), accepted=accepted, today=DAY), document)[0]
    assert check.passed == passed
    assert check.figures.startswith("2 of 4 do not")
    assert words in check.figures
    (plain,) = evaluate(Gate((least,), today=DAY), document)
    assert not plain.passed
    assert [finding.state for finding in plain.failing] == [1, 2]
    assert [finding.verdict for finding in plain.failing] == ["unsafe", "unknown"]


def test_an_accepted_margin_that_the_gate_does_not_count_is_named() -> None:
    document = Margins([(0.05, 0.06), (0.01, None)])
    for number in (0, 7):  # one survives, the other is not there
        checks = evaluate(
            Gate((Threshold("margin", Fraction("0.02")),), accepted=(acceptance(state=number),), today=DAY),
            document,
        )
        assert checks[-1].unfounded
