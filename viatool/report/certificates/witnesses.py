"""The worst counterexamples of a certificate as a file that ``viatool replay`` runs again."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from viatool.places import Certificate
    from viatool.report.gate import Check

SUFFIXES = (".json",)
_MOST = 1000


def render(certificate: Certificate, checks: Sequence[Check], suffix: str) -> str:
    """Return the worst places first, then others spread over the refuted cells, a thousand in all."""
    from viatool.safety import Witnesses
    from viatool.trajectory import write_scenario
    from viatool.verification.witness_file import commands_before, compose_witnesses

    found, worst = certificate.findings, certificate.worst(100)
    others = np.setdiff1d(np.arange(len(found.clearance)), worst)
    step = max(1, -(-len(others) // (_MOST - len(worst))))
    rows = np.concatenate([worst, others[::step]])
    seen = Witnesses(
        rows,
        found.observation.astype(np.float64),
        found.action,
        found.seconds,
        found.closest,
        found.clearance,
    )
    scenario = certificate.scenario
    about = json.loads(write_scenario(scenario) or "null")
    outline = certificate.rules.footprint
    under_way = certificate.rules.dead_time.queue(found.previous)
    entries = [
        {
            "state": row,
            "episode": 0,
            "time": 0.0,
            "pose": found.pose[row].tolist(),
            **commands_before(under_way[row]),
            "previous": found.previous[row].tolist(),
            **seen.violation(row, certificate.world_map, scenario, outline),
            "scenario": about,
        }
        for row in rows.tolist()
    ]
    document = compose_witnesses(
        certificate.policy.path, certificate.policy.sha256, certificate.world_map,
        certificate.setting.columns, certificate.rules, entries,
    )  # fmt: skip
    return json.dumps(document, indent=1, allow_nan=False) + "\n"
