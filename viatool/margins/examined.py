"""The states that are examined: driven, recorded or picked ones, and close places beside them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from viatool.margins.question import Question
from viatool.policy import Policy
from viatool.setting.received import as_received
from viatool.trajectory import Trajectory
from viatool.verification.close import joined, places_beside
from viatool.verification.source import Source
from viatool.verification.states import States, states_of


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
        places, reason = places_beside(setting, driven, count, seed=source.seed)
        if places is None:
            return replace(found, reason=reason)
        return replace(found, places=places, close=states_of(widest, places))

    @property
    def trajectory(self) -> Trajectory:
        """Return all of them, the close places last."""
        return self.driven if self.places is None else joined(self.driven, self.places)

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
