"""The page of missions: what its template speaks of, filled in one place."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from viatool.report.foreign import one_line
from viatool.report.html.shell import assemble
from viatool.report.missions.document import MEANING, TONES, MissionsDocument
from viatool.report.missions.html.data import page_data
from viatool.report.missions.html.figures import clearance_figure, tubes_figure
from viatool.report.numbers import count
from viatool.report.sections import Check
from viatool.report.wording import describe_eps

if TYPE_CHECKING:
    from viatool.report.missions.run import MissionsRun

SCRIPTS = ("arrays.js", "figures.js", "theme.js", "missions.js")


def render_page(document: MissionsRun, checks: Sequence[Check]) -> str:
    """Return the page of missions: the tube of each can be played beside the runs that were driven against it."""
    missions = document.missions
    return assemble(
        document,
        __package__,
        "missions.html",
        SCRIPTS,
        title="viatool missions",
        data=page_data(missions),
        figures=[tubes_figure(missions), clearance_figure()],
        checks=checks,
        headline=_headline(document),
        verdicts=_verdicts(document),
        table=document.missions_table,
        driven=max((len(mission.paths) for mission in missions), default=0),
    )


def _headline(document: MissionsDocument) -> dict[str, str]:
    record, found = document.record, document.headline
    return {
        "rate": found.rate,
        "rest": found.rest,
        "policy": one_line(record.policy.path),
        "map": one_line(record.map.path),
        "eps": one_line(describe_eps(record.eps)),
        "criterion": one_line(record.criterion),
        "arithmetic": one_line(record.arithmetic),
        "total": count(document.size),
    }


def _verdicts(document: MissionsDocument) -> list[dict[str, Any]]:
    found = document.record.mission_verdicts
    return [
        {"name": name, "kind": tone, "size": getattr(found, name), "meaning": MEANING[name]}
        for name, tone in TONES.items()
    ]
