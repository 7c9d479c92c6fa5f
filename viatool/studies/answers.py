"""The paper's questions, answered from the data by a rule that is fixed beforehand.

A claim is a list of comparisons between variants. Each comparison is decided by the 95 % confidence interval of
the difference of the means over the seeds (Welch): *as claimed* or *opposite* when the whole interval lies on one
side of 0, *undecided* otherwise. The claim is **confirmed** if every comparison goes as claimed, **reversed** if
more go the opposite way than as claimed, and **not confirmed** otherwise; **open** without any comparison.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

from viatool.studies.metrics import METRICS
from viatool.studies.statistics import Estimate, difference, sign
from viatool.studies.tables import number, table
from viatool.studies.variants import VARIANTS


@dataclass(frozen=True)
class VariantComparison:
    """Whether one variant is better than another in one metric.

    Parameters
    ----------
    better, worse : str
        The variants, as claimed.
    metric : str
        In which the claim says so.
    difference : Estimate
        Of `better` minus `worse`.
    verdict : int
        +1 as claimed, -1 opposite, 0 undecided.
    """

    better: str
    worse: str
    metric: str
    difference: Estimate
    verdict: int


@dataclass(frozen=True)
class Answer:
    """What the data say about a claim."""

    word: str
    claimed: int
    opposite: int
    undecided: int

    def __str__(self) -> str:
        """Return the answer in words."""
        counts = f"{self.claimed} as claimed, {self.opposite} opposite, {self.undecided} undecided"
        return f"**{self.word}** ({counts})"


def compare(data: Mapping[str, Any], better: str, worse: str, metric: str) -> VariantComparison | None:
    """Compare two variants; None if the data lack one of them, or have fewer than two values of either."""
    first, second = (_known(data, name, metric) for name in (better, worse))
    if min(len(first), len(second)) < 2:
        return None
    gap = difference(first, second)
    return VariantComparison(better, worse, metric, gap, sign(gap) * METRICS[metric].better)


def _known(data: Mapping[str, Any], name: str, metric: str) -> list[float]:
    values = data["variants"].get(name, {}).get("values", {}).get(metric, ())
    return [value for value in values if value is not None]


def compare_all(
    data: Mapping[str, Any], pairs: Iterable[tuple[str, str]], metrics: Sequence[str]
) -> list[VariantComparison]:
    """Return every comparison that the data allow."""
    wanted = (compare(data, *pair, metric) for pair in pairs for metric in metrics)
    return [found for found in wanted if found is not None]


def answer(comparisons: Sequence[VariantComparison]) -> Answer:
    """Sum up comparisons by the rule."""
    verdicts = [found.verdict for found in comparisons]
    claimed, opposite, undecided = (verdicts.count(verdict) for verdict in (1, -1, 0))
    if not comparisons:
        word = "open"
    elif claimed == len(comparisons):
        word = "confirmed"
    else:
        word = "reversed" if opposite > claimed else "not confirmed"
    return Answer(word, claimed, opposite, undecided)


def comparison_table(comparisons: Sequence[VariantComparison]) -> list[str]:
    """Return a table of the comparisons: differences in the units of the tables."""
    words = {1: "as claimed", -1: "**opposite**", 0: "undecided"}
    rows = []
    for found in comparisons:
        metric, gap = METRICS[found.metric], found.difference
        low, high = (number(value, metric) for value in (gap.low, gap.high))
        rows.append(
            [
                f"{VARIANTS[found.better].title} against {VARIANTS[found.worse].title}",
                metric.title,
                f"{number(gap.mean, metric)} [{low}, {high}]",
                words[found.verdict],
            ]
        )
    return table(["Claimed better", "Metric", "Difference [95 % interval]", "Finding"], rows)


def discordant_pairs(
    data: Mapping[str, Any], names: Sequence[str], cost: str, safety: str
) -> tuple[list[VariantComparison], list[VariantComparison]]:
    """Find pairs of which one has the lower cost.

    Returns
    -------
    tuple of list
        Comparisons of the safety of the cheaper against the dearer variant, for the pairs whose costs differ
        beyond doubt: those in which the cheaper is less safe beyond doubt, and those in which it is safer.
    """
    discordant: list[VariantComparison] = []
    concordant: list[VariantComparison] = []
    for first, second in combinations(names, 2):
        costs = compare(data, first, second, cost)
        if costs is None or costs.verdict == 0:
            continue
        cheaper, dearer = (first, second) if costs.verdict > 0 else (second, first)
        safer = compare(data, cheaper, dearer, safety)
        if safer is not None and safer.verdict:
            (discordant if safer.verdict < 0 else concordant).append(safer)
    return discordant, concordant
