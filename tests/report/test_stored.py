"""A state table holds its run: what is made of it later is what the run itself would have written."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result

import viatool
from tests.hall import MAP, write_policy
from viatool.cli import main
from viatool.loop.horizon import Horizon
from viatool.report import Output, formats_of, load_document, load_shown
from viatool.report.outputs import content_of
from viatool.report.states.run import StatesRun

CASES: dict[str, dict[str, Any]] = {
    "close places": {"eps": 0.05, "close": 10},
    "a horizon": {"eps": {"": 0.02, "lidar": 0.05}, "close": 0, "horizon": Horizon(2)},
    "other rules": {
        "eps": 0.05, "close": 5, "criterion": "braking", "footprint": 0.1, "delay": 0.04, "clearance": 0.3,
        "robot": "turtlebot3", "interval": 0.2, "prefer": {"": "map"},
    },
    "an error model": {"errors": "errors.yaml", "eps": 0.02, "close": 5},
}  # fmt: skip
ERRORS = "version: 1\nsensor: {lidar: {absolute: 0.03}}\npose: {x: 0.01, y: 0.01, theta: 0.01}\n"


@pytest.fixture(scope="module")
def hall(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("hall")
    write_policy(folder / "policy.onnx")
    (folder / "map.yaml").write_text(MAP, encoding="utf-8")
    (folder / "errors.yaml").write_text(ERRORS, encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def run(hall: Path) -> Callable[[str], StatesRun]:
    made: dict[str, StatesRun] = {}

    def of(case: str) -> StatesRun:
        if case not in made:
            asked = dict(CASES[case])
            if "errors" in asked:
                asked["errors"] = hall / asked["errors"]
            made[case] = StatesRun(viatool.verify(hall / "policy.onnx", hall / "map.yaml", **asked))
        return made[case]

    return of


def content(document: Any, name: str) -> bytes:
    suffix = {"figure": ".png", "mcap": ".mcap"}.get(name, "")
    made = b"".join(content_of(Output(name, Path(f"x{suffix}")), document))
    return re.sub(rb'"p\d+"', b'"p"', made) if name == "html" else made  # bokeh counts over the process


def stored(document: StatesRun, path: Path) -> Path:
    path.write_bytes(content(document, "states"))
    return path


@pytest.mark.parametrize("case", CASES)
def test_every_format_of_a_state_table_is_what_the_run_wrote(
    run: Callable[[str], StatesRun], case: str, tmp_path: Path
) -> None:
    document = run(case)
    again = load_shown(stored(document, tmp_path / "states.npz"))
    few = {"csv", "witnesses", "mcap"}
    names = set(formats_of(type(again))) - {"figure"} if case == "close places" else few
    assert {*few, "html", "figure", "junit", "github", "markdown", "json"} <= set(formats_of(type(again)))
    differing = {name for name in names if content(again, name) != content(document, name)}
    assert not differing


def viatool_report(*words: Any) -> Result:
    return CliRunner().invoke(main, ["report", *map(str, words)])


def test_a_moved_table_finds_its_map_beside_it_or_takes_another_path(
    run: Callable[[str], StatesRun], hall: Path, tmp_path: Path
) -> None:
    told = run("close places")
    told.content["map"]["path"], before = "gone.yaml", told.content["map"]["path"]
    table = stored(told, tmp_path / "states.npz")
    told.content["map"]["path"] = before
    lost = viatool_report(table, "-q", "-o", f"csv:{tmp_path / 'a.csv'}")
    assert lost.exit_code == 2
    assert "give it with --map FILE" in lost.output
    assert not (tmp_path / "a.csv").exists()
    given = viatool_report(table, "-q", "--map", hall / "map.yaml", "-o", f"csv:{tmp_path / 'a.csv'}")
    assert given.exit_code == 0
    (tmp_path / "gone.yaml").write_text(MAP, encoding="utf-8")
    assert viatool_report(table, "-q", "-o", f"csv:{tmp_path / 'b.csv'}").exit_code == 0
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()
    (tmp_path / "gone.yaml").write_text(MAP.replace("0.55", "0.65"), encoding="utf-8")
    other = viatool_report(table, "-q", "-o", f"csv:{tmp_path / 'c.csv'}")
    assert other.exit_code == 2
    assert "is not the one of" in other.output


def test_damaged_foreign_and_other_tables_are_told_by_name(
    run: Callable[[str], StatesRun], tmp_path: Path
) -> None:
    whole = stored(run("close places"), tmp_path / "states.npz")
    cut = tmp_path / "cut.npz"
    cut.write_bytes(whole.read_bytes()[:5000])
    foreign = tmp_path / "foreign.npz"
    np.savez(foreign, pose=np.zeros((1, 3)))
    with np.load(whole) as archive:
        arrays = dict(archive)
    lacking, version = tmp_path / "lacking.npz", tmp_path / "version.npz"
    np.savez(lacking, **{name: array for name, array in arrays.items() if name != "observation"})
    report = json.loads(arrays["run.report"].tobytes())
    report["schema_version"] = 7
    text = np.frombuffer(json.dumps(report).encode(), dtype=np.uint8)
    np.savez(version, **{**arrays, "run.report": text})
    turned, shortened = tmp_path / "turned.npz", tmp_path / "shortened.npz"
    np.savez(turned, **{**arrays, "verdict": np.full_like(arrays["verdict"], "safe")})
    states = len(arrays["verdict"])
    np.savez(
        shortened,
        **{name: array[: states - 1] if len(array) == states else array for name, array in arrays.items()},
    )
    for path, words in (
        (turned, "the table gives "),
        (shortened, "cannot be shown"),
        (cut, "is cut off or damaged"),
        (foreign, "holds no report"),
        (lacking, "lacks 'observation'"),
        (version, "schema version 7"),
    ):
        done = viatool_report(path, "-q", "-o", f"csv:{tmp_path / 'x.csv'}")
        assert done.exit_code == 2, done.output
        assert words in done.output
        assert not (tmp_path / "x.csv").exists()


def test_whatever_reads_a_report_reads_the_archive_that_holds_it(
    run: Callable[[str], StatesRun], tmp_path: Path
) -> None:
    document = run("close places")
    table = stored(document, tmp_path / "states.npz")
    assert load_document(table).content == json.loads(content(document, "json"))
    gate = CliRunner().invoke(main, ["gate", str(table), "--max-unsafe", "100000"])
    assert gate.exit_code == 0
    assert "passed" in gate.output


def test_a_report_in_json_makes_a_page_of_words_and_says_what_makes_more(
    run: Callable[[str], StatesRun], tmp_path: Path
) -> None:
    document, path = run("close places"), tmp_path / "report.json"
    path.write_bytes(content(document, "json"))
    assert viatool_report(path, "-q", "-o", f"html:{tmp_path / 'a.html'}").exit_code == 0
    page = (tmp_path / "a.html").read_text(encoding="utf-8")
    assert document.stake in page
    assert "--output states:FILE.npz" in page
    assert "<script" not in page
    csv = viatool_report(path, "-q", "-o", f"csv:{tmp_path / 'a.csv'}")
    assert csv.exit_code == 2
    assert "states.npz" in csv.output
