"""The report on states while the result is at hand: episodes, counterexamples with their places, tables, pictures."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
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
    Playable,
    Replayable,
    StateTable,
    StateTabled,
    Tabled,
)
from viatool.report.numbers import counted
from viatool.report.sections import Annotation, Case, Check, Finding, Rules
from viatool.report.states.document import StatesDocument, describe_state
from viatool.report.states.episodes import Episode, summarise_episodes

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from viatool.margins.result import Margins
    from viatool.report.files import Content
    from viatool.report.playback.messages import RosMessage
    from viatool.verification.result import Result

NOT_SAFE = ("unsafe", "unknown")
COLUMNS = ("state", "episode", "scenario", "outcome", "time", "x", "y", "theta", "verdict")


class StatesRun(
    StatesDocument,
    Cased,
    Annotated,
    Located,
    Tabled,
    Drawn,
    Explorable,
    Replayable,
    Playable,
    StateTabled,
    Evidenced,
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

    FINDING_RULES: ClassVar[Rules] = {  # of what was not driven, no finding is an error
        "unsafe-state": (
            "error",
            "A sensor error within eps makes the deployed policy violate the criterion.",
        ),
        "unknown-state": ("warning", "The criterion could be neither proved nor refuted."),
        "unsafe-close-place": (
            "warning",
            "Beside the driven path, a sensor error within eps makes the deployed policy violate the criterion.",
        ),
        "unknown-close-place": (
            "note",
            "Beside the driven path, the criterion could be neither proved nor refuted.",
        ),
    }

    def __init__(
        self, result: Result, margins: Margins | None = None, files: Mapping[str, Path] | None = None
    ) -> None:
        told = {} if margins is None else {"margins": {**margins.part(), "varied": margins.varied.to_json()}}
        super().__init__({**result.to_json(), **told})
        self.result, self.files = result, files or {}

    def cases(self) -> Sequence[Case]:
        """Return every episode: an unsafe one is a failure, one with unknown states an error; and close places.

        Close places were not driven: they fail nothing but the gate that asks for them.
        """
        close = self.result.close
        beside = [] if close is None else summarise_episodes(close)
        return [
            *(_case(episode, self._worst.get(episode.index)) for episode in summarise_episodes(self.result)),
            *(self._beside(episode) for episode in beside if episode.states),
        ]

    @cached_property
    def _worst(self) -> Mapping[int, str]:
        """Return in short why the worst state of each episode is not safe, by the number of the episode."""
        worst: dict[int, str] = {}
        for one in self.result.reasons.each:
            worst.setdefault(int(self.result.episode[one.state]), f"state {one.state}: {one.brief}")
        return worst

    def _beside(self, episode: Episode) -> Case:
        evidence = tuple(self._told(self.result.close, "close place", episode.index))
        name = f"beside {episode.index}: {episode.name}"
        return Case("viatool.close_places", name, figures=_figures(episode), evidence=evidence)

    def annotations(self) -> Sequence[Annotation]:
        """Return an error for each unsafe episode, and a warning for each with unknown states alone."""
        episodes = summarise_episodes(self.result)
        unsafe = [(e, "error", "unsafe", e.unsafe) for e in episodes if e.unsafe]
        unknown = [(e, "warning", "unknown", e.unknown) for e in episodes if e.unknown and not e.unsafe]
        driven = [
            Annotation(
                level,
                f"{counted(number, f'{verdict} state')} in {e.name}",
                f"{e.safe} of {e.states} states safe, the episode ended in {e.outcome}"
                + (f"; {self._worst[e.index]}" if e.index in self._worst else ""),
            )
            for e, level, verdict, number in [*unsafe, *unknown]
        ]
        close = [] if self.result.close is None else summarise_episodes(self.result.close)
        beside = [
            Annotation(
                "warning",
                f"{counted(e.unsafe + e.unknown, 'close place')} not safe beside {e.name}",
                f"{e.safe} of {counted(e.states, 'close place')} safe, {e.unsafe} unsafe, {e.unknown} unknown",
            )
            for e in close
            if e.unsafe + e.unknown
        ]
        return [*driven, *beside]

    def findings(self) -> tuple[Iterable[Finding], int]:
        """Return the unsafe states, then the unknown ones, and the same of close places."""
        number = int((self.result.verdict != "safe").sum())
        if self.result.close is not None:
            number += int((self.result.close.verdict != "safe").sum())
        return self._findings(), number

    def _findings(self) -> Iterator[Finding]:
        lacking = self._lacking
        for found in _findings(self.result, "state"):
            takes = [rate for rate, rows in lacking.items() if rows[found.state]] + [found.verdict]
            yield replace(found, takes=dict.fromkeys(takes, 1))
        if self.result.close is not None:
            for found in _findings(self.result.close, "close place"):
                beside = f"beside {found.scenario}"  # nobody who accepts a driven state means this one
                yield replace(found, scenario=beside, state=None, takes={"close": 1})

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

    def evidence(self, rate: str) -> Iterator[str]:
        """Name every state, or close place, that is not safe."""
        if rate == "close":
            yield from self._told(self.result.close, "close place")
        elif rate in ("overall", "contested"):
            yield from self._told(self.result, "state")

    @staticmethod
    def _told(result: Result | None, what: str, episode: int | None = None) -> Iterator[str]:
        """Name what is not safe of a result, in one of its episodes or in all."""
        if result is not None:
            for verdict in NOT_SAFE:
                for state in _where(result, verdict, episode):
                    yield _describe(result, state, what)

    def columns(self) -> Sequence[str]:
        """Return what a row tells of its state, with the ends of every action."""
        ends = [f"{action.name}_{end}" for end in ("lower", "upper") for action in self.result.actions]
        return [*COLUMNS, *ends, "reason"]

    def rows(self) -> Iterator[Sequence[object]]:
        """Yield a row for each state."""
        trajectory, reachable = self.result.trajectory, self.result.reachable
        names = [trajectory.name_of(index) for index in range(trajectory.episodes)]
        words = {one.state: one.words for one in self.result.reasons.each}
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
                words.get(state, ""),
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

    def play(self) -> Iterator[RosMessage]:
        """Yield the states as they were driven, with what is known of each."""
        from viatool.report.states.playback import StatesPlayback

        return StatesPlayback(self.result).messages()

    def evidence_files(self, checks: Sequence[Check]) -> Mapping[str, Content]:
        """Return claims, assumptions, inputs, verdicts and counterexamples, and a page about them."""
        from viatool.report.evidence.folder import evidence_folder

        return evidence_folder(self, checks)

    def state_tables(self) -> Mapping[str, StateTable]:
        """Return the arrays of the states, and those of close places."""
        every = {"": self.result, **({} if self.result.close is None else {"close_": self.result.close})}
        return {
            prefix: StateTable(len(one.trajectory), one.EPISODE_COLUMNS, one.state_table)
            for prefix, one in every.items()
        }


def _where(result: Result, verdict: str, episode: int | None = None) -> list[int]:
    """Return which states have a verdict, in one of the episodes or in all."""
    there = result.verdict == verdict
    if episode is not None:
        there &= result.episode == episode
    found: list[int] = np.flatnonzero(there).tolist()
    return found


def _describe(result: Result, state: int, what: str) -> str:
    trajectory, verdict = result.trajectory, str(result.verdict[state])
    name, time = trajectory.name_of(trajectory.episode[state]), float(trajectory.time[state])
    return describe_state(what, state, verdict, name, time, trajectory.poses[state].tolist())


def _findings(result: Result, what: str) -> Iterator[Finding]:
    trajectory = result.trajectory
    reasons = {one.state: f" Reason: {one.brief}." for one in result.reasons.each}
    for verdict in NOT_SAFE:
        for state in _where(result, verdict):
            name, time = trajectory.name_of(trajectory.episode[state]), float(trajectory.time[state])
            x, y, heading = trajectory.poses[state].tolist()
            # Poses that were picked have no time that tells them apart.
            place = f"{name}/{time:.3f}" if trajectory.connected else f"{name}/{x:.3f},{y:.3f},{heading:.3f}"
            rule = f"{verdict}-{what.replace(' ', '-')}"
            text = f"{_describe(result, state, what)}{reasons.get(state, '')}"
            yield Finding(rule, text, place, place, verdict, name, state)


def _figures(episode: Episode) -> str:
    return (
        f"{episode.safe} safe, {episode.unsafe} unsafe, {episode.unknown} unknown; outcome {episode.outcome}"
    )


def _case(episode: Episode, worst: str | None) -> Case:
    """Return an episode as a case, with why its worst state is not safe."""
    group, name = "viatool.trajectory", f"{episode.index}: {episode.name}"
    figures, because = _figures(episode), f"; {worst}" if worst else ""
    if episode.unsafe:
        first = f"{counted(episode.unsafe, 'unsafe state')}, the first is state {episode.first_unsafe}"
        return Case(group, name, "failure", f"{first}{because}", figures)
    if episode.unknown:
        return Case(group, name, "error", f"{counted(episode.unknown, 'unknown state')}{because}", figures)
    if not episode.states:
        return Case(group, name, "skipped", "no states")
    return Case(group, name)
