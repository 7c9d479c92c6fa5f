"""What each term of the error model costs: what would be proved if the robot were ideal in it.

Of every state or cell that is not proved, each term is dropped in turn and it is judged again. One may be lost to
several terms, each of which would save it, or to several at once, of which none alone would: so the numbers of terms
neither add up to that of all terms together nor exclude each other.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Booleans, Indices
from viatool.errors import ConfigurationError
from viatool.setting.setting import Setting
from viatool.setting.wishes import Wishes

EPS = "eps of "
"""Before the name of a channel: the error that is its radius."""
MOST = 2000
"""What is judged again at most."""


@dataclass(frozen=True)
class TermCost:
    """A term and what it costs.

    Parameters
    ----------
    term, value : str
        Where it stands, such as ``timing.delay`` or ``eps of lidar``, and what it says.
    saved : int
        States or cells that are proved without it, and not with it.
    """

    term: str
    value: str
    saved: int


@dataclass(frozen=True, eq=False)
class ErrorCosts:
    """What the errors cost that a verdict allows for.

    Parameters
    ----------
    rows : ndarray
        (D,) states or cells, not proved, that were judged again.
    not_proved : int
        Those that are not proved, of which they are some or all.
    terms : tuple of TermCost
        T of them, the costliest first; of equal ones in the order of the model.
    proved : ndarray
        (D, T) bool: whether a state or a cell is proved without a term.
    together : int
        States or cells that are proved without any of the terms; the others are lost to the policy or to the bounds.
    left_out : tuple of str
        Terms that cannot be dropped alone, and why.
    """

    rows: Indices
    not_proved: int
    terms: tuple[TermCost, ...]
    proved: Booleans
    together: int
    left_out: tuple[str, ...] = ()

    @classmethod
    def ranked(
        cls, without: Alternatives, rows: Indices, not_proved: int, proved: Booleans, bare: Booleans
    ) -> ErrorCosts:
        """Rank T terms by what is proved without each, (D, T), and without all of them, (D,)."""
        saved = proved.sum(axis=0)
        order = np.argsort(-saved, kind="stable")
        terms = tuple(without.cost(number, int(saved[number])) for number in order.tolist())
        return cls(rows, not_proved, terms, proved[:, order], int(bare.sum()), without.left_out)

    def column(self, count: int) -> NDArray[np.str_]:
        """Return by which terms each of N fails, (N,): those that would save it, with commas between."""
        names = np.array([term.term for term in self.terms], dtype=np.str_)
        told = [",".join(names[row]) for row in self.proved]
        column = np.zeros(count, dtype=f"U{max(map(len, told), default=1) or 1}")
        column[self.rows] = told
        return column

    def to_json(self, subjects: str) -> dict[str, Any]:
        """Return plain data for a report, in which states, or cells, are called by their name."""
        terms = [{"term": one.term, "value": one.value, subjects: one.saved} for one in self.terms]
        return {
            "not_proved": self.not_proved,
            "judged": len(self.rows),
            "terms": terms,
            "together": self.together,
            "left_out": list(self.left_out),
        }


@dataclass(frozen=True, eq=False)
class Alternatives:
    """What is asked without each of T errors, and without all of them.

    Parameters
    ----------
    terms : tuple
        T names and values.
    settings : tuple of Setting
        T of them, each without one error.
    bare : Setting
        Without any.
    left_out : tuple of str
        Errors that cannot be dropped alone, and why.
    """

    terms: tuple[tuple[str, str], ...]
    settings: tuple[Setting, ...]
    bare: Setting
    left_out: tuple[str, ...]

    def cost(self, number: int, saved: int) -> TermCost:
        """Return what an error costs, by its number."""
        term, value = self.terms[number]
        return TermCost(term, value, saved)


Ask = Callable[[Wishes, Mapping[str, float]], Setting]
"""Makes the setting of other wishes and radii by channel."""
Judge = Callable[[Setting, Indices], Booleans]
"""Tells which of some states (D,) are proved in a setting."""


def cost_of_errors(setting: Setting, wishes: Wishes, safe: Booleans, ask: Ask, judge: Judge) -> ErrorCosts:
    """Drop each term in turn, and judge again the states that are not proved, evenly spread ones of many.

    Parameters
    ----------
    setting : Setting
        What was asked.
    wishes : Wishes
        How.
    safe : ndarray
        (N,) bool: the states that are proved.
    ask, judge : callable
        How another setting is made, and states are judged in it.
    """
    lost = np.flatnonzero(~safe)
    rows = lost[np.unique(np.linspace(0, len(lost) - 1, MOST).round().astype(int))] if len(lost) else lost
    without = drop_each(setting, wishes, ask)
    proved = np.zeros((len(rows), len(without.settings)), dtype=bool)
    bare = np.zeros(len(rows), dtype=bool)
    if len(rows) and without.settings:
        for number, other in enumerate(without.settings):
            proved[:, number] = judge(other, rows)
        bare = judge(without.bare, rows)
    return ErrorCosts.ranked(without, rows, len(lost), proved, bare)


def drop_each(setting: Setting, wishes: Wishes, ask: Ask) -> Alternatives:
    """Return what is asked without each error that a verdict allows for; as `cost_of_errors`."""
    terms, settings, left_out = [], [], []
    bare: tuple[Wishes, Mapping[str, float]] = (wishes, radii_of(setting))
    for term, value, dropped in droppable(setting, wishes):
        bare = dropped(*bare)
        try:
            settings.append(ask(*dropped(wishes, radii_of(setting))))
        except ConfigurationError as error:
            left_out.append(f"{term}: {error.message}")
        else:
            terms.append((term, value))
    return Alternatives(tuple(terms), tuple(settings), ask(*bare), tuple(left_out))


def radii_of(setting: Setting) -> dict[str, float]:
    """Return the radius of every channel that is not fixed."""
    fixed = {channel.name for channel in setting.spec.observation if channel.value is not None}
    return {name: radius for name, radius in setting.errors.by_channel.items() if name not in fixed}


Dropped = Callable[[Wishes, Mapping[str, float]], tuple[Wishes, Mapping[str, float]]]


def droppable(setting: Setting, wishes: Wishes) -> Iterator[tuple[str, str, Dropped]]:
    """Yield every error that a verdict allows for: its name, its value, and what drops it."""
    units = setting.errors.units
    for channel, radius in radii_of(setting).items():
        if radius > 0.0:
            yield f"{EPS}{channel}", f"{radius:g} {units[channel]}".rstrip(), _without_eps(channel)
    if wishes.delay > 0.0:
        yield "delay", f"{wishes.delay:g} s", lambda wished, radii: (replace(wished, delay=0.0), radii)
    for place, value in wishes.errors.premises():
        if not (place.startswith("sensor.") and place.endswith(".absolute")):  # those are eps
            yield place, value, _without_term(place)


def _without_eps(channel: str) -> Dropped:
    place = f"sensor.{channel}.absolute"
    return lambda wished, radii: (_without(wished, place), {**radii, channel: 0.0})


def _without_term(place: str) -> Dropped:
    return lambda wished, radii: (_without(wished, place), radii)


def _without(wished: Wishes, place: str) -> Wishes:
    return replace(wished, errors=wished.errors.without(place))
