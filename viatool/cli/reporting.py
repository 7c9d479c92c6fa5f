"""What every command that reports does: the outputs are read before the work, and written and shown after it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from viatool.cli.terminal import open_console

if TYPE_CHECKING:
    from viatool.report import Check, Document, Output


def read_outputs(texts: Iterable[str], kind: type[Document]) -> tuple[Output, ...]:
    """Read the outputs of a kind of document, and refuse those that could not be written."""
    from viatool.report import check_outputs, parse_output

    outputs = tuple(parse_output(text, kind) for text in texts)
    check_outputs(outputs)
    return outputs


def tell(document: Document, outputs: Sequence[Output], checks: Sequence[Check], *, quiet: bool) -> None:
    """Write every output, and print the document unless that was not wanted; on stderr if an output is stdout."""
    from viatool.report import STDOUT, print_report, write_outputs

    write_outputs(document, outputs, checks)
    if not quiet:
        to_stdout = any(output.path == STDOUT for output in outputs)
        print_report(document, open_console(stderr=to_stdout), checks)
