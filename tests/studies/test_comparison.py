"""From records to data, answers and pages."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.studies.records import THREE_SEEDS, records_of
from viatool.studies import STUDIES, study_named
from viatool.studies.answers import (
    Finding,
    Superiority,
    answer,
    answer_word,
    compare_all,
    discordant_pairs,
    error_rates,
)
from viatool.studies.comparison import constraint_of
from viatool.studies.metrics import METRICS
from viatool.studies.study import write_data, write_page
from viatool.studies.tables import number
from viatool.studies.training import choose_epochs, curves_of

GOLDEN = Path(__file__).parent / "golden"

QUALITY = {
    "td3": (0.95, 0.02, 1.0, 990),
    "rcpo": (0.90, 0.0, 0.2, 980),
    "via-0.9": (0.97, 0.0, 0.5, 999),
    "via-0.5": (0.96, 0.0, 0.5, 999),
    "via-0.1": (0.80, 0.0, 0.5, 999),
}


def data_of(name: str) -> dict[str, Any]:
    study = study_named(name)
    tasks = study.plan(THREE_SEEDS)
    records = records_of(tasks, QUALITY)
    content = {"study": name, "command": THREE_SEEDS.command(name), **study.collect(tasks, records)}
    return content | {"tasks": {"finished": len(records), "total": len(tasks)}}


def test_the_data_hold_the_seeds_and_their_mean_and_deviation() -> None:
    td3 = data_of("table1")["variants"]["td3"]
    assert td3["seeds"] == [0, 1, 2]
    assert td3["values"]["success"] == pytest.approx([0.95, 0.94, 0.93])
    assert td3["estimates"]["success"]["mean"] == pytest.approx(0.94)
    assert td3["estimates"]["success"]["std"] == pytest.approx(0.01)
    assert td3["values"]["safety"] == [0.99, 0.989, 0.988]
    assert td3["values"]["cvar_0.9"] == pytest.approx([10.0, 10.1, 10.2])
    assert td3["estimates"]["width_omega"]["mean"] == 0.125


def test_seeds_without_collisions_have_no_safety_of_collisions() -> None:
    data = data_of("table1")["variants"]
    assert data["td3"]["values"]["safety_collision"] == [0.5] * 3
    assert data["rcpo"]["values"]["safety_collision"] == [None] * 3
    assert "safety_collision" not in data["rcpo"]["estimates"]


def test_the_share_of_the_training_in_which_lambda_was_zero() -> None:
    curves = {"multiplier": [[0.2, 0.0], [0.1, 0.0], [0.0, 0.0], [0.0, 0.4]], "var": [[4.0, 2.0]] * 4}
    found = constraint_of(curves)
    assert found["zero"] == 5 / 8
    assert found["zero_late"] == 0.5
    assert (found["multiplier"], found["multiplier_highest"], found["var"]) == (0.2, 0.4, 3.0)


def test_comparisons_are_decided_and_summed_up_by_the_rule() -> None:
    data = data_of("table1")
    claim = Superiority([("via-0.9", "td3"), ("via-0.9", "rcpo")], ("cost", "safety"))
    found = compare_all(data, claim)
    assert [(one.worse, one.metric, one.finding) for one in found] == [
        ("td3", "cost", "as claimed"),
        ("td3", "safety", "as claimed"),
        ("rcpo", "cost", "opposite"),
        ("rcpo", "safety", "as claimed"),
    ]
    alone = compare_all(data, Superiority([("via-0.9", "rcpo")], ("cost",)))[0]
    corrected = found[2]
    assert alone.p < corrected.p  # one of four
    said = answer(data, claim)
    assert str(said) == "**mixed** (3 as claimed, 1 opposite, 0 equal, 0 undecided)"


@pytest.mark.parametrize(
    ("counts", "word"),
    [
        ({"as claimed": 3}, "confirmed"),
        ({"as claimed": 2, "equal": 1}, "partly confirmed"),
        ({"as claimed": 1, "undecided": 11}, "partly confirmed"),
        ({"opposite": 1, "undecided": 11}, "contradicted"),
        ({"as claimed": 1, "opposite": 1}, "mixed"),
        ({"equal": 4}, "no difference"),
        ({"equal": 4, "undecided": 1}, "undecided"),
        ({}, "open"),
    ],
)
def test_the_word_for_a_claim(counts: dict[Finding, int], word: str) -> None:
    assert answer_word(counts) == word


def test_a_difference_below_the_margin_is_equal_however_sure_it_is() -> None:
    data = data_of("table1")
    for name, shift in (("td3", 0.0), ("via-0.9", METRICS["success"].margin / 4)):
        data["variants"][name]["values"]["success"] = [0.9 + shift + 1e-6 * seed for seed in range(30)]
    data["about"]["episodes"]["held_out"] = 10**9  # no spread of chance
    found = compare_all(data, Superiority([("via-0.9", "td3")], ("success",)))[0]
    assert found.p < 1e-6
    assert found.finding == "equal"


def test_where_methods_do_not_differ_the_rule_decides_something_in_at_most_one_of_twenty_studies() -> None:
    """Error rates by relabelling, where all seeds are drawn from one distribution, and where a method is far better."""
    data = data_of("table1")
    rng = np.random.default_rng(3)
    names = ("td3", "rcpo", "via-0.9")
    for name in names:
        for metric in ("cost", "cvar_0.9"):
            data["variants"][name]["values"][metric] = rng.normal(5.0, 2.0, 6).tolist()
    claim = Superiority([("via-0.9", "td3"), ("via-0.9", "rcpo")], ("cost", "cvar_0.9"))
    errors = error_rates(data, claim)
    assert sum(errors.values()) == pytest.approx(1.0)
    assert 0.0 < 1.0 - errors["undecided"] < 0.05
    assert errors == error_rates(data, claim)  # seeded
    data["variants"]["via-0.9"]["values"]["cost"] = [0.1, 0.2, 0.1, 0.2, 0.1, 0.2]
    assert answer(data, claim).word == "partly confirmed"
    assert error_rates(data, claim).get("partly confirmed", 0.0) < 0.05


def test_variants_that_are_not_there_are_not_compared() -> None:
    claim = Superiority([("via-0.9", "td7")], ("cost",))
    assert compare_all(data_of("table1"), claim) == []
    assert answer(data_of("table1"), claim).word == "open"


def test_a_cheaper_method_that_is_less_safe_is_found() -> None:
    discordant, concordant = discordant_pairs(data_of("table1"), ["td3", "rcpo", "via-0.9"], "cost", "safety")
    assert set(discordant) == {("rcpo", "td3"), ("rcpo", "via-0.9")}
    assert concordant == [("via-0.9", "td3")]


def test_a_share_is_never_rounded_up_to_all() -> None:
    metric = METRICS["safety"]
    assert number(1.0, metric) == "100.000"
    assert number(0.9999999, metric) == "99.999"
    assert number(0.5, metric) == "50.000"


def test_each_seed_has_its_own_best_epoch_the_later_of_equals() -> None:
    rows = [
        {
            "epoch": str(epoch),
            "seed": str(seed),
            "validation_success_rate": success,
            "validation_collision_rate": bad,
        }
        for epoch, seed, success, bad in [
            (1, 0, "", ""),
            (2, 0, "0.9", "0.1"),
            (3, 0, "0.85", "0.05"),
            (4, 0, "0.95", "0.2"),
            (2, 1, "0.5", "0.0"),
            (3, 1, "0.4", "0.0"),
        ]
    ]
    assert choose_epochs(rows, 2) == [3, 2]
    assert curves_of(rows, 2)["validation_success_rate"] == [
        [None, None],
        [0.9, 0.5],
        [0.85, 0.4],
        [0.95, None],
    ]


@pytest.mark.parametrize("name", [name for name in STUDIES if name in ("table1", "table2", "mean-limit")])
def test_a_page_is_as_before(name: str, tmp_path: Path) -> None:
    (tmp_path / "data").mkdir()
    data = data_of(name)
    data["about"]["machine"] = "2-core x86_64"
    (tmp_path / "data" / f"{name}.json").write_text(json.dumps(data))
    written = write_page(study_named(name), tmp_path).read_text(encoding="utf-8")
    assert written == (GOLDEN / f"{name}.md").read_text(encoding="utf-8")


def test_figures_have_a_picture_of_every_setting_that_has_data(tmp_path: Path) -> None:
    study = study_named("figures")
    tasks = [task for task in study.plan(THREE_SEEDS) if not task.name.startswith("mean-limit")]
    records = records_of(tasks, QUALITY)
    write_data(study, THREE_SEEDS, tasks, records, tmp_path)
    page = write_page(study, tmp_path).read_text(encoding="utf-8")
    pictures = sorted(path.name for path in tmp_path.glob("*.png"))
    assert pictures == ["constraint.png", "learning-lab.png", "paths-lab.png"]
    assert all(f"]({name})" in page for name in pictures)
    assert "Scenario `lab-1`" in page  # the only one in which somebody fails


@pytest.mark.parametrize("name", ["table1", "table2", "mean-limit", "figures"])
@pytest.mark.parametrize("finished", [1, 2])
def test_every_page_can_be_written_from_the_first_tasks(name: str, finished: int, tmp_path: Path) -> None:
    study = study_named(name)
    tasks = study.plan(THREE_SEEDS)
    every = records_of(tasks, QUALITY | {"sac-lag": QUALITY["rcpo"]})
    records = dict(list(every.items())[:finished])
    write_data(study, THREE_SEEDS, tasks, records, tmp_path)
    page = write_page(study, tmp_path).read_text(encoding="utf-8")
    assert f"**Partial**: {finished} of {len(tasks)} tasks" in page
