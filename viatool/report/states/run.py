"""The report on states while the result is at hand: episodes, counterexamples with their places, tables, pictures."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from viatool.report.document import (
    Annotated,
    Cased,
    Drawn,
    Evidenced,
    Explorable,
    Located,
    Replayable,
    StateTabled,
    Tabled,
)
from viatool.report.numbers import counted
from viatool.report.sections import Annotation, Case, Check, Finding, Rules
from viatool.report.states.document import StatesDocument
from viatool.report.states.episodes import Episode, summarise_episodes

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from viatool.margins.result import Margins
    from viatool.report.files import Content
    from viatool.verification.result import Result

COLUMNS = ("state", "episode", "scenario", "outcome", "time", "x", "y", "theta", "verdict")


class StatesRun(
    StatesDocument, Cased, Annotated, Located, Tabled, Drawn, Explorable, Replayable, StateTabled, Evidenced
):
    """The report of a result.

    Parameters
    ----------
    result : Result
        What was found.
    margins : Margins, optional
        Those of its contested states, if they were asked for.
    files : mapping, optional
        What was read besides policy and map, by its role: ``specification``, ``errors``, ``recording``.
    """

    FINDING_RULES: ClassVar[Rules] = {
        "unsafe-state": (
            "error",
            "A sensor error within eps makes the deployed policy violate the criterion.",
        ),
        "unknown-state": ("warning", "The criterion could be neither proved nor refuted."),
    }

    def __init__(
        self, result: Result, margins: Margins | None = None, files: Mapping[str, Path] | None = None
    ) -> None:
        told = {} if margins is None else {"margins": {**margins.part(), "varied": margins.varied.to_json()}}
        super().__init__({**result.to_json(), **told})
        self.result, self.files = result, files or {}

    def cases(self) -> Sequence[Case]:
        """Return every episode: an unsafe one is a failure, one with unknown states an error."""
        return [_case(episode) for episode in summarise_episodes(self.result)]

    def annotations(self) -> Sequence[Annotation]:
        """Return an error for each unsafe episode, and a warning for each with unknown states alone."""
        episodes = summarise_episodes(self.result)
        unsafe = [(e, "error", "unsafe", e.unsafe) for e in episodes if e.unsafe]
        unknown = [(e, "warning", "unknown", e.unknown) for e in episodes if e.unknown and not e.unsafe]
        return [
            Annotation(
                level,
                f"{counted(number, f'{verdict} state')} in {e.name}",
                f"{e.safe} of {e.states} states safe, the episode ended in {e.outcome}",
            )
            for e, level, verdict, number in [*unsafe, *unknown]
        ]

    def findings(self) -> tuple[Iterable[Finding], int]:
        """Return the unsafe states, then the unknown ones."""
        return self._findings(), int((self.result.verdict != "safe").sum())

    def _findings(self) -> Iterator[Finding]:
        trajectory, lacking = self.result.trajectory, self._lacking
        for verdict in ("unsafe", "unknown"):
            for state in np.flatnonzero(self.result.verdict == verdict).tolist():
                name, time = trajectory.name_of(trajectory.episode[state]), float(trajectory.time[state])
                x, y, heading = trajectory.poses[state].tolist()
                text = (
                    f"State {state} is {verdict}: scenario {name} at {time:.2f} s, "
                    f"x {x:.3f} m, y {y:.3f} m, heading {heading:.3f} rad."
                )
                # Poses that were picked have no time that tells them apart.
                place = (
                    f"{name}/{time:.3f}" if trajectory.connected else f"{name}/{x:.3f},{y:.3f},{heading:.3f}"
                )
                takes = dict.fromkeys([rate for rate, rows in lacking.items() if rows[state]] + [verdict], 1)
                yield Finding(f"{verdict}-state", text, place, place, verdict, name, state, takes)

    @property
    def _lacking(self) -> Mapping[str, NDArray[np.bool_]]:
        """Return the states that each rate counts and that are not among its safe ones, (N,) each."""
        result, judgement = self.result, self.result.judgement
        outcome = result.outcomes[result.episode]
        lasting = {} if result.horizon is None else {"horizon": ~result.horizon.tubes.safe}
        return {
            "overall": ~judgement.safe,
            "danger": ~judgement.danger,
            "contested": ~judgement.safe & result.contested.collision,
            "sampled": ~judgement.sampled,
            **{name: ~judgement.safe & (outcome == name) for name in ("success", "collision", "timeout")},
            **lasting,
        }

    def columns(self) -> Sequence[str]:
        """Return what a row tells of its state, with the ends of every action."""
        ends = [f"{action.name}_{end}" for end in ("lower", "upper") for action in self.result.actions]
        return [*COLUMNS, *ends]

    def rows(self) -> Iterator[Sequence[object]]:
        """Yield a row for each state."""
        trajectory, reachable = self.result.trajectory, self.result.reachable
        names = [trajectory.name_of(index) for index in range(trajectory.episodes)]
        for state, episode in enumerate(trajectory.episode.tolist()):
            ends = (*reachable.lower[state], *reachable.upper[state])
            yield [
                state,
                episode,
                names[episode],
                trajectory.outcomes[episode],
                *(f"{number:.9g}" for number in (trajectory.time[state], *trajectory.poses[state])),
                self.result.verdict[state],
                *(f"{number:.17g}" for number in ends),
            ]

    def draw(self) -> Figure:
        """Return the overview with its episodes, or the map of poses."""
        from viatool.report.states.figure import draw_result

        return draw_result(self.result)

    def page(self, checks: Sequence[Check]) -> str:
        """Return the page with every state behind its verdict."""
        from viatool.report.html.page import render_page

        return render_page(self, checks)

    def witness_file(self) -> Mapping[str, Any]:
        """Return every counterexample."""
        from viatool.verification.witness_file import witness_document

        return witness_document(self.result)

    def evidence_files(self, checks: Sequence[Check]) -> Mapping[str, Content]:
        """Return claims, assumptions, inputs, verdicts and counterexamples, and a page about them."""
        from viatool.report.evidence.folder import evidence_folder

        return evidence_folder(self, checks)

    @property
    def episode_columns(self) -> Sequence[str]:
        """Return the names of the arrays with one row for each episode."""
        return self.result.EPISODE_COLUMNS

    def state_table(self, rows: slice) -> Mapping[str, NDArray[Any]]:
        """Return the arrays of some states."""
        return self.result.state_table(rows)


def _case(episode: Episode) -> Case:
    group, name = "viatool.trajectory", f"{episode.index}: {episode.name}"
    figures = (
        f"{episode.safe} safe, {episode.unsafe} unsafe, {episode.unknown} unknown; outcome {episode.outcome}"
    )
    if episode.unsafe:
        first = f"{counted(episode.unsafe, 'unsafe state')}, the first is state {episode.first_unsafe}"
        return Case(group, name, "failure", first, figures)
    if episode.unknown:
        return Case(group, name, "error", counted(episode.unknown, "unknown state"), figures)
    if not episode.states:
        return Case(group, name, "skipped", "no states")
    return Case(group, name)
