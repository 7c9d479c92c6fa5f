"""Markdown of tables: rows of variants, ``mean ± std`` of metrics, intervals, and the head of every page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from viatool.studies.metrics import METRICS, Metric
from viatool.studies.paper import PAPER
from viatool.studies.variants import VARIANTS, Variant

MISSING = "n/a"
_FIXED = (
    "fixed_success",
    "fixed_collision",
    "fixed_cost",
    "fixed_success_safety",
    "fixed_collision_safety",
    "fixed_safety",
    "fixed_proved",
    "width_v",
    "width_omega",
)


def head(title: str, data: Mapping[str, Any], introduction: str) -> list[str]:
    """Return the first lines of a page: what it is, whether it is whole, how it was made."""
    about, tasks = data["about"], data["tasks"]
    lines = [f"# {title}", "", introduction, ""]
    if tasks["finished"] < tasks["total"]:
        lines += [
            f"**Partial**: {tasks['finished']} of {tasks['total']} tasks are finished; the same command goes on.",
            "",
        ]
    dates = " to ".join(dict.fromkeys(about["dates"]))
    versions = ", ".join(
        f"{name} {version}" for name, version in about["versions"].items() if name != "platform"
    )
    lines += [
        f"    {data['command']}",
        "",
        f"{about['seeds']} seeds, {dates}, {about['machine']}, {about['minutes']:g} minutes of work; {versions}. "
        f"Written from `data/{data['study']}.json`.",
        "",
    ]
    return lines


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Return the lines of a markdown table."""
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    return [*lines, *("| " + " | ".join(row) + " |" for row in rows), ""]


def metrics_table(
    data: Mapping[str, Any],
    variants: Sequence[Variant],
    metrics: Sequence[Metric | str],
    *,
    interval: bool = False,
) -> list[str]:
    """Return a table with a row for each variant that has data.

    Parameters
    ----------
    data : mapping
        Of the study.
    variants : sequence of Variant
        The rows.
    metrics : sequence of Metric or str
        The columns.
    interval : bool
        Show ``mean [low, high]`` of the confidence interval instead of ``mean ± std``.
    """
    columns = [METRICS[metric] if isinstance(metric, str) else metric for metric in metrics]
    header = ["Method", *(f"{one.title} {arrow(one)}" for one in columns)]
    rows = []
    for variant in variants:
        if variant.name in data["variants"]:
            estimates = data["variants"][variant.name]["estimates"]
            rows.append([variant.title, *(cell(estimates.get(one.name), one, interval) for one in columns)])
    return table(header, rows)


def beside_paper(data: Mapping[str, Any], variants: Sequence[Variant]) -> list[str]:
    """Return the section of what the paper has measured too, ``ours (theirs)``."""
    columns = [METRICS[name] for name in _FIXED]
    rows = []
    for variant in variants:
        if variant.name in data["variants"]:
            estimates = data["variants"][variant.name]["estimates"]
            pairs = ((cell(estimates.get(one.name), one), theirs(variant, one)) for one in columns)
            rows.append([variant.title, *(f"{ours} ({paper})" if paper else ours for ours, paper in pairs)])
    introduction = (
        "The policies drive the ten fixed scenarios once each; safety rates are those of the visited states at eps "
        "0.01 by the sampled criterion, from the LiDAR's origin as the paper's text has it, and once as proved. In "
        "brackets: the paper, whose published code measures from the edge of a disc of 0.17 m and leaves walls out."
    )
    header = ["Method", *(f"{one.title} {arrow(one)}" for one in columns)]
    return ["## On the ten fixed scenarios, beside the paper", "", introduction, "", *table(header, rows)]


def arrow(metric: Metric) -> str:
    """Return which direction is better."""
    return "↑" if metric.better > 0 else "↓"


def cell(estimated: Mapping[str, Any] | None, metric: Metric, interval: bool = False) -> str:
    """Return one number with its spread."""
    if estimated is None:
        return MISSING
    mean = number(estimated["mean"], metric)
    if not interval:
        return f"{mean} ± {number(estimated['std'], metric)}"
    if estimated["low"] is None:
        return f"{mean} [one seed]"
    low, high = max(estimated["low"], 0.0), estimated["high"]  # no metric can be negative
    if metric.scale == 100.0:
        high = min(high, 1.0)
    return f"{mean} [{number(low, metric)}, {number(high, metric)}]"


def number(value: float, metric: Metric) -> str:
    """Return a value as the metric is shown; a share is never rounded up to 100 or down to 0."""
    shown = value * metric.scale
    text = f"{shown:.{metric.digits}f}"
    if metric.scale == 100.0 and shown < 100.0 and float(text) == 100.0:
        return f"{100.0 - 10.0**-metric.digits:.{metric.digits}f}"
    return text


def theirs(variant: Variant, metric: Metric) -> str:
    """Return the paper's number, empty where it has none."""
    pair = PAPER[variant.name].get(metric.name)
    return "" if pair is None else f"{pair[0]:g} ± {pair[1]:g}"


def constraint_table(data: Mapping[str, Any]) -> list[str]:
    """Return what lambda and u did in the trainings, and whether the policies keep the limit."""
    rows = []
    for variant in (VARIANTS[name] for name in VARIANTS if name in data["variants"]):
        if variant.family == "unconstrained":
            continue
        constraint = data["variants"][variant.name]["constraint"]
        tracked = variant.method in ("via", "cvar-cpo")
        rows.append(
            [
                variant.title,
                f"{constraint['zero']:.0%}",
                f"{constraint['zero_late']:.0%}",
                f"{constraint['multiplier']:.3f}",
                f"{constraint['multiplier_highest']:.3f}",
                f"{constraint['var']:.2f}" if tracked else MISSING,
                _kept_limit(data, variant),
            ]
        )
    titles = (
        "lambda = 0",
        "in the last quarter",
        "lambda there",
        "highest lambda",
        "u there",
        "limited to b",
    )
    return table(["Method", *titles], rows)


def _kept_limit(data: Mapping[str, Any], variant: Variant) -> str:
    """Return the mean of what the method limits, on the held-out scenarios, against b."""
    metric = METRICS["cost" if variant.family == "expectation" else f"cvar_{variant.alpha:g}"]
    found = data["variants"][variant.name]
    mean, limit = found["estimates"][metric.name]["mean"], found["constraint"]["limit"]
    return f"{metric.title} {number(mean, metric)} {'≤' if mean <= limit else '>'} {limit:g}"
