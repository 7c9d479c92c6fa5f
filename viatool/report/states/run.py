"""The report on states while the result is at hand: episodes, counterexamples with their places, tables, pictures."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from viatool.report.archives import as_array
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
from viatool.report.sections import Annotation, Case, Check, Finding, Key, Rules
from viatool.report.states.document import TABLES, StatesDocument, describe_state
from viatool.report.states.episodes import Episode, summarise_episodes

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from viatool.margins.result import Margins
    from viatool.report.files import Content
    from viatool.report.playback.messages import RosMessage
    from viatool.verification.result import Result

NOT_SAFE = ("unsafe", "unknown")
_BESIDES = {
    "danger": "safe, and not proved to keep the danger distance",
    "sampled": "safe, and fails one of the nine sampled actions",
    "horizon": "safe, and not proved so over the horizon",
}
"""What a rate misses of states that are safe."""
COLUMNS = ("state", "episode", "scenario", "outcome", "time", "x", "y", "theta", "verdict")


class StatesShown(
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
):
    """The report of states that are at hand, one by one: of a live result, or of a stored one.

    Attributes
    ----------
    result : Result
        What was found.
    """

    result: Result

    FINDING_RULES: ClassVar[Rules] = {
        "unsafe-state": (
            "warning",
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
        "counted-state": ("note", "The state is safe by the criterion, and not by what the gate asks for."),
    }

    def cases(self) -> Sequence[Case]:
        """Return every episode, and the close places beside each."""
        driven = zip(summarise_episodes(self.result), _keys_by_episode(self.result, "state"), strict=True)
        return [
            *(
                _case(episode, keys, self._worst.get(episode.index), partly=episode.index in self._partly)
                for episode, keys in driven
            ),
            *self._beside(),
        ]

    @property
    def _partly(self) -> frozenset[int]:
        """Return of which episodes states may be missing, where a run was stopped early."""
        if not self.incomplete:
            return frozenset()
        episode = self.result.episode
        first = int(episode[-1]) if (np.diff(episode) >= 0).all() else 0
        return frozenset(range(first, self.result.trajectory.episodes))

    def _beside(self) -> Iterator[Case]:
        close = self.result.close
        if close is None:
            return
        told: dict[int, list[str]] = {}
        for state in _not_safe(close):
            told.setdefault(int(close.episode[state]), []).append(_describe(close, state, "close place"))
        every = zip(summarise_episodes(close), _keys_by_episode(close, "close place"), strict=True)
        for episode, keys in every:
            if episode.states:
                name, evidence = f"beside {episode.index}: {episode.name}", tuple(told.get(episode.index, ()))
                outcome, message = (
                    ("warning", _not_safe_words(episode, "close place")) if evidence else ("passed", "")
                )
                yield Case("viatool.close_places", name, outcome, message, _figures(episode), evidence, keys)

    @cached_property
    def _worst(self) -> Mapping[int, str]:
        """Return in short why the worst state of each episode is not safe, by the number of the episode."""
        worst: dict[int, str] = {}
        for one in self.result.reasons.each:
            worst.setdefault(int(self.result.episode[one.state]), f"state {one.state}: {one.brief}")
        return worst

    def annotations(self) -> Sequence[Annotation]:
        """Return a remark on each episode with states that are not safe, those with unsafe ones first."""
        episodes, keys = summarise_episodes(self.result), _keys_by_episode(self.result, "state")
        unsafe = [(e, "unsafe", e.unsafe) for e in episodes if e.unsafe]
        unknown = [(e, "unknown", e.unknown) for e in episodes if e.unknown and not e.unsafe]
        driven = [
            Annotation(
                "warning",
                f"{counted(number, f'{verdict} state')} in {e.name}",
                f"{e.safe} of {e.states} states safe, the episode ended in {e.outcome}"
                + (f"; {self._worst[e.index]}" if e.index in self._worst else ""),
                keys[e.index],
            )
            for e, verdict, number in [*unsafe, *unknown]
        ]
        close = self.result.close
        every = (
            []
            if close is None
            else zip(summarise_episodes(close), _keys_by_episode(close, "close place"), strict=True)
        )
        beside = [
            Annotation(
                "warning",
                f"{counted(e.unsafe + e.unknown, 'close place')} not safe beside {e.name}",
                f"{e.safe} of {counted(e.states, 'close place')} safe, {e.unsafe} unsafe, {e.unknown} unknown",
                subjects,
            )
            for e, subjects in every
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
        yield from map(self._driven, _not_safe(self.result))
        if self.result.close is not None:
            yield from map(self._close, _not_safe(self.result.close))

    @cached_property
    def _reasons(self) -> Mapping[int, str]:
        """Return why states are not safe, as the end of a sentence about each."""
        return _reasons_of(self.result)

    @cached_property
    def _close_reasons(self) -> Mapping[int, str]:
        return {} if self.result.close is None else _reasons_of(self.result.close)

    def _driven(self, state: int) -> Finding:
        """Return a driven state with all that counts it."""
        found = _finding(self.result, state, "state", self._reasons.get(state, ""))
        takes = [name for name, rows in self._lacking.items() if rows[state]]
        return replace(found, takes=dict.fromkeys(takes, 1))

    def _close(self, place: int) -> Finding:
        assert self.result.close is not None
        found = _finding(self.result.close, place, "close place", self._close_reasons.get(place, ""))
        beside = f"beside {found.scenario}"  # nobody who accepts a driven state means this one
        return replace(found, scenario=beside, state=None, takes={"close": 1})

    @cached_property
    def _lacking(self) -> Mapping[str, NDArray[np.bool_]]:
        """Return which states each rate misses of those that it counts, or each limit counts, (N,) each."""
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
            **{verdict: result.verdict == verdict for verdict in NOT_SAFE},
        }

    def counted(self, name: str) -> Iterator[Finding]:
        """Return every state, or close place, that a rate misses or a limit counts; the unsafe ones first."""
        if name == "close":
            yield from map(self._close, [] if self.result.close is None else _not_safe(self.result.close))
        elif name in self._lacking:
            found = np.flatnonzero(self._lacking[name])
            verdicts = self.result.verdict[found]
            order = np.argsort(
                np.select([verdicts == verdict for verdict in NOT_SAFE], [0, 1], 2), kind="stable"
            )
            for state in found[order].tolist():
                finding = self._driven(state)
                yield (
                    finding
                    if finding.verdict != "safe"
                    else replace(
                        finding,
                        rule="counted-state",
                        text=_describe(self.result, state, "state", _BESIDES[name]),
                    )
                )

    def columns(self) -> Sequence[str]:
        """Return what a row tells of its state, with the ends of every action."""
        ends = [f"{action.name}_{end}" for end in ("lower", "upper") for action in self.result.actions]
        return [*COLUMNS, *ends, "reason"]

    def rows(self) -> Iterator[Sequence[object]]:
        """Yield a row for each state."""
        trajectory = self.result.trajectory
        names = [trajectory.name_of(index) for index in range(trajectory.episodes)]
        words = {one.state: one.words for one in self.result.reasons.each}
        for state, episode in enumerate(trajectory.episode.tolist()):
            yield _row(self.result, state, names[episode], words.get(state, ""))

    def row_of(self, finding: Finding) -> Sequence[object] | None:
        """Return a row for a close place."""
        table, place = finding.key
        if table != TABLES["close place"] or self.result.close is None or not isinstance(place, int):
            return None
        close = self.result.close
        words = next((one.words for one in close.reasons.each if one.state == place), "")
        return _row(close, place, f"beside {close.trajectory.name_of(close.episode[place])}", words)

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

    def state_tables(self) -> Mapping[str, StateTable]:
        """Return the arrays of the states, and those of close places."""
        every = {"": self.result, **({} if self.result.close is None else {"close_": self.result.close})}
        return {
            prefix: StateTable(
                len(one.trajectory), one.EPISODE_COLUMNS, one.state_table, partial(_key, prefix)
            )
            for prefix, one in every.items()
        }


class StatesRun(StatesShown, Evidenced):
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

    def __init__(
        self, result: Result, margins: Margins | None = None, files: Mapping[str, Path] | None = None
    ) -> None:
        told = {} if margins is None else {"margins": {**margins.part(), "varied": margins.varied.to_json()}}
        super().__init__({**result.to_json(), **told})
        self.result, self.files = result, files or {}

    def evidence_files(self, checks: Sequence[Check]) -> Mapping[str, Content]:
        """Return claims, assumptions, inputs, verdicts and counterexamples, and a page about them."""
        from viatool.report.evidence.folder import evidence_folder

        return evidence_folder(self, checks)

    def kept_beside(self) -> Mapping[str, NDArray[Any]]:
        """Return what was asked, and what the tables lack of the result."""
        from viatool.verification.stored import asked_of, stored_arrays

        return {"asked": as_array(asked_of(self.result)), **stored_arrays(self.result)}


def _not_safe(result: Result) -> list[int]:
    """Return which states are not safe, the unsafe ones first."""
    return [state for verdict in NOT_SAFE for state in np.flatnonzero(result.verdict == verdict).tolist()]


def _key(table: str, row: int) -> Key:
    return table, row


def _keys_by_episode(result: Result, what: str) -> list[list[Key]]:
    """Return which parts of the run the states of each episode are."""
    keys: list[list[Key]] = [[] for _ in range(result.trajectory.episodes)]
    for state, episode in enumerate(result.episode.tolist()):
        keys[episode].append((TABLES[what], state))
    return keys


def _row(result: Result, state: int, name: str, reason: str) -> list[object]:
    trajectory, reachable = result.trajectory, result.reachable
    episode, ends = int(trajectory.episode[state]), (*reachable.lower[state], *reachable.upper[state])
    return [
        state,
        episode,
        name,
        trajectory.outcomes[episode],
        *(f"{number:.9g}" for number in (trajectory.time[state], *trajectory.poses[state])),
        result.verdict[state],
        *(f"{number:.17g}" for number in ends),
        reason,
    ]


def _describe(result: Result, state: int, what: str, verdict: str = "") -> str:
    """Name a state and its verdict, or what else is to be said of it."""
    trajectory, verdict = result.trajectory, verdict or str(result.verdict[state])
    name, time = trajectory.name_of(trajectory.episode[state]), float(trajectory.time[state])
    return describe_state(what, state, verdict, name, time, trajectory.poses[state].tolist())


def _reasons_of(result: Result) -> dict[int, str]:
    return {one.state: f" Reason: {one.brief}." for one in result.reasons.each}


def _finding(result: Result, state: int, what: str, reason: str) -> Finding:
    trajectory, verdict = result.trajectory, str(result.verdict[state])
    name, time = trajectory.name_of(trajectory.episode[state]), float(trajectory.time[state])
    x, y, heading = trajectory.poses[state].tolist()
    # Poses that were picked have no time that tells them apart.
    place = f"{name}/{time:.3f}" if trajectory.connected else f"{name}/{x:.3f},{y:.3f},{heading:.3f}"
    rule, text = f"{verdict}-{what.replace(' ', '-')}", _describe(result, state, what)
    return Finding(rule, f"{text}{reason}", place, place, verdict, name, state, subject=(TABLES[what], state))


def _figures(episode: Episode) -> str:
    return (
        f"{episode.safe} safe, {episode.unsafe} unsafe, {episode.unknown} unknown; outcome {episode.outcome}"
    )


def _case(episode: Episode, keys: Sequence[Key], worst: str | None, *, partly: bool) -> Case:
    """Return an episode as a case, with why its worst state is not safe."""
    group, name = "viatool.trajectory", f"{episode.index}: {episode.name}"
    if not episode.states:
        return Case(group, name, "skipped", "no states")
    if partly and not episode.unsafe + episode.unknown:
        return Case(
            group, name, "skipped", "not all of its states were judged", _figures(episode), subjects=keys
        )
    if not episode.unsafe + episode.unknown:
        return Case(group, name, figures=_figures(episode), subjects=keys)
    message = _not_safe_words(episode, "state") + (f"; {worst}" if worst else "")
    return Case(group, name, "warning", message, _figures(episode), subjects=keys)


def _not_safe_words(episode: Episode, what: str) -> str:
    if not episode.unsafe:
        return counted(episode.unknown, f"unknown {what}")
    return f"{counted(episode.unsafe, f'unsafe {what}')}, the first is {what} {episode.first_unsafe}"
