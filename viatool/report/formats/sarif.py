"""SARIF 2.1.0, for code-scanning dashboards: rules, findings and what they rest on."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from itertools import islice
from pathlib import PurePath
from typing import Any
from urllib.parse import quote

from viatool.report.document import Located
from viatool.report.ruling import Ruling
from viatool.report.sections import Check, Finding, Rules

SUFFIXES = (".sarif", ".json")
NEEDS = Located
LIBRARIES = ()
SCHEMA = "https://docs.oasis-open.org/sarif/sarif/v2.1.0/os/schemas/sarif-schema-2.1.0.json"
MOST_EVIDENCE = 100  # sentences of a condition that failed
MOST_RESULTS = 25_000  # more are refused by code scanning
GATE = {"gate": ("error", "A condition of the gate does not hold.")}


def render(document: Located, checks: Sequence[Check], suffix: str) -> str:
    """Return the log: failed conditions of the gate first, then as many findings as code scanning takes.

    Notes
    -----
    There are results of level error exactly if the gate fails or could not be decided.
    """
    rules: Rules = {**document.FINDING_RULES, **GATE}
    ruling, (findings, found) = Ruling(checks), document.findings()
    named = zip(checks, ruling.names, strict=True)
    failed = [(_failed(check, name), ruling.of_check(check)) for check, name in named if not check.passed]
    every = [*islice(findings, MOST_RESULTS)]
    besides = ruling.found_besides(every) if found <= MOST_RESULTS else []
    levels = [(one, ruling.of_finding(one, rules[one.rule][0])) for one in [*every, *besides]]
    kept = [*failed, *sorted(levels, key=lambda one: one[1] != "error")][:MOST_RESULTS]
    record, stake = document.record, document.headline.stake
    run = {
        "tool": {
            "driver": {
                "name": "viatool",
                "version": record.versions.get("viatool", "unknown"),
                "rules": [_rule(name, level, text) for name, (level, text) in rules.items()],
            }
        },
        "results": [_result(finding, level, list(rules), record.map.path) for finding, level in kept],
        "properties": {
            **({"stake": stake} if stake else {}),
            "resultsFound": len(failed) + found + len(besides),
            **document.terms,
            "policySha256": record.policy.sha256,
            "mapSha256": record.map.sha256,
            **({"premises": [p.model_dump() for p in record.premises]} if record.premises else {}),
        },
    }
    return json.dumps({"$schema": SCHEMA, "version": "2.1.0", "runs": [run]}, indent=1) + "\n"


def _failed(check: Check, name: str) -> Finding:
    told = " ".join([f"{check.condition}: {check.figures}", *check.some_evidence(MOST_EVIDENCE)])
    return Finding("gate", told, check.condition, name)


def _rule(name: str, level: str, text: str) -> dict[str, Any]:
    return {"id": name, "shortDescription": {"text": text}, "defaultConfiguration": {"level": level}}


def _result(finding: Finding, level: str, rules: list[str], map_path: str) -> dict[str, Any]:
    """Return one result; its fingerprint stays the same while its rule and its identity do."""
    marked = f"{finding.rule}\0{finding.identity}".encode("utf-8", errors="surrogatepass")
    return {
        "ruleId": finding.rule,
        "ruleIndex": rules.index(finding.rule),
        "level": level,
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
