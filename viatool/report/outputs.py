"""The reporters by name, and the outputs that a user asks for as FORMAT:PATH."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, cast

from viatool.errors import ConfigurationError
from viatool.report.files import check_writable, write_whole

if TYPE_CHECKING:
    from viatool.report.gate import Check
    from viatool.verification.result import Result

REPORTERS = {
    "json": "viatool.report.json_report",
    "states": "viatool.report.states_report",
    "csv": "viatool.report.csv_report",
    "witnesses": "viatool.report.witnesses_report",
    "figure": "viatool.report.figure_report",
    "html": "viatool.report.html",
    "markdown": "viatool.report.markdown_report",
    "junit": "viatool.report.junit_report",
    "sarif": "viatool.report.sarif_report",
    "github": "viatool.report.github_report",
}
"""Format name to the module that renders it; imported when it is asked for."""

STDOUT = Path("-")


class Reporter(Protocol):
    """What a module of `REPORTERS` offers."""

    SUFFIXES: tuple[str, ...]
    """What its files may end in; anything if empty."""

    def render(
        self, result: Result, checks: Sequence[Check], suffix: str
    ) -> str | bytes | Iterable[str] | Iterable[bytes]:
        """Return the content of a file with that suffix, whole or in parts; text is written as UTF-8."""


@dataclass(frozen=True)
class Output:
    """One requested output; the path ``-`` is stdout. Formats are those of a result unless other ones are given."""

    format: str
    path: Path
    reporters: Mapping[str, str] = field(default_factory=lambda: REPORTERS, repr=False)

    @property
    def reporter(self) -> Reporter:
        """Import the module that renders the format."""
        return cast(Reporter, import_module(self.reporters[self.format]))

    @property
    def suffix(self) -> str:
        """Return the suffix in lower case; that of the format's first kind of file for stdout."""
        return (self.reporter.SUFFIXES or ("",))[0] if self.path == STDOUT else self.path.suffix.lower()


def parse_output(text: str, reporters: Mapping[str, str] = REPORTERS) -> Output:
    """Read FORMAT:PATH.

    Parameters
    ----------
    text : str
        What the user wrote.
    reporters : mapping
        Names of the formats, with the modules that render them.

    Raises
    ------
    ConfigurationError
        If the format is unknown or there is no path.
    """
    name, colon, path = text.partition(":")
    if name not in reporters or not colon or not path:
        raise ConfigurationError(
            f"'{text}' is not FORMAT:PATH with a known format",
            f"write for example json:report.json; formats are {', '.join(reporters)}",
        )
    return Output(name, Path(path), reporters)


def check_outputs(outputs: Sequence[Output]) -> None:
    """Refuse outputs that could not be written, before any long work is done for them.

    Raises
    ------
    ConfigurationError
        If a path cannot be written, has a suffix that its format does not know, or is asked for twice.
    """
    for index, output in enumerate(outputs):
        suffixes = output.reporter.SUFFIXES
        if suffixes and output.suffix not in suffixes:
            raise ConfigurationError(
                f"the {output.format} output '{output.path}' ends in '{output.path.suffix}'",
                f"end it in {' or '.join(suffixes)}",
            )
        if any(output.path == other.path for other in outputs[:index]):
            raise ConfigurationError(f"two outputs go to '{output.path}'", "give each output its own file")
        if output.path != STDOUT:
            check_writable(output.path)


def write_outputs(result: Any, outputs: Sequence[Output], checks: Sequence[Check] = ()) -> None:
    """Write every output, each whole or not at all.

    Parameters
    ----------
    result : Result
        What was found: whatever the reporters of the outputs render.
    outputs : sequence of Output
        Where it goes.
    checks : sequence of Check
        The decided conditions of the gate.
    """
    for output in outputs:
        content = content_of(output, result, checks)
        if output.path == STDOUT:
            sys.stdout.buffer.writelines(content)
            sys.stdout.flush()
        else:
            write_whole(output.path, content)


def content_of(output: Output, result: Result, checks: Sequence[Check] = ()) -> Iterator[bytes]:
    """Yield the content of an output part by part, so that the files of long runs need not fit into memory."""
    content = output.reporter.render(result, checks, output.suffix)
    for part in [content] if isinstance(content, str | bytes) else content:
        yield part if isinstance(part, bytes) else part.encode("utf-8", errors="backslashreplace")
