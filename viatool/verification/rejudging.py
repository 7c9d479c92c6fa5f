"""States judged again where something else is asked of them: without an error, within less, by tighter bounds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from viatool.arrays import Booleans, Floats, Indices
from viatool.policy import Policy
from viatool.setting.error_costs import EPS
from viatool.setting.needed import WithoutErrors
from viatool.setting.setting import Setting
from viatool.setting.wishes import Wishes
from viatool.trajectory import Trajectory
from viatool.verification.examination import StateExamination
from viatool.verification.findings import StateFindings
from viatool.verification.states import States, states_of
from viatool.world import Scenario, WorldMap


@dataclass(frozen=True, eq=False)
class Rejudging:
    """What was asked of N states, to be asked again in another way.

    Parameters
    ----------
    policy : Policy
        As it was loaded.
    world_map : WorldMap
        As it was loaded.
    scenarios : sequence of Scenario, optional
        What was asked about.
    setting : Setting
        What was asked.
    wishes : Wishes
        How.
    job : str
        Who asked, as `Setting.of` takes it.
    trajectory : Trajectory
        The states, as the program received them.
    examination : StateExamination
        What was asked of each of them.
    """

    policy: Policy
    world_map: WorldMap
    scenarios: Sequence[Scenario] | None
    setting: Setting
    wishes: Wishes
    job: str
    trajectory: Trajectory
    examination: StateExamination

    @cached_property
    def without(self) -> WithoutErrors:
        """What is asked without some of T errors that a verdict allows for."""
        return WithoutErrors(self.setting, self.wishes, self.ask)

    def ask(self, wished: Wishes, radii: Mapping[str, float]) -> Setting:
        """Return what is asked with other wishes, and radii by channel."""
        return Setting.of(self.policy, self.world_map, radii, wished, self.scenarios, job=self.job)

    def proved(self, other: Setting, rows: Indices) -> Booleans:
        """Tell which of some states (D,) are proved in another setting."""
        return self._asking(other).proves(states_of(other, self.trajectory).select(rows))

    def searched(self, other: Setting, rows: Indices) -> StateFindings:
        """Examine states (D,) in another setting, with a search for counterexamples."""
        return replace(self._asking(other), search=True)(states_of(other, self.trajectory).select(rows))

    def proved_without(self, rows: Indices, dropped: Booleans) -> Booleans:
        """Tell which of some states (D,) are proved, each without some of the T errors, (D, T)."""
        proved = np.zeros(len(rows), dtype=bool)
        others = dropped & ~self._radii_alone
        for pattern in np.unique(others, axis=0):
            some = np.flatnonzero((others == pattern).all(axis=1))
            if (setting := self.without(pattern)) is not None:
                states = states_of(setting, self.trajectory).select(rows[some])
                radii = np.where((dropped & self._radii_alone)[some] @ self._entries, 0.0, setting.radii)
                proved[some] = self._asking(setting).proves(replace(states, radii=radii))
        return proved

    def proved_within(self, states: States, radii: Floats) -> Booleans:
        """Tell which states are proved where the readings of each err by radii of its own, (D, n)."""
        return self._asking(self.setting).proves(replace(states, first=0, radii=radii))

    def proved_by(self, states: States, settings: Mapping[str, Any]) -> Booleans:
        """Tell which states are proved with other settings of `viatool.reach`."""
        effort = {**self.examination.efforts[-1], **settings}
        return replace(self._asking(self.setting), efforts=(effort,)).proves(states)

    @cached_property
    def _entries(self) -> Booleans:
        """Tell which entries of an observation err by each error that is the radius of a channel, (T, n)."""
        spec = self.setting.spec
        terms = self.without.terms
        entries = np.zeros((len(terms), spec.observation_size), dtype=bool)
        for row, (term, _) in enumerate(terms):
            if term.startswith(EPS):
                entries[row, spec.columns(term.removeprefix(EPS))] = True
        return entries

    @cached_property
    def _radii_alone(self) -> Booleans:
        """Tell which errors change nothing but how far readings are off, (T,), of which each state may have its own."""
        if self.setting.rules.kinematics.state or self.setting.rules.machine is not None:
            return np.zeros(
                len(self.without.terms), dtype=bool
            )  # how the robot moves is known as well as it is measured
        return np.asarray(self._entries.any(axis=1))

    def _asking(self, other: Setting) -> StateExamination:
        """Return the examination in another setting, without all on which a verdict does not depend."""
        return replace(
            self.examination, policy=other.commanding(self.policy), setting=other.bare(), only_contested=True,
            horizon=None, bounded_every=0, search=False,
        )  # fmt: skip
