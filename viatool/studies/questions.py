"""The paper's questions Q1 to Q3 as sections of a page, answered from the data by the rule of `answers`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from viatool.studies.answers import (
    Answer,
    Superiority,
    answer,
    compare_all,
    comparison_table,
    discordant_pairs,
)
from viatool.studies.metrics import METRICS
from viatool.studies.statistics import rank_correlation
from viatool.studies.tables import number
from viatool.studies.variants import ALPHAS, METHODS, RCPO, VARIANTS, VIA, VIA_LOW, VIA_MIDDLE, Variant

Data = Mapping[str, Any]

_OTHERS = tuple(variant for variant in METHODS if variant.family in ("unconstrained", "expectation"))
_CVAR = tuple(variant for variant in METHODS if variant.family == "cvar")
_SAFETY = ("safety", "contested")


@dataclass(frozen=True)
class Section:
    """A question and its answer.

    Parameters
    ----------
    question : str
        The heading.
    answers : tuple of str
        One line each.
    details : tuple of str
        Lines of markdown below.
    """

    question: str
    answers: tuple[str, ...]
    details: tuple[str, ...]

    def lines(self) -> list[str]:
        """Return the section of a page."""
        return [f"## {self.question}", "", *(f"- {one}" for one in self.answers), "", *self.details]


def in_short(sections: Sequence[Section]) -> list[str]:
    """Return the answers alone, for the head of a page."""
    rows = [f"- {section.question} {one}" for section in sections for one in section.answers[:1]]
    return ["## In short", "", *rows, ""]


def question_1(data: Data, metrics: Sequence[str]) -> Section:
    """Answer whether CVaR constraints improve on unconstrained and expectation-based methods, in some metrics."""
    via = Superiority([(VIA.name, other.name) for other in _OTHERS], metrics)
    family = Superiority([(one.name, other.name) for one in _CVAR for other in _OTHERS], metrics)
    found, every = answer(data, via), answer(data, family)
    return Section(
        "Q1: does the CVaR formulation improve navigation and safety?",
        (
            f"VIA against {_listed(_OTHERS)}: {found}.",
            f"All CVaR methods ({_listed(_CVAR)}) against the same: {every}.",
        ),
        (*_details(data, via, found), *_decided(data, family)),
    )


def _decided(data: Data, claim: Superiority) -> list[str]:
    """Return the comparisons of a claim that go one way or the other, if there are any."""
    found = [one for one in compare_all(data, claim) if one.finding in ("as claimed", "opposite")]
    return ["What is decided among all CVaR methods:", "", *comparison_table(found)] if found else []


def _details(data: Data, claim: Superiority, found: Answer) -> tuple[str, ...]:
    """Return every comparison of a claim, and how often the rule errs."""
    return (*comparison_table(compare_all(data, claim)), found.chances(), "")


def question_2(data: Data) -> Section:
    """Answer whether the ranking by cost and the ranking by verified safety diverge."""
    names = [variant.name for variant in VARIANTS.values() if variant.name in data["variants"]]
    found = {safety: discordant_pairs(data, names, "cost", safety) for safety in _SAFETY}
    answers = [_second_answer(data, names, safety, *pairs) for safety, pairs in found.items()]
    claim = (
        "The claim: a method can have the lower cost and yet be verified as less safe. Those pairs of methods "
        "count that differ in both, at 0.05 for the larger of the two p-values, corrected for the number of pairs. It "
        "is confirmed if there is such a pair, contradicted if there are only pairs in which the cheaper one is the "
        "safer one, else undecided."
    )
    examples = [
        f"- {VARIANTS[cheaper].title} is cheaper than {VARIANTS[dearer].title}, and less safe "
        f"({METRICS[safety].title.lower()})."
        for safety, (discordant, _) in found.items()
        for cheaper, dearer in discordant
    ]
    return Section(
        "Q2: does verification reveal what the average cost does not?",
        (*answers, _rcpo_against_via(data)),
        (claim, "", *examples, *([""] if examples else [])),
    )


def _second_answer(
    data: Data,
    names: Sequence[str],
    safety: str,
    discordant: Sequence[tuple[str, str]],
    concordant: Sequence[tuple[str, str]],
) -> str:
    word = "confirmed" if discordant else "contradicted" if concordant else "undecided"
    estimates = [data["variants"][name]["estimates"] for name in names]
    both = [(one["cost"]["mean"], one[safety]["mean"]) for one in estimates if safety in one]
    tau = rank_correlation(*zip(*both, strict=True)) if len(both) > 2 else 0.0
    return (
        f"{METRICS[safety].title} (proved): **{word}** (cheaper and less safe in {len(discordant)} pairs, cheaper "
        f"and safer in {len(concordant)}). Kendall's tau of the two rankings: {0.0 - tau:+.2f} (1: they agree)."
    )


def _rcpo_against_via(data: Data) -> str:
    """Return the paper's own example in our numbers."""
    found = {
        one.metric: one for one in compare_all(data, Superiority([(RCPO.name, VIA.name)], ("cost", "safety")))
    }
    if not found:
        return "RCPO and VIA, the paper's example, are not both there."
    differences = [
        f"{METRICS[name].title.lower()} {_signed(one.difference, name)} "
        f"[{_signed(one.low, name)}, {_signed(one.high, name)}]"
        for name, one in found.items()
    ]
    return f"The paper's example, RCPO minus VIA: {' and '.join(differences)} (the paper: cost -0.35, overall -1.7)."


def _signed(value: float, metric: str) -> str:
    text = number(value, METRICS[metric])
    return text if text.startswith("-") else f"+{text}"


def question_3(data: Data, metrics: Sequence[str]) -> Section:
    """Answer whether a higher alpha improves success and safety, in some metrics."""
    pairs = [(VIA.name, VIA_LOW.name), (VIA.name, VIA_MIDDLE.name), (VIA_MIDDLE.name, VIA_LOW.name)]
    claim = Superiority(pairs, metrics)
    found = answer(data, claim)
    return Section(
        "Q3: does a higher alpha improve success and safety?",
        (f"{_listed(ALPHAS)}, the higher one claimed to be better: {found}.",),
        _details(data, claim, found),
    )


def binding_sentences(data: Data) -> list[str]:
    """Return in plain words for which variants the constraint ended without force."""
    constrained = [
        (VARIANTS[name], found["constraint"])
        for name, found in data["variants"].items()
        if VARIANTS[name].family != "unconstrained"
    ]
    idle = [variant for variant, constraint in constrained if constraint["zero_late"] == 1.0]
    held = [variant for variant, constraint in constrained if constraint["zero_late"] < 1.0]
    lines = []
    if idle:
        lines.append(
            f"In the last quarter of the training lambda was 0, in every epoch and for every seed, for "
            f"{_listed(idle)}. Their actors maximised the same as TD3's there: what distinguishes their policies from "
            "TD3's is chance, the way there, and for VIA and CVaR-CPO a budget that the actor sees."
        )
    if held:
        shares = ", ".join(
            f"{variant.title} {1 - constraint['zero_late']:.0%}"
            for variant, constraint in constrained
            if variant in held
        )
        lines.append(f"Lambda was above 0 in this share of the last quarter, over all seeds: {shares}.")
    return [text for line in lines for text in (line, "")]


def _listed(variants: Sequence[Variant]) -> str:
    titles = [variant.title for variant in variants]
    return titles[0] if len(titles) == 1 else f"{', '.join(titles[:-1])} and {titles[-1]}"
