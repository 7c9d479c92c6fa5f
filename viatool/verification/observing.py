"""What may be observed in each state of a block, what the policy makes of it, and the search for what fails."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from viatool.arrays import Booleans, Floats, Indices
from viatool.channels.drift import Drift
from viatool.channels.reading_errors import ReadingErrors
from viatool.policy import Policy
from viatool.policy.repeated import repeating
from viatool.safety import JudgedStates, ScenePoses, Witnesses, search_witnesses
from viatool.safety.moving import movers_around
from viatool.safety.pieces import CommandPieces
from viatool.sets.chance import RowChance
from viatool.setting.admissible import AdmissibleSets
from viatool.setting.driven import DrivenPolicy
from viatool.setting.explanation import explain
from viatool.setting.scanned import changed_scans
from viatool.setting.setting import Setting
from viatool.taylor import ReachableSet, reach
from viatool.taylor.observed import reach_observed
from viatool.taylor.propagation import Box
from viatool.verification.states import States

_CORNERS = np.array(np.meshgrid(*[[-1.0, 1.0]] * 3, indexing="ij")).reshape(3, -1).T
_BELIEFS = 4
"""Pairs of a true and a believed pose from which each state is searched."""
_WITHIN = 1.0 - 1e-9


@dataclass(frozen=True, eq=False)
class BlockSensors:
    """What the sensors of a robot may say in each of B states.

    Parameters
    ----------
    setting : Setting
        How they err.
    states : States
        Where they were read, and what they said.
    exact : ScenePoses
        The recorded poses.
    """

    setting: Setting
    states: States
    exact: ScenePoses

    @cached_property
    def errors(self) -> ReadingErrors:
        """How readings err: as the setting says, or each state's within radii of its own."""
        errors, own = self.setting.reading_errors, self.states.radii
        return errors if own is None else replace(errors, absolute=own)

    @property
    def observations(self) -> Floats:
        """Return what was recorded, (B, n)."""
        return self.states.observations

    @cached_property
    def drift(self) -> Drift | None:
        """What other believed poses change; None where the pose is exact."""
        return self.setting.drift(self.states.poses, self.states.scenarios, self.states.episode)

    @property
    def is_box(self) -> bool:
        """Tell whether every entry errs by itself, by a radius of its own."""
        return self.errors.is_box and self.drift is None

    @cached_property
    def shared(self) -> Indices | None:
        """The first of the inputs that may hold the same reading as each, (B, n); None where every one is another."""
        inputs, states = self.setting.inputs, self.states
        before = np.where(np.isnan(states.steps), states.rows, states.steps)
        return inputs.shared(self.observations, before) if inputs.memory else None

    @cached_property
    def repeated(self) -> Indices | None:
        """The first of the inputs that surely hold the reading of each, (B, n); None where every one is another."""
        inputs, steps = self.setting.inputs, self.states.steps
        if not (inputs.memory and (steps < inputs.memory).any()):
            return None
        return inputs.shared(self.observations, steps)

    @property
    def placed(self) -> ScenePoses:
        """Return the boxes of poses at which the robot may really be."""
        radii = self.setting.pose_radii
        if not radii.any():
            return self.exact
        return replace(self.exact, radii=np.broadcast_to(radii, self.exact.poses.shape))

    @property
    def judged(self) -> JudgedStates:
        """Return the states with what is asked of them, among what moves so near that it may count."""
        states = self.states
        judged = JudgedStates(
            self.setting.rules, self.placed, states.under_way, states.measured, states.begun
        )
        return judged.among_near()

    @property
    def bounds(self) -> tuple[Floats, Floats]:
        """Return the least and the largest number that the network may take, (B, n) each."""
        return self.setting.observed(self.observations, self.drift, self.errors)

    def pieces(self, policy: DrivenPolicy, reachable: ReachableSet) -> CommandPieces:
        """Return the commands that may be sent, where the network may give what is reachable."""
        if policy.is_plain:
            return CommandPieces.plain(reachable)
        return CommandPieces.of(policy, reachable, *self.bounds)

    def reach(
        self, policy: Policy, engine: Mapping[str, Any], wanted: Booleans, contested: Booleans
    ) -> ReachableSet:
        """Bound the commands of the wanted states, those of contested ones with more effort; the others get NaN.

        Notes
        -----
        Sound: yes. Inputs that surely hold one reading are one number, with one error.
        """
        rows, parts = [], []
        for some, first in self._alike(np.flatnonzero(wanted)):
            taken = policy if first is None else repeating(policy, tuple(first.tolist()))
            kept = slice(None) if first is None else np.unique(first)
            for these, thorough in self._by_effort(some, contested):
                rows.append(these)
                parts.append(self._reach(taken, these, kept, engine, thorough))
        found = ReachableSet.join(parts)
        if len(parts) > 1:
            found = found.rows(np.argsort(np.concatenate(rows), kind="stable"))
        return found if wanted.all() else found.spread(wanted)

    def _reach(
        self,
        policy: Any,
        rows: Indices,
        kept: Indices | slice,
        engine: Mapping[str, Any],
        thorough: bool,
    ) -> ReachableSet:
        """Bound the commands of a policy that takes some of the inputs, over what these may be in some states."""
        if self.is_box or not rows.size:
            radii = self.errors.rows(rows).absolute
            centre, radii = self.setting.uncertain(self.observations[rows], radii)
            return reach(policy, centre[:, kept], radii[..., kept], **engine)
        sets = self._sets(rows)
        sets = sets if isinstance(kept, slice) else sets.among(kept)
        return reach_observed(policy, sets, thorough=thorough, **engine)

    def _alike(self, rows: Indices) -> Iterator[tuple[Indices, Indices | None]]:
        """Give the states in which the same inputs hold one reading, with the first input of each reading, (n,)."""
        if self.repeated is None or not rows.size:
            yield rows, None
            return
        patterns, which = np.unique(self.repeated[rows], axis=0, return_inverse=True)
        for number, first in enumerate(patterns):
            yield rows[which.reshape(-1) == number], first

    def _by_effort(self, rows: Indices, contested: Booleans) -> Iterator[tuple[Indices, bool]]:
        """Give the contested ones of some states, and the others, where these are bounded with less effort."""
        if self.is_box or not rows.size:
            yield rows, True
            return
        for thorough in (True, False):
            some = rows[contested[rows] == thorough]
            if some.size:
                yield some, thorough

    def search(
        self,
        policy: DrivenPolicy,
        judged: JudgedStates,
        doubtful: Indices,
        commands: tuple[Floats, Floats],
        seed: int,
    ) -> Witnesses:
        """Look for counterexamples in some states, within bounds of the commands, (B, A) each.

        Notes
        -----
        Sound: yes, as `search_witnesses`; where errors are no box, each is one that `explain` explains.
        """
        inputs = self.setting.inputs
        if not len(doubtful) and not self.errors.scans:
            return Witnesses.none(self.observations.shape[1], commands[0].shape[1])
        if self.is_box and judged.observing.radii is None:
            box = Box(*inputs.box(self.observations, self.errors.absolute, within=True))
            return search_witnesses(
                policy, judged, doubtful, self.observations, box, *commands, seed=seed, shared=self.shared
            )
        if judged.observing.radii is None and not self.errors.scans:
            sets = AdmissibleSets(self.errors, self.observations)
            found = search_witnesses(
                policy, judged, doubtful, self.observations, sets, *commands, seed=seed, shared=self.shared
            )
            return self._explained(found, found.state, np.zeros_like(found.observation))
        return self._search_poses(policy, judged, doubtful, commands, seed)

    def _sets(self, rows: Indices) -> Any:
        drift = None if self.drift is None else self.drift.select(rows)
        return self.errors.rows(rows).sets(self.observations[rows], drift)

    def _search_poses(
        self,
        policy: DrivenPolicy,
        judged: JudgedStates,
        doubtful: Indices,
        commands: tuple[Floats, Floats],
        seed: int,
    ) -> Witnesses:
        """Search from some true poses of each box, with some believed ones."""
        if not len(doubtful):
            turn, passed = self._scans(RowChance(seed, self.observations[:0]))
            none = Witnesses.none(self.observations.shape[1], commands[0].shape[1])
            return replace(none, turn=turn, passed=passed)
        chance = RowChance(seed, self.states.poses[doubtful], self.observations[doubtful])
        rows = np.repeat(doubtful, _BELIEFS)
        recorded, radii = self.states.poses[rows], _WITHIN * self.setting.pose_radii
        true, believed = recorded.copy(), recorded.copy()
        worst = self._worst_corners(judged.select(doubtful), commands, doubtful)
        turn, passed = self._scans(chance)
        for number in range(1, _BELIEFS):
            true[number::_BELIEFS] += radii * worst
            if number > 1:
                corners = _CORNERS[(len(_CORNERS) * chance.random(1)[:, 0]).astype(int)]
                believed[number::_BELIEFS] += radii * corners
        drifted = self._drifted(rows, true, believed, turn, passed)
        sets = AdmissibleSets(self.errors.rows(rows), self.observations[rows], drifted)
        seen = sets.nearest(sets.recorded_inputs).astype(np.float32).astype(np.float64)
        some = judged.select(rows)
        some = replace(some, observing=self._really(some.observing, rows, true)).among_near()
        found = search_witnesses(
            policy, some, np.arange(len(rows)), seen, sets,
            commands[0][rows], commands[1][rows], seed=seed,
            shared=None if self.shared is None else self.shared[rows],
        )  # fmt: skip
        at = found.state
        found = replace(found, start=true[at], believed=believed[at])
        if self.errors.scans:
            found = replace(found, turn=turn[at], passed=passed[at])
        found = self._explained(found, rows[found.state], drifted[found.state])
        best = np.lexsort([found.clearance, found.state])
        found = found.select(best)
        return found.select(np.unique(found.state, return_index=True)[1])

    def _really(self, observing: ScenePoses, rows: Indices, true: Floats) -> ScenePoses:
        """Return states (P,) at the poses (P, 3) where they really are, with what the LiDAR saw around those."""
        here = replace(observing, poses=true, radii=None)
        terms = self.setting.uncertainty.obstacles
        if terms.returns is None and terms.hidden is None:
            return here
        states = self.states
        movers = movers_around(
            self.setting,
            states.scenarios,
            true,
            states.episode[rows],
            states.observations[rows],
            states.people[rows],
        )
        return replace(here, movers=()).among(movers)

    def _worst_corners(self, judged: JudgedStates, commands: tuple[Floats, Floats], rows: Indices) -> Floats:
        """Return from which corner of its box the middle command of each state comes nearest, (D, 3) signs."""
        radii = _WITHIN * self.setting.pose_radii
        middle = judged.rules.clip(0.5 * (commands[0][rows] + commands[1][rows]))[:, None]
        clearances = []
        for corner in _CORNERS:
            here = replace(judged.observing, poses=judged.observing.poses + radii * corner, radii=None)
            clearances.append(replace(judged, observing=here).closest_approach(middle)[0][:, 0])
        return np.asarray(_CORNERS[np.argmin(clearances, axis=0)])

    def _scans(self, chance: RowChance) -> tuple[Floats, Booleans]:
        """Return turns (P, T) of scans and which bins pass what is thin, (P, n), for every belief of D states.

        The first of each are none, the others ends of the model.
        """
        limits = _WITHIN * np.array([scan.angle for scan in self.errors.scans])
        count, size = len(chance), self.errors.inputs.size
        turn = np.zeros((count, _BELIEFS, len(limits)))
        passed = np.zeros((count, _BELIEFS, size), dtype=bool)
        signs = chance.random((_BELIEFS - 1) * len(limits)).reshape(turn[:, 1:].shape) < 0.5
        turn[:, 1:] = np.where(signs, -limits, limits)
        turn[:, 2] = -turn[:, 1]
        if self.errors.passes:
            passed[:, 2] = True
            passed[:, 3] = chance.random(size) < 0.5
        rows = count * _BELIEFS
        return turn.reshape(rows, len(limits)), passed.reshape(rows, passed.shape[2])

    def _drifted(
        self, rows: Indices, true: Floats, believed: Floats, turn: Floats, passed: Booleans
    ) -> Floats:
        """Return by how much readings (P, n) change: where the robot believes other poses, and where its scan errs."""
        scene, setting, scenarios = self.states.episode[rows], self.setting, self.states.scenarios
        found = np.zeros((len(rows), setting.spec.inputs.size))
        if self.drift is None:
            return found
        if setting.believes:
            goals = setting.goals(scenarios)[scene]
            found += setting.drifted(self.exact.still, scene, self.states.poses[rows], believed, goals)
        return found + changed_scans(setting, scenarios, scene, true, turn, passed)

    def _explained(self, found: Witnesses, state: Indices, drifted: Floats) -> Witnesses:
        """Return the counterexamples that errors within their bounds explain, with the states that they are of."""
        kept = [
            explain(self.errors.rows(row), self.observations[row], seen, drift) is not None
            for row, seen, drift in zip(state.tolist(), found.observation, drifted, strict=True)
        ]
        return replace(found, state=state).select(np.flatnonzero(kept))
