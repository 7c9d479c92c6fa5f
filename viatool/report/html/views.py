"""What a page of states shows of close places, margins and what is not safe, each with links into the map."""

from __future__ import annotations

from pathlib import PurePath
from typing import TYPE_CHECKING, Any

from viatool.report.margins.html.curve import curve_view
from viatool.report.margins.html.rows import weakest_view
from viatool.report.margins.tables import quantiles_table, varied_in_words
from viatool.report.numbers import count
from viatool.report.palette import VERDICTS
from viatool.report.sections import Key

if TYPE_CHECKING:
    from viatool.report.reasons import Failing
    from viatool.report.states.document import StatesDocument

MOST_ROWS = 200
"""Of a table of what is not safe, or survives least."""


def state_address(key: Key) -> str:
    """Return where a page shows a state or a close place."""
    table, number = key
    return f"#{'close' if table else 'state'}={number}"


def doubtful_view(part: Failing) -> dict[str, Any] | None:
    """Return the worst states, or close places, with why they are not safe; None if all are, or it is not told why."""
    reasons = list((part.reasons or {}).values())[:MOST_ROWS]
    if not reasons:
        return None
    total = len(part.reasons or {}) + part.left_out
    table = "" if part.what == "state" else "close_"
    return {
        "head": (part.what, "scenario", "time [s]", "verdict", "why"),
        "rows": [
            (str(one.state), one.scenario, f"{one.time:.2f}", one.verdict, one.brief) for one in reasons
        ],
        "addresses": [state_address((table, one.state)) for one in reasons],
        "remark": f"The worst {count(len(reasons))} of {count(total)}." if total > len(reasons) else "",
    }


def close_view(document: StatesDocument) -> dict[str, Any] | None:
    """Return what a page says of close places; None if there are none."""
    record = document.record.close
    if record is None or not document.close.total:
        return None
    numbers = [int(getattr(record.verdicts, name)) for name in VERDICTS]
    return {
        "rate": document.close.percentage(),
        "total": count(document.close.total),
        "verdicts": [
            {"name": name, "count": number, "text": count(number)}
            for name, number in zip(VERDICTS, numbers, strict=True)
        ],
        "doubtful": doubtful_view(document.failing_parts["close"]),
    }


def margins_view(document: StatesDocument) -> dict[str, Any] | None:
    """Return how much error the contested states survive; None if that was not asked."""
    found = document.record.margins
    if found is None or not found.tested:
        return None
    parts = {PurePath(document.record.policy.path).name: found}
    return {
        "varied": varied_in_words(found.varied),
        "curve": curve_view(found.varied, parts),
        "quantiles": quantiles_table(found.varied, parts),
        "weakest": weakest_view(
            found.varied,
            found,
            MOST_ROWS,
            lambda state: state_address(("close_" if state.close else "", state.state)),
            lambda _: (),
        ),
    }
