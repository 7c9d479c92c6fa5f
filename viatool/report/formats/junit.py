"""JUnit XML: one case for each part of the run and one for each condition of the gate."""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree import ElementTree as Xml

from viatool.report.document import Cased
from viatool.report.foreign import one_line
from viatool.report.sections import Case, Check

SUFFIXES = (".xml",)
NEEDS = Cased
LIBRARIES = ()
MOST_EVIDENCE = 1000  # sentences of a condition that failed


def render(document: Cased, checks: Sequence[Check], suffix: str) -> bytes:
    """Return the suite.

    Notes
    -----
    Names are unique within the suite, for GitLab drops cases of the same class name and name.
    """
    cases = [_element(case) for case in [*document.cases(), *map(_condition, checks)]]
    totals = {
        "tests": str(len(cases)),
        "failures": str(sum(case.find("failure") is not None for case in cases)),
        "errors": str(sum(case.find("error") is not None for case in cases)),
        "skipped": str(sum(case.find("skipped") is not None for case in cases)),
        "time": f"{document.record.total_seconds:.3f}",
    }
    root = Xml.Element("testsuites", {"name": "viatool", **totals})
    suite = Xml.SubElement(root, "testsuite", {"name": _clean(document.record.policy.path), **totals})
    properties = Xml.SubElement(suite, "properties")
    for name, value in _facts(document):
        Xml.SubElement(properties, "property", {"name": _clean(name), "value": _clean(value)})
    suite.extend(cases)
    Xml.indent(root)
    content: bytes = Xml.tostring(root, encoding="utf-8", xml_declaration=True)
    return content + b"\n"


def _facts(document: Cased) -> list[tuple[str, str]]:
    record, stake = document.record, document.headline.stake
    return [
        *([("stake", stake)] if stake else []),
        ("map", record.map.path),
        *document.terms.items(),
        ("policy sha256", record.policy.sha256),
        ("map sha256", record.map.sha256),
        *((f"premise: {p.name}", f"{p.value} [{p.source}]") for p in record.premises),
    ]


def _condition(check: Check) -> Case:
    outcome = "error" if check.empty or check.unfounded else "passed" if check.passed else "failure"
    evidence = check.some_evidence(MOST_EVIDENCE)
    return Case("viatool.gate", check.condition, outcome, check.figures, check.condition, evidence)


def _element(case: Case) -> Xml.Element:
    element = Xml.Element(
        "testcase", {"classname": _clean(case.group), "name": _clean(case.name), "time": "0"}
    )
    match case.outcome:
        case "passed":
            if case.evidence:
                Xml.SubElement(element, "system-out").text = _lines(case)
        case "skipped":
            Xml.SubElement(element, "skipped", {"message": _clean(case.message)})
        case kind:
            part = Xml.SubElement(element, kind, {"message": _clean(case.message), "type": f"viatool.{kind}"})
            part.text = _lines(case)
    return element


def _lines(case: Case) -> str:
    return "\n".join(map(_clean, (case.figures, *case.evidence)))


def _clean(text: str) -> str:
    """Replace what XML 1.0 cannot hold, such as control characters and lone surrogates."""
    return one_line(text, "\N{REPLACEMENT CHARACTER}")
