"""What happens to every state, one block at a time: contested, reach, judge, search, and what follows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from viatool.arrays import Booleans, Floats
from viatool.loop.horizon import Crashes, Tubes
from viatool.policy import Policy
from viatool.safety import JudgedStates, ScenePoses, Witnesses, find_contested, search_witnesses
from viatool.safety.pieces import CommandPieces, judge_pieces
from viatool.setting.admissible import AdmissibleSets, explain
from viatool.setting.setting import Setting
from viatool.taylor import ReachableSet, reach
from viatool.taylor.observed import reach_observed
from viatool.taylor.propagation import Box
from viatool.verification.clock import Clock
from viatool.verification.findings import StateFindings
from viatool.verification.horizon import HorizonExamination
from viatool.verification.states import States


@dataclass(frozen=True, eq=False)
class StateExamination:
    """What is asked of every state: a picklable, pure function of states.

    Parameters
    ----------
    policy : Policy
        n inputs; it gives commands, of A entries.
    setting : Setting
        Where the robot drives, the meaning of n observation entries and their uncertainty, and what is to hold.
    engine : mapping
        Settings of `viatool.reach`.
    only_contested : bool
        Whether only the actions of contested states are bounded.
    seed : int
        Of the search for counterexamples.
    horizon : HorizonExamination, optional
        What is asked of the intervals that follow.
    search : bool
        Whether counterexamples are looked for.
    """

    policy: Policy
    setting: Setting
    engine: Mapping[str, Any]
    only_contested: bool
    seed: int
    horizon: HorizonExamination | None = None
    search: bool = True

    def __call__(self, states: States) -> StateFindings:
        """Examine states block by block; what is found in a block depends on that block alone."""
        return StateFindings.join([self.examine(block) for block in states.each_block()])

    def examine(self, block: States) -> StateFindings:
        """Examine one block of B states."""
        clock = Clock()
        with clock.timed("geometry"):
            placed = ScenePoses.of(self.setting.world_map, block.scenarios, block.poses, block.episode)
            judged = JudgedStates(self.setting.rules, placed, block.under_way, block.measured)
            contested = find_contested(judged)
        with clock.timed("reach"):
            wanted = contested.either if self.only_contested else np.ones(len(block), dtype=bool)
            reachable = self._reach(block.observations, wanted, contested.either)
            observed = self.setting.observed(block.observations)
            policy = self.setting.driven(self.policy)
            pieces = CommandPieces.of(policy, reachable, *observed)
            commands = reachable if policy.is_plain else pieces.reachable(reachable)
        with clock.timed("judge"):
            judgement = judge_pieces(judged, pieces, contested)
        with clock.timed("search"):
            doubtful = np.flatnonzero(~judgement.safe & judged.known & self.search)
            found = search_witnesses(
                policy, judged, doubtful, block.observations, self._searched(block.observations),
                commands.lower, commands.upper, seed=(self.seed, block.first),
            )  # fmt: skip
            found = self._explained(found, block.observations)
            witnesses = replace(found, state=block.first + found.state)
        with clock.timed("horizon"):
            tubes, crashes = self._follow(block, placed)
        if self.horizon is None:
            del clock.seconds["horizon"]
        return StateFindings(commands, contested, judgement, witnesses, clock.seconds, tubes, crashes)

    def _follow(self, block: States, placed: ScenePoses) -> tuple[Tubes | None, Crashes | None]:
        """Follow the closed loop from every state, or with `only_contested` from those that can come too near."""
        if self.horizon is None:
            return None, None
        assert block.previous is not None
        known = np.isfinite(block.previous).all(axis=1)
        wanted = np.ones(len(block), dtype=bool)
        if self.only_contested or not known.all():
            wanted = ~self.horizon.out_of_reach(placed) | (known & (not self.only_contested))
        return self.horizon.examine(
            block.scenarios,
            block.poses,
            block.previous,
            block.episode,
            wanted,
            first=block.first,
            seed=self.seed,
        )

    def _reach(self, observations: Floats, wanted: Booleans, contested: Booleans) -> ReachableSet:
        """Bound the commands of the wanted states, those of contested ones with more effort; the others get NaN."""
        errors = self.setting.reading_errors
        if errors.is_box or not wanted.any():
            found = reach(self.policy, *self.setting.uncertain(observations[wanted]), **self.engine)
            return found if wanted.all() else found.spread(wanted)
        rows = [np.flatnonzero(wanted & (contested == effort)) for effort in (True, False)]
        parts = [
            reach_observed(self.policy, errors.sets(observations[some]), thorough=effort, **self.engine)
            for some, effort in zip(rows, (True, False), strict=True)
            if some.size
        ]
        return ReachableSet.join(parts).rows(np.argsort(np.concatenate(rows), kind="stable")).spread(wanted)

    def _searched(self, observations: Floats) -> Box | AdmissibleSets:
        """Return what the network may take in each state, to be searched."""
        errors = self.setting.reading_errors
        if errors.is_box:
            return Box(*self.setting.spec.inputs.box(observations, self.setting.radii, within=True))
        return AdmissibleSets(errors, observations)

    def _explained(self, found: Witnesses, observations: Floats) -> Witnesses:
        """Return the counterexamples that errors within their bounds explain: all, of errors that are a box."""
        errors = self.setting.reading_errors
        if errors.is_box:
            return found
        pairs = zip(found.state.tolist(), found.observation, strict=True)
        kept = [explain(errors, observations[state], seen) is not None for state, seen in pairs]
        return found.select(np.flatnonzero(kept))
