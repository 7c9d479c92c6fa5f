"""Each format says what the result says, and no foreign string gets out of its place."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import pytest
import shapely
from matplotlib.figure import Figure
from pydantic_sarif.model import StaticAnalysisResultsFormatSarifVersion210JsonSchema as SarifLog
from rich.console import Console

import viatool
from tests.hall import MAP, write_policy
from viatool.report import Check, evaluate, formats_of, parse_threshold, print_report
from viatool.report.gate import Gate
from viatool.report.outputs import Output, content_of
from viatool.report.states.closest_call import closest_state, draw_closest_call
from viatool.report.states.figure import PANELS, choose_episodes
from viatool.report.states.run import StatesRun
from viatool.verification.result import Result
from viatool.world import Scenes

HOSTILE = "<img src=x onerror=alert(1)>\"'`|**bold**\r\n::error::owned\x1b[31m%0A=1+1]]>&amp; @team #1 $x$"
FAILED = (Check(f"gate {HOSTILE}", passed=False, figures=f"figures {HOSTILE}"),)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("hall")
    write_policy(folder / "policy.onnx")
    (folder / "plain.yaml").write_text(MAP, encoding="utf-8")
    hostile = MAP.replace("name: past", f"name: {json.dumps(HOSTILE)}").replace(
        "name: hall", f"name: {json.dumps(HOSTILE)}"
    )
    (folder / "hostile.yaml").write_text(hostile, encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def plain(folder: Path) -> Result:
    return viatool.verify(folder / "policy.onnx", folder / "plain.yaml", eps=0.01, close=0)


@pytest.fixture(scope="module")
def hostile(folder: Path) -> Result:
    return viatool.verify(folder / "policy.onnx", folder / "hostile.yaml", eps=0.01, close=0)


def render(result: Result, name: str, checks: tuple[Check, ...] = ()) -> str:
    output = Output(name, Path("-"))
    return b"".join(content_of(output, StatesRun(result), checks)).decode()


def test_junit_has_a_case_for_each_trajectory_and_each_condition(plain: Result) -> None:
    gate = Gate((parse_threshold("1.0", StatesRun), parse_threshold("timeout=0.5", StatesRun)))
    root = ElementTree.fromstring(render(plain, "junit", evaluate(gate, StatesRun(plain))))
    cases = {
        (case.get("classname"), case.get("name")): [part.tag for part in case]
        for case in root.iter("testcase")
    }
    assert len(cases) == 4
    assert cases["viatool.trajectory", "0: past"] == ["failure"]
    assert cases["viatool.trajectory", "1: clear"] == []
    assert cases["viatool.gate", "safety rate >= 100.00 %"] == ["failure"]
    assert [parts for (_, name), parts in cases.items() if name and "ran out of time" in name] == [["error"]]
    assert (root.get("tests"), root.get("failures"), root.get("errors")) == ("4", "2", "1")


def test_sarif_keeps_to_the_standard_and_its_fingerprints_last(plain: Result) -> None:
    log = json.loads(render(plain, "sarif", FAILED))
    SarifLog.model_validate(log)
    again = json.loads(render(plain, "sarif", FAILED))
    prints = [
        [found["partialFingerprints"] for found in run["results"]]
        for run in (log["runs"][0], again["runs"][0])
    ]
    assert prints[0] == prints[1]
    rules = [found["ruleId"] for found in log["runs"][0]["results"]]
    assert rules.count("unsafe-state") == StatesRun(plain).record.verdicts.unsafe
    assert rules[0] == "gate"
    assert len({json.dumps(mark) for mark in prints[0]}) == len(prints[0])


def test_the_table_has_a_row_for_each_state(plain: Result) -> None:
    rows = list(csv.DictReader(io.StringIO(render(plain, "csv"))))
    assert len(rows) == len(plain.trajectory)
    assert [row["verdict"] for row in rows] == plain.verdict.tolist()
    assert [float(row["linear_lower"]) for row in rows] == plain.lower[:, 0].tolist()


def test_no_string_of_a_map_starts_a_workflow_command(
    hostile: Result, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("GITHUB_STEP_SUMMARY", raising=False)
    lines = render(hostile, "github", FAILED).splitlines()
    assert len(lines) == 3  # what was at stake, the condition and the trajectory
    for level, line in zip(("notice", "error", "warning"), lines, strict=True):
        assert line.startswith(f"::{level} file=")
        properties, _, message = line.removeprefix(f"::{level} ").partition("::")
        assert "::" not in properties
        assert properties.count("title=") == 1
        assert not set("\r\n\x1b") & set(line)
        assert "%0A=1" not in message


def test_annotations_stop_at_what_github_shows(plain: Result, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("GITHUB_STEP_SUMMARY", raising=False)
    lines = render(plain, "github", FAILED * 30).splitlines()
    assert len(lines) == 1 + 10 + 1  # what was at stake, errors, and the trajectory that no condition counts
    assert "and 21 more" in lines[-2]


def test_the_job_summary_is_appended(plain: Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    summary = tmp_path / "summary.md"
    summary.write_text("before\n")
    monkeypatch.setenv("GITHUB_STEP_SUMMARY", str(summary))
    render(plain, "github")
    assert summary.read_text(encoding="utf-8").startswith("before\n## viatool: ")


def test_markdown_holds_no_markup_of_a_map(hostile: Result) -> None:
    text = render(hostile, "markdown", FAILED)
    assert "<img" not in text
    assert "**bold**" not in text
    assert "\x1b" not in text
    columns = {
        line.replace("\\|", "").count("|") for line in text.splitlines() if line.startswith("| **FAILED**")
    }
    assert columns == {4}


def test_xml_of_hostile_names_is_read_back_as_text(hostile: Result) -> None:
    root = ElementTree.fromstring(render(hostile, "junit", FAILED))
    names = [case.get("name") or "" for case in root.iter("testcase")]
    assert len(names) == len(set(names)) == 3
    assert any("<img src=x" in name for name in names)


def test_a_spreadsheet_finds_no_formula(hostile: Result) -> None:
    rows = list(csv.DictReader(io.StringIO(render(hostile, "csv"))))
    assert len(rows) == len(hostile.trajectory)
    assert not any(row["scenario"].startswith(("=", "+", "-", "@")) for row in rows)


@pytest.mark.parametrize("name", formats_of(StatesRun))
def test_every_format_survives_hostile_names(
    hostile: Result, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("GITHUB_STEP_SUMMARY", raising=False)
    output = Output(name, Path("-"))
    assert b"".join(content_of(output, StatesRun(hostile), FAILED))


def test_the_console_prints_no_control_characters_of_a_map(
    folder: Path, document: Callable[..., object]
) -> None:
    stream = io.StringIO()
    report = document(1, 1, 1, criterion=HOSTILE, eps={HOSTILE: 0.1})
    print_report(report, Console(file=stream, width=200), FAILED)
    assert "\x1b" not in stream.getvalue()
    assert "\n::error" not in stream.getvalue()


def test_the_figure_shows_the_episodes_that_matter(plain: Result) -> None:
    assert choose_episodes(plain) == [0, 1]
    assert PANELS >= 10  # the ten fixed scenarios of the lab


def test_the_closest_call_is_drawn_with_the_obstacle_that_is_near(plain: Result) -> None:
    axes = Figure().add_subplot()
    draw_closest_call(axes, plain)
    state = closest_state(plain)
    scenes = Scenes.of(plain.world_map, plain.trajectory.scenarios)
    blocked = scenes.shapely(int(plain.trajectory.episode[state]))
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    view = shapely.box(left, low, right, high)
    assert view.contains(shapely.Point(plain.poses[state, :2]))
    assert view.intersection(blocked).area > 0.02 * view.area
    told = next(text.get_text() for text in axes.texts if text.get_text() != "20 cm")
    least = plain.witnesses.clearance[plain.witnesses.state == state].item()
    assert float(told.removesuffix(" cm")) == pytest.approx(100.0 * least, abs=0.5)
