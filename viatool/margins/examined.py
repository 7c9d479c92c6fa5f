"""The states that are examined: driven, recorded or picked ones, and close places beside them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from viatool.errors import EmptyEvaluationError, InputError
from viatool.margins.question import Question
from viatool.policy import Policy
from viatool.setting.received import as_received
from viatool.trajectory import Trajectory
from viatool.verification.close import close_places
from viatool.verification.source import Source
from viatool.verification.states import States, states_of

_PICKED = "the states are places that were picked, beside which there is no path"


@dataclass(frozen=True, eq=False)
class ExaminedStates:
    """N states, and close places beside them.

    Parameters
    ----------
    driven : Trajectory
        As the program received them.
    states : States
        With what a setting needs to know of them.
    places : Trajectory or None
        The close places.
    close : States or None
        The same of these.
    reason : str
        Why there are none, where some were asked for.
    """

    driven: Trajectory
    states: States
    places: Trajectory | None = None
    close: States | None = None
    reason: str = ""

    @classmethod
    def of(cls, question: Question, policy: Policy, source: Source, count: int) -> ExaminedStates:
        """Return the states of a source, and so many close places beside them."""
        setting, widest = question.setting, question.widest
        driven = as_received(setting, source.states(policy, setting))
        if widest.pose_radii.any() and "goal" in widest.quantities.needs:
            widest.goals(driven.scenarios)  # refuses episodes without one
        found = cls(driven, states_of(widest, driven))
        if not count:
            return found
        if not driven.connected:
            return replace(found, reason=_PICKED)
        try:
            places = close_places(setting, driven, count, seed=source.seed)
            close = states_of(widest, places)
        except (InputError, EmptyEvaluationError) as error:
            return replace(found, reason=error.message)
        return replace(found, places=places, close=close)

    @property
    def trajectory(self) -> Trajectory:
        """Return all of them, the close places last."""
        return self.driven if self.places is None else _both(self.driven, self.places)

    @property
    def known(self) -> dict[str, Any]:
        """Return what a setting needs to know of all of them, by name."""
        parts = [self.states] if self.close is None else [self.states, self.close]
        velocities = [part.velocity for part in parts if part.velocity is not None]
        return {
            "under_way": np.concatenate([part.under_way for part in parts]),
            "begun": np.concatenate([part.begun for part in parts]),
            "velocity": np.concatenate(velocities) if velocities else None,
        }


def _both(driven: Trajectory, close: Trajectory) -> Trajectory:
    named = (one if one is None else replace(one, name=f"beside {one.name}") for one in close.scenarios)
    arrays: dict[str, Any] = {
        name: np.concatenate([getattr(driven, name), getattr(close, name)])
        for name in ("poses", "observations", "time", "outcomes", "costs")
    }
    count = len(driven) + len(close)
    return replace(
        driven,
        **arrays,
        actions=np.zeros((count, 0)),
        episode=np.concatenate([driven.episode, close.episode + driven.episodes]),
        scenarios=(*driven.scenarios, *named),
        commanded=None,
        steps=None,
        people=np.zeros((count, 0, 5)),
        motion={},
    )
