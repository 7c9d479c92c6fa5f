"""A certificate as JUnit XML: one case for each slice by heading and one for each condition of the gate."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING
from xml.etree import ElementTree as Xml

from viatool.places import SECTOR_NAMES, STATUSES
from viatool.report.certificates.document import read_certificate
from viatool.report.junit_report import add, condition, suite_of
from viatool.report.numbers import significant

if TYPE_CHECKING:
    from viatool.places import Certificate
    from viatool.report.gate import Check

SUFFIXES = (".xml",)


def render(certificate: Certificate, checks: Sequence[Check], suffix: str) -> bytes:
    """Return the suite: a slice with refuted volume is a failure, one with unknown volume an error."""
    volumes = certificate.sectors.volumes.sum(axis=(2, 3)).T  # (sectors, statuses)
    cases = [_slice(name, row.tolist()) for name, row in zip(SECTOR_NAMES, volumes, strict=True)]
    document = read_certificate(certificate)
    seconds = sum(document.seconds.values())
    suite = suite_of(document, [*cases, *(condition(check) for check in checks)], seconds)
    Xml.indent(suite)
    content: bytes = Xml.tostring(suite, encoding="utf-8", xml_declaration=True)
    return content + b"\n"


def _slice(name: str, volumes: Sequence[float]) -> Xml.Element:
    case = Xml.Element("testcase", {"classname": "viatool.heading", "name": name, "time": "0"})
    by_status = dict(zip(STATUSES, volumes, strict=True))
    figures = ", ".join(f"{significant(volume)} m^2 rad {status}" for status, volume in by_status.items())
    for status, kind in (("refuted", "failure"), ("unknown", "error")):
        if by_status[status] > 0.0:
            add(case, kind, f"{significant(by_status[status])} m^2 rad {status}", figures)
            break
    return case
