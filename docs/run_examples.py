"""Run the examples of pages, in order and in an empty folder, and compare what they print with what the page shows.

    python docs/run_examples.py README.md docs/*.md       # tells what differs
    python docs/run_examples.py --write docs/tutorial.md  # puts what was printed into the page
    python docs/run_examples.py --folder DIR docs/tutorial.md  # in a folder in which the slow blocks have run before

Examples are fenced blocks: `console` (a line that begins with `$ ` is run, what follows is its output), `python`,
and `pycon`. A line `...` in an output stands for any lines, a `...` within a line for any characters. Before a block,
`<!-- not run: WHY -->` leaves it out, `<!-- slow -->` leaves it and the rest of the page out of the tests, and
`<!-- run CODE -->` runs Python that a reader need not see.
"""

from __future__ import annotations

import argparse
import difflib
import doctest
import os
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from click.testing import CliRunner

from viatool.cli import main as viatool

ROOT = Path(__file__).resolve().parents[1]
_BLOCK = re.compile(
    r"^<!-- (?P<mark>not run: .*|slow) -->\n+```(?:console|python|pycon)\n.*?^```$"
    r"|^```(?P<language>console|python|pycon)\n(?P<code>.*?)^```$"
    r"|^<!-- run\n(?P<hidden>.*?)^-->$",
    re.MULTILINE | re.DOTALL,
)
_COMMAND = re.compile(r"^\$ (?P<command>(?:.*\\\n)*.*)\n(?P<output>(?:(?!\$ ).*\n)*)", re.MULTILINE)


@dataclass
class Page:
    """One run of a page: its Python names, the last exit code, and what differs.

    `exact` compares numbers as well; without it they may have changed with a policy, a machine or a version.
    """

    path: Path
    exact: bool = True
    names: dict[str, Any] = field(default_factory=lambda: {"__name__": "example"})
    code: int = 0
    complaints: list[str] = field(default_factory=list)

    def run(self, *, slow: str, folder: Path | None = None) -> str:
        """Run the blocks; return the page with the outputs that were seen.

        `slow` says what is done about slow blocks: "run" them, "skip" them, or "stop" there.
        """
        text = self.path.read_text(encoding="utf-8")
        with tempfile.TemporaryDirectory() as empty, chdir(folder or empty):
            seen, end = [], 0
            for block in _BLOCK.finditer(text):
                if block["mark"] == "slow" and slow != "run":
                    if slow == "stop":
                        break
                    continue
                seen += [text[end : block.start()], self._block(block)]
                end = block.end()
        return "".join([*seen, text[end:]])

    def _block(self, block: re.Match[str]) -> str:
        source = block[0]
        if (block["mark"] or "").startswith("not run"):
            return source
        if block["language"] == "console" or block["mark"] == "slow":
            return _COMMAND.sub(self._command, source)
        code = block["hidden"] or block["code"]
        if block["language"] == "pycon":
            self._doctest(code)
        else:
            exec(compile(code, str(self.path), "exec"), self.names)
        return source

    def _doctest(self, code: str) -> None:
        test = doctest.DocTestParser().get_doctest(code, self.names, self.path.name, str(self.path), 0)
        runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS, verbose=False)
        found: list[str] = []
        runner.run(test, out=found.append, clear_globs=False)
        self.names |= test.globs
        self.complaints += found

    def _command(self, example: re.Match[str]) -> str:
        command, shown = example["command"].replace("\\\n", " "), example["output"]
        printed = self._execute(command)
        if matches(shown, printed, exact=self.exact):
            return example[0]
        self.complaints.append(f"$ {command}\n{shown}--- printed\n{printed}")
        return f"$ {example['command']}\n{elide(shown, printed)}"

    def _execute(self, command: str) -> str:
        """Run a command: viatool in this process, anything else in bash; return what it says."""
        if command.startswith("viatool "):
            result = CliRunner().invoke(viatool, shlex.split(command, comments=True)[1:], prog_name="viatool")
            self.code = result.exit_code
            return tidy(result.stdout or result.stderr)
        environment = os.environ | {"PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}"}
        run = subprocess.run(
            ["bash", "-c", f"(exit {self.code}); {command}"],
            env=environment, capture_output=True, text=True, check=False,
        )  # fmt: skip
        self.code = run.returncode
        return tidy(run.stdout or run.stderr)


@contextmanager
def chdir(folder: str | Path) -> Iterator[None]:
    """Work in a folder for a while."""
    before = Path.cwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)


def tidy(text: str) -> str:
    """Return lines without trailing blanks, and without empty lines at the ends."""
    lines = "\n".join(line.rstrip() for line in text.splitlines()).strip("\n")
    return f"{lines}\n" if lines else ""


def loosely(text: str) -> str:
    """Return a text in which all numbers, and the widths of columns and bars, are the same."""
    text = re.sub(r"[ ─█▓▒░]+", " ", re.sub(r"-?\d[\d,.:]*", "0", text))
    return re.sub(r"(?m)^ | $", "", text)


def matches(shown: str, printed: str, *, exact: bool = True) -> bool:
    """Whether an output is what a page shows; an empty one is not looked at."""
    if not shown.strip():
        return True
    if not exact:
        shown, printed = loosely(shown), loosely(printed)
    pattern = re.escape(tidy(shown)).replace(r"\.\.\.", "...")
    pattern = re.sub(r"(?m)^\.\.\.(?:\\\n|\n)", r"(?:.*\\n)*?", pattern).replace("\\\n", "\n")
    return re.fullmatch(pattern.replace("...", ".*?"), printed) is not None


def elide(shown: str, printed: str) -> str:
    """Return what was printed, left out where the page leaves lines out."""
    parts = re.split(r"(?m)^\.\.\.\n", shown)
    lines = printed.splitlines(keepends=True)
    if len(parts) == 1:
        return printed
    first, *middle, last = [part.splitlines(keepends=True) for part in parts]
    found, begin = [lines[: len(first)]], len(first)
    end = len(lines) - len(last)
    for part in middle:
        starts = range(begin, max(begin, end - len(part)) + 1)
        begin = max(starts, key=lambda i: likeness(part, lines[i : i + len(part)]))
        found.append(lines[begin : begin + len(part)])
        begin += len(part)
    found.append(lines[max(begin, end) :])
    return "...\n".join("".join(part) for part in found)


def likeness(one: list[str], other: list[str]) -> float:
    """Return how alike two pieces of text are."""
    return difflib.SequenceMatcher(None, "".join(one), "".join(other)).ratio()


def examples(path: Path) -> Iterator[str]:
    """Yield the kind of every block that a page runs in the tests."""
    for block in _BLOCK.finditer(path.read_text(encoding="utf-8")):
        if block["mark"] == "slow":
            return
        if block["mark"] is None:
            yield block["language"] or "hidden"


def main() -> int:
    """Run pages; return 1 if one shows something else than what was printed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("pages", nargs="+", type=Path)
    parser.add_argument("--write", action="store_true", help="put what was printed into the pages")
    parser.add_argument("--folder", type=Path, help="run here, and leave slow blocks out")
    arguments = parser.parse_args()
    differ = False
    for path in arguments.pages:
        page = Page(path.resolve())
        text = page.run(slow="skip" if arguments.folder else "run", folder=arguments.folder)
        print(f"{path}: {len(page.complaints)} differ", *page.complaints, sep="\n")
        differ |= bool(page.complaints)
        if arguments.write:
            path.write_text(text, encoding="utf-8", newline="\n")
    return int(differ)


if __name__ == "__main__":
    sys.exit(main())
