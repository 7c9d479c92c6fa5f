"""SARIF 2.1.0, for code-scanning dashboards: one result for each state that is not safe."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import PurePath
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import numpy as np

from viatool.report.document import read_result
from viatool.report.gate import Check
from viatool.report.wording import describe_eps

if TYPE_CHECKING:
    from viatool.safety import Result

SUFFIXES = (".sarif", ".json")
SCHEMA = "https://docs.oasis-open.org/sarif/sarif/v2.1.0/os/schemas/sarif-schema-2.1.0.json"
MOST_RESULTS = 25_000  # more are refused by code scanning
RULES = {
    "unsafe-state": ("error", "A sensor error within eps makes the deployed policy violate the criterion."),
    "unknown-state": ("warning", "The criterion could be neither proved nor refuted."),
    "gate": ("error", "A condition of the gate does not hold."),
}


def render(result: Result, checks: Sequence[Check], suffix: str) -> str:
    """Return the log; failed conditions of the gate first, then unsafe states, then unknown ones."""
    document = read_result(result)
    failed = list(_gate_results(checks, result))
    listed = [*failed, *islice(_state_results(result), MOST_RESULTS)]
    doubtful = int((result.verdict != "safe").sum())
    run = {
        "tool": {
            "driver": {
                "name": "viatool",
                "version": document.versions.get("viatool", "unknown"),
                "rules": [_rule(name, level, text) for name, (level, text) in RULES.items()],
            }
        },
        "results": listed[:MOST_RESULTS],
        "properties": {
            "resultsFound": len(failed) + doubtful,
            "eps": describe_eps(document.eps),
            "criterion": document.criterion,
            "arithmetic": document.arithmetic,
            "policySha256": document.policy.sha256,
            "mapSha256": document.map.sha256,
        },
    }
    return json.dumps({"$schema": SCHEMA, "version": "2.1.0", "runs": [run]}, indent=1) + "\n"


def _rule(name: str, level: str, text: str) -> dict[str, Any]:
    return {"id": name, "shortDescription": {"text": text}, "defaultConfiguration": {"level": level}}


def _gate_results(checks: Sequence[Check], result: Result) -> Iterator[dict[str, Any]]:
    for check in checks:
        if not check.passed:
            yield _finding(
                "gate", f"{check.condition}: {check.figures}", result, check.condition, check.condition
            )


def _state_results(result: Result) -> Iterator[dict[str, Any]]:
    trajectory = result.trajectory
    for verdict in ("unsafe", "unknown"):
        for state in np.flatnonzero(result.verdict == verdict).tolist():
            name, time = trajectory.name_of(trajectory.episode[state]), float(trajectory.time[state])
            x, y, heading = trajectory.poses[state].tolist()
            text = (
                f"State {state} is {verdict}: scenario {name} at {time:.2f} s, "
                f"x {x:.3f} m, y {y:.3f} m, heading {heading:.3f} rad."
            )
            # Poses that were picked have no time that tells them apart.
            place = f"{name}/{time:.3f}" if trajectory.connected else f"{name}/{x:.3f},{y:.3f},{heading:.3f}"
            yield _finding(f"{verdict}-state", text, result, place, place)


def _finding(rule: str, text: str, result: Result, place: str, identity: str) -> dict[str, Any]:
    """Return one result; its fingerprint stays the same while rule, scenario and time do."""
    digest = hashlib.sha256(f"{rule}\0{identity}".encode("utf-8", errors="surrogatepass")).hexdigest()
    uri = quote(PurePath(result.world_map.path).as_posix())
    return {
        "ruleId": rule,
        "ruleIndex": list(RULES).index(rule),
        "level": RULES[rule][0],
        "message": {"text": text},
        "locations": [
            {
                "physicalLocation": {"artifactLocation": {"uri": uri}, "region": {"startLine": 1}},
                "logicalLocations": [{"fullyQualifiedName": place}],
            }
        ],
        "partialFingerprints": {"viatoolState/v1": digest},
    }
