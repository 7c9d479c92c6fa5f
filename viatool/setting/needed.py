"""Which errors a state fails by: a least set of terms without which it is proved.

Each term is dropped alone. Where none suffices, all are dropped and then taken back one by one as long as the state
stays proved; those that cannot be are the set.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from viatool.arrays import Booleans, Indices
from viatool.errors import ConfigurationError
from viatool.setting.error_costs import EPS, Ask, droppable, radii_of
from viatool.setting.setting import Setting
from viatool.setting.wishes import Wishes

ProvedWithout = Callable[[Indices, Booleans], Booleans]
"""Tells which of some states (K,) are proved, each without errors of its own, (K, T)."""


@dataclass(frozen=True, eq=False)
class WithoutErrors:
    """What is asked without some of T errors that a verdict allows for.

    Parameters
    ----------
    setting : Setting
        What was asked.
    wishes : Wishes
        How.
    ask : callable
        How another setting is made.
    """

    setting: Setting
    wishes: Wishes
    ask: Ask

    @cached_property
    def terms(self) -> tuple[tuple[str, str], ...]:
        """Names and values of the errors."""
        return tuple((term, value) for term, value, _ in droppable(self.setting, self.wishes))

    @property
    def of_sensors(self) -> bool:
        """Tell whether all errors are those of sensors."""
        return all(term.startswith((EPS, "sensor.")) for term, _ in self.terms)

    @property
    def bare(self) -> Setting | None:
        """Return what is asked without any error; None where there is none, or none is known to be asked."""
        return self(np.ones(len(self.terms), dtype=bool)) if self.terms else None

    def __call__(self, dropped: Booleans) -> Setting | None:
        """Return what is asked without some errors, (T,); None where these cannot be dropped without others."""
        if not dropped.any():
            return self.setting
        left: tuple[Wishes, Mapping[str, float]] = (self.wishes, radii_of(self.setting))
        each = zip(droppable(self.setting, self.wishes), dropped.tolist(), strict=True)
        for (_, _, drop), gone in each:
            left = drop(*left) if gone else left
        try:
            return self.ask(*left)
        except ConfigurationError:
            return None

    def picked(self, which: Booleans) -> tuple[tuple[str, str], ...]:
        """Return some of the errors, (T,)."""
        return tuple(term for term, there in zip(self.terms, which.tolist(), strict=True) if there)


@dataclass(frozen=True, eq=False)
class NeededErrors:
    """What D states need of T errors to fail.

    Parameters
    ----------
    least : ndarray
        (D, T) bool: a set without which a state is proved, and of which none can be taken back; nothing where a state
        is not proved without any error.
    alone : ndarray
        (D, T) bool: the errors that suffice each by itself.
    """

    least: Booleans
    alone: Booleans


def needed_errors(ideal: Booleans, terms: int, proved: ProvedWithout) -> NeededErrors:
    """Find out by which of T errors states fail.

    Parameters
    ----------
    ideal : ndarray
        (D,) bool: those that are proved without any error; of the others nothing is asked.
    terms : int
        T.
    proved : callable
        How states are judged without errors.
    """
    alone = np.zeros((len(ideal), terms), dtype=bool)
    if not (terms and ideal.any()):
        return NeededErrors(alone, alone)
    lost = np.flatnonzero(ideal)
    if terms == 1:
        alone[lost] = True
    else:
        each = np.tile(np.eye(terms, dtype=bool), (len(lost), 1))
        alone[lost] = proved(np.repeat(lost, terms), each).reshape(len(lost), terms)
    least, single = np.zeros_like(alone), alone.any(axis=1)
    least[single, alone[single].argmax(axis=1)] = True
    several = np.flatnonzero(ideal & ~single)
    least[several] = True
    for term in range(terms if several.size else 0):
        fewer = least[several]
        fewer[:, term] = False
        least[several[proved(several, fewer)], term] = False
    return NeededErrors(least, alone)
