"""Table I of the paper: seven methods in its lab, and the questions Q1 and Q2."""

from __future__ import annotations

from collections.abc import Sequence

from viatool.studies.answers import RULE
from viatool.studies.comparison import collect
from viatool.studies.questions import binding_sentences, in_short, question_1, question_2
from viatool.studies.study import Data, Options, Page, Study
from viatool.studies.tables import beside_paper, constraint_table, head, metrics_table
from viatool.studies.tasks import Task
from viatool.studies.variants import LAB, METHODS, plan

_HELD_OUT = ("success", "collision", "timeout", "cost", "cvar_0.9")
_PROVED = ("safety_success", "safety_collision", "safety", "danger", "contested")
_SAMPLED = ("sampled_success", "sampled_collision", "sampled")
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
    questions = [question_1(data, _CLAIMED), question_2(data)]
    lines += [*in_short(questions), *binding_sentences(data)]
    lines += beside_paper(data, METHODS)
    lines += ["## On held-out random scenarios", ""]
    lines += metrics_table(data, METHODS, _HELD_OUT, interval=True)
    lines += ["## Verified at eps 0.01: proved", ""]
    lines += metrics_table(data, METHODS, _PROVED)
    lines += ["## Verified at eps 0.01: sampled, as the paper does", ""]
    lines += metrics_table(data, METHODS, _SAMPLED)
    lines += ["## What the constraint did", "", *constraint_table(data)]
    lines += ["## How the questions are answered", "", RULE, ""]
    lines += [line for question in questions for line in question.lines()]
    return Page("\n".join(lines).rstrip() + "\n")


STUDY = Study("table1", "seven methods in the paper's lab", _plan, collect, _render)
