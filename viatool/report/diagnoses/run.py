"""The report on a diagnosis while it is at hand: its content and its picture."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from viatool.doctor import Compared, Driven
from viatool.report.diagnoses.document import DiagnosisDocument
from viatool.report.document import Drawn, Explorable
from viatool.report.sections import Check
from viatool.versions import installed_versions

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from viatool.doctor import Diagnosis, Examined, Repeat
    from viatool.simulate import Proportion

SCHEMA_VERSION = 1


class DiagnosisRun(DiagnosisDocument, Drawn, Explorable):
    """The report of a diagnosis."""

    def __init__(self, diagnosis: Diagnosis) -> None:
        super().__init__(_content(diagnosis))
        self.diagnosis = diagnosis

    def draw(self) -> Figure:
        """Return the readings as bars, and the paths as specified and under the best reading."""
        from viatool.report.diagnoses.figure import draw_diagnosis

        return draw_diagnosis(self.diagnosis, self)

    def page(self, checks: Sequence[Check]) -> str:
        """Return the finding, the picture and the readings with their keys as one page."""
        from viatool.report.diagnoses.html.page import render_page

        return render_page(self, checks)


def _content(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return a diagnosis as JSON values; docs/doctor.md names the fields."""
    ranking, world_map = diagnosis.ranking, diagnosis.world_map
    good = ranking.equals
    return {
        "schema_version": SCHEMA_VERSION,
        "policy": {"path": str(diagnosis.policy.path), "sha256": diagnosis.policy.sha256},
        "map": {"path": str(world_map.path), "sha256": world_map.sha256},
        "method": "driven" if isinstance(ranking.best.evidence, Driven) else "recorded",
        "source": diagnosis.source,
        "seed": diagnosis.seed,
        "verdict": diagnosis.verdict,
        "readings": [_reading(diagnosis, one, as_good=one in good) for one in ranking.examined],
        "specified": ranking.examined.index(ranking.specified),
        "best": ranking.examined.index(ranking.best),
        "stopped": ranking.stopped,
        "again": None if ranking.again is None else _again(ranking.again),
        "seconds": round(diagnosis.seconds, 3),
        "versions": installed_versions(),
        "premises": [premise.to_json() for premise in diagnosis.premises],
    }


def _reading(diagnosis: Diagnosis, one: Examined, *, as_good: bool) -> dict[str, Any]:
    found, evidence = one.interpretation, one.evidence
    against = evidence.against(diagnosis.ranking.specified.evidence)
    return {
        "name": found.name,
        "changes": [{"family": change.family, "words": change.words} for change in found.changes],
        "edits": [{"key": edit.key, "now": edit.now, "was": edit.was} for edit in diagnosis.edits_of(one)],
        "driven": _driven(evidence) if isinstance(evidence, Driven) else None,
        "compared": _compared(evidence) if isinstance(evidence, Compared) else None,
        "better": against.better,
        "worse": against.worse,
        "chance": against.chance,
        "as_good": as_good,
    }


def _again(repeat: Repeat) -> dict[str, Any]:
    evidence, specified = repeat.evidence, repeat.specified
    assert isinstance(evidence, Driven)
    assert isinstance(specified, Driven)
    against = evidence.against(specified)
    return {
        "name": repeat.contender.interpretation.name,
        "driven": _driven(evidence),
        "specified": _driven(specified),
        "better": against.better,
        "worse": against.worse,
        "chance": against.chance,
    }


def _driven(evidence: Driven) -> dict[str, Any]:
    return {name: _share(evidence.share(name)) for name in ("success", "collision", "timeout")}


def _compared(evidence: Compared) -> dict[str, Any]:
    known = np.isfinite(evidence.differences)
    each = zip(evidence.axes, evidence.each[known].T, strict=True)
    return {
        "states": int(known.sum()),
        "explained": evidence.explained,
        "difference": _difference(evidence.differences[known]),
        "actions": {name: _difference(column) for name, column in each},
    }


def _difference(values: np.ndarray) -> dict[str, float]:
    median, most = np.quantile(values, [0.5, 0.9]).tolist()
    return {"median": median, "most": most}


def _share(share: Proportion) -> dict[str, Any]:
    low, high = share.interval
    return {"count": share.count, "total": share.total, "rate": share.rate, "interval": [low, high]}
