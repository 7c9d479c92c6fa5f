"""TOML with line numbers: read a document, find the line on which a field of it stands, and write values."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

from viatool.errors import ConfigurationError

if sys.version_info >= (3, 11):
    import tomllib
else:  # pragma: no cover  # the older Python's half
    import tomli as tomllib

_HEADER = re.compile(r"\s*(\[\[?)\s*([^\[\]]+?)\s*\]\]?\s*(#.*)?")
_KEY = re.compile(r"""\s*("[^"]*"|'[^']*'|[\w-]+)(?:\s*\.\s*("[^"]*"|'[^']*'|[\w-]+))*\s*=""")
_PART = re.compile(r""""[^"]*"|'[^']*'|[\w-]+""")

Place = tuple[str | int, ...]


@dataclass(frozen=True, eq=False)
class TomlDocument:
    """A parsed file.

    Parameters
    ----------
    path : Path
        Where it was read.
    content : dict
        What it holds.
    lines : mapping
        The lines, counted from 1, of tables and keys that stand on lines of their own.
    """

    path: Path
    content: dict[str, Any]
    lines: Mapping[Place, int]

    def place(self, location: Sequence[str | int]) -> str:
        """Return "file:line" of a field, or of the innermost table around it that has a line."""
        for end in range(len(location), 0, -1):
            if (line := self.lines.get(tuple(location[:end]))) is not None:
                return f"{self.path}:{line}"
        return str(self.path)


def read_toml(path: Path) -> TomlDocument:
    """Read a TOML file.

    Raises
    ------
    ConfigurationError
        If it cannot be read, or is not TOML; names the line.
    """
    try:
        text = path.read_text(encoding="utf-8")
        return TomlDocument(path, tomllib.loads(text), _lines(text))
    except OSError as error:
        raise ConfigurationError(f"cannot read '{path}': {error.strerror}", "check the path") from error
    except UnicodeDecodeError as error:
        raise ConfigurationError(f"'{path}' is not a UTF-8 text file", "save it as TOML in UTF-8") from error
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise ConfigurationError(f"'{path}' is not TOML: {error}", "correct the syntax") from error


def _lines(text: str) -> dict[Place, int]:
    """Return where tables and keys stand; a key inside a value that spans lines is found as if it stood alone."""
    found: dict[Place, int] = {}
    counts: dict[Place, int] = {}
    table: Place = ()
    for number, line in enumerate(text.splitlines(), 1):
        if header := _HEADER.fullmatch(line):
            table = _table(_parts(header[2]), counts, repeated=header[1] == "[[")
            found.setdefault(table, number)
        elif key := _KEY.match(line):
            found.setdefault((*table, *_parts(key[0].rpartition("=")[0])), number)
    return found


def _table(names: Sequence[str], counts: dict[Place, int], *, repeated: bool) -> Place:
    """Return the place that a header begins, with the number of the table in each array of tables on the way."""
    place: Place = ()
    for step, name in enumerate(names):
        place = (*place, name)
        if repeated and step == len(names) - 1:
            counts[place] = counts.get(place, -1) + 1
        if place in counts:
            place = (*place, counts[place])
    return place


def _parts(text: str) -> list[str]:
    return [part.strip("\"'") for part in _PART.findall(text)]


def toml_value(value: Any) -> str:
    """Return a value as it may stand behind ``key =`` in a file.

    Raises
    ------
    TypeError
        If TOML has no such value.
    """
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, date):
        return value.isoformat()
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, Mapping):
        pairs = (f"{toml_key(name)} = {toml_value(part)}" for name, part in value.items())
        return f"{{ {', '.join(pairs)} }}"
    if isinstance(value, Sequence):
        return f"[{', '.join(map(toml_value, value))}]"
    raise TypeError(f"TOML has no {type(value).__name__}")


def toml_key(name: str) -> str:
    """Return a key as it may stand before ``=``."""
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else toml_value(name)
