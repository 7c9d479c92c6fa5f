"""The page of a result: what its template speaks of, filled in one place."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from bokeh.plotting import figure

from viatool.report.document import HorizonDocument, RateByOutcome, ReportDocument, read_result
from viatool.report.episodes import Episode, summarise_episodes
from viatool.report.foreign import one_line
from viatool.report.gate import Check
from viatool.report.html.canvas import situation_figure
from viatool.report.html.figures import commands_figure, histograms, map_figure, width_figure
from viatool.report.html.shell import assemble
from viatool.report.html.states import keep_states, page_data
from viatool.report.numbers import count, percentage, significant
from viatool.report.palette import MEANING, VERDICTS
from viatool.report.wording import (
    HORIZON_COLUMNS,
    assumptions,
    describe_eps,
    describe_horizon,
    describe_task,
    describe_verdicts,
    horizon_rows,
    identities,
    rate_rows,
    unit_of,
)

if TYPE_CHECKING:
    from viatool.arrays import Indices
    from viatool.verification.result import Result

SCRIPTS = (
    "geometry.js",
    "arrays.js",
    "states.js",
    "figures.js",
    "theme.js",
    "scene.js",
    "drawing.js",
    "words.js",
    "report.js",
)
MOST_EPISODES = 500  # rows of the table of episodes
OUTCOMES = ("overall", "success", "collision", "timeout")


def render_page(result: Result, checks: Sequence[Check], most: int | None = None) -> str:
    """Return the page of a result.

    Parameters
    ----------
    result : Result
        What was found.
    checks : sequence of Check
        The decided conditions of the gate.
    most : int, optional
        How many states the page holds at most; the rates always speak of all.
    """
    document = read_result(result)
    kept = keep_states(result) if most is None else keep_states(result, most)
    return assemble(
        __package__,
        "page.html",
        SCRIPTS,
        title=f"{document.policy.path} on {document.map.path}: viatool",
        version=document.versions.get("viatool", ""),
        data=page_data(result, kept),
        figures=_figures(result),
        checks=checks,
        connected=result.trajectory.connected,
        thinned=_thinned(result, kept),
        shown_outcomes=[name for name in (*OUTCOMES[1:], "unknown") if name in result.outcomes],
        **_tables(document),
        **_episodes(result, kept),
    )


def _figures(result: Result) -> list[figure]:
    return [
        map_figure(result),
        situation_figure(result.world_map),
        commands_figure(result),
        width_figure(result, 0),
        width_figure(result, 1),
        *histograms(result),
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


def _tables(document: ReportDocument) -> dict[str, Any]:
    overall = document.safety_rate.overall
    return {
        "headline": {
            "rate": percentage(overall.safe, overall.total),
            "safe": count(overall.safe),
            "total": count(overall.total),
            "policy": one_line(document.policy.path),
            "map": one_line(document.map.path),
            "eps": one_line(describe_eps(document.eps)),
            "criterion": one_line(document.criterion),
            "arithmetic": one_line(document.arithmetic),
        },
        "verdicts": [_verdict(document, name) for name in VERDICTS],
        "outcomes": OUTCOMES,
        "rates": [
            {"title": title, "cells": list(_cells(rates))} for title, rates in rate_rows(document).items()
        ],
        "horizon": None if document.horizon is None else _horizon(document.horizon),
        "task": describe_task(document),
        "widths": [
            (name, *map(significant, (width.mean, width.std, width.max)), unit_of(document, name))
            for name, width in document.reachable_width.items()
        ],
        "assumptions": {**assumptions(document), **identities(document)},
    }


def _horizon(horizon: HorizonDocument) -> dict[str, Any]:
    return {
        "meaning": f"{describe_verdicts(horizon)} over {describe_horizon(horizon)}",
        "columns": HORIZON_COLUMNS,
        "rows": horizon_rows(horizon),
    }


def _verdict(document: ReportDocument, name: str) -> dict[str, Any]:
    number = int(getattr(document.verdicts, name))
    return {
        "name": name,
        "count": number,
        "text": count(number),
        "share": percentage(number, document.states),
        "meaning": MEANING[name],
    }


def _cells(rates: RateByOutcome) -> Iterator[dict[str, str]]:
    for outcome in OUTCOMES:
        rate = getattr(rates, outcome)
        figures = f"{count(rate.safe)} of {count(rate.total)}" if rate.total else "no states"
        yield {"rate": percentage(rate.safe, rate.total), "figures": figures}


def _episodes(result: Result, kept: Indices) -> dict[str, Any]:
    import numpy as np

    every = summarise_episodes(result)
    worst = sorted(every, key=lambda e: (-e.unsafe, -e.unknown, e.index))[:MOST_EPISODES]
    place = {int(e): i for i, e in enumerate(np.unique(result.trajectory.episode[kept]))}
    left_out = len(every) - len(worst)
    note = f"The {count(MOST_EPISODES)} with the most states that are not safe, of {count(len(every))}."
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
