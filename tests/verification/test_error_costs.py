"""What errors cost: each number is that of a verification without the error."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import viatool
from viatool.cli import main
from viatool.errors import ConfigurationError
from viatool.simulate import Places
from viatool.uncertainty import ErrorModel, load_errors
from viatool.verification.result import Result

EPS = {"lidar": 0.3, "": 0.1}
ASKED = {"places": Places(count=400), "seed": 3, "criterion": "braking", "refine": "none"}


def verified(**changed) -> Result:
    return viatool.verify("via", "lab", **{**ASKED, "eps": EPS, "delay": 0.1, **changed})


@pytest.fixture(scope="module")
def result() -> Result:
    return verified(explain_errors=True)


def test_each_error_costs_what_a_verification_without_it_saves(result: Result) -> None:
    lost = result.verdict != "safe"
    costs = {one.term: one.saved for one in result.error_costs.terms}
    assert result.error_costs.not_proved == lost.sum() > 5
    for term, without in (
        ("eps of lidar", {"eps": {**EPS, "lidar": 0.0}}),
        ("delay", {"delay": 0.0}),
    ):
        again = verified(**without)
        saved = lost & (again.verdict == "safe")
        assert costs[term] == saved.sum()
        named = np.array([term in told.split(",") for told in result.state_table()["fails_by"]])
        assert (named == saved).all()
    assert costs["eps of lidar"] > 0
    assert [one.saved for one in result.error_costs.terms] == sorted(costs.values(), reverse=True)
    assert result.error_costs.together >= max(costs.values())


def test_the_verdicts_are_the_same_as_without_the_question(result: Result) -> None:
    plain = verified()
    assert (plain.verdict == result.verdict).all()
    assert plain.error_costs is None
    assert "fails_by" not in plain.state_table()
    assert "error_costs" not in plain.to_json()


def test_an_absolute_error_of_the_model_is_the_eps_of_its_channel() -> None:
    model = ErrorModel.model_validate({"sensor": {"lidar": {"absolute": 0.3}}})
    found = verified(eps={"": 0.1}, errors=model, explain_errors=True)
    assert "eps of lidar" in [one.term for one in found.error_costs.terms]
    assert all("absolute" not in one.term for one in found.error_costs.terms)


def test_the_report_ranks_them(tmp_path: Path) -> None:
    target = tmp_path / "report.json"
    asked = [
        "verify", "via", "--map", "lab", "--eps", "lidar=0.3", "--eps", "0.1", "--poses", "random:400", "--seed", "3",
        "--criterion", "braking", "--refine", "none", "--only-contested", "--explain-errors", "-o", f"json:{target}",
        "-o", f"markdown:{tmp_path / 'report.md'}", "-o", f"html:{tmp_path / 'report.html'}",
    ]  # fmt: skip
    run = CliRunner().invoke(main, asked)
    assert run.exit_code == 0, run.output
    assert "What the errors cost" in run.output
    assert "all of them together" in run.output
    for name in ("report.md", "report.html"):
        assert "What the errors cost" in (tmp_path / name).read_text()
    assert '"error_costs"' in target.read_text()
    shown = CliRunner().invoke(main, ["report", str(target)])
    assert "What the errors cost" in shown.output


EVERY = {
    "sensor": {"scan.front": {"absolute": 0.1, "bias": 0.2}},
    "pose": {"x": 0.1},
    "actuation": {"linear": {"lag": [0.1, 0.2]}, "slip": 0.1},
    "timing": {"delay": [0.0, 0.1]},
    "obstacles": {"named": {"crate.2": 0.4, "crate": 0.3}},
}


def test_a_model_without_a_term_has_all_others() -> None:
    model = ErrorModel.model_validate(EVERY)
    places = [place for place, *_ in model.stated()]
    assert len(places) == 8
    for place in places:
        left = [other for other, *_ in model.without(place).stated()]
        assert left == [other for other in places if other != place]
    assert model.without("pose.y") == model


def test_the_source_stays(tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    path.write_text("pose: {x: 0.1, y: 0.1}")
    assert load_errors(path).without("pose.x").source == str(path)
    with pytest.raises(ConfigurationError, match=r"pose\.y"):
        load_errors(path).without("pose.x").require("the job", frozenset())
