"""JUnit XML: one case for each trajectory and one for each condition of the gate."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING
from xml.etree import ElementTree as Xml

from viatool.report.document import ReportDocument, RunDocument, read_result
from viatool.report.episodes import Episode, summarise_episodes
from viatool.report.foreign import one_line
from viatool.report.gate import Check
from viatool.report.numbers import counted
from viatool.report.wording import describe_eps, total_seconds

if TYPE_CHECKING:
    from viatool.verification.result import Result

SUFFIXES = (".xml",)


def render(result: Result, checks: Sequence[Check], suffix: str) -> bytes:
    """Return the suite: an unsafe trajectory is a failure, one with unknown states an error."""
    suite = junit(read_result(result), summarise_episodes(result), checks)
    Xml.indent(suite)
    content: bytes = Xml.tostring(suite, encoding="utf-8", xml_declaration=True)
    return content + b"\n"


def junit(document: ReportDocument, episodes: Sequence[Episode], checks: Sequence[Check]) -> Xml.Element:
    """Return the document element.

    Notes
    -----
    Names are unique within the suite, for GitLab drops cases of the same class name and name.
    """
    cases = [_trajectory(episode) for episode in episodes] + [condition(check) for check in checks]
    return suite_of(document, cases, total_seconds(document))


def suite_of(document: RunDocument, cases: Sequence[Xml.Element], seconds: float) -> Xml.Element:
    """Return the document element around cases; the document says of which policy, map and assumptions."""
    totals = {
        "tests": str(len(cases)),
        "failures": str(sum(case.find("failure") is not None for case in cases)),
        "errors": str(sum(case.find("error") is not None for case in cases)),
        "skipped": str(sum(case.find("skipped") is not None for case in cases)),
        "time": f"{seconds:.3f}",
    }
    root = Xml.Element("testsuites", {"name": "viatool", **totals})
    suite = Xml.SubElement(root, "testsuite", {"name": clean(document.policy.path), **totals})
    properties = Xml.SubElement(suite, "properties")
    facts = {
        "map": document.map.path,
        "eps": describe_eps(document.eps),
        "criterion": document.criterion,
        "arithmetic": document.arithmetic,
        "policy sha256": document.policy.sha256,
        "map sha256": document.map.sha256,
    }
    for name, value in facts.items():
        Xml.SubElement(properties, "property", {"name": name, "value": clean(value)})
    suite.extend(cases)
    return root


def _trajectory(episode: Episode) -> Xml.Element:
    name = f"{episode.index}: {episode.name}"
    case = Xml.Element("testcase", {"classname": "viatool.trajectory", "name": clean(name), "time": "0"})
    figures = (
        f"{episode.safe} safe, {episode.unsafe} unsafe, {episode.unknown} unknown; outcome {episode.outcome}"
    )
    if episode.unsafe:
        add(
            case,
            "failure",
            f"{counted(episode.unsafe, 'unsafe state')}, the first is state {episode.first_unsafe}",
            figures,
        )
    elif episode.unknown:
        add(case, "error", counted(episode.unknown, "unknown state"), figures)
    elif not episode.states:
        Xml.SubElement(case, "skipped", {"message": "no states"})
    return case


def condition(check: Check) -> Xml.Element:
    """Return the case of a condition of the gate."""
    case = Xml.Element("testcase", {"classname": "viatool.gate", "name": clean(check.condition), "time": "0"})
    if check.empty:
        add(case, "error", check.figures, check.condition)
    elif not check.passed:
        add(case, "failure", check.figures, check.condition)
    return case


def add(case: Xml.Element, kind: str, message: str, text: str) -> None:
    """Add a failure or an error to a case."""
    element = Xml.SubElement(case, kind, {"message": clean(message), "type": f"viatool.{kind}"})
    element.text = clean(text)


def clean(text: str) -> str:
    """Replace what XML 1.0 cannot hold, such as control characters and lone surrogates."""
    return one_line(text, "\N{REPLACEMENT CHARACTER}")
