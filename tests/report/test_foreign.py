"""Text that others wrote gives no command to a CI system that reads the log, wherever a line is wrapped."""

from __future__ import annotations

import pytest

from viatool.cli.failures import compose
from viatool.report.foreign import one_line, shown
from viatool.report.formats.github import command
from viatool.report.sections import Annotation

COMMANDS = (
    "::error file=x::owned",
    ":::error::owned",
    "::::set-output name=a::b",
    "a :::::warning::owned",
    "one\n::error::owned",
    "one\r::error::owned",
)


@pytest.mark.parametrize("text", COMMANDS)
def test_no_two_colons_stay_together(text: str) -> None:
    assert "::" not in shown(text)
    assert "::" not in compose(text, text)


@pytest.mark.parametrize("text", COMMANDS)
def test_nothing_else_is_lost(text: str) -> None:
    for made in (shown(text), compose(text).removeprefix("error: ")):
        assert "".join(made.replace("?", "").split()) == "".join(text.split())


def test_one_colon_stays_as_it_is() -> None:
    assert shown("C:/maps/lab.yaml: wall 3") == "C:/maps/lab.yaml: wall 3"


@pytest.mark.parametrize("text", ["\x1b[31mred", "two\nlines", "\u2028", "bell\x07", "\x9b2J"])
def test_control_characters_are_blanks(text: str) -> None:
    assert one_line(text).isprintable()
    assert len(one_line(text)) == len(text)


@pytest.mark.parametrize("text", [*COMMANDS, "a,title=b", "%0A::error::x", "100 %"])
def test_a_workflow_command_holds_its_texts_and_no_other_command(text: str) -> None:
    """As GitHub reads it: properties end at the first ``::``, entries at a comma, and %XX stands for a character."""
    line = command(Annotation("error", text, text), text)
    assert "\n" not in line
    assert "\r" not in line
    properties, end, message = line.removeprefix("::error ").partition("::")
    assert end
    entries = dict(entry.split("=", 1) for entry in properties.split(","))
    plain = one_line(text)
    assert {name: decoded(value) for name, value in entries.items()} == {"file": plain, "title": plain}
    assert decoded(message) == plain


def decoded(text: str) -> str:
    for code, character in (("%3A", ":"), ("%2C", ","), ("%0A", "\n"), ("%0D", "\r"), ("%25", "%")):
        text = text.replace(code, character)
    return text
