"""Pages name where their figures come from, how viatool is installed today, and what their commands need."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
GENERATED = ("cli.md", "fields.md", "operators.md", "changelog.md")
PAGES = [
    page for page in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))) if page.name not in GENERATED
]
NOT_PROSE = re.compile(r"^```.*?^```$|^<!--.*?-->$|^ {4,}\S.*?$|`[^`\n]*`", re.MULTILINE | re.DOTALL)
"""Blocks, whose output the tests compare (test_examples.py), and what is code in a line."""
MEASURED = re.compile(
    r"(?<![\w.])(?:\d[\d.,]* (?:ms|µs|seconds|minutes|hours|MB|GB)\b"  # times and sizes
    r"|\d+\.\d+ %"  # rates that nobody sets as a limit
    r"|\d[\d,]* of (?:all )?\d[\d,]+)"
)
DATE = re.compile(r"\b20\d\d-\d\d-\d\d\b")
NOT_YET = re.compile(r"pip install [^`\n&#]*?(?<![\w./])viatool(?:\[[\w,]+\])?(?! @ )(?![\w\[@/])")
"""Of viatool by its name alone, which works when it has been published."""

NEEDS = {
    "train": r"(?:train|import|reproduce)\b",
    "sim": r".*--engine bullet",
    "ros": r".*(?:\.mcap|\.bag|mcap:)",
    "cluster": r".*--scheduler",
    "html": r"(?:.*\\\n)*.*html:",
}
"""By extra, how a command of viatool goes on that needs it."""


def sections(text: str) -> list[str]:
    """Return the prose under each heading of a page."""
    return [NOT_PROSE.sub("", section) for section in re.split(r"^(?=#+ )", text, flags=re.MULTILINE)]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_measured_figure_outside_of_an_example_has_a_date_beside_it(page: Path) -> None:
    parts = sections(page.read_text(encoding="utf-8"))
    undated = [line for part in parts if not DATE.search(part) for line in part.splitlines()]
    assert [line for line in undated if MEASURED.search(line)] == []


@pytest.mark.parametrize("page", [*PAGES, ROOT / "CHANGELOG.md"], ids=lambda page: page.stem)
def test_no_page_installs_what_is_not_published(page: Path) -> None:
    assert NOT_YET.findall(page.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize(
    "page", [page for page in PAGES if page.name != "messages.md"], ids=lambda page: page.stem
)
def test_a_page_says_which_extra_its_commands_need(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    needed = {
        name
        for name, rest in NEEDS.items()
        if re.search(rf"^(?: {{4}}|\$ )viatool {rest}", text, re.MULTILINE)
    }
    told = {name for name in NEEDS if re.search(rf"`{name}`|\[[\w,]*\b{name}\b[\w,]*\]", text)}
    assert needed <= told


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("it takes 12 ms a state", True),
        ("97.2 % of the states", True),
        ("461 of 1,347 states", True),
        ("a gate of 99 % in 0.1 s", False),
        ("two of 10 rays at `0.5 %`", False),
        ("`95.1 %`", False),
    ],
)
def test_what_counts_as_measured(line: str, found: bool) -> None:
    assert bool(MEASURED.search(NOT_PROSE.sub("", line))) is found


def test_a_name_alone_is_not_a_place_to_install_from() -> None:
    assert NOT_YET.search("pip install viatool\n")
    assert NOT_YET.search("`pip install 'viatool[ros]'`")
    assert not NOT_YET.search('pip install "viatool[html] @ git+https://example.org/viatool"')
    assert not NOT_YET.search("pip install torch==2.13.0 '.[train]'")
    assert not NOT_YET.search("pip install . && .venv/bin/viatool verify via")
