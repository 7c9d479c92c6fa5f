"""What the examination of states found, as arrays that can be joined and stored."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Indices
from viatool.loop.horizon import Crashes, Horizon, Tubes
from viatool.safety import Contested, Judgement, Witnesses
from viatool.taylor import ReachableSet
from viatool.verification.horizon_result import HorizonResult

Arrays = dict[str, NDArray[Any]]


@dataclass(frozen=True, eq=False)
class StateFindings:
    """What is known of B states after their examination.

    Parameters
    ----------
    reachable : ReachableSet
        (B, A) bounds of the actions; NaN for states that were settled without them.
    contested : Contested
        Which states some admissible command of the robot could make fail.
    judgement : Judgement
        Which states the criterion, and the paper's nine actions, find safe.
    witnesses : Witnesses
        The counterexamples; their states are counted over the whole run.
    seconds : dict
        Time that each stage took.
    tubes, crashes : Tubes and Crashes, optional
        Where the closed loop may be over the horizon, and the runs that fail, if that was asked.
    """

    reachable: ReachableSet
    contested: Contested
    judgement: Judgement
    witnesses: Witnesses
    seconds: Mapping[str, float]
    tubes: Tubes | None = None
    crashes: Crashes | None = None

    def over(self, horizon: Horizon | None) -> HorizonResult | None:
        """Return what is known of the intervals after the states; None where nothing was asked."""
        if horizon is None or self.tubes is None or self.crashes is None:
            return None
        return HorizonResult(horizon, self.tubes, self.crashes)

    def rows(self, which: Indices) -> StateFindings:
        """Return what is known of some states, each once, counted from the first of them; without the horizon."""
        place = np.full(len(self.judgement.safe), -1)
        place[which] = np.arange(len(which))
        witnesses = replace(self.witnesses, state=place[self.witnesses.state])
        kept = np.flatnonzero(witnesses.state >= 0)
        kept = kept[np.argsort(witnesses.state[kept], kind="stable")]
        return StateFindings(
            self.reachable.rows(which),
            Contested(self.contested.collision[which], self.contested.danger[which]),
            Judgement(
                self.judgement.safe[which], self.judgement.danger[which], self.judgement.sampled[which]
            ),
            witnesses.select(kept),
            {},
        )

    @classmethod
    def join(cls, parts: Sequence[StateFindings]) -> StateFindings:
        """Return the findings of consecutive states as one."""
        every = [part.to_arrays() for part in parts]
        arrays = {
            name: np.concatenate([part[name] for part in every])
            for name in every[0]
            if not name.startswith(_SECONDS)
        }
        for name in dict.fromkeys(name for part in every for name in part if name.startswith(_SECONDS)):
            arrays[name] = np.array(sum(float(part.get(name, 0.0)) for part in every))
        return cls.from_arrays(arrays)

    def to_arrays(self) -> Arrays:
        """Return everything by name, such as ``reachable.lower``."""
        arrays = {
            f"{part}.{field.name}": getattr(getattr(self, part), field.name)
            for part, kind in _PARTS.items()
            if getattr(self, part) is not None
            for field in fields(kind)
            if getattr(getattr(self, part), field.name) is not None
        }
        return arrays | {_SECONDS + stage: np.array(value) for stage, value in self.seconds.items()}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> StateFindings:
        """Return what `to_arrays` was called on."""
        parts: dict[str, Any] = {
            part: kind(
                **{
                    field.name: arrays[f"{part}.{field.name}"]
                    for field in fields(kind)
                    if f"{part}.{field.name}" in arrays
                }
            )
            for part, kind in _PARTS.items()
            if f"{part}.{fields(kind)[0].name}" in arrays
        }
        seconds = {
            name.removeprefix(_SECONDS): float(value)
            for name, value in arrays.items()
            if name.startswith(_SECONDS)
        }
        return cls(**parts, seconds=seconds)


_SECONDS = "seconds."
_PARTS: Mapping[str, Any] = {
    "reachable": ReachableSet,
    "contested": Contested,
    "judgement": Judgement,
    "witnesses": Witnesses,
    "tubes": Tubes,
    "crashes": Crashes,
}
