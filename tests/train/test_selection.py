"""Choosing a policy: by success, or by proved safety among those that drive about as well."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from tests.train.test_run import tiny
from viatool.errors import ConfigurationError
from viatool.train import make_configuration, train
from viatool.train.networks import Weights
from viatool.train.scoring import Safety
from viatool.train.selection import Candidate, best_candidates


def candidate(epoch: int, score: float, safety: tuple[float, ...] = ()) -> Candidate:
    return Candidate(0, epoch, score, 0.0, Weights((3, 2), 1), safety)


def epochs(candidates: list[Candidate], tolerance: float = 0.01) -> list[int]:
    return [one.epoch for one in best_candidates(candidates, 3, tolerance)]


def test_without_rates_the_best_score_wins_and_of_equals_the_later() -> None:
    assert epochs([candidate(1, 0.95), candidate(2, 0.97), candidate(3, 0.97), candidate(4, 0.969)]) == [
        3,
        2,
        4,
    ]


def test_of_about_equal_scores_the_safer_wins() -> None:
    safest_but_worse = candidate(1, 0.94, (1.0, 1.0))
    safer = candidate(2, 0.965, (1.0, 0.99))
    best = candidate(3, 0.97, (1.0, 0.98))
    assert epochs([safest_but_worse, best, safer]) == [2, 3, 1]
    assert epochs([safest_but_worse, best, safer], tolerance=0.0) == [3, 2, 1]


def test_collisions_weigh_more_than_danger() -> None:
    assert Safety(0.999, 0.2) > Safety(0.998, 0.9)
    assert Safety(0.999, 0.3) > Safety(0.999, 0.2)


def test_a_run_records_what_was_verified(tmp_path: Path) -> None:
    options = tiny(epochs=1, verification_scenarios=3, select_by="safety", tensorboard=False)
    result = train(options, tmp_path / "run")
    with (result.run_directory / "metrics.csv").open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    for row in rows:
        assert 0.0 <= float(row["verified_danger_rate"]) <= float(row["verified_safety_rate"]) <= 1.0


def test_safety_cannot_decide_without_verification() -> None:
    with pytest.raises(ConfigurationError, match="verification_scenarios"):
        make_configuration("quick", None, ["select_by=safety"])
