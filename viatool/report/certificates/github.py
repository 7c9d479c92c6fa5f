"""GitHub Actions: annotations of a failed gate and of the worst places, and the certificate in the job's summary."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from viatool.report.certificates.console import rows_of_worst
from viatool.report.certificates.document import read_certificate
from viatool.report.certificates.markdown import render as markdown
from viatool.report.github_report import MOST_OF_A_KIND, SUMMARY_VARIABLE, command

if TYPE_CHECKING:
    from viatool.places import Certificate
    from viatool.report.gate import Check

SUFFIXES = ()


def render(certificate: Certificate, checks: Sequence[Check], suffix: str) -> str:
    """Return the workflow commands, and append the certificate to the job's summary if there is one."""
    document = read_certificate(certificate)
    summary = os.environ.get(SUMMARY_VARIABLE)
    if summary:
        with Path(summary).open("a", encoding="utf-8") as stream:
            stream.write(markdown(certificate, checks, "") + "\n")
    place = document.map.path
    errors = [
        command("error", f"gate failed: {c.condition}", c.figures, place) for c in checks if not c.passed
    ]
    warnings = [
        command("warning", f"refuted place {pose}", f"after {previous}: {action} comes within {near}", place)
        for pose, previous, action, near in rows_of_worst(document)
    ]
    kept = (*errors[:MOST_OF_A_KIND], *warnings[:MOST_OF_A_KIND])
    return "".join(f"{line}\n" for line in kept)
