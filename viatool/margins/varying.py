"""What varies: the errors of readings, within which each state has radii of its own, or a term of the error model."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from viatool.arrays import Floats, Indices
from viatool.errors import EnclosureError
from viatool.margins.bisection import Answers
from viatool.policy import Policy
from viatool.safety import Witnesses
from viatool.setting.setting import Setting
from viatool.setting.wishes import Wishes
from viatool.verification.examination import StateExamination
from viatool.verification.states import States
from viatool.world import WorldMap

Found = TypeVar("Found")
Asked = tuple[Indices, StateExamination, States]
"""Which of some states, what is asked of them, and the states."""


class Varying(ABC):
    """What is asked of states, each at an error of its own; picklable.

    The set of observations and motions that an error allows holds those that every smaller error allows.
    """

    @abstractmethod
    def at(self, states: States, errors: Floats) -> Iterator[Asked]:
        """Give the B states, each at an error of its own (B,), in as few groups as they can be examined in."""

    @abstractmethod
    def setting(self, error: float) -> Setting:
        """Return what is asked at an error."""

    @property
    @abstractmethod
    def axes(self) -> int:
        """Return A, how many numbers a command has."""

    @property
    @abstractmethod
    def described(self) -> Mapping[str, Any]:
        """Return on what the answers depend, beside states and versions."""

    def answers(self, states: States, errors: Floats, seconds: dict[str, float]) -> Answers:
        """Examine B states, each at an error of its own, and add the time that each stage took.

        Notes
        -----
        Sound: yes, as the examination of `viatool.verify`, whatever other states have for errors. Where an error is so
        large that nothing bounds what the network takes, nothing is known.
        """
        proved, refuted = np.zeros(len(states), dtype=bool), np.zeros(len(states), dtype=bool)
        witnesses: list[Witnesses] = []
        for rows, found in self.each(states, errors, lambda examination, some: examination(some)):
            proved[rows] = found.judgement.safe
            refuted[rows[found.witnesses.state]] = True
            witnesses.append(replace(found.witnesses, state=rows[found.witnesses.state]))
            for stage, spent in found.seconds.items():
                seconds[stage] = seconds.get(stage, 0.0) + spent
        return Answers(proved, refuted, Witnesses.join(witnesses, states.observations.shape[1], self.axes))

    def each(
        self, states: States, errors: Floats, examine: Callable[[StateExamination, States], Found]
    ) -> Iterator[tuple[Indices, Found]]:
        """Do something with B states, each at an error of its own, and give what it finds with the rows of the states.

        States whose error is so large that nothing bounds what the network takes are left out.

        Raises
        ------
        EnclosureError
            If nothing bounds it at an error of 0 either.
        """
        for rows, examination, some in self.at(states, errors):
            waiting = [np.arange(len(some))]
            while waiting:
                part = waiting.pop()
                try:
                    yield rows[part], examine(examination, some.select(part))
                except EnclosureError:
                    if not errors[rows[part]].any():
                        raise
                    if len(part) > 1:
                        by_error = part[np.argsort(errors[rows[part]], kind="stable")]
                        waiting += np.array_split(by_error, 2)


@dataclass(frozen=True, eq=False)
class VaryingReadings(Varying):
    """Readings that err by more and more, by themselves or beside others that err by the same always.

    Parameters
    ----------
    examination : StateExamination
        What is asked of every state.
    base : ndarray
        (n,) radii that stay.
    direction : ndarray
        (n,) by how much the radius of each reading grows with the error, at least 0.
    """

    examination: StateExamination
    base: Floats
    direction: Floats

    def at(self, states: States, errors: Floats) -> Iterator[Asked]:
        """Give all states at once, with radii of their own."""
        radii = self.base + errors[:, None] * self.direction
        yield np.arange(len(states)), self.examination, replace(states, first=0, radii=radii)

    def setting(self, error: float) -> Setting:
        """Return what is asked where all states have the same error."""
        asked = self.examination.setting
        return replace(asked, errors=replace(asked.errors, radii=self.base + error * self.direction))

    @property
    def axes(self) -> int:
        """Return A."""
        return len(self.examination.setting.rules.lower)

    @property
    def described(self) -> Mapping[str, Any]:
        """Return what stays and what grows."""
        return {"base": self.base.tolist(), "direction": self.direction.tolist()}


@dataclass(frozen=True, eq=False)
class VaryingTerm(Varying):
    """A term of the error model that says more and more.

    Parameters
    ----------
    policy, world_map, eps, wishes
        What is asked, as `Setting.of` takes it.
    place : str
        Where the term stands, such as ``pose.x``.
    engine : mapping
        Settings of `viatool.reach`.
    seed : int
        Of the search for counterexamples.
    """

    policy: Policy
    world_map: WorldMap
    eps: Mapping[str, float] | float | None
    wishes: Wishes
    place: str
    engine: Mapping[str, Any]
    seed: int

    def setting(self, error: float) -> Setting:
        """Return what is asked where the term says so much."""
        wishes = replace(self.wishes, errors=self.wishes.errors.at(self.place, error))
        return Setting.of(self.policy, self.world_map, self.eps, wishes, (), job="verify")

    def at(self, states: States, errors: Floats) -> Iterator[Asked]:
        """Give the states in groups of one error: bisections of one range meet at the same errors."""
        for error in np.unique(errors).tolist():
            rows, setting = np.flatnonzero(errors == error), self.setting(error)
            examination = StateExamination.of(
                setting.commanding(self.policy), setting, self.engine, only_contested=True, seed=self.seed
            )
            some, count = states.select(rows), setting.rules.commands_before
            known = some.under_way.shape[1]
            yield rows, examination, replace(some, under_way=some.under_way[:, known - count :])

    @property
    def axes(self) -> int:
        """Return A."""
        return len(self.setting(0.0).rules.lower)

    @property
    def described(self) -> Mapping[str, Any]:
        """Return the term."""
        return {"term": self.place}
