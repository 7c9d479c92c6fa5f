"""One result, many reporters, and the gate."""

from __future__ import annotations

from viatool.report.bounds_file import check_bounds_file, write_bounds
from viatool.report.comparison import print_comparison
from viatool.report.console import print_checks, print_report
from viatool.report.document import ReportDocument, load_document, read_result
from viatool.report.gate import Check, Gate, Threshold, evaluate, parse_threshold
from viatool.report.outputs import REPORTERS, STDOUT, Output, check_outputs, parse_output, write_outputs
from viatool.report.policy_summary import print_inspection
from viatool.report.summaries import print_bounds, print_map, print_symbolic

__all__ = [
    "REPORTERS",
    "STDOUT",
    "Check",
    "Gate",
    "Output",
    "ReportDocument",
    "Threshold",
    "check_bounds_file",
    "check_outputs",
    "evaluate",
    "load_document",
    "parse_output",
    "parse_threshold",
    "print_bounds",
    "print_checks",
    "print_comparison",
    "print_inspection",
    "print_map",
    "print_report",
    "print_symbolic",
    "read_result",
    "write_bounds",
    "write_outputs",
]
