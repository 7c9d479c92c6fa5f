"""One document for every kind of run, many formats, and the gate."""

from __future__ import annotations

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
