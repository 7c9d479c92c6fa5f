"""A short run of the fuzzer; docs/results/fuzz.md has the figures of a long one."""

from __future__ import annotations

from collections import Counter

from tests.policy.fuzz import run


def test_mutated_models_load_or_are_refused() -> None:
    bad = {}
    tally: Counter[str] = Counter()
    for number, outcome in run(range(500), seed=20):
        kind = outcome.partition("\n")[0].partition(":")[0]
        tally[kind] += 1
        if kind not in ("loaded", "refused", "no number"):
            bad[number] = outcome
    assert not bad
    assert tally["loaded"] > 30
    assert tally["refused"] > 150
