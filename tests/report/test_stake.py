"""The first line of every report on states: in how many of them the verdict depended on the policy."""

from __future__ import annotations

import io
import json

import pytest
from click.testing import CliRunner
from rich.console import Console

import viatool
from tests.report.conftest import content, rates
from viatool.cli import main
from viatool.errors import ConfigurationError
from viatool.report import print_report
from viatool.report.outputs import FORMATS, format_named
from viatool.report.states.document import StatesDocument
from viatool.report.states.run import StatesRun

NOTHING = "no verdict depended on the policy"


@pytest.fixture(scope="module")
def result() -> viatool.Result:
    """A run in which one of three verdicts is not that of an obstacle far away."""
    return viatool.verify("td3", "lab", eps=0.1)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({}, "the policy was put to the test in 3 of 100 states: 1 unsafe, 2 unknown"),
        (
            {"contested_rate": rates(5, 8)},
            "the policy was put to the test in 8 of 100 states: 5 proved, 1 unsafe, 2 unknown",
        ),
    ],
)
def test_contested_states_are_counted_by_their_verdicts(changes, words) -> None:
    assert StatesDocument({**content(97, 1, 2), **changes}).stake == words


def test_where_nothing_is_contested_the_report_says_so_in_these_words() -> None:
    assert StatesDocument(content(100, 0, 0)).stake == NOTHING


def test_a_stake_that_contradicts_the_contested_rate_is_no_report() -> None:
    StatesDocument({**content(), "stake": {"contested": 3, "states": 100}})
    with pytest.raises(ConfigurationError, match="stake is 4 of 100"):
        StatesDocument({**content(), "stake": {"contested": 4, "states": 100}})


def test_the_stake_is_the_whole_of_the_contested_rate(result) -> None:
    stored = result.to_json()["stake"]
    assert stored == {"contested": result.contested_rate.overall.total, "states": len(result.trajectory)}
    assert stored["contested"] > 0
    kinds = {
        name: int(((result.verdict == name) & result.contested.collision).sum())
        for name in ("unsafe", "unknown")
    }
    assert kinds == {
        name: int((result.verdict == name).sum()) for name in kinds
    }  # all that is not safe is contested


@pytest.mark.parametrize("name", ["markdown", "github", "junit", "sarif", "html", "figure"])
def test_every_format_for_people_and_dashboards_begins_with_it(result, name) -> None:
    document = StatesRun(result)
    module = format_named(name)
    suffix = ".svg" if name == "figure" else (module.SUFFIXES or ("",))[0]
    rendered = module.render(document, (), suffix)
    text = (
        rendered
        if isinstance(rendered, str)
        else b"".join([rendered] if isinstance(rendered, bytes) else rendered).decode()
    )
    assert name in FORMATS
    if name == "figure":  # drawn as paths
        title = document.draw().subfigs[0].get_suptitle().replace(";\n", "; ")
        assert title.splitlines()[0] == document.stake
        return
    assert document.stake in text
    if name in ("markdown", "github"):
        assert document.stake in text.splitlines()[0]


def test_a_pipe_gets_each_line_of_the_headline_whole() -> None:
    stream = io.StringIO()
    changes = {"contested_rate": rates(5, 8), "policy": {"path": "a/long/path/" * 12, "sha256": "0" * 64}}
    report = StatesDocument({**content(97, 1, 2), **changes})
    print_report(report, Console(file=stream, width=60))
    first, second, *_ = stream.getvalue().splitlines()
    assert first == report.stake
    assert second.startswith("a/long/path/" * 12)


def test_the_console_begins_with_it_and_the_gate_counts_it(tmp_path) -> None:
    report = tmp_path / "report.json"
    command = [
        "verify",
        "via",
        "--map",
        "lab",
        "--eps",
        "0.01",
        "--scenarios",
        "1",
        "--close",
        "0",
        "--output",
        f"json:{report}",
    ]
    run = CliRunner().invoke(main, command)
    assert (run.exit_code, run.stdout.splitlines()[0]) == (0, NOTHING)
    assert json.loads(report.read_text())["stake"]["contested"] == 0
    for gated in (["gate", str(report)], command):
        few = CliRunner().invoke(main, [*gated, "--min-contested", "1"])
        assert (few.exit_code, "at least 1 contested: 0 contested" in few.stderr, "hint" in few.stderr) == (
            5,
            True,
            True,
        )
        assert CliRunner().invoke(main, [*gated, "--min-contested", "0"]).exit_code == 0


def test_only_reports_on_states_know_it(tmp_path) -> None:
    path = tmp_path / "simulation.json"
    CliRunner().invoke(
        main, ["simulate", "via", "--map", "lab", "--episodes", "2", "--quiet", "--output", f"json:{path}"]
    )
    refused = CliRunner().invoke(main, ["gate", str(path), "--min-contested", "1"])
    assert (refused.exit_code, "--min-contested is not about a" in refused.stderr) == (2, True)
