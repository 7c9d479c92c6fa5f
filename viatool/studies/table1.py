"""Table I of the paper: seven methods in its lab, and the questions Q1 and Q2."""

from __future__ import annotations

from collections.abc import Sequence

from viatool.studies.answers import (
    RULE,
    answer,
    compare_all,
    comparison_table,
    discordant_pairs,
)
from viatool.studies.comparison import collect
from viatool.studies.study import Data, Options, Page, Study
from viatool.studies.tables import beside_paper, constraint_table, head, metrics_table
from viatool.studies.tasks import Task
from viatool.studies.variants import LAB, METHODS, VARIANTS, VIA, plan

_FIXED = ("fixed_success", "fixed_collision", "fixed_cost")
_HELD_OUT = ("success", "collision", "timeout", "cost", "cvar_0.9")
_PROVED = ("safety_success", "safety_collision", "safety", "danger", "contested")
_SAMPLED = ("sampled_success", "sampled_collision", "sampled", "width_v", "width_omega")
_CLAIMED = ("success", "collision", "safety")


def _plan(options: Options) -> Sequence[Task]:
    return plan(LAB, METHODS, options)


def _render(data: Data) -> Page:
    lines = head(
        "Table I: seven methods in the paper's lab",
        data,
        "Every method on the same TD3 backbone, network (26 x 26), reward, schedule and exploration, with the "
        "paper's limit b = 10. Mean ± standard deviation over the seeds, shares in per cent.",
    )
    lines += ["## On the ten fixed scenarios, beside the paper", ""]
    lines += beside_paper(data, METHODS, _FIXED)
    lines += ["## On held-out random scenarios", ""]
    lines += metrics_table(data, METHODS, _HELD_OUT, interval=True)
    lines += ["## Verified at eps 0.01: proved", ""]
    lines += metrics_table(data, METHODS, _PROVED)
    lines += ["## Verified at eps 0.01: sampled, as the paper does, and widths of the reachable sets", ""]
    lines += metrics_table(data, METHODS, _SAMPLED)
    lines += ["## What the constraint did", "", *constraint_table(data)]
    lines += _questions(data)
    return Page("\n".join(lines).rstrip() + "\n")


def _questions(data: Data) -> list[str]:
    pairs = [(VIA.name, other.name) for other in METHODS if other.family in ("unconstrained", "expectation")]
    first = compare_all(data, pairs, _CLAIMED)
    lines = ["## Q1: does the CVaR constraint improve navigation and safety?", "", RULE, ""]
    lines += [f"VIA against the unconstrained and the expectation-based methods: {answer(first)}.", ""]
    lines += comparison_table(first)
    names = [variant.name for variant in METHODS]
    discordant, concordant = discordant_pairs(data, names, "cost", "safety")
    lines += ["## Q2: does verification reveal what the cost does not?", ""]
    lines += [
        f"Among the pairs of methods whose mean costs differ beyond doubt, the cheaper one is less safe (proved, "
        f"overall) in {len(discordant)} and safer in {len(concordant)}.",
        "",
    ]
    lines += [
        f"- {VARIANTS[one.better].title} is cheaper than {VARIANTS[one.worse].title}" for one in discordant
    ]
    return lines


STUDY = Study("table1", "seven methods in the paper's lab", _plan, collect, _render)
