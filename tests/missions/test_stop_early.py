"""Missions that stop early end as all of them do, and say what was left out."""

from __future__ import annotations

from fractions import Fraction
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from viatool.missions import mission
from viatool.missions.so_far import MissionsKnown
from viatool.missions.verdicts import MISSION_VERDICTS
from viatool.report import Gate, Threshold, evaluate
from viatool.report.gate import is_certain
from viatool.report.missions.document import MissionsDocument
from viatool.report.missions.so_far import MissionsSoFar
from viatool.report.ruling import Ruling
from viatool.schedule import Campaign

LEAST = st.sampled_from([Fraction(0), Fraction(1, 3), Fraction(1, 2), Fraction(9, 10), Fraction(1)])
THRESHOLDS = st.lists(st.builds(Threshold, st.sampled_from(["overall", "mission"]), LEAST), max_size=2)
LIMIT = st.none() | st.integers(0, 5)
GATES = st.builds(Gate, THRESHOLDS.map(tuple), max_unsafe=LIMIT, max_unknown=LIMIT, exit_zero=st.booleans())


def so_far(verdicts: list[str], total: int) -> Any:
    missions: Any = [SimpleNamespace(verdict=verdict) for verdict in verdicts]
    return MissionsSoFar(MissionsKnown.of(missions, total))


@settings(max_examples=150, deadline=None)
@given(gate=GATES, verdicts=st.lists(st.sampled_from(MISSION_VERDICTS), min_size=1, max_size=9))
def test_no_later_mission_changes_how_a_gate_ends_that_is_certain(gate: Gate, verdicts: list[str]) -> None:
    total = len(verdicts)
    whole = Ruling(evaluate(gate, so_far(verdicts, total))).outcome
    judged = next(
        (n for n in range(1, total + 1) if is_certain(evaluate(gate, so_far(verdicts[:n], total)))), total
    )
    assert Ruling(evaluate(gate, so_far(verdicts[:judged], total))).outcome == whole


@pytest.mark.parametrize(
    ("gate", "verdicts", "certain"),
    [
        (Gate((Threshold("mission", Fraction(1, 2)),)), ["proved", "proved"], True),
        (Gate((Threshold("mission", Fraction(1, 2)),)), ["proved", "unknown"], False),
        (Gate((Threshold("overall", Fraction(1)),)), ["proved", "unknown"], True),
        (Gate(max_unsafe=0), ["proved", "unknown"], False),
        (Gate(max_unsafe=0), ["refuted"], True),
        (Gate(max_unknown=2), ["proved", "refuted"], True),
        (Gate((Threshold("mission", Fraction(1, 4)),), max_unsafe=0), ["proved"], False),  # a collision fails it
    ],
)  # fmt: skip
def test_missions_are_certain_when_nothing_can_change_the_gate(
    gate: Gate, verdicts: list[str], certain: bool
) -> None:
    assert is_certain(evaluate(gate, so_far(verdicts, 4))) is certain


def test_a_run_that_goes_on_from_a_checkpoint_stops_where_the_first_one_did(hall, dodging, tmp_path):
    def once(found: MissionsKnown) -> bool:
        return found.unjudged <= 1

    known = {"eps": 0.01, "time_limit": 2.0, "enough": once}
    kept = tmp_path / "kept"
    first = mission(dodging, hall, **known, campaign=Campaign(checkpoint=kept))
    again = mission(dodging, hall, **known, campaign=Campaign(checkpoint=kept, resume=True))
    assert [one.scenario.name for one in first] == [hall.scenarios[0].name]
    assert first.unjudged == again.unjudged == hall.scenarios[1:]
    ours, theirs = (MissionsDocument(one.to_json()) for one in (first, again))
    assert ours.record.missions == theirs.record.missions
    whole = mission(
        dodging, hall, **{**known, "enough": None}, campaign=Campaign(checkpoint=kept, resume=True)
    )
    assert whole.unjudged == ()
    assert "not_judged" not in whole.to_json()
    later = mission(dodging, hall, **known, campaign=Campaign(checkpoint=kept, resume=True))
    assert later.to_json()["not_judged"] == {"overall": 1, "scenarios": [hall.scenarios[1].name]}
    assert later.counts["proved"] + later.counts["refuted"] + later.counts["unknown"] == 1
