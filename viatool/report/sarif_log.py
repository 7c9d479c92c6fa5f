"""SARIF 2.1.0 logs, for code-scanning dashboards: rules, findings and what they rest on, whatever was examined."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import PurePath
from typing import Any
from urllib.parse import quote

from viatool.report.document import RunDocument
from viatool.report.gate import Check
from viatool.report.wording import describe_eps

SCHEMA = "https://docs.oasis-open.org/sarif/sarif/v2.1.0/os/schemas/sarif-schema-2.1.0.json"
MOST_RESULTS = 25_000  # more are refused by code scanning
GATE = {"gate": ("error", "A condition of the gate does not hold.")}


@dataclass(frozen=True)
class Finding:
    """One result.

    Parameters
    ----------
    rule : str
        Which rule it is of.
    text : str
        What is said.
    place : str
        Where, in words.
    identity : str
        What makes it the same finding in the next run.
    """

    rule: str
    text: str
    place: str
    identity: str


def compose_log(
    document: RunDocument,
    rules: Mapping[str, tuple[str, str]],
    checks: Sequence[Check],
    findings: Iterable[Finding],
    found: int,
) -> str:
    """Return a log.

    Parameters
    ----------
    document : RunDocument
        What the findings rest on.
    rules : mapping
        Level and description by name; the gate's among them.
    checks : sequence of Check
        The decided conditions of the gate; those that failed come first.
    findings : iterable of Finding
        As many of them as code scanning takes are kept.
    found : int
        How many findings there are.
    """
    failed = list(_failed(checks))
    kept = list(islice([*failed, *islice(findings, MOST_RESULTS)], MOST_RESULTS))
    run = {
        "tool": {
            "driver": {
                "name": "viatool",
                "version": document.versions.get("viatool", "unknown"),
                "rules": [_rule(name, level, text) for name, (level, text) in rules.items()],
            }
        },
        "results": [_result(finding, rules, document.map.path) for finding in kept],
        "properties": {
            "resultsFound": len(failed) + found,
            "eps": describe_eps(document.eps),
            "criterion": document.criterion,
            "arithmetic": document.arithmetic,
            "policySha256": document.policy.sha256,
            "mapSha256": document.map.sha256,
        },
    }
    return json.dumps({"$schema": SCHEMA, "version": "2.1.0", "runs": [run]}, indent=1) + "\n"


def _failed(checks: Sequence[Check]) -> Iterator[Finding]:
    for check in checks:
        if not check.passed:
            yield Finding("gate", f"{check.condition}: {check.figures}", check.condition, check.condition)


def _rule(name: str, level: str, text: str) -> dict[str, Any]:
    return {"id": name, "shortDescription": {"text": text}, "defaultConfiguration": {"level": level}}


def _result(finding: Finding, rules: Mapping[str, tuple[str, str]], map_path: str) -> dict[str, Any]:
    """Return one result; its fingerprint stays the same while its rule and its identity do."""
    marked = f"{finding.rule}\0{finding.identity}".encode("utf-8", errors="surrogatepass")
    return {
        "ruleId": finding.rule,
        "ruleIndex": list(rules).index(finding.rule),
        "level": rules[finding.rule][0],
        "message": {"text": finding.text},
        "locations": [
            {
                "physicalLocation": {
                    "artifactLocation": {"uri": quote(PurePath(map_path).as_posix())},
                    "region": {"startLine": 1},
                },
                "logicalLocations": [{"fullyQualifiedName": finding.place}],
            }
        ],
        "partialFingerprints": {"viatoolState/v1": hashlib.sha256(marked).hexdigest()},
    }
