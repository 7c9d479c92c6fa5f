"""The examples of the README and of the documentation run, and print what the pages show."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = runpy.run_path(str(ROOT / "docs" / "run_examples.py"))
PAGES = [
    path
    for path in (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
    if any(EXAMPLES["examples"](path))
]


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize("path", PAGES, ids=lambda path: path.stem)
def test_the_examples_of_a_page_print_what_it_shows(path: Path) -> None:
    page = EXAMPLES["Page"](path, exact=False)
    page.run(slow="stop")
    assert not page.complaints, "\n".join(page.complaints)


@pytest.mark.parametrize(
    ("shown", "printed", "same"),
    [
        ("", "anything\n", True),
        ("a\nb\n", "a\nb\n", True),
        ("a\n", "b\n", False),
        ("a\n...\nd\n", "a\nb\nc\nd\n", True),
        ("a\n...\n", "a\nb\n", True),
        ("took ... s\n", "took 1.5 s\n", True),
        ("a\n...\nd\n", "a\nb\n", False),
        ("1.5 (x)\n", "1x5 (x)\n", False),
    ],
)
def test_what_a_page_leaves_out(shown: str, printed: str, same: bool) -> None:
    assert EXAMPLES["matches"](shown, printed) is same


def test_numbers_may_change_and_words_may_not() -> None:
    shown, printed = "rate  9.50 %  (1,190 of 1,200)\n", "rate 100.00 % (7 of 7)\n"
    assert not EXAMPLES["matches"](shown, printed)
    assert EXAMPLES["matches"](shown, printed, exact=False)
    assert not EXAMPLES["matches"](shown, printed.replace("rate", "share"), exact=False)


def test_a_renewed_output_leaves_out_what_the_page_left_out() -> None:
    shown = "head 1\n...\nrate 90 %\nof 10\n...\nend 1\n"
    printed = "head 2\nx\nrate 80 %\nof 20\ny\nz\nend 2\n"
    assert EXAMPLES["elide"](shown, printed) == "head 2\n...\nrate 80 %\nof 20\n...\nend 2\n"
