"""Names with markup, commands and control characters, in every format: they stay text, and stay in their place."""

from __future__ import annotations

import csv
import io
import json
import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

import viatool
from tests.hall import MAP, write_policy
from tests.renamed import renamed
from viatool.report import Check, formats_of
from viatool.report.outputs import FOLDERS, Output, content_of
from viatool.report.states.run import StatesRun
from viatool.verification.result import Result

NAMES = {
    "quotes": "a\"b'c`d",
    "angle brackets": "<script>owned()</script><img src=x onerror=owned()>",
    "newlines": "one\ntwo\r\nthree\u2028four\x85five",
    "ansi": "\x1b[31mred\x1b]0;title\x07\x9b2J",
    "workflow command": "\n::error file=x::owned\n##[error]owned\n::set-output name=a::b",
    "percent": "%0A%0D::error::owned%25",
    "markdown": "| a | b |\n|---|---|\n[link](javascript:owned()) **bold** `code` <!-- @team #1",
    "formula": "=cmd|' /C calc'!A0",
    "plus formula": "+1+1",
    "minus formula": "-1+1",
    "at formula": "@SUM(1)",
    "tab formula": "\t=1+1",
    "mathematics": "$\\frac{1}{0}$ $ x_",
    "end of cdata": "]]> &amp; &#x1b; <!ENTITY x>",
    "template": "{{7*7}} {% raw %} ${7*7} %(x)s {0}",
    "right to left": "safe\u202eefasnu\u2066",
}
FOR_THE_PAGE = ("angle brackets", "ansi", "workflow command", "template")  # the browser's tests have more
TEXT_FORMATS = sorted(set(formats_of(StatesRun)) - {"states", "figure", "mcap", *FOLDERS})


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Result:
    folder = tmp_path_factory.mktemp("hall")
    write_policy(folder / "policy.onnx")
    (folder / "map.yaml").write_text(MAP, encoding="utf-8")
    return viatool.verify(folder / "policy.onnx", folder / "map.yaml", eps=0.01, close=20)


def named(result: Result, name: str) -> Result:
    """Return a result in which everything that others name bears this name."""
    trajectory = result.trajectory
    scenarios = tuple(
        replace(scenario, name=f"{name}{'' if index == 0 else index}")
        for index, scenario in enumerate(trajectory.scenarios)
    )
    return replace(
        result,
        policy_path=Path(name.replace("\0", "")),
        setting=renamed(result.setting, name),
        trajectory=replace(trajectory, scenarios=scenarios, notes=(name,)),
        versions={**result.versions, name: name},
        origin=name,
        close=None if result.close is None else named(result.close, name),
    )


def render(result: Result, form: str, name: str = "") -> str:
    checks = (Check(f"condition {name}", passed=False, figures=name),)
    return b"".join(content_of(Output(form, Path("-")), StatesRun(result), checks)).decode("utf-8")


@pytest.mark.parametrize(
    ("form", "kind"), [(f, k) for f in TEXT_FORMATS for k in (FOR_THE_PAGE if f == "html" else NAMES)]
)
def test_a_name_stays_text(plain: Result, form: str, kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("GITHUB_STEP_SUMMARY", raising=False)
    text = render(named(plain, NAMES[kind]), form, NAMES[kind])
    assert not re.search("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f]", text)
    if form == "html":
        text = re.sub(r"<script>.*?</script>", "", text, flags=re.DOTALL)  # the plotting library's own
    if form != "github":
        assert not [line for line in text.splitlines() if line.lstrip().startswith(("::", "##["))]
    READERS.get(form, lambda text, plain: None)(text, plain)


def read_json(text: str, plain: Result) -> None:
    json.loads(text)


def read_junit(text: str, plain: Result) -> None:
    cases = list(ElementTree.fromstring(text).iter("testcase"))
    assert plain.close is not None
    beside = len(np.unique(plain.close.episode))
    assert len(cases) == plain.trajectory.episodes + beside + 1
    assert {part.tag for case in cases for part in case} <= {"failure", "error", "skipped", "system-out"}


def read_csv(text: str, plain: Result) -> None:
    rows = list(csv.reader(io.StringIO(text)))
    assert len(rows) == len(plain.trajectory) + 1
    assert len({len(row) for row in rows}) == 1
    cells = np.array(rows, dtype=object).ravel().tolist()
    assert not [c for c in cells if c.startswith(("=", "+", "-", "@", "\t", "\r")) and not is_number(c)]


def is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def read_markdown(text: str, plain: Result) -> None:
    assert not re.search(r"<(?!/?(?:details|summary)\b)", text)
    bare = re.sub(r"\\.", "", text)
    assert "](" not in bare
    assert "@" not in bare
    rows = [line.count("|") for line in bare.splitlines() if line.startswith("|")]
    assert max(rows) == 6


def read_github(text: str, plain: Result) -> None:
    for line in text.splitlines():
        assert re.match(r"::(notice|error|warning) file=[^,:]*,title=[^,:]*::", line)


READERS = {
    "json": read_json,
    "sarif": read_json,
    "witnesses": read_json,
    "junit": read_junit,
    "csv": read_csv,
    "markdown": read_markdown,
    "github": read_github,
}


@pytest.mark.parametrize("suffix", [".png", ".svg"])
def test_a_picture_is_drawn_whatever_the_names(plain: Result, suffix: str) -> None:
    from viatool.report.formats.figure import render as draw

    for name in ("mathematics", "angle brackets", "newlines"):
        content = draw(StatesRun(named(plain, NAMES[name])), (), suffix)
        if suffix == ".svg":
            assert not [e for e in ElementTree.fromstring(content).iter() if e.tag.endswith("script")]
