"""The paper's questions, answered from the data by a rule that is stated on every page, with its error rates.

A claim is a family of comparisons between variants. Each is Welch's test over the seeds (`statistics.differences`),
and all of a claim are corrected by Holm: without any true difference, nothing is decided in 19 of 20 studies.
A difference that is smaller than the metric's margin beyond doubt is *equal*, whatever its sign.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any, Literal

import numpy as np

from viatool.arrays import Floats, Indices
from viatool.studies.metrics import METRICS, Metric
from viatool.studies.statistics import Differences, differences, holm
from viatool.studies.tables import number, table
from viatool.studies.variants import VARIANTS

LEVEL = 0.05
DRAWS = 2000  # relabelled studies from which the rule's error rates are counted

RULE = (
    "Rule. The seed is what was drawn at random: a comparison is Welch's test of the means over the seeds. The "
    "variance of a share of episodes is taken to be at least the binomial one, for near 0 and 1 a few seeds agree by "
    "chance. All comparisons of a claim are corrected together (Holm), so that nothing at all is decided in 19 of 20 "
    "studies without a true difference. A comparison is *equal* if its difference is smaller than the metric's margin "
    "beyond doubt (two one-sided tests at 0.05): what is smaller does not matter in practice. Otherwise it goes *as "
    "claimed* or the *opposite* way where its corrected p-value is at most 0.05, else it is *undecided*. A claim is "
    "**confirmed** if every comparison goes as claimed; **partly confirmed** if some do and none goes the opposite "
    "way; **contradicted** if some go the opposite way and none as claimed; **mixed** if there are both; **no "
    "difference** if all are equal; otherwise **undecided**."
)

Finding = Literal["as claimed", "opposite", "equal", "undecided"]
FINDINGS: tuple[Finding, ...] = ("as claimed", "opposite", "equal", "undecided")


@dataclass(frozen=True)
class VariantComparison:
    """Whether one variant is better than another in one metric.

    Parameters
    ----------
    better, worse : str
        The variants, as claimed.
    metric : str
        In which the claim says so.
    difference, low, high : float
        Of `better` minus `worse`, with its 95 % interval, which is not corrected.
    p : float
        Corrected for the number of comparisons.
    detectable : float
        How large a true difference must be to be found in 4 of 5 such studies.
    finding : str
        By the rule.
    """

    better: str
    worse: str
    metric: str
    difference: float
    low: float
    high: float
    p: float
    detectable: float
    finding: Finding


@dataclass(frozen=True)
class Answer:
    """What the data say about a claim.

    Parameters
    ----------
    word : str
        By the rule.
    counts : mapping
        Comparisons by finding.
    errors : mapping
        How often each word comes out where the variants of the claim do not differ.
    """

    word: str
    counts: Mapping[Finding, int]
    errors: Mapping[str, float]

    def __str__(self) -> str:
        """Return the answer in words."""
        return f"**{self.word}** ({', '.join(f'{self.counts.get(one, 0)} {one}' for one in FINDINGS)})"

    def chances(self) -> str:
        """Return in words how often the rule errs."""
        shares = [f"{share:.1%} {word}" for word, share in self.errors.items() if share]
        return (
            "Were there no difference between these methods (their seeds relabelled at random, "
            f"{DRAWS} times), the rule would say: {', '.join(shares)}."
        )


@dataclass(frozen=True)
class Superiority:
    """That the first of each pair of variants is better than the second, in each of some metrics.

    Parameters
    ----------
    pairs : sequence of pair of str
        Variants.
    metrics : sequence of str
        In which.
    """

    pairs: Sequence[tuple[str, str]]
    metrics: Sequence[str]

    def where_known(self, data: Mapping[str, Any]) -> Superiority:
        """Return the claim about those variants that the data have."""
        known = [pair for pair in self.pairs if all(name in data["variants"] for name in pair)]
        return Superiority(known, self.metrics)

    def variants(self) -> list[str]:
        """Return the variants that are compared."""
        return list(dict.fromkeys(name for pair in self.pairs for name in pair))

    def differences(self, data: Mapping[str, Any], values: Floats) -> dict[str, Differences]:
        """Return for each metric the differences ``(..., pairs)`` of values ``(..., variants, seeds, metrics)``."""
        place = {name: index for index, name in enumerate(self.variants())}
        better, worse = (np.array([place[pair[side]] for pair in self.pairs]) for side in (0, 1))
        return {
            metric: differences(
                values[..., column][..., better, :],
                values[..., column][..., worse, :],
                trials(METRICS[metric], data),
            )
            for column, metric in enumerate(self.metrics)
        }


def trials(metric: Metric, data: Mapping[str, Any]) -> int | None:
    """Return of how many episodes a metric is a share; None for others."""
    return None if metric.episodes is None else int(data["about"]["episodes"][metric.episodes])


def seed_values(data: Mapping[str, Any], variants: Sequence[str], metrics: Sequence[str]) -> Floats:
    """Return ``(variants, seeds, metrics)``, NaN where a seed has no value."""
    found = [[data["variants"][name]["values"][metric] for metric in metrics] for name in variants]
    seeds = max((len(values) for columns in found for values in columns), default=0)
    table = np.full((len(variants), seeds, len(metrics)), np.nan)
    for row, columns in enumerate(found):
        for column, values in enumerate(columns):
            table[row, : len(values), column] = [np.nan if value is None else value for value in values]
    return table


def compare_all(data: Mapping[str, Any], claim: Superiority) -> list[VariantComparison]:
    """Return every comparison of a claim that the data allow, corrected for their number."""
    claim = claim.where_known(data)
    if not claim.pairs:
        return []
    values = seed_values(data, claim.variants(), claim.metrics)
    found, (codes, corrected) = claim.differences(data, values), judged(data, claim, values)
    ends = {metric: gaps.within() for metric, gaps in found.items()}
    detectable = {metric: gaps.detectable(LEVEL / codes.size) for metric, gaps in found.items()}
    return [
        VariantComparison(
            better,
            worse,
            metric,
            difference=float(found[metric].mean[row]),
            low=float(ends[metric][0][row]),
            high=float(ends[metric][1][row]),
            p=float(corrected[row, column]),
            detectable=float(detectable[metric][row]),
            finding=FINDINGS[codes[row, column]],
        )
        for row, (better, worse) in enumerate(claim.pairs)
        for column, metric in enumerate(claim.metrics)
    ]


def judged(data: Mapping[str, Any], claim: Superiority, values: Floats) -> tuple[Indices, Floats]:
    """Judge all comparisons of a claim by the rule.

    Parameters
    ----------
    data, claim
        The claim is about variants that the data have.
    values : ndarray
        ``(..., variants, seeds, metrics)``.

    Returns
    -------
    tuple of ndarray
        ``(..., pairs, metrics)``: places in `FINDINGS`, and the corrected p-values.
    """
    found = claim.differences(data, values)
    different = np.stack([gaps.p_different() for gaps in found.values()], axis=-1)
    corrected = holm(different.reshape(*different.shape[:-2], -1)).reshape(different.shape)
    equal = np.stack([gaps.p_equal(METRICS[name].margin) <= LEVEL for name, gaps in found.items()], axis=-1)
    claimed = np.stack([gaps.mean * METRICS[name].better > 0 for name, gaps in found.items()], axis=-1)
    decided = np.where(claimed, FINDINGS.index("as claimed"), FINDINGS.index("opposite"))
    undecided = np.where(corrected <= LEVEL, decided, FINDINGS.index("undecided"))
    return np.where(equal, FINDINGS.index("equal"), undecided), corrected


def answer(data: Mapping[str, Any], claim: Superiority) -> Answer:
    """Sum up the comparisons of a claim by the rule, with the rule's error rates on these data."""
    counts = Counter(found.finding for found in compare_all(data, claim))
    return Answer(answer_word(counts), counts, error_rates(data, claim))


