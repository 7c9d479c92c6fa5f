"""``viatool run``: a matrix with what is missing in it, what is kept, what is accepted, and one exit code."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from datetime import date
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from click.testing import CliRunner, Result

from viatool.cli import main
from viatool.cli.run import commands_of_checks
from viatool.projects import expand, load_project
from viatool.projects.inputs import digest_of_inputs
from viatool.report import accepted as accepting

ROOT = Path(__file__).resolve().parents[2]
Run = Callable[..., Result]

HEAD = """
policies = {{ straight = "policy.onnx"{policies} }}
maps = ["map.yaml"{maps}]
reports = []
[defaults]
eps = 0.01
"""
GATED = '[[check]]\nname = "drive"\ngate = { fail-under = 0.9, max-unsafe = 0 }\n'
ACCEPTED = """
[[accepted]]
cell = "drive"
verdict = "unsafe"
state = 24
reason = "the pillar will be moved"
expires = 2999-01-31
"""


@pytest.fixture
def folder(hall: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder with ``policy.onnx`` and ``map.yaml``, of whose states number 24 alone is unsafe."""
    for name in ("policy.onnx", "map.yaml"):
        shutil.copy(hall / name, tmp_path / name)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def write(folder: Path) -> Callable[..., None]:
    """Write a project file."""

    def to_file(text: str, policies: str = "", maps: str = "") -> None:
        content = HEAD.format(policies=policies, maps=maps) + text
        (folder / "viatool.toml").write_text(content, encoding="utf-8")

    return to_file


def run(*arguments: object) -> Result:
    return CliRunner().invoke(main, ["run", *map(str, arguments)])


