"""``--verbose`` says on stderr what is read, decided and done; stdout stays what it was."""

from __future__ import annotations

import logging
import re
from pathlib import Path

from click.testing import CliRunner

from viatool.cli import main
from viatool.cli.group import COMMANDS


def said(folder: Path, *words: str) -> tuple[str, str]:
    done = CliRunner().invoke(
        main,
        ["verify", str(folder / "policy.onnx"), "--map", str(folder / "map.yaml"), "--eps", "0.01", *words],
    )
    assert done.exit_code == 0, done.output
    return done.stdout, done.stderr


def test_what_was_read_chosen_and_written_stands_on_stderr_with_its_seconds(
    hall: Path, tmp_path: Path
) -> None:
    report = tmp_path / "report.json"
    _, told = said(hall, "--verbose", "--output", f"json:{report}", "--close", "5")
    for words in (
        "map.yaml read: sha256 ",
        "policy.onnx: sha256 ",
        "self-check agrees",
        "passes ",
        "load: took ",
        "examine: of that reach ",
        "close places: 5 of 5 found",
        f"json written to {report}: {report.stat().st_size} bytes",
        "s of the processor",
    ):
        assert words in told, words
    notes = [line for line in told.splitlines() if line.startswith("[")]
    assert all(re.match(r"\[ *\d+\.\d\d s\] ", line) for line in notes)
    assert logging.getLogger("viatool").level == logging.NOTSET  # nothing stays behind


def test_the_report_is_the_same_and_others_are_told_nothing(hall: Path) -> None:
    timed = re.compile(r"^Time\n.*?\n\n", re.DOTALL | re.MULTILINE)
    plain, quiet = said(hall, "--close", "0")
    loud, _ = said(hall, "--close", "0", "--verbose")
    assert timed.sub("", plain) == timed.sub("", loud)
    assert "sha256" not in quiet


def test_every_command_takes_it_and_means_the_same() -> None:
    helps = {name: main.get_command(None, name) for name in COMMANDS}  # type: ignore[attr-defined]
    for name, command in helps.items():
        own = [one for one in command.params if "--verbose" in one.opts]
        assert len(own) == 1, name
        assert own[0].help.startswith("Say on stderr")