def answer_word(counts: Mapping[Finding, int]) -> str:
    """Return the rule's word for so many comparisons of each finding."""
    claimed, opposite, equal, _ = (counts.get(one, 0) for one in FINDINGS)
    total = sum(counts.values())
    if not total:
        return "open"
    if claimed == total:
        return "confirmed"
    if claimed or opposite:
        return "mixed" if claimed and opposite else "partly confirmed" if claimed else "contradicted"
    return "no difference" if equal == total else "undecided"


def error_rates(
    data: Mapping[str, Any], claim: Superiority, draws: int = DRAWS, seed: int = 0
) -> dict[str, float]:
    """Return how often the rule gives each word where no two variants of a claim differ.

    Every draw deals the seeds of all variants, each with all its metrics, out to the variants at random: what the data
    would be if the method made no difference, with the spread and the dependence of the metrics that they have.
    """
    claim = claim.where_known(data)
    if not claim.pairs:
        return {}
    values = seed_values(data, claim.variants(), claim.metrics)
    seeds = values.reshape(-1, len(claim.metrics))
    orders = np.random.default_rng(seed).permuted(np.tile(np.arange(len(seeds)), (draws, 1)), axis=1)
    codes, _ = judged(data, claim, seeds[orders].reshape(draws, *values.shape))
    each = codes.reshape(draws, -1)
    rows = np.stack([(each == code).sum(axis=1) for code in range(len(FINDINGS))], axis=1).tolist()
    words = Counter(answer_word(dict(zip(FINDINGS, row, strict=True))) for row in rows)
    return {word: count / draws for word, count in words.most_common()}


