"""The paper's study of alpha: VIA at 0.1, 0.5 and 0.9 in its lab, and the question Q3."""

from __future__ import annotations

from collections.abc import Sequence

from viatool.studies.answers import RULE
from viatool.studies.comparison import collect
from viatool.studies.questions import binding_sentences, in_short, question_3
from viatool.studies.study import Data, Options, Page, Study
from viatool.studies.tables import beside_paper, constraint_table, head, metrics_table
from viatool.studies.tasks import Task
from viatool.studies.variants import ALPHAS, LAB, plan

_HELD_OUT = ("success", "collision", "timeout", "cost", "cvar_0.9")
_VERIFIED = ("safety_success", "safety_collision", "safety", "danger", "contested")
_CLAIMED = ("success", "collision", "safety", "width_omega")


def _plan(options: Options) -> Sequence[Task]:
    return plan(LAB, ALPHAS, options)


def _render(data: Data) -> Page:
    lines = head(
        "Table II: the level alpha of VIA",
        data,
        "VIA with three CVaR levels in the paper's lab, b = 10. Mean ± standard deviation over the seeds, shares "
        "in per cent.",
    )
    question = question_3(data, _CLAIMED)
    lines += [*in_short([question]), *binding_sentences(data)]
    lines += beside_paper(data, ALPHAS)
    lines += ["## On held-out random scenarios", "", *metrics_table(data, ALPHAS, _HELD_OUT, interval=True)]
    lines += ["## Verified at eps 0.01: proved", "", *metrics_table(data, ALPHAS, _VERIFIED)]
    lines += ["## What the constraint did", "", *constraint_table(data)]
    lines += ["## How the question is answered", "", RULE, "", *question.lines()]
    return Page("\n".join(lines).rstrip() + "\n")


STUDY = Study("table2", "VIA with alpha 0.1, 0.5 and 0.9 in the paper's lab", _plan, collect, _render)
