"""The folder of evidence, put together: the content of each of its files."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from viatool.arrays import Indices
from viatool.report.evidence.assumptions import assumptions_of
from viatool.report.evidence.claims import claims_of
from viatool.report.evidence.described import describe_setting
from viatool.report.evidence.inputs import read_inputs
from viatool.report.evidence.page import render_page
from viatool.report.evidence.questions import QUESTIONS
from viatool.report.files import Content
from viatool.report.formats import json as report_json
from viatool.report.formats import states, witnesses
from viatool.report.sections import Check
from viatool.report.vnnlib import instances, query
from viatool.trajectory import write_scenario

if TYPE_CHECKING:
    from viatool.report.states.run import StatesRun
    from viatool.world import WorldMap

SCHEMA_VERSION = 1
MOST_QUERIES = 10


def evidence_folder(document: StatesRun, checks: Sequence[Check]) -> Mapping[str, Content]:
    """Return the content of every file by its name.

    Parameters
    ----------
    document : StatesRun
        What was found, and what was read.
    checks : sequence of Check
        The decided conditions of the gate.

    Raises
    ------
    ConfigurationError
        If policy or map are no longer those that were verified.
    """
    result, files = document.result, document.files
    world_map = result.world_map
    inputs = read_inputs(
        (result.policy_path, result.policy_sha256), (world_map.path, world_map.sha256), files
    )
    scenarios = _json([json.loads(write_scenario(one) or "null") for one in result.trajectory.scenarios])
    setting = describe_setting(
        result, files.get("specification"), inputs, hashlib.sha256(scenarios.encode()).hexdigest()
    )
    claims = claims_of(document.content, result.rules)
    assumptions = assumptions_of(document.assumptions, result, files.get("errors"))
    counterexamples = document.witness_file()
    return {
        "index.html": render_page(
            document, checks, claims, assumptions, setting, counterexamples["witnesses"]
        ),
        "claims.json": _json(
            {
                "schema_version": SCHEMA_VERSION,
                "claims": [claim.to_json() for claim in claims],
                "gate": [
                    {"condition": check.condition, "passed": check.passed, "figures": check.figures}
                    for check in checks
                ],
                "rules": setting["rules"],
            }
        ),
        "assumptions.json": _json([one.to_json() for one in assumptions]),
        "questions.json": _json([asdict(one) for one in QUESTIONS]),
        "setting.json": _json(setting),
        "report.json": report_json.render(document, checks, ".json"),
        "states.npz": states.tables(document, checks),
        "witnesses.json": witnesses.render(document, checks, ".json"),
        "scenarios.json": scenarios,
        **_grid(world_map),
        **_queries(document, setting),
        **{one.place: one.content for one in inputs if one.place},
    }


def _json(content: Any) -> str:
    return json.dumps(content, indent=1, allow_nan=False) + "\n"


def _grid(world_map: WorldMap) -> Mapping[str, Content]:
    """Return which cells of an occupancy map are obstacles, so that a checker needs no reader of images."""
    grid = world_map.obstacles.grid
    if grid is None:
        return {}
    stored = io.BytesIO()
    np.savez_compressed(
        stored, blocked=grid.blocked, resolution=grid.resolution, origin=np.array(grid.origin)
    )
    return {"grid.npz": stored.getvalue()}


def _queries(document: StatesRun, setting: Mapping[str, Any]) -> Mapping[str, Content]:
    """Return queries about the commands of some states, where the file itself gives the commands, for all of a box."""
    result, model, commands = document.result, setting["model"], setting["commands"]
    policy = next(one["file"] for one in setting["inputs"] if one["role"] == "policy")
    if not (setting["is_box"] and model and commands and _is_plain(model, commands)):
        return {}
    table, found = result.state_table(), dict[str, Content]()
    for row in _telling(document).tolist():
        box = table["observation_lower"][row], table["observation_upper"][row]
        text = query(box, (table["lower"][row], table["upper"][row]), f"the commands of state {row}")
        found[f"queries/state-{row}.vnnlib"] = text
    names = [name.removeprefix("queries/") for name in found]
    return {**found, "queries/instances.csv": instances(f"../{policy}", names)} if found else {}


def _is_plain(model: Mapping[str, Any], commands: Mapping[str, Any]) -> bool:
    """Tell whether the model takes one observation as it is, and gives the command and nothing else."""
    as_it_is = all(one == 1.0 for one in commands["scale"]) and not any(commands["offset"])
    in_order = commands["columns"] == list(range(len(commands["scale"])))
    alone = len(model["inputs"]) == 1 and model["alone"] and model["entries"] is None
    return bool(as_it_is and in_order and alone and commands["limits"] is None and commands["choice"] is None)


def _telling(document: StatesRun) -> Indices:
    """Return the states whose commands matter most, (K,): safe ones that some command would make fail, then others."""
    result = document.result
    bounded = np.isfinite(result.lower + result.upper).all(axis=1) & (result.verdict == "safe")
    rank = np.where(result.contested.collision, 0, np.where(result.contested.danger, 1, 2))
    rows = np.flatnonzero(bounded)
    return np.sort(rows[np.argsort(rank[rows], kind="stable")][:MOST_QUERIES])
