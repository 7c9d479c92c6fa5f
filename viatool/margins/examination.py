"""The margins of states, one block at a time, and as work for the driver of long work."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Booleans, Floats, Indices
from viatool.margins.bisection import Answers, Brackets, bisect
from viatool.margins.deciding import deciding_weights
from viatool.margins.findings import Arrays, MarginFindings
from viatool.margins.varying import Varying
from viatool.safety import find_contested
from viatool.schedule import EvenWork, Span
from viatool.verification.campaign import StateWork, describe
from viatool.verification.clock import Clock
from viatool.verification.examination import StateExamination
from viatool.verification.states import States


@dataclass(frozen=True, eq=False)
class MarginExamination:
    """What is asked of every state: a picklable, pure function of states.

    Parameters
    ----------
    widest : StateExamination
        What is asked at the largest error: states that are not contested there are so at no error.
    varying : Varying
        What is asked at each error.
    most, resolution : float
        The largest error that is tried, and how close both ends are followed.
    also : tuple of float
        Errors between that are tried as well.
    """

    widest: StateExamination
    varying: Varying
    most: float
    resolution: float
    also: tuple[float, ...] = ()

    def __call__(self, states: States) -> MarginFindings:
        """Examine all contested ones of some states together."""
        size, axes = states.observations.shape[1], len(self.widest.setting.rules.lower)
        clock = Clock(noted=False)
        with clock.timed("geometry"):
            rows = np.flatnonzero(np.concatenate([self._contested(block) for block in states.each_block()]))
        if not rows.size:
            return MarginFindings.none(size, axes, clock.seconds)
        some, spent = states.select(rows), dict(clock.seconds)

        def examine(which: Indices, errors: Floats) -> Answers:
            return self.varying.answers(some.select(which), errors, spent)

        found = bisect(examine, len(rows), size, axes, self.most, self.resolution, self.also)
        with clock.timed("decides"):
            weight = self._weigh(some, found)
            placed = self.widest.placed(some)
            distance = placed.footprint_clearance(self.widest.setting.rules.footprint, np.zeros(len(some)))[0]
        spent["decides"] = clock.seconds["decides"]
        state = states.first + rows
        witnesses = replace(found.witnesses, state=state[found.witnesses.state])
        return MarginFindings(state, found.certified, found.refuted, witnesses, distance, weight, spent)

    def _contested(self, block: States) -> Booleans:
        """Tell which states of a block some command could endanger at the largest error, (B,)."""
        return find_contested(self.widest.sensors(block, self.widest.placed(block)).judged).collision

    def _weigh(self, states: States, found: Brackets) -> Floats:
        """Return which entries decide where the proof of each state ends."""
        ends = np.minimum(np.minimum(found.unproved, found.refuted), self.most)
        weight = np.zeros(states.observations.shape)
        for rows, found_there in self.varying.each(states, ends, deciding_weights):
            weight[rows] = found_there
        return weight


@dataclass(frozen=True, eq=False)
class MarginWork(EvenWork[States, MarginFindings]):
    """The margins of states; a unit is a block of them, and the contested ones of a piece are examined together.

    Parameters
    ----------
    examination : MarginExamination
        What happens to each block.
    states : States
        N states.
    versions : mapping
        Of everything that may change a result.
    """

    examination: MarginExamination
    states: States
    versions: Mapping[str, str]
    stage = "states"
    piece = 8

    @property
    def _blocks(self) -> StateWork:
        """How states are cut into blocks, as for their verdicts."""
        return StateWork(self.examination.widest, self.states, self.versions)

    def __len__(self) -> int:
        """Return the number of blocks."""
        return len(self._blocks)

    @property
    def function(self) -> MarginExamination:
        """Return what happens to each block."""
        return self.examination

    def content(self, span: Span) -> States:
        """Return the states of some blocks."""
        return self._blocks.content(span)

    def size(self, span: Span) -> int:
        """Return the number of states in some blocks."""
        return self._blocks.size(span)

    def name(self, span: Span) -> str:
        """Return which states some blocks are."""
        return self._blocks.name(span)

    def describe(self) -> dict[str, Any]:
        """Return everything that the findings depend on."""
        asked = self.examination
        return {
            **describe(asked.widest, self.states, self.versions),
            **asked.varying.described,
            "most": asked.most,
            "resolution": asked.resolution,
            "also": list(asked.also),
        }

    def to_arrays(self, part: MarginFindings) -> Arrays:
        """Return findings as arrays."""
        return part.to_arrays()

    def from_arrays(self, arrays: Mapping[str, NDArray[Any]]) -> MarginFindings:
        """Return findings."""
        return MarginFindings.from_arrays(arrays)

    def join(self, parts: Sequence[MarginFindings]) -> MarginFindings:
        """Return the findings of consecutive blocks as one."""
        return MarginFindings.join(parts)


class CloseMarginWork(MarginWork):
    """The same of close places."""

    stage = "close places"
