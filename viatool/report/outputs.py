"""The formats by name, and the outputs that a user asks for as FORMAT:PATH."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, cast

from viatool.errors import ConfigurationError
from viatool.report.files import as_bytes, check_folder, check_writable, write_folder, write_whole
from viatool.report.kinds import KINDS, live_of

if TYPE_CHECKING:
    from viatool.report.document import Document
    from viatool.report.sections import Check

_log = logging.getLogger(__name__)

FORMATS = {
    "json": "viatool.report.formats.json",
    "gate": "viatool.report.formats.gate",
    "states": "viatool.report.formats.states",
    "cells": "viatool.report.formats.cells",
    "tube": "viatool.report.formats.tube",
    "trajectory": "viatool.report.formats.trajectory",
    "csv": "viatool.report.formats.csv",
    "witnesses": "viatool.report.formats.witnesses",
    "mcap": "viatool.report.formats.mcap",
    "figure": "viatool.report.formats.figure",
    "html": "viatool.report.formats.html",
    "markdown": "viatool.report.formats.markdown",
    "junit": "viatool.report.formats.junit",
    "sarif": "viatool.report.formats.sarif",
    "github": "viatool.report.formats.github",
    "evidence": "viatool.report.formats.evidence",
}
"""Format name to the module that renders it; imported when it is asked for."""

FOLDERS = ("evidence",)
"""Formats that are folders: they render the content of each file by its name, for `write_folder`."""

STDOUT = Path("-")


class Format(Protocol):
    """What a module of `FORMATS` offers."""

    SUFFIXES: tuple[str, ...]
    """What its files may end in; anything if empty."""
    NEEDS: type[Document]
    """The class of the documents that it can render."""
    LIBRARIES: tuple[str, ...]
    """What has to be installed for it and is not for every command."""

    def render(self, document: Any, checks: Sequence[Check], suffix: str) -> Any:
        """Return the content of a file with that suffix, or of a folder the contents of its files by name."""


def format_named(name: str) -> Format:
    """Import the module that renders a format."""
    return cast(Format, import_module(FORMATS[name]))


def formats_of(kind: type[Document]) -> tuple[str, ...]:
    """Return the names of the formats that serve a kind of document."""
    return tuple(name for name in FORMATS if issubclass(kind, format_named(name).NEEDS))


@dataclass(frozen=True)
class Output:
    """One requested output; the path ``-`` is stdout."""

    format: str
    path: Path

    @property
    def suffix(self) -> str:
        """Return the suffix in lower case; that of the format's first kind of file for stdout."""
        suffixes = format_named(self.format).SUFFIXES
        return (suffixes or ("",))[0] if self.path == STDOUT else self.path.suffix.lower()


def parse_output(text: str, kind: type[Document]) -> Output:
    """Read FORMAT:PATH.

    Parameters
    ----------
    text : str
        What the user wrote.
    kind : type
        The class of the document that will be written.

    Raises
    ------
    ConfigurationError
        If the format is unknown or does not serve such a document, or there is no path.
    """
    name, colon, path = text.partition(":")
    if name in FOLDERS and path == str(STDOUT):
        raise ConfigurationError(f"'{text}' is a folder, which stdout is not", f"write {name}:DIRECTORY")
    if name not in FORMATS or not colon or not path:
        raise ConfigurationError(
            f"'{text}' is not FORMAT:PATH with a known format",
            f"write for example json:report.json; formats are {', '.join(formats_of(kind))}",
        )
    if not issubclass(kind, format_named(name).NEEDS):
        raise _unsupported(name, kind)
    return Output(name, Path(path))


def _unsupported(name: str, kind: type[Document]) -> ConfigurationError:
    """Say what serves a kind of document instead; of a stored one, also how the format can be had."""
    supported = ", ".join(formats_of(kind))
    live = live_of(kind)
    if live is not kind and issubclass(live, format_named(name).NEEDS):
        table = ""
        if kind.COMMAND == "verify" and name not in FOLDERS:
            table = ", or give viatool report the states.npz that --output states wrote"
        return ConfigurationError(
            f"the format '{name}' needs more than the JSON of {kind.WHAT} holds",
            f"run viatool {kind.COMMAND} again with --output {name}:PATH{table}; of the JSON alone formats are "
            f"{supported}",
        )
    writers = [other.COMMAND for other in KINDS if issubclass(live_of(other), format_named(name).NEEDS)]
    by = f": it is written by viatool {' and '.join(writers)}" if writers else ""
    return ConfigurationError(
        f"the format '{name}' cannot show {kind.WHAT}{by}", f"choose another one; formats are {supported}"
    )


def check_outputs(outputs: Sequence[Output]) -> None:
    """Refuse outputs that could not be written, before any long work is done for them.

    Raises
    ------
    ConfigurationError
        If a path cannot be written, has a suffix that its format does not know, or is asked for twice.
    ModuleNotFoundError
        If a format lacks a library.
    """
    for index, output in enumerate(outputs):
        suffixes = format_named(output.format).SUFFIXES
        for library in format_named(output.format).LIBRARIES:
            import_module(library)
        if suffixes and output.suffix not in suffixes:
            raise ConfigurationError(
                f"the {output.format} output '{output.path}' ends in '{output.path.suffix}'",
                f"end it in {' or '.join(suffixes)}",
            )
        if any(output.path == other.path for other in outputs[:index]):
            raise ConfigurationError(f"two outputs go to '{output.path}'", "give each output its own file")
        if output.format in FOLDERS:
            check_folder(output.path, output.format)
        elif output.path != STDOUT:
            check_writable(output.path)


def write_outputs(document: Document, outputs: Sequence[Output], checks: Sequence[Check] = ()) -> None:
    """Write every output, each whole or not at all.

    Parameters
    ----------
    document : Document
        What was found.
    outputs : sequence of Output
        Where it goes.
    checks : sequence of Check
        The decided conditions of the gate.
    """
    for output in outputs:
        if output.format in FOLDERS:
            files = format_named(output.format).render(document, checks, output.suffix)
            write_folder(output.path, output.format, files)
            _log.info("%s written to the folder %s", output.format, output.path)
            continue
        content = content_of(output, document, checks)
        if output.path == STDOUT:
            sys.stdout.buffer.writelines(content)
            sys.stdout.flush()
        else:
            write_whole(output.path, content)
            _log.info("%s written to %s: %d bytes", output.format, output.path, output.path.stat().st_size)


def content_of(output: Output, document: Document, checks: Sequence[Check] = ()) -> Iterator[bytes]:
    """Yield the content of an output that is a file part by part."""
    return as_bytes(format_named(output.format).render(document, checks, output.suffix))
