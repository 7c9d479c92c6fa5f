"""The exit code of many cells."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from viatool.projects import worst
from viatool.projects.records import CellRecord, ConditionRecord, outcome_of

CODES = st.lists(st.sampled_from([0, 1, 2, 3, 5]), min_size=1)


@given(CODES)
def test_one_code_for_all_is_the_worst(codes: list[int]) -> None:
    rank = {3: 0, 2: 1, 5: 2, 1: 3, 0: 4}
    assert worst(codes) == min(codes, key=rank.__getitem__)


@given(CODES, st.integers().filter(lambda code: code not in (0, 1, 2, 3, 5)))
def test_a_code_that_nobody_knows_is_never_a_pass(codes: list[int], unknown: int) -> None:
    assert worst([*codes, unknown]) == 3


def test_without_cells_nothing_was_evaluated() -> None:
    assert worst([]) == 5


def test_a_cell_that_was_not_run_is_no_pass() -> None:
    assert CellRecord(name="a/b/c", check="a", kind="verify", policy="b", map="c").exit_code == 3


def test_what_passes_without_having_to_is_not_called_passed() -> None:
    failed = ConditionRecord(condition="safety rate >= 100 %", passed=False, figures="99 %")
    assert outcome_of(0, []) == "no gate"
    assert outcome_of(0, [failed]) == "gate failed, exit zero"
    assert outcome_of(0, [failed.model_copy(update={"passed": True})]) == "passed"