def comparison_table(comparisons: Sequence[VariantComparison]) -> list[str]:
    """Return a table of the comparisons: differences in the units of the tables."""
    rows = []
    for found in comparisons:
        metric = METRICS[found.metric]
        low, high, mean, margin = (
            number(value, metric) if np.isfinite(value) else "?"
            for value in (found.low, found.high, found.difference, metric.margin)
        )
        detectable = number(found.detectable, metric) if np.isfinite(found.detectable) else "?"
        rows.append(
            [
                f"{VARIANTS[found.better].title} against {VARIANTS[found.worse].title}",
                metric.title,
                f"{mean} [{low}, {high}]",
                f"{found.p:.3f}",
                margin,
                detectable,
                found.finding,
            ]
        )
    header = [
        "Claimed better",
        "Metric",
        "Difference [95 % interval]",
        "p, corrected",
        "margin",
        "found in 4 of 5",
        "Finding",
    ]
    return table(header, rows)


def discordant_pairs(
    data: Mapping[str, Any], names: Sequence[str], cost: str, safety: str
) -> tuple[list[tuple[str, str]], list[tuple[str, str]]]:
    """Find pairs of which one has the lower cost.

    A pair's p-value is the larger of those of its two differences, as both must hold; all pairs are corrected together.

    Returns
    -------
    tuple of list
        Pairs (cheaper, dearer) that differ in both beyond doubt: those in which the cheaper is less safe, and those
        in which it is safer.
    """
    claim = Superiority(list(combinations(names, 2)), (cost, safety)).where_known(data)
    discordant: list[tuple[str, str]] = []
    concordant: list[tuple[str, str]] = []
    if not claim.pairs:
        return discordant, concordant
    found = claim.differences(data, seed_values(data, claim.variants(), claim.metrics))
    both = holm(np.maximum(found[cost].p_different(), found[safety].p_different()))
    cheaper, safer = (found[metric].mean * METRICS[metric].better > 0 for metric in (cost, safety))
    for row in np.flatnonzero(both <= LEVEL).tolist():
        first, second = claim.pairs[row]
        pair = (first, second) if cheaper[row] else (second, first)
        (concordant if cheaper[row] == safer[row] else discordant).append(pair)
    return discordant, concordant
