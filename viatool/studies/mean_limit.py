"""Where the constraint binds, and limits the mean by the rule of lambda: every method and alpha, Q1 to Q3 again."""

from __future__ import annotations

from collections.abc import Sequence

from viatool.studies.answers import RULE
from viatool.studies.comparison import collect
from viatool.studies.questions import binding_sentences, in_short, question_1, question_2, question_3
from viatool.studies.study import Data, Options, Page, Study
from viatool.studies.tables import constraint_table, head, metrics_table
from viatool.studies.tasks import Task
from viatool.studies.variants import EVERY, MEAN_LIMIT, plan

_HELD_OUT = ("success", "collision", "timeout", "cost", "cvar_0.9")
_TAILS = ("cvar_0.1", "cvar_0.5", "cvar_0.9")
_PROVED = ("safety_success", "safety_collision", "safety", "danger", "contested")
_SAMPLED = ("sampled_success", "sampled_collision", "sampled", "width_v", "width_omega")
_CLAIMED = ("success", "collision", "cost", "cvar_0.9", "safety", "contested")


def _plan(options: Options) -> Sequence[Task]:
    return plan(MEAN_LIMIT, EVERY, options)


def _render(data: Data) -> Page:
    lines = head(
        "Where a limit on the mean binds",
        data,
        f"Every method and alpha in {MEAN_LIMIT.title}. Where u is near 0 (below), VIA's rule of lambda, b - u - mean "
        "C, limits the mean cost, and alpha hardly acts. Mean and 95 % interval over the seeds, shares in per cent.",
    )
    questions = [
        question_1(data, _CLAIMED),
        question_2(data),
        question_3(data, (*_CLAIMED, "width_omega")),
    ]
    lines += [*in_short(questions), *binding_sentences(data)]
    lines += ["## What the constraint did", "", *constraint_table(data)]
    lines += ["## On held-out random scenarios", "", *metrics_table(data, EVERY, _HELD_OUT, interval=True)]
    lines += ["## The tail of the cost", "", *metrics_table(data, EVERY, _TAILS, interval=True)]
    lines += ["## Verified at eps 0.01: proved", "", *metrics_table(data, EVERY, _PROVED, interval=True)]
    lines += ["## Verified at eps 0.01: sampled, and widths of the reachable sets", ""]
    lines += metrics_table(data, EVERY, _SAMPLED, interval=True)
    lines += ["## How the questions are answered", "", RULE, ""]
    lines += [line for question in questions for line in question.lines()]
    return Page("\n".join(lines).rstrip() + "\n")


STUDY = Study(
    "mean-limit", "every method and alpha where a limit on the mean cost binds", _plan, collect, _render
)
