"""Data and pages: written from records, and pages from the data alone."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.studies.small import SMALL
from viatool.errors import ConfigurationError
from viatool.studies.progress import Board
from viatool.studies.reproduction import render, reproduce
from viatool.studies.runner import run_tasks
from viatool.studies.study import Options, data_path, write_data, write_page


def test_a_page_is_written_from_the_data_alone(tmp_path: Path) -> None:
    options = Options(seeds=4)
    tasks = SMALL.plan(options)
    records = run_tasks(tasks, tmp_path / "output", Board())
    write_data(SMALL, options, tasks, {"small/a": records["small/a"]}, tmp_path)
    assert write_page(SMALL, tmp_path).read_text(encoding="utf-8") == "1 of 2\nsmall/a: 10\n"
    write_data(SMALL, options, tasks, records, tmp_path)
    data = json.loads(data_path(tmp_path, SMALL).read_text(encoding="utf-8"))
    assert data["command"] == "viatool reproduce small --preset study --seeds 4"
    assert write_page(SMALL, tmp_path).read_text(encoding="utf-8") == "2 of 2\nsmall/a: 10\nsmall/b: 6\n"
    assert (tmp_path / "picture.svg").read_bytes() == b"<svg/>"


@pytest.mark.parametrize(
    ("content", "message"),
    [(None, "cannot read"), ("{", "is not JSON"), ('{"study": "other"}', "is not the data of small")],
)
def test_a_page_needs_the_data_of_its_study(tmp_path: Path, content: str | None, message: str) -> None:
    if content is not None:
        data_path(tmp_path, SMALL).parent.mkdir()
        data_path(tmp_path, SMALL).write_text(content)
    with pytest.raises(ConfigurationError, match=message):
        write_page(SMALL, tmp_path)
    assert not (tmp_path / "small.md").exists()


def test_an_interrupted_run_leaves_the_pages_of_what_is_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Interrupted(Board):
        def end(self, task: str, outcome: object) -> None:
            if task == "small/b":
                raise KeyboardInterrupt

    monkeypatch.setattr("viatool.studies.reproduction.study_named", {"small": SMALL}.__getitem__)
    output, results = tmp_path / "output", tmp_path / "results"
    with pytest.raises(KeyboardInterrupt):
        reproduce(["small"], Options(), output, results, Interrupted())
    page = results / "small.md"
    assert page.read_text(encoding="utf-8") == "1 of 2\nsmall/a: 15\n"
    assert reproduce(["small"], Options(), output, results, Board()) == [page]
    whole = page.read_text(encoding="utf-8")
    assert whole == "2 of 2\nsmall/a: 15\nsmall/b: 6\n"
    page.unlink()
    assert render(["small"], results) == [page]
    assert page.read_text(encoding="utf-8") == whole
