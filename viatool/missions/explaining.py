"""Which errors a mission needs that is not proved: it is examined again without all of them, then without each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.missions.verdicts import Mission, MissionNeeds
from viatool.missions.work import MissionExamination
from viatool.schedule import Campaign, Deadline, Progress, Span, Work, digest_of
from viatool.setting.error_costs import Alternatives
from viatool.world import Scenario

Question = tuple[int, Scenario]
"""Which of several examinations a scenario gets."""


def with_needs(
    missions: Sequence[Mission],
    examination: MissionExamination,
    without: Alternatives,
    campaign: Campaign,
    tell: Progress,
    *,
    until: Deadline,
) -> tuple[Mission, ...]:
    """Return missions, with what is known of the errors that those take which are not proved.

    Parameters
    ----------
    missions : sequence of Mission
        As they were examined.
    examination : MissionExamination
        How.
    without : Alternatives
        What is asked without each of T errors, and without all of them.
    campaign, tell, until
        Who does it and where it is kept, who is told, and when to stop.

    Notes
    -----
    Sound: a verdict without an error is found as every verdict is. One that is not proved without any error is not
    asked about single ones, which leave the others in place.
    """
    lost = [row for row, one in enumerate(missions) if one.verdict != "proved" and len(one.arrived)]
    others = tuple(replace(examination, setting=one.bare()) for one in (without.bare, *without.settings))
    if not (lost and without.terms):
        return tuple(missions)
    inquiry = Reexamination(others)

    def verdicts(questions: Sequence[tuple[int, int]]) -> Mapping[tuple[int, int], str]:
        """Return the verdicts of missions (second) in settings (first), as far as there was time."""
        asked = tuple((which, missions[row].scenario) for which, row in questions)
        work = ReexaminedMissions(inquiry, asked)
        part = (
            campaign.within(f"explain-{digest_of(work.describe())[:16]}")
            .carry_out(work, tell, until=until)
            .part
        )
        return dict(zip(questions, part, strict=False))

    bare = verdicts([(0, row) for row in lost])
    ideal = [row for (_, row), verdict in bare.items() if verdict == "proved"]
    each = verdicts([(1 + number, row) for row in ideal for number in range(len(without.terms))])
    found = {row: _needs(row, verdict, each, without.terms) for (_, row), verdict in bare.items()}
    return tuple(replace(one, needs=found.get(row)) for row, one in enumerate(missions))


def _needs(
    row: int, bare: str, each: Mapping[tuple[int, int], str], terms: Sequence[tuple[str, str]]
) -> MissionNeeds:
    asked = {
        name: each[1 + number, row] for number, (name, _) in enumerate(terms) if (1 + number, row) in each
    }
    alone = tuple(name for name, verdict in asked.items() if verdict == "proved")
    return MissionNeeds(bare, alone, tuple(name for name in asked if name not in alone))


@dataclass(frozen=True, eq=False)
class Reexamination:
    """Several ways to examine a mission; a pure function that workers can be sent."""

    ways: tuple[MissionExamination, ...]

    def __call__(self, questions: Sequence[Question]) -> tuple[str, ...]:
        """Return the verdict of each question."""
        return tuple(self.ways[which].examine(scenario).verdict for which, scenario in questions)


@dataclass(frozen=True, eq=False)
class ReexaminedMissions(Work[Sequence[Question], tuple[str, ...]]):
    """Missions that are examined again; a unit is one of them in one way."""

    inquiry: Reexamination
    questions: tuple[Question, ...]
    stage = "missions without errors"

    def __len__(self) -> int:
        """Return the number of questions."""
        return len(self.questions)

    @property
    def function(self) -> Reexamination:
        """Return what happens to each."""
        return self.inquiry

    def content(self, span: Span) -> Sequence[Question]:
        """Return some questions."""
        return self.questions[span.first : span.last]

    def at_once(self, workers: int) -> int:
        """Return one: a mission is long."""
        return 1

    def describe(self) -> dict[str, Any]:
        """Return what the answers depend on beside the missions, in whose folder they are kept."""
        settings = [
            (one.setting.radii.tolist(), one.setting.uncertainty.exactly()) for one in self.inquiry.ways
        ]
        return {
            "settings": digest_of(settings),
            "missions": [(which, one.name) for which, one in self.questions],
        }

    def to_arrays(self, part: tuple[str, ...]) -> Mapping[str, NDArray[Any]]:
        """Return verdicts as an array."""
        return {"verdict": np.array(part, dtype=np.str_)}

    def from_arrays(self, arrays: Mapping[str, NDArray[Any]]) -> tuple[str, ...]:
        """Return verdicts."""
        return tuple(arrays["verdict"].tolist())

    def join(self, parts: Sequence[tuple[str, ...]]) -> tuple[str, ...]:
        """Return all verdicts in the order of the questions."""
        return tuple(verdict for part in parts for verdict in part)
