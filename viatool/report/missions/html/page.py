"""The page of missions: what its template speaks of, filled in one place."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from viatool.report.foreign import one_line
from viatool.report.html.shell import assemble
from viatool.report.missions.document import MEANING, TONES, MissionsDocument
from viatool.report.missions.html.data import page_data
from viatool.report.missions.html.figures import clearance_figure, tubes_figure
from viatool.report.numbers import count
from viatool.report.sections import Check, Key
from viatool.report.wording import describe_eps

if TYPE_CHECKING:
    from viatool.report.missions.run import MissionsRun

_RANK = {"refuted": 0, "unknown": 1, "proved": 2}
SCRIPTS = ("arrays.js", "figures.js", "theme.js", "keys.js", "missions.js")


def render_page(document: MissionsRun, checks: Sequence[Check]) -> str:
    """Return the page of missions: the tube of each can be played beside the runs that were driven against it."""
    missions, order = document.missions, worst_first(document)
    fails = failing_rows(checks, document.size)
    table = document.missions_table
    return assemble(
        document,
        __package__,
        "missions.html",
        SCRIPTS,
        title="viatool missions",
        data={**page_data(missions), "order": order, "fails": fails},
        figures=[tubes_figure(missions), clearance_figure()],
        checks=checks,
        address=_address,
        headline=_headline(document),
        verdicts=_verdicts(document),
        table=replace(table, rows=tuple(table.rows[row] for row in order)),
        addresses=[_address(("", row)) for row in order],
        fails=[fails[row] for row in order],
        driven=max((len(mission.paths) for mission in missions), default=0),
    )


def worst_first(document: MissionsDocument) -> list[int]:
    """Return the numbers of the missions: refuted, unknown, proved."""
    verdicts = [mission.verdict for mission in document.record.missions]
    return sorted(range(len(verdicts)), key=lambda row: (_RANK[verdicts[row]], row))


def failing_rows(checks: Sequence[Check], size: int) -> list[list[int]]:
    """Return which of the conditions that do not hold count each mission."""
    failed = [{finding.key for finding in check.failing} for check in checks if not check.passed]
    return [[place for place, keys in enumerate(failed) if ("", row) in keys] for row in range(size)]


def _address(key: Key) -> str:
    """Return where the page shows a mission: by its number, as names may be alike."""
    return f"#mission={key[1]}"


def _headline(document: MissionsDocument) -> dict[str, str]:
    record, found = document.record, document.headline
    return {
        "stake": found.stake,
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
