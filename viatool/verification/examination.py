"""What happens to every state, one block at a time: contested, reach, judge, search, and what follows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from viatool.arrays import Booleans
from viatool.loop.horizon import Crashes, Tubes
from viatool.loop.told import Told
from viatool.motion.carried import recorded_ends
from viatool.policy import Policy
from viatool.safety import Contested, JudgedStates, Judgement, ScenePoses, find_contested
from viatool.safety.moving import movers_around
from viatool.safety.pieces import CommandPieces, judge_pieces
from viatool.setting.driven import DrivenPolicy
from viatool.setting.setting import Setting
from viatool.taylor import ReachableSet, bounds_in_passing, efforts_of
from viatool.verification.clock import Clock
from viatool.verification.findings import StateFindings
from viatool.verification.horizon import HorizonExamination
from viatool.verification.observing import BlockSensors
from viatool.verification.states import States


@dataclass(frozen=True, eq=False)
class Attained:
    """What would be known of B states if no command could be sent beyond those that were found attained.

    Parameters
    ----------
    pieces : CommandPieces
        These commands: of each output the span of what is attained.
    known : ndarray
        (B,) bool: whether anything was found attained.
    judgement : Judgement
        Of these; what is not known holds.
    """

    pieces: CommandPieces
    known: Booleans
    judgement: Judgement


def judge_attained(
    policy: DrivenPolicy,
    reachable: ReachableSet,
    judged: JudgedStates,
    asked: Contested,
    sensors: BlockSensors,
) -> Attained:
    """Judge B states as if bounds were as tight as they can be: the tightest of them hold all that is attained."""
    inner = reachable.attained_alone()
    known = np.asarray(np.isfinite(inner.upper - inner.lower).all(axis=1))
    if inner.possible is not None:
        known &= inner.possible.any(axis=1)
    pieces = sensors.pieces(policy, inner)
    asked = Contested(asked.collision & known, asked.danger & known)
    return Attained(pieces, known, judge_pieces(judged, pieces, asked))


@dataclass(frozen=True, eq=False)
class StateExamination:
    """What is asked of every state: a picklable, pure function of states.

    Parameters
    ----------
    policy : Policy
        n inputs; it gives commands, of A entries.
    setting : Setting
        Where the robot drives, the meaning of n observation entries and their uncertainty, and what is to hold.
    efforts : tuple of mapping
        Settings of `viatool.reach`: the first for all states, each of the others where a verdict is open still and what
        is attained does not settle it.
    bounded_every : int
        Of the states that are not contested, the actions of every so manieth are bounded as well, to tell how wide they
        are: 1 for all, 0 for none.
    only_contested : bool
        Whether the closed loop is followed only from where it can come too near.
    seed : int
        Of the search for counterexamples.
    horizon : HorizonExamination, optional
        What is asked of the intervals that follow.
    search : bool
        Whether counterexamples are looked for.
    """

    policy: Policy
    setting: Setting
    efforts: tuple[Mapping[str, Any], ...]
    bounded_every: int
    only_contested: bool
    seed: int
    horizon: HorizonExamination | None = None
    search: bool = True

    @classmethod
    def of(
        cls,
        policy: Policy,
        setting: Setting,
        engine: Mapping[str, Any],
        *,
        only_contested: bool = False,
        seed: int = 0,
        horizon: HorizonExamination | None = None,
        search: bool = True,
        bounded_every: int = 1,
    ) -> StateExamination:
        """Return the examination of a policy that gives commands, by settings of `viatool.reach`."""
        every = 0 if only_contested or not bounds_in_passing(policy.network) else bounded_every
        efforts = efforts_of(policy, engine)
        return cls(policy, setting.bare(), efforts, every, only_contested, seed, horizon, search)

    def __call__(self, states: States) -> StateFindings:
        """Examine states block by block; what is found in a block depends on that block alone."""
        return StateFindings.join([self.examine(block) for block in states.each_block()])

    def examine(self, block: States, placed: ScenePoses | None = None) -> StateFindings:
        """Examine one block of B states, whose poses among what stands are given or built."""
        clock = Clock(noted=False)
        with clock.timed("geometry"):
            if placed is None:
                placed = self.placed(block)
            sensors = self.sensors(block, placed)
            judged = sensors.judged
            contested = find_contested(judged)
        policy = self.setting.driven(self.policy)
        wanted, reachable = contested.either | self._in_sample(block), None
        for effort in self.efforts:
            thorough = contested.either & (effort is self.efforts[-1])
            with clock.timed("reach"):
                bounded = sensors.reach(self.policy, effort, wanted, thorough)
                reachable = bounded if reachable is None else bounded.where(wanted, reachable)
                pieces = sensors.pieces(policy, reachable)
                commands = reachable if policy.is_plain else pieces.reachable(reachable)
            with clock.timed("judge"):
                judgement = judge_pieces(judged, pieces, contested)
                if effort is self.efforts[-1]:
                    break
                wanted = self._undecided(policy, reachable, judged, contested, judgement, sensors)
            if not wanted.any():
                break
        with clock.timed("search"):
            doubtful = np.flatnonzero(~judgement.safe & judged.known & self.search)
            bounds = commands.lower, commands.upper
            found = sensors.search(policy, judged, doubtful, bounds, self.seed)
            witnesses = replace(found, state=block.first + found.state)
        with clock.timed("horizon"):
            tubes, crashes = self._follow(block, placed)
        if self.horizon is None:
            del clock.seconds["horizon"]
        return StateFindings(commands, contested, judgement, witnesses, clock.seconds, tubes, crashes)

    def proves(self, states: States) -> Booleans:
        """Tell which states are proved at d_col with the last of the efforts, (B,), and nothing else.

        Notes
        -----
        Sound: yes. All are taken for contested, so that one which geometry alone settles may not be proved.
        """
        return np.concatenate([np.zeros(0, dtype=bool), *map(self._proves, states.each_block())])

    def _proves(self, block: States) -> Booleans:
        sensors, every = self.sensors(block, self.placed(block)), np.ones(len(block), dtype=bool)
        policy, effort = self.setting.driven(self.policy), self.efforts[-1]
        pieces = sensors.pieces(policy, sensors.reach(self.policy, effort, every, every))
        return judge_pieces(sensors.judged, pieces, Contested(every, ~every)).safe

    def placed(self, block: States) -> ScenePoses:
        """Return where the states of a block stand, among what stands there."""
        return ScenePoses.of(self.setting.world_map, block.scenarios, block.poses, block.episode)

    def sensors(self, block: States, placed: ScenePoses) -> BlockSensors:
        """Return what may be observed in the states of a block, among all that may be there."""
        movers = movers_around(
            self.setting, block.scenarios, block.poses, block.episode, block.observations, block.people
        )
        return BlockSensors(self.setting, block, placed.among(movers))

    def _in_sample(self, block: States) -> Booleans:
        """Tell of which of B states the actions are bounded in any case."""
        if not self.bounded_every:
            return np.zeros(len(block), dtype=bool)
        return np.asarray((block.first + np.arange(len(block))) % self.bounded_every == 0)

    def _undecided(
        self,
        policy: DrivenPolicy,
        reachable: ReachableSet,
        judged: JudgedStates,
        contested: Contested,
        judgement: Judgement,
        sensors: BlockSensors,
    ) -> Booleans:
        """Tell in which of B states tighter bounds might prove what is not proved yet.

        They might not where what is attained fails already: the tightest of bounds hold it, too. Where nothing is known
        of what is attained they might.
        """
        open_ = contested.either & ~judgement.all_hold
        asked = Contested(contested.collision & open_, contested.danger & open_)
        best = judge_attained(policy, reachable, judged, asked, sensors).judgement
        return open_ & (
            (best.safe & ~judgement.safe)
            | (best.danger & ~judgement.danger)
            | (best.sampled & ~judgement.sampled)
        )

    def _follow(self, block: States, placed: ScenePoses) -> tuple[Tubes | None, Crashes | None]:
        """Follow the closed loop from every state, or from those that can come too near if the others are left out."""
        if self.horizon is None:
            return None, None
        assert block.previous is not None
        before = block.begun if block.begun.shape[2] else np.stack([block.previous, block.previous], axis=1)
        machine = self.setting.rules.over_time
        if machine is not None:
            before = np.stack(recorded_ends(machine, block.previous, block.under_way, block.measured), axis=1)
        known = np.isfinite(before).all(axis=(1, 2))
        wanted, only_near = np.ones(len(block), dtype=bool), self.only_contested
        if only_near or not known.all():
            wanted = ~self.horizon.out_of_reach(placed, block.begun) | (known & (not only_near))
        return self.horizon.examine(
            block.scenarios,
            block.poses,
            before,
            block.episode,
            wanted,
            Told.recorded(self.setting, block.observations),
            first=block.first,
            seed=self.seed,
            commands=block.previous if block.begun.shape[2] else None,
        )
