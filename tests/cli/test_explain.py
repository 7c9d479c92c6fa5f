"""``viatool explain``: reasons from a stored report alone, the same words as in the other formats."""

from __future__ import annotations

import csv
import html
import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from tests.hall import MAP, write_policy
from viatool.cli import main


def run(*arguments: object) -> tuple[int, str]:
    found = CliRunner().invoke(main, [str(argument) for argument in arguments])
    return found.exit_code, " ".join(found.output.split())


@pytest.fixture(scope="module")
def hall(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A hall in which the drive past the obstacle ends in it, and its reports."""
    folder = tmp_path_factory.mktemp("hall")
    write_policy(folder / "policy.onnx")
    (folder / "map.yaml").write_text(MAP)
    formats = ("json:r.json", "csv:r.csv", "sarif:r.sarif", "junit:r.xml", "markdown:r.md", "html:r.html")
    outputs = [part for one in formats for part in ("-o", one.replace(":", f":{folder}/"))]
    asked = (folder / "policy.onnx", "--map", folder / "map.yaml", "--eps", "0.01", "-q")
    assert run("verify", *asked, "--close", "0", *outputs)[0] == 0
    assert run("mission", *asked, "-o", f"json:{folder}/m.json")[0] == 0
    return folder


@pytest.fixture(scope="module")
def reason(hall: Path) -> dict:
    (only,) = json.loads((hall / "r.json").read_text())["reasons"]
    return only


def test_it_prints_the_words_of_the_report(hall: Path, reason: dict) -> None:
    code, said = run("explain", hall / "r.json", "--state", reason["state"])
    assert code == 0
    assert reason["words"] in said
    assert said.startswith(f"State {reason['state']} is unsafe: scenario past at 2.40 s")
    assert "circle of radius 0.3 m at (0.00, 0.55)" in said
    listed = run("explain", hall / "r.json")[1]
    assert f"state {reason['state']} past 2.40 unsafe" in listed


def test_a_report_says_it_without_the_policy_and_the_map(hall: Path, reason: dict, tmp_path: Path) -> None:
    alone = tmp_path / "elsewhere.json"
    told = json.loads((hall / "r.json").read_text())
    told["policy"]["path"] = told["map"]["path"] = "gone"
    alone.write_text(json.dumps(told))
    assert reason["words"] in run("explain", alone, "--state", reason["state"])[1]


def test_every_format_says_the_same(hall: Path, reason: dict) -> None:
    rows = {
        int(row["state"]): row["reason"] for row in csv.DictReader((hall / "r.csv").read_text().splitlines())
    }
    assert rows.pop(reason["state"]) == reason["words"]
    assert set(rows.values()) == {""}
    (result,) = json.loads((hall / "r.sarif").read_text())["runs"][0]["results"]
    assert f"Reason: {reason['brief']}." in result["message"]["text"]
    assert reason["brief"] in html.unescape((hall / "r.xml").read_text())
    plain = (hall / "r.md").read_text().replace("\\", "")
    assert reason["brief"] in plain
    assert reason["words"] in html.unescape((hall / "r.html").read_text())


def test_a_safe_state_has_nothing_to_explain(hall: Path) -> None:
    assert run("explain", hall / "r.json", "--state", 0) == (0, "State 0 is proved safe: nothing to explain.")


@pytest.mark.parametrize("number", [82, -1])
def test_a_state_that_does_not_exist_is_refused_with_the_range(hall: Path, number: int) -> None:
    code, said = run("explain", hall / "r.json", f"--state={number}")
    assert code == 2
    assert f"there is no state {number}: the report is on states 0 to 81" in said


def test_another_schema_version_is_refused_by_name(hall: Path, tmp_path: Path) -> None:
    told = json.loads((hall / "r.json").read_text())
    (tmp_path / "r.json").write_text(json.dumps({**told, "schema_version": 7}))
    code, said = run("explain", tmp_path / "r.json", "--state", 0)
    assert code == 2
    assert "is a report of schema version 7, and this viatool reads version 1" in said


def test_a_report_without_reasons_does_not_pass_for_safe(hall: Path, tmp_path: Path) -> None:
    told = json.loads((hall / "r.json").read_text())
    del told["reasons"]
    (tmp_path / "r.json").write_text(json.dumps(told))
    code, said = run("explain", tmp_path / "r.json", "--state", 0)
    assert code == 2
    assert "does not say why states are not safe" in said


def test_an_option_of_another_kind_of_report_is_refused(hall: Path) -> None:
    code, said = run("explain", hall / "r.json", "--scenario", "past")
    assert code == 2
    assert "--scenario is not for a report on states: it takes --state or --close" in said


def test_a_mission_names_what_its_run_comes_near_to(hall: Path) -> None:
    code, said = run("explain", hall / "m.json", "--scenario", "past")
    assert code == 0
    assert said.startswith("Mission past is refuted.")
    assert "circle of radius 0.3 m at (0.00, 0.55)" in said
    assert "The run without any error comes too near as well: no better sensor helps." in said
    assert run("explain", hall / "m.json", "--scenario", "nowhere")[0] == 2
    assert "past refuted" in run("explain", hall / "m.json")[1]