def summary(folder: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((folder / ".viatool" / "summary.json").read_text(encoding="utf-8"))
    return content


def codes(folder: Path) -> dict[str, int | None]:
    return {cell["name"]: cell["code"] for cell in summary(folder)["cells"]}


def reused(folder: Path) -> list[str]:
    return [cell["name"] for cell in summary(folder)["cells"] if cell["reused"]]


def test_what_is_missing_in_one_cell_leaves_the_others_alone(
    folder: Path, write: Callable[..., None]
) -> None:
    write('[[check]]\nname = "drive"\ngate.fail-under = 0.9\n', ', gone = "gone.onnx"', ', "nowhere.yaml"')
    result = run()
    assert result.exit_code == 2
    assert codes(folder) == {
        "drive/straight/map": 0, "drive/straight/nowhere": 2, "drive/gone/map": 2, "drive/gone/nowhere": 2,
    }  # fmt: skip
    assert "cannot read the policy gone.onnx" in result.output
    assert re.search(r"straight .*passed 98\.78 %.*unusable input", result.output)
    page = (folder / ".viatool" / "index.html").read_text(encoding="utf-8")
    for name in codes(folder):
        assert name in page
    schema = json.loads((ROOT / "docs" / "run.schema.json").read_text(encoding="utf-8"))
    jsonschema.validate(summary(folder), schema)


def test_one_cause_of_several_cells_is_told_once_with_their_names(
    folder: Path, write: Callable[..., None]
) -> None:
    write('[[check]]\nname = "drive"\nmatrix.seed = [0, 1, 2, 3, 4]\n', ', gone = "gone.onnx"')
    result = run("-k", "gone")
    assert result.exit_code == 2
    assert result.output.count("error: cannot read the policy gone.onnx") == 1
    line = next(line for line in result.output.splitlines() if "error: cannot read" in line)
    assert line.startswith("drive/gone/map/seed=0, drive/gone/map/seed=1, drive/gone/map/seed=2 and 2 more: ")


def test_a_failed_gate_is_one_and_a_cell_without_states_five(
    folder: Path, write: Callable[..., None]
) -> None:
    write(GATED)
    assert run("--quiet").exit_code == 1
    write(GATED + '[[check]]\nname = "empty"\ngate = { fail-under = "timeout=0.9" }\n')
    result = run()
    assert codes(folder) == {"drive/straight/map": 1, "empty/straight/map": 5}
    assert result.exit_code == 5
    assert "drive/straight/map: at most 0 unsafe: 1 unsafe" in result.output


def test_finished_cells_are_kept_while_their_inputs_are_the_same(
    folder: Path, write: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copy(folder / "policy.onnx", folder / "other.onnx")
    write(GATED + '[[check]]\nname = "later"\nhorizon = 2\n', ', other = "other.onnx"')
    every = ["drive/straight/map", "drive/other/map", "later/straight/map", "later/other/map"]
    assert run().exit_code == 1
    assert reused(folder) == []
    assert run("--resume").exit_code == 1
    assert reused(folder) == every
    assert run().exit_code == 1  # without --resume all are run again
    assert reused(folder) == []
    content = (folder / "other.onnx").read_bytes()
    (folder / "other.onnx").write_bytes(content + b"\x72\x00")  # an empty metadata entry: the same network
    run("--resume")
    assert reused(folder) == ["drive/straight/map", "later/straight/map"]
    run("--resume", "--seed", 1)
    assert reused(folder) == []
    run("--resume")
    write(GATED.replace("0.9", "0.8") + '[[check]]\nname = "later"\nhorizon = 2\n', ', other = "other.onnx"')
    run("--resume")
    assert reused(folder) == ["later/straight/map", "later/other/map"]
    monkeypatch.setattr("viatool.projects.inputs.result_versions", lambda: {"viatool": "9"})
    run("--resume")
    assert reused(folder) == []


def test_a_changed_map_and_a_lost_report_are_noticed(folder: Path, write: Callable[..., None]) -> None:
    write(GATED)
    run()
    (folder / ".viatool" / "cells" / "drive--straight--map" / "report.json").unlink()
    run("--resume")
    assert reused(folder) == []
    (folder / "map.yaml").write_text((folder / "map.yaml").read_text() + "# moved\n", encoding="utf-8")
    run("--resume")
    assert reused(folder) == []
    run("--resume")
    assert reused(folder) == ["drive/straight/map"]


def test_what_ended_by_an_error_is_never_kept(folder: Path, write: Callable[..., None]) -> None:
    write("[[check]]\n", ', gone = "gone.onnx"')
    assert run().exit_code == 2
    shutil.copy(folder / "policy.onnx", folder / "gone.onnx")
    assert run("--resume").exit_code == 0
    assert reused(folder) == ["verify/straight/map"]


def test_last_failed_runs_what_has_not_passed(folder: Path, write: Callable[..., None]) -> None:
    write(GATED + '[[check]]\nname = "loose"\ngate.fail-under = 0.5\n')
    assert "drive/straight/map\nloose/straight/map\n" in run("--list").output
    assert run().exit_code == 1
    assert run("--last-failed", "--list").output == "drive/straight/map\n"
    assert run("--last-failed").exit_code == 1
    assert [cell["run"] for cell in summary(folder)["cells"]] == [True, False]
    assert codes(folder) == {"drive/straight/map": 1, "loose/straight/map": 0}
    # A pass under other options is no pass: the cell is still one that has failed.
    assert run("-k", "drive", "--max-unsafe", 5).exit_code == 0
    assert run("--last-failed", "--list").output == "drive/straight/map\n"


def test_words_select_cells_and_none_is_no_pass(folder: Path, write: Callable[..., None]) -> None:
    write(GATED + '[[check]]\nname = "loose"\n')
    assert run("-k", "straight and not drive").exit_code == 0
    assert codes(folder) == {"drive/straight/map": None, "loose/straight/map": 0}
    assert run("-k", "nothing").exit_code == 5
    assert run("-k", "drive and").exit_code == 2


def test_options_of_the_command_line_win(folder: Path, write: Callable[..., None]) -> None:
    write(GATED)
    assert run("--max-unsafe", "1", "--eps=0.005").exit_code == 0
    (cell,) = summary(folder)["cells"]
    assert "the policy" in cell["stake"]
    assert "--max-unsafe=1" in cell["command"]
    assert "--eps=0.005" in cell["command"]
    result = run("--max-unsaf", "1")
    assert result.exit_code == 2
    assert "write 'max-unsafe' if you mean that" in result.output
    assert run("--max-unsafe").exit_code == 2
    assert run("stray").exit_code == 2


def test_a_project_is_found_from_below_and_its_paths_begin_beside_it(
    folder: Path, write: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    write("[[check]]\n")
    below = folder / "src"
    below.mkdir()
    monkeypatch.chdir(below)
    assert run().exit_code == 0
    assert Path.cwd() == below
    assert (folder / ".viatool" / "index.html").is_file()
    assert run("--project", "../viatool.toml", "--output", "here").exit_code == 0
    assert (below / "here" / "summary.json").is_file()


def test_cells_of_two_workers_are_the_same(folder: Path, write: Callable[..., None]) -> None:
    write(GATED + '[[check]]\nname = "loose"\n')
    assert run("--workers", 2).exit_code == 1
    assert codes(folder) == {"drive/straight/map": 1, "loose/straight/map": 0}


class Links(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found += [str(value) for name, value in attrs if name == "href"]


def test_the_page_leads_to_the_report_of_each_cell(folder: Path, write: Callable[..., None]) -> None:
    write("")
    text = (
        (folder / "viatool.toml")
        .read_text(encoding="utf-8")
        .replace("reports = []", 'reports = ["html", "junit"]')
    )
    (folder / "viatool.toml").write_text(text + GATED + '[[check]]\nname = "<b>"\n', encoding="utf-8")
    assert run().exit_code == 2  # that is no name
    (folder / "viatool.toml").write_text(text + GATED, encoding="utf-8")
    run()
    links = Links()
    links.feed((folder / ".viatool" / "index.html").read_text(encoding="utf-8"))
    files = [link for link in links.found if not link.startswith("#")]
    assert [Path(link).name for link in files] == ["report.html", "junit.xml", "report.json"]
    assert all((folder / ".viatool" / link).is_file() for link in files)


def test_an_accepted_finding_does_not_fail_the_gate_and_changes_no_rate(
    folder: Path, write: Callable[..., None]
) -> None:
    write(GATED.replace("0.9", "1") + ACCEPTED)
    result = run()
    assert result.exit_code == 0
    assert "passed 98.78 %, 1 accepted" in result.output
    (cell,) = summary(folder)["cells"]
    report = json.loads((folder / ".viatool" / cell["reports"]["json"]).read_text(encoding="utf-8"))
    assert report["verdicts"] == {"safe": 81, "unsafe": 1, "unknown": 0}
    assert [one["figures"] for one in cell["conditions"]] == [
        "98.78 % (81 of 82), 1 accepted",
        "1 unsafe, 1 accepted",
        "1 finding: the pillar will be moved",
    ]
    page = (folder / ".viatool" / "index.html").read_text(encoding="utf-8")
    assert "in force" in page
    assert "the pillar will be moved" in page


@pytest.mark.parametrize(
    ("before", "after", "code", "told"),
    [
        ("2999-01-31", "2020-01-31", 1, "expired, so 1 finding of it counts again"),
        ("state = 24", "state = 23", 2, "unsafe state 23: there is no such finding"),
        ('verdict = "unsafe"', 'verdict = "unknown"', 2, "unknown state 24: there is no such finding"),
        ("state = 24", 'scenario = "past"', 0, None),
        ("state = 24", 'scenario = "clear"', 2, "unsafe scenario clear: there is no such finding"),
        ("state = 24", 'place = "past/2.400"', 0, None),
        ("state = 24", 'place = "past/2.500"', 2, "there is no such finding"),
    ],
)
def test_what_is_no_longer_accepted_is_named_and_fails_the_run(
    folder: Path, write: Callable[..., None], before: str, after: str, code: int, told: str | None
) -> None:
    assert before in ACCEPTED
    write(GATED + ACCEPTED.replace(before, after))
    result = run()
    assert result.exit_code == code
    assert told is None or told in result.output


def test_an_expired_finding_fails_a_run_whose_gate_would_pass(
    folder: Path, write: Callable[..., None]
) -> None:
    write('[[check]]\nname = "drive"\n' + ACCEPTED.replace("2999", "2020"))
    assert run().exit_code == 1


def test_the_day_on_which_a_finding_expires_decides_what_is_kept(
    folder: Path, write: Callable[..., None]
) -> None:
    write(GATED + ACCEPTED)
    (cell,) = expand(load_project(folder / "viatool.toml"), commands_of_checks())
    days = [date(2999, 1, 1), date(2999, 1, 31), date(2999, 2, 1)]
    first, last, after = (digest_of_inputs(cell, ["verify"], [], day) for day in days)
    assert first == last != after


def test_accepting_for_the_scenario_covers_no_more_than_was_looked_at(
    folder: Path, write: Callable[..., None]
) -> None:
    wide = GATED.replace("0.9", "0") + ACCEPTED.replace("state = 24", 'scenario = "past"')
    write(wide)
    result = run("--criterion", "braking")
    assert result.exit_code == 1
    assert "where at most 1 may be" in result.output


def test_a_command_that_says_nothing_of_its_gate_has_not_passed(
    folder: Path, write: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    write(GATED)
    monkeypatch.setattr("viatool.cli.run.carry_out", lambda words: (0, ""))
    assert run().exit_code == 3


def test_a_refuted_state_that_was_accepted_as_unknown_would_pass_without_the_rule(
    folder: Path, write: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    write(GATED + ACCEPTED.replace('verdict = "unsafe"', 'verdict = "unknown"'))
    assert run().exit_code == 2
    monkeypatch.setattr(accepting, "_COVERS", {"unknown": ("unsafe", "unknown")})
    assert run().exit_code == 0


def test_an_expired_finding_would_pass_without_the_day(
    folder: Path, write: Callable[..., None], monkeypatch: pytest.MonkeyPatch
) -> None:
    write(GATED + ACCEPTED.replace("2999", "2020"))
    assert run().exit_code == 1
    settle = accepting.settle
    monkeypatch.setattr("viatool.report.gate.settle", lambda *about: settle(*about[:2], date(2019, 1, 1)))
    assert run().exit_code == 0
