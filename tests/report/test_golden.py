"""The whole text of the reports, so that a change of a word is seen in review.

``VIATOOL_WRITE_GOLDEN=1 pytest tests/report/test_golden.py`` writes the files anew.
"""

from __future__ import annotations

import io
import os
from collections.abc import Callable
from pathlib import Path

from rich.console import Console

from viatool.report import Gate, ReportDocument, evaluate, parse_threshold, print_comparison, print_report
from viatool.report.markdown_report import markdown

GOLDEN = Path(__file__).parent / "golden"
GATE = Gate((parse_threshold("0.97"), parse_threshold("danger=0.9")), max_unsafe=0)


def check(name: str, text: str) -> None:
    path = GOLDEN / name
    lines = "\n".join(line.rstrip() for line in text.splitlines()) + "\n"
    if os.environ.get("VIATOOL_WRITE_GOLDEN"):
        path.write_text(lines, encoding="utf-8", newline="\n")
    assert lines == path.read_text(encoding="utf-8")


def test_the_console_report(document: Callable[..., ReportDocument]) -> None:
    stream = io.StringIO()
    report = document(9700, 100, 200)
    print_report(report, Console(file=stream, width=100), evaluate(GATE, report))
    check("console.txt", stream.getvalue())


def test_the_markdown_report(document: Callable[..., ReportDocument]) -> None:
    report = document(9700, 100, 200)
    check("report.md", markdown(report, evaluate(GATE, report)))


def test_the_comparison(document: Callable[..., ReportDocument]) -> None:
    stream = io.StringIO()
    print_comparison(document(9700, 100, 200), document(9900, 0, 100), Console(file=stream, width=100))
    check("comparison.txt", stream.getvalue())
