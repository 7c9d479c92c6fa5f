"""A result in the cell of a notebook: a small static table, without scripts."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from viatool.verification.rates import RateByOutcome
    from viatool.verification.result import Result

_OUTCOMES = ("overall", "success", "collision", "timeout")


def table_of(result: Result) -> str:
    """Return verdicts and rates as HTML; names of others are escaped."""
    rows: dict[str, RateByOutcome] = {
        f"{result.criterion}, d_col": result.safety_rate,
        f"{result.criterion}, d_danger": result.danger_rate,
        "sampled, not a proof": result.sampled_safety_rate,
        "contested states only": result.contested_rate,
        **({} if result.close is None else {"close places": result.close_rate}),
    }
    head = "".join(f"<th>{outcome}</th>" for outcome in ("rate of safe states", *_OUTCOMES))
    body = "".join(
        f"<tr><td>{escape(name)}</td>{''.join(f'<td>{getattr(rates, o)}</td>' for o in _OUTCOMES)}</tr>"
        for name, rates in rows.items()
    )
    counts = result.to_json()["verdicts"]
    tally = ", ".join(f"{number:,} {verdict}" for verdict, number in counts.items())
    title = f"{result.policy_path.name} on {result.world_map.name}, eps {result.eps}"
    return (
        f"<p><b>{escape(title)}</b><br>{escape(tally)}</p>"
        f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
    )
