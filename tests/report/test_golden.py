"""The whole text of the reports, so that a change of a word is seen in review.

``VIATOOL_WRITE_GOLDEN=1 pytest tests/report/test_golden.py`` writes the files anew.
"""

from __future__ import annotations

import io
import os
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from rich.console import Console

import viatool
from tests.hall import MAP, write_policy
from viatool.report import (
    Gate,
    Output,
    evaluate,
    parse_threshold,
    print_comparison,
    print_report,
)
from viatool.report.formats.markdown import markdown
from viatool.report.outputs import content_of
from viatool.report.states.document import StatesDocument
from viatool.report.states.run import StatesRun
from viatool.verification.result import Result

GOLDEN = Path(__file__).parent / "golden"
GATE = Gate(
    (parse_threshold("0.97", StatesDocument), parse_threshold("danger=0.9", StatesDocument)), max_unsafe=0
)
LINES = 120
"""Of a long report the first lines show its form."""

CHANGING = (
    (r"[0-9a-f]{64}", "SHA256"),
    (r'"(\w+)": "\d+\.\d+\.\d+[^"]*"', r'"\1": "VERSION"'),
    (r'(time|timestamp)="[^"]*"', r'\1="TIME"'),
    (r'"(load|trajectory|geometry|reach|judge|search|total)": [0-9]+\.[0-9e-]+', r'"\1": SECONDS'),
    (r"float32, [0-9.]+ m?s", "float32, SECONDS"),
    (r'"(passes|engine)": "(compiled|numpy)"', r'"\1": "ENGINE"'),
    (r"onnxruntime \d+\.\d+\.\d+\S*", "onnxruntime VERSION"),
)
"""What depends on the machine and the moment."""


def check(name: str, text: str) -> None:
    path = GOLDEN / name
    lines = "\n".join(line.rstrip() for line in text.splitlines()) + "\n"
    if os.environ.get("VIATOOL_WRITE_GOLDEN"):
        path.write_text(lines, encoding="utf-8", newline="\n")
    assert lines == path.read_text(encoding="utf-8")


def test_the_console_report(document: Callable[..., StatesDocument]) -> None:
    stream = io.StringIO()
    report = document(9700, 100, 200)
    print_report(report, Console(file=stream, width=100), evaluate(GATE, report))
    check("console.txt", stream.getvalue())


def test_the_markdown_report(document: Callable[..., StatesDocument]) -> None:
    report = document(9700, 100, 200)
    check("report.md", markdown(report, evaluate(GATE, report)))


def test_the_comparison(document: Callable[..., StatesDocument]) -> None:
    stream = io.StringIO()
    print_comparison(document(9700, 100, 200), document(9900, 0, 100), Console(file=stream, width=100))
    check("comparison.txt", stream.getvalue())


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("hall")


@pytest.fixture(scope="module")
def driven(folder: Path) -> Result:
    write_policy(folder / "policy.onnx")
    (folder / "map.yaml").write_text(MAP, encoding="utf-8")
    return viatool.verify(folder / "policy.onnx", folder / "map.yaml", eps=0.01, close=6)


@pytest.mark.parametrize("name", ["json", "csv", "junit", "sarif", "github", "witnesses"])
def test_what_other_programs_read(
    name: str, driven: Result, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("GITHUB_STEP_SUMMARY", raising=False)
    document = StatesRun(driven)
    checks = evaluate(GATE, document)
    text = b"".join(content_of(Output(name, Path("-")), document, checks)).decode()
    check(f"{name}.txt", "\n".join(steady(text, folder).splitlines()[:LINES]))


def steady(text: str, folder: Path) -> str:
    """Return a report without what depends on the machine and the moment, its numbers with four digits."""
    text = text.replace(folder.as_uri(), "file:///FOLDER").replace(folder.as_posix(), "FOLDER")
    for pattern, replacement in CHANGING:
        text = re.sub(pattern, replacement, text)
    return re.sub(r"-?\d+\.\d+(?:e[+-]?\d+)?", lambda number: f"{float(number[0]):.4g}", text)
