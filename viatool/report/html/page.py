"""The page of a result: what its template speaks of, filled in one place."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from bokeh.plotting import figure

from viatool.report.foreign import one_line
from viatool.report.html.canvas import situation_figure
from viatool.report.html.figures import commands_figure, map_figure, width_figure
from viatool.report.html.histograms import histograms
from viatool.report.html.shell import assemble
from viatool.report.html.states import MOST_STATES, failing_rows, keep_states, page_data
from viatool.report.html.views import close_view, doubtful_view, margins_view, state_address
from viatool.report.numbers import count, percentage
from viatool.report.palette import MEANING, VERDICTS
from viatool.report.sections import Check, Share, Table
from viatool.report.states.document import StatesDocument, by_outcome
from viatool.report.states.episodes import Episode, summarise_episodes
from viatool.report.states.record import OUTCOMES
from viatool.report.wording import describe_eps
from viatool.verification.beside import together

if TYPE_CHECKING:
    from viatool.arrays import Indices
    from viatool.report.states.run import StatesShown
    from viatool.verification.result import Result

SCRIPTS = (
    "geometry.js",
    "gap.js",
    "arrays.js",
    "states.js",
    "figures.js",
    "theme.js",
    "keys.js",
    "scene.js",
    "drawing.js",
    "words.js",
    "report.js",
)
MOST_EPISODES = 500  # rows of the table of episodes
MOST_CLOSE = 2_000  # close places that a page holds


def render_page(document: StatesShown, checks: Sequence[Check], most: int | None = None) -> str:
    """Return the page of a result.

    Parameters
    ----------
    document : StatesShown
        What was found.
    checks : sequence of Check
        The decided conditions of the gate.
    most : int, optional
        How many states the page holds at most; the rates always speak of all.
    """
    result = document.result
    every, driven = together(result), len(result.trajectory)
    failing = np.asarray(failing_rows(checks, every, driven).any(axis=1))
    shown = kept = keep_states(result, MOST_STATES if most is None else most, failing[:driven])
    if result.close is not None:
        beside = keep_states(result.close, MOST_CLOSE, failing[driven:])
        shown = np.concatenate([kept, driven + beside])
    charts = histograms(every, driven)
    return assemble(
        document,
        __package__,
        "page.html",
        SCRIPTS,
        title="viatool",
        data={**page_data(every, shown, driven=result, checks=checks), "reasons": _reasons(every, shown)},
        figures=[*_figures(result), *(one.plot for one in charts)],
        checks=checks,
        address=state_address,
        connected=result.trajectory.connected,
        thinned=_thinned(result, kept),
        close=close_view(document),
        doubtful=doubtful_view(document.failing_parts["state"]),
        margins=margins_view(document),
        histograms=[one for one in charts if one.name != "histogram-close"],
        shown_outcomes=[name for name in (*OUTCOMES[1:], "unknown") if name in result.outcomes],
        **_tables(document),
        **_episodes(result, np.unique(every.trajectory.episode[shown])),
    )


def _reasons(result: Result, shown: Indices) -> list[tuple[int, str]]:
    """Return why states are not safe, by the place of each among those that the page holds."""
    place = {state: row for row, state in enumerate(shown.tolist())}
    return [(place[one.state], one_line(one.words)) for one in result.reasons.each if one.state in place]


def _figures(result: Result) -> list[figure]:
    return [
        map_figure(result),
        situation_figure(result.world_map),
        commands_figure(result),
        width_figure(result, 0),
        width_figure(result, 1),
    ]


def _thinned(result: Result, kept: Indices) -> str:
    total = len(result.trajectory)
    if len(kept) == total:
        return ""
    every = [
        f"{count(int((result.verdict[kept] == name).sum()))} of {count(int((result.verdict == name).sum()))} {name}"
        for name in reversed(VERDICTS)
    ]
    return (
        f"The map and the slider hold {count(len(kept))} of {count(total)} states, those that are not safe first: "
        f"{', '.join(every)}. Rates, distributions and the table of episodes speak of all states."
    )


def _tables(document: StatesDocument) -> dict[str, Any]:
    overall, record = document.rates["overall"], document.record
    return {
        "headline": {
            "stake": document.stake,
            "rate": overall.percentage(),
            "safe": count(overall.part),
            "total": count(overall.total),
            "policy": one_line(record.policy.path),
            "map": one_line(record.map.path),
            "eps": one_line(describe_eps(record.eps)),
            "criterion": one_line(record.criterion),
            "arithmetic": one_line(record.arithmetic),
        },
        "verdicts": [_verdict(document, name) for name in VERDICTS],
        "outcomes": OUTCOMES,
        "rates": [
            {"title": title, "cells": [_cell(share) for share in by_outcome(rates)]}
            for title, rates in document.rate_rows.items()
        ],
        "horizon": _horizon(document.horizon),
        "error_costs": document.error_costs,
        "task": document.task,
        "widths": document.widths.rows,
        "bounded": document.bounded,
    }


def _horizon(table: Table | None) -> dict[str, Any] | None:
    if table is None:
        return None
    return {"meaning": table.remark, "columns": table.head, "rows": table.rows}


def _verdict(document: StatesDocument, name: str) -> dict[str, Any]:
    number = int(getattr(document.record.verdicts, name))
    return {
        "name": name,
        "count": number,
        "text": count(number),
        "share": percentage(number, document.size),
        "meaning": MEANING[name],
    }


def _cell(share: Share) -> dict[str, str]:
    return {"rate": share.percentage(), "figures": share.of() if share.total else "no states"}


def _episodes(result: Result, shown: Indices) -> dict[str, Any]:
    every = summarise_episodes(result)
    worst = sorted(every, key=lambda e: (-e.unsafe, -e.unknown, e.index))[:MOST_EPISODES]
    place = {int(e): i for i, e in enumerate(shown)}
    left_out = len(every) - len(worst)
    note = f"These are {count(MOST_EPISODES)} of {count(len(every))}."
    return {
        "episodes": [_row(episode, place.get(episode.index)) for episode in worst],
        "episodes_left_out": note if left_out else "",
    }


def _row(episode: Episode, place: int | None) -> dict[str, Any]:
    return {
        "name": f"{episode.index}: {episode.name}",
        "outcome": episode.outcome,
        "seconds": f"{episode.seconds:.1f}",
        "counts": [count(getattr(episode, verdict)) for verdict in VERDICTS],
        "place": place,
    }
