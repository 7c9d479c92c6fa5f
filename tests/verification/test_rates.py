from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from viatool.verification.rates import Rate, RateByOutcome


@given(st.data())
def test_a_rate_shows_100_percent_only_when_every_state_is_safe(data):
    total = data.draw(st.integers(1, 10**9))
    safe = data.draw(st.one_of(st.integers(0, total), st.integers(max(0, total - 3), total)))
    rate = Rate(safe, total)
    assert str(rate).startswith("100.00 %") == (safe == total)
    assert (rate.rate == 1.0) == (safe == total)
    assert float(str(rate).split()[0]) <= 100.0 * safe / total + 1e-9


@given(st.lists(st.tuples(st.booleans(), st.sampled_from(["success", "collision", "timeout", "unknown"]))))
def test_outcomes_add_up(states):
    safe = np.array([state[0] for state in states], dtype=bool)
    outcome = np.array([state[1] for state in states], dtype=np.str_)
    rates = RateByOutcome.of(safe, outcome)
    assert rates.overall == Rate(int(safe.sum()), len(states))
    parts = [rates.success, rates.collision, rates.timeout, Rate.of(safe, outcome == "unknown")]
    assert sum(part.total for part in parts) == len(states)
    assert sum(part.safe for part in parts) == rates.overall.safe


def test_no_states_have_no_rate():
    rates = RateByOutcome.of(np.zeros(0, dtype=bool), np.zeros(0, dtype=np.str_))
    assert rates.overall.rate is None
    assert np.isnan(float(rates))
    assert json.loads(json.dumps(rates.to_json()))["success"] == {"safe": 0, "total": 0, "rate": None}


def test_more_safe_states_than_states_are_impossible():
    with pytest.raises(ValueError, match="3 safe states of 2"):
        Rate(3, 2)
