"""A folder of evidence that people read and ``viatool check`` rechecks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from viatool.report.document import Evidenced
from viatool.report.files import Content
from viatool.report.sections import Check

SUFFIXES = ()
NEEDS = Evidenced
LIBRARIES = ()


def render(document: Evidenced, checks: Sequence[Check], suffix: str) -> Mapping[str, Content]:
    """Return the content of every file by its name."""
    return document.evidence_files(checks)
