"""JUnit XML: one case for each part of the run and one for each condition of the gate."""

from __future__ import annotations

from collections.abc import Sequence
from xml.etree import ElementTree as Xml

from viatool.report.document import Cased
from viatool.report.foreign import one_line
from viatool.report.ruling import Ruling
from viatool.report.sections import Case, Check

SUFFIXES = (".xml",)
NEEDS = Cased
LIBRARIES = ()
MOST_EVIDENCE = 1000  # sentences of a condition that failed


def render(document: Cased, checks: Sequence[Check], suffix: str) -> bytes:
    """Return the suite.

    Notes
    -----
    Names are unique within the suite, for GitLab drops cases of the same class name and name. There are failures
    exactly if the gate fails, and errors exactly if a condition could not be decided.
    """
    ruling = Ruling(checks)
    cases = [_element(case, ruling.of_case(case), ruling) for case in document.cases()]
    cases += [
        _element(_condition(check, name), check.outcome, ruling)
        for check, name in zip(checks, ruling.names, strict=True)
    ]
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


def _condition(check: Check, name: str) -> Case:
    evidence = check.some_evidence(MOST_EVIDENCE)
    return Case("viatool.gate", name, check.outcome, check.figures, check.condition, evidence)


def _element(case: Case, outcome: str, ruling: Ruling) -> Xml.Element:
    element = Xml.Element(
        "testcase", {"classname": _clean(case.group), "name": _clean(case.name), "time": "0"}
    )
    broken = [f"counted by: {condition}" for condition in ruling.conditions(case.subjects)]
    match outcome:
        case "passed":
            pass
        case "warning":
            told = Xml.SubElement(element, "system-out")
            told.text = "\n".join([f"warning: {_clean(case.message)}", _lines(case, broken)])
        case "skipped":
            Xml.SubElement(element, "skipped", {"message": _clean(case.message)})
        case kind:
            message = case.message if case.outcome != "passed" else broken[0]
            part = Xml.SubElement(element, kind, {"message": _clean(message), "type": f"viatool.{kind}"})
            part.text = _lines(case, broken)
    return element


def _lines(case: Case, more: Sequence[str]) -> str:
    return "\n".join(map(_clean, (case.figures, *case.evidence, *more)))


def _clean(text: str) -> str:
    """Replace what XML 1.0 cannot hold, such as control characters and lone surrogates."""
    return one_line(text, "\N{REPLACEMENT CHARACTER}")
