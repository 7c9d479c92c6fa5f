"""Bisection over verdicts: the largest error that is proved safe, and the smallest that is refuted, of many states.

A proof at one error is one at every smaller error, whose observations it covers as well; a counterexample at one error
is one at every larger error, which allows it as well. Verdicts as they are computed need not be so orderly, so both
ends are what was really found: the largest error with a proof, and the smallest with a counterexample.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from viatool.arrays import Booleans, Floats, Indices
from viatool.errors import BoundsError
from viatool.safety import Witnesses
from viatool.schedule import check_time


@dataclass(frozen=True, eq=False)
class Answers:
    """What was found of Q states, each at an error of its own.

    Parameters
    ----------
    proved, refuted : ndarray
        (Q,) bool; never both.
    witnesses : Witnesses
        Of those that are refuted, one for each; their states are the Q.
    """

    proved: Booleans
    refuted: Booleans
    witnesses: Witnesses


Examine = Callable[[Indices, Floats], Answers]
"""Examines states, by their rows (Q,), each within an error of its own, (Q,)."""


@dataclass(eq=False)
class Brackets:
    """Between which errors the verdicts of C states change.

    Parameters
    ----------
    certified : ndarray
        (C,) the largest error with a proof; minus infinity where there is none.
    unproved : ndarray
        (C,) the smallest error above that was tried in vain; infinite where none was.
    withstood : ndarray
        (C,) the largest error below `refuted` without a counterexample; minus infinity where there is none.
    refuted : ndarray
        (C,) the smallest error with a counterexample; infinite where there is none.
    witnesses : Witnesses
        These counterexamples.
    """

    certified: Floats
    unproved: Floats
    withstood: Floats
    refuted: Floats
    witnesses: Witnesses

    @classmethod
    def unknown(cls, count: int, size: int, axes: int) -> Brackets:
        """Return what is known of C states before any is examined: n observation entries, A axes of a command."""
        nothing, anything = np.full(count, -np.inf), np.full(count, np.inf)
        none = Witnesses.none(size, axes)
        return cls(nothing, anything, nothing.copy(), anything.copy(), none)

    def learn(self, rows: Indices, errors: Floats, found: Answers, most: float) -> None:
        """Take in what was found of some states (Q,), each at an error of its own.

        Raises
        ------
        BoundsError
            If an error is proved safe at or above one with a counterexample, which is a fault of viatool.

        Notes
        -----
        Sound: yes. `certified` moves to errors with a proof alone, `refuted` to those with a counterexample.
        """
        np.maximum.at(self.certified, rows[found.proved], errors[found.proved])
        np.minimum.at(self.refuted, rows[found.refuted], errors[found.refuted])
        self._keep(replace(found.witnesses, state=rows[found.witnesses.state]), errors[found.witnesses.state])
        crossed = np.flatnonzero(~(self.certified < self.refuted))
        if crossed.size:
            row = crossed[0]
            raise BoundsError(
                f"a state is proved safe within {self.certified[row]:g} and refuted within {self.refuted[row]:g}"
            )
        done = self.certified >= most
        passed = self.unproved <= self.certified
        self.unproved[passed] = np.where(done, np.inf, np.minimum(self.refuted, most))[passed]
        vain = ~found.proved & (errors > self.certified[rows])
        np.minimum.at(self.unproved, rows[vain], errors[vain])
        fallen = self.withstood >= self.refuted
        self.withstood[fallen] = np.maximum(self.certified, 0.0)[fallen]
        quiet = ~found.refuted & (errors < self.refuted[rows])
        np.maximum.at(self.withstood, rows[quiet], errors[quiet])

    def _keep(self, witnesses: Witnesses, errors: Floats) -> None:
        """Keep the counterexamples within the smallest errors, in the place of those within larger ones."""
        nearer = witnesses.select(np.flatnonzero(errors == self.refuted[witnesses.state]))
        left = self.witnesses.select(np.flatnonzero(~np.isin(self.witnesses.state, nearer.state)))
        self.witnesses = Witnesses.join([left, nearer], nearer.observation.shape[1], nearer.action.shape[1])

    def questions(self, resolution: float) -> tuple[Indices, Floats]:
        """Return what to examine next, (Q,) rows and errors: the middles of brackets wider than the resolution."""
        with np.errstate(invalid="ignore"):  # ends that are infinite have no middle, and are not open
            proofs = 0.5 * (self.certified + self.unproved)
            witnesses = 0.5 * (self.withstood + self.refuted)
            open_ = self.unproved - self.certified > resolution
            sought = self.refuted - self.withstood > resolution
        open_ &= np.isfinite(proofs) & (self.certified < proofs) & (proofs < self.unproved)
        sought &= np.isfinite(witnesses) & (self.withstood < witnesses) & (witnesses < self.refuted)
        sought &= ~(open_ & (proofs == witnesses))
        rows = np.concatenate([np.flatnonzero(open_), np.flatnonzero(sought)])
        return rows, np.concatenate([proofs[open_], witnesses[sought]])


def bisect(
    examine: Examine,
    count: int,
    size: int,
    axes: int,
    most: float,
    resolution: float,
    also: Sequence[float] = (),
) -> Brackets:
    """Find between which errors the verdicts of C states change, all of them at once.

    Parameters
    ----------
    examine : callable
        What is done with some states, each at an error of its own.
    count, size, axes : int
        C states, of n observation entries, and A axes of a command.
    most : float
        The largest error that is tried.
    resolution : float
        Brackets that are no wider are not cut again.
    also : sequence of float
        Errors between that are tried at first, as somebody asks about them.

    Returns
    -------
    Brackets
        Of C states.

    Notes
    -----
    Sound: as `examine`. Cost: at most two states for each in a round, of which there are about log2(most / resolution).
    A state that is not proved without an error has no proof anywhere, and none is sought.
    """
    found, every = Brackets.unknown(count, size, axes), np.arange(count)
    first = np.unique([0.0, *also, most])
    rows, errors = np.tile(every, len(first)), np.repeat(first, count)
    while len(rows):
        check_time()
        found.learn(rows, errors, examine(rows, errors), most)
        rows, errors = found.questions(resolution)
    return found
