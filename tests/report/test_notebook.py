"""Results in notebooks: a small table, figures of matplotlib, and the example that shows both."""

from __future__ import annotations

import runpy
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest
from matplotlib.figure import Figure

import viatool
from tests.hall import MAP, write_policy
from tests.renamed import renamed
from viatool.verification.result import Result

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Result:
    folder = tmp_path_factory.mktemp("hall")
    write_policy(folder / "policy.onnx")
    (folder / "map.yaml").write_text(MAP, encoding="utf-8")
    return viatool.verify(folder / "policy.onnx", folder / "map.yaml", eps=0.01)


def test_a_notebook_shows_the_rates(result: Result) -> None:
    shown = result._repr_html_()
    assert str(result.safety_rate) in shown
    assert str(result.contested_rate.collision) in shown
    assert len(shown) < 3000


def test_a_notebook_is_safe_from_names(result: Result) -> None:
    named = replace(result, setting=renamed(result.setting, "<img src=x>"))
    tags: set[str] = set()

    class Tags(HTMLParser):
        def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
            tags.add(tag)

    Tags().feed(named._repr_html_())
    assert tags == {"p", "b", "br", "table", "thead", "tbody", "tr", "th", "td"}


def test_plots_are_figures_of_matplotlib(result: Result) -> None:
    assert isinstance(viatool.draw_result(result), Figure)
    assert isinstance(viatool.draw_map(result.world_map), Figure)


def test_the_example_runs(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(ROOT)
    names = runpy.run_path(str(ROOT / "examples" / "verify_in_python.py"))
    assert isinstance(names["figure"], Figure)
    printed = capsys.readouterr().out
    assert f"{names['result'].safety_rate}: " in printed
    assert printed.splitlines()[-1] in ("safe enough to drive", "not safe enough to drive")
