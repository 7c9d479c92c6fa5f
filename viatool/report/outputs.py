"""The reporters by name, and the outputs that a user asks for as FORMAT:PATH."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

from viatool.errors import ConfigurationError
from viatool.report.files import check_writable

if TYPE_CHECKING:
    from viatool.safety import Result

REPORTERS = {
    "json": "viatool.report.json_report",
    "states": "viatool.report.states_report",
    "figure": "viatool.report.figure_report",
}
"""Format name to module; each has ``SUFFIXES`` (empty: any) and ``write(result, path)``."""


@dataclass(frozen=True)
class Output:
    """One requested output."""

    format: str
    path: Path

    @property
    def reporter(self) -> ModuleType:
        """Import the module that writes the format."""
        return import_module(REPORTERS[self.format])


def parse_output(text: str) -> Output:
    """Read FORMAT:PATH.

    Raises
    ------
    ConfigurationError
        If the format is unknown or there is no path.
    """
    name, colon, path = text.partition(":")
    if name not in REPORTERS or not colon or not path:
        raise ConfigurationError(
            f"'{text}' is not FORMAT:PATH with a known format",
            f"write for example json:report.json; formats are {', '.join(REPORTERS)}",
        )
    return Output(name, Path(path))


def check_outputs(outputs: Sequence[Output]) -> None:
    """Refuse outputs that could not be written, before any long work is done for them.

    Raises
    ------
    ConfigurationError
        If a path cannot be written, has a suffix that its format does not know, or is asked for twice.
    """
    for index, output in enumerate(outputs):
        suffixes = output.reporter.SUFFIXES
        if suffixes and output.path.suffix.lower() not in suffixes:
            raise ConfigurationError(
                f"the {output.format} output '{output.path}' ends in '{output.path.suffix}'",
                f"end it in {' or '.join(suffixes)}",
            )
        if any(output.path == other.path for other in outputs[:index]):
            raise ConfigurationError(f"two outputs go to '{output.path}'", "give each output its own file")
        check_writable(output.path)


def write_outputs(result: Result, outputs: Sequence[Output]) -> None:
    """Write every output; each is written whole or not at all."""
    for output in outputs:
        output.reporter.write(result, output.path)
