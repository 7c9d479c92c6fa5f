"""GitHub Actions: workflow commands for annotations, and the Markdown report in the job's summary."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from viatool.report.document import read_result
from viatool.report.episodes import Episode, summarise_episodes
from viatool.report.foreign import one_line
from viatool.report.gate import Check
from viatool.report.markdown_report import markdown
from viatool.report.numbers import counted

if TYPE_CHECKING:
    from viatool.verification.result import Result

SUFFIXES = ()
SUMMARY_VARIABLE = "GITHUB_STEP_SUMMARY"
MOST_OF_A_KIND = 10  # GitHub shows no more annotations of a kind for each step


def render(result: Result, checks: Sequence[Check], suffix: str) -> str:
    """Return the workflow commands, and append the Markdown report to the job's summary if there is one."""
    document = read_result(result)
    summary = os.environ.get(SUMMARY_VARIABLE)
    if summary:
        with Path(summary).open("a", encoding="utf-8") as stream:
            stream.write(markdown(document, checks) + "\n")
    return annotate(document.map.path, summarise_episodes(result), checks)


def annotate(map_path: str, episodes: Sequence[Episode], checks: Sequence[Check]) -> str:
    """Return at most `MOST_OF_A_KIND` errors and as many warnings; the last one counts what is left out."""
    errors = [
        command("error", f"gate failed: {c.condition}", c.figures, map_path) for c in checks if not c.passed
    ]
    errors += [
        command("error", f"{counted(e.unsafe, 'unsafe state')} in {e.name}", _tally(e), map_path)
        for e in episodes
        if e.unsafe
    ]
    warnings = [
        command("warning", f"{counted(e.unknown, 'unknown state')} in {e.name}", _tally(e), map_path)
        for e in episodes
        if e.unknown and not e.unsafe
    ]
    return "".join(f"{line}\n" for kind in (errors, warnings) for line in _limited(kind, map_path))


def _tally(episode: Episode) -> str:
    return f"{episode.safe} of {episode.states} states safe, the episode ended in {episode.outcome}"


def _limited(lines: Sequence[str], map_path: str) -> list[str]:
    if len(lines) <= MOST_OF_A_KIND:
        return list(lines)
    kind = "error" if lines[0].startswith("::error") else "warning"
    left_out = len(lines) - MOST_OF_A_KIND + 1
    shown = list(lines[: MOST_OF_A_KIND - 1])
    return [*shown, command(kind, f"and {left_out} more", "see the report", map_path)]


def command(kind: str, title: str, message: str, file: str) -> str:
    """Return one workflow command; nothing in the texts can end it or start another."""
    return f"::{kind} file={_property(file)},title={_property(title)}::{_data(message)}"


def _data(text: str) -> str:
    return one_line(text).replace("%", "%25")


def _property(text: str) -> str:
    return _data(text).replace(":", "%3A").replace(",", "%2C")
