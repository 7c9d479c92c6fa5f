"""Choosing a policy: by success, or by proved safety among those that drive about as well."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from tests.hall import MAP
from tests.missions.dodging import write_dodging_policy
from tests.train.test_run import tiny
from viatool import load_map, load_policy
from viatool.errors import ConfigurationError
from viatool.train import TrainingMaps, make_configuration, train
from viatool.train.networks import Weights
from viatool.train.observation import make_scaling
from viatool.train.scoring import Safety, proved_missions
from viatool.train.selection import Candidate, best_candidates, choose


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


@pytest.mark.parametrize(
    ("select_by", "needed"), [("safety", "verification_scenarios"), ("missions", "mission_scenarios")]
)
def test_what_decides_has_to_be_measured(select_by: str, needed: str) -> None:
    with pytest.raises(ConfigurationError, match=needed):
        make_configuration("quick", None, [f"select_by={select_by}"])


def test_of_finalists_about_as_good_the_one_with_most_proved_missions_wins() -> None:
    """Random actors never arrive: their scores are equal."""
    options = tiny(final_scenarios=3, horizon=5)
    maps = TrainingMaps((load_map("maps/lab.yaml"),))
    scaling = make_scaling(maps.robot, 10.0)
    some = [
        Candidate(0, epoch, 0.5, 0.0, scaling.actor((4,), 1, "relu").draw(torch.Generator().manual_seed(1)))
        for epoch in (1, 2, 3)
    ]
    shares = {1: 0.5, 2: 0.75, 3: 0.25}
    assert choose(some, maps, scaling, options).epoch == 3
    chosen = choose(some, maps, scaling, options, lambda one: shares[one.epoch])
    assert (chosen.epoch, chosen.safety) == (2, (0.75,))


def test_proved_missions_are_counted(tmp_path: Path) -> None:
    (tmp_path / "hall.yaml").write_text(MAP, encoding="utf-8")
    hall = TrainingMaps(
        (replace(load_map(tmp_path / "hall.yaml"), generator=None),)
    )  # of its own scenarios both are proved
    policy = load_policy(write_dodging_policy(tmp_path / "policy.onnx"))
    options = make_configuration(mission_scenarios=2)
    assert proved_missions(policy, hall, options) == 1.0
    assert proved_missions(policy, hall, options.model_copy(update={"mission_parts": 5})) == 0.0


def test_a_run_may_be_chosen_by_missions(tmp_path: Path) -> None:
    options = tiny(epochs=1, mission_scenarios=1, select_by="missions", tensorboard=False)
    result = train(options, tmp_path / "run")
    record = json.loads((result.run_directory / "evaluation.json").read_text(encoding="utf-8"))
    assert record["safety"] == [0.0]  # after one epoch of twenty-five steps
