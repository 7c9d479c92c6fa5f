"""Strings that others wrote, such as names in a map: made harmless before they are shown."""

from __future__ import annotations

import re


def one_line(text: str, replacement: str = " ") -> str:
    """Return a text without line breaks, escape sequences or other control characters."""
    return "".join(character if character.isprintable() else replacement for character in text)


def shown(text: str) -> str:
    """Return a text for a terminal or a log: one line, and nothing that a CI system takes for a command.

    A line of a log that starts with two colons is a workflow command of GitHub Actions, and wrapping can put
    any word at the start of a line. So no two colons stay together, of however many there are.
    """
    return re.sub(":(?=:)", ": ", one_line(text))
