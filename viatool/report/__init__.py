"""One document for every kind of run, many formats, and the gate."""

from __future__ import annotations

from typing import TYPE_CHECKING

from viatool.lazy_names import lazily

if TYPE_CHECKING:
    from viatool.report.accepted import Acceptance, accepted_text, load_accepted
    from viatool.report.bounds_file import parse_bounds_output
    from viatool.report.comparison import print_comparison
    from viatool.report.console import print_checks, print_explanation, print_failing, print_report
    from viatool.report.document import Document
    from viatool.report.gate import Gate, Threshold, evaluate, parse_threshold
    from viatool.report.kinds import KINDS, load_document, load_shown
    from viatool.report.outputs import (
        FORMATS,
        STDOUT,
        Output,
        check_outputs,
        formats_of,
        parse_output,
        write_outputs,
    )
    from viatool.report.policy_summary import print_inspection
    from viatool.report.ruling import Ruling
    from viatool.report.sections import Check
    from viatool.report.summaries import print_bounds, print_map, print_symbolic

_NAMES_OF = {
    "accepted": (
        "Acceptance",
        "accepted_text",
        "load_accepted",
    ),
    "bounds_file": ("parse_bounds_output",),
    "comparison": ("print_comparison",),
    "console": (
        "print_checks",
        "print_explanation",
        "print_failing",
        "print_report",
    ),
    "document": ("Document",),
    "gate": (
        "Gate",
        "Threshold",
        "evaluate",
        "parse_threshold",
    ),
    "kinds": (
        "KINDS",
        "load_document",
        "load_shown",
    ),
    "outputs": (
        "FORMATS",
        "STDOUT",
        "Output",
        "check_outputs",
        "formats_of",
        "parse_output",
        "write_outputs",
    ),
    "policy_summary": ("print_inspection",),
    "ruling": ("Ruling",),
    "sections": ("Check",),
    "summaries": (
        "print_bounds",
        "print_map",
        "print_symbolic",
    ),
}

__all__ = [
    "FORMATS",
    "KINDS",
    "STDOUT",
    "Acceptance",
    "Check",
    "Document",
    "Gate",
    "Output",
    "Ruling",
    "Threshold",
    "accepted_text",
    "check_outputs",
    "evaluate",
    "formats_of",
    "load_accepted",
    "load_document",
    "load_shown",
    "parse_bounds_output",
    "parse_output",
    "parse_threshold",
    "print_bounds",
    "print_checks",
    "print_comparison",
    "print_explanation",
    "print_failing",
    "print_inspection",
    "print_map",
    "print_report",
    "print_symbolic",
    "write_outputs",
]

__getattr__, __dir__ = lazily(
    __name__, {name: f"{__name__}.{module}" for module, names in _NAMES_OF.items() for name in names}
)
