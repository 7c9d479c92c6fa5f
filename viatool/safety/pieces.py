"""The commands that may be sent in each state, as pieces: several boxes, of which every one has to be safe.

A policy of one command has one piece in a state: the box of its bounds. A choice has one for each command that is
possible, and a rule around the policy adds the command of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Booleans, Floats, Indices
from viatool.safety.judged_states import JudgedStates
from viatool.safety.judgement import Contested, Judgement, judge
from viatool.setting.driven import DrivenPolicy
from viatool.taylor import ReachableSet


@dataclass(frozen=True, eq=False)
class CommandPieces:
    """P boxes of commands in B states.

    Parameters
    ----------
    state : ndarray
        (P,) whose piece it is; every state has one at least.
    lower, upper : ndarray
        (P, A) ends; NaN where nothing is known.
    count : int
        B.
    """

    state: Indices
    lower: Floats
    upper: Floats
    count: int

    @classmethod
    def of(
        cls, policy: DrivenPolicy, reachable: ReachableSet, observed_lower: Floats, observed_upper: Floats
    ) -> CommandPieces:
        """Return the pieces of B states.

        Parameters
        ----------
        policy : DrivenPolicy
            What is between outputs and commands.
        reachable : ReachableSet
            Of B states; NaN where it was not asked for.
        observed_lower, observed_upper : ndarray
            (B, n) what the network may take.

        Notes
        -----
        Sound: yes. Every command that may be sent in a state lies in one of its pieces.
        """
        count = len(reachable.lower)
        lower, upper = reachable.lower, reachable.upper
        if policy.is_plain:
            return cls.plain(reachable)
        known = ~np.isnan(lower).any(axis=1)
        standing = policy.overrides.over(observed_lower, observed_upper)
        parts = [_unknown(np.flatnonzero(~known), policy)]
        own = known & standing.policy
        if policy.choice is None:
            rows = np.flatnonzero(own)
            parts.append((rows, lower[rows], upper[rows]))
        else:
            assert reachable.possible is not None
            rows, command = np.nonzero(reachable.possible & own[:, None])
            parts.append((rows, policy.choice.commands[command], policy.choice.commands[command]))
        for number, rule in enumerate(policy.overrides.rules):
            rows = np.flatnonzero(known & standing.counts[:, number])
            sent = np.broadcast_to(rule.command, (len(rows), len(rule.command)))
            parts.append((rows, sent, sent))
        state, lower, upper = (np.concatenate(column) for column in zip(*parts, strict=True))
        return cls(state, lower, upper, count)

    @classmethod
    def plain(cls, reachable: ReachableSet) -> CommandPieces:
        """Return the pieces of a policy whose output is the command that is sent: one in each of B states."""
        count = len(reachable.lower)
        return cls(np.arange(count), reachable.lower, reachable.upper, count)

    def __len__(self) -> int:
        """Return P."""
        return len(self.state)

    @classmethod
    def of_parts(
        cls, pieces: CommandPieces, whole: Indices, count: int, limits: tuple[Floats, Floats]
    ) -> CommandPieces:
        """Return the pieces of B states of which those of `pieces` are parts, part r of state ``whole[r]``.

        Commands are clipped to the ends (A,) of what the robot carries out; what is then the same is one piece. Pieces
        come in the order of their states.
        """
        lower, upper = (np.clip(end, *limits) for end in (pieces.lower, pieces.upper))
        state = whole[pieces.state]
        if len(state) == count and (state == np.arange(count)).all():
            return cls(state, lower, upper, count)
        each = np.column_stack([state.astype(np.float64), lower, upper])
        each = np.unique(each, axis=0)
        state, axes = each[:, 0].astype(np.int64), lower.shape[1]
        return cls(state, each[:, 1 : 1 + axes], each[:, 1 + axes :], count)

    @classmethod
    def join(cls, parts: Sequence[CommandPieces]) -> CommandPieces:
        """Return the pieces of states that follow each other."""
        first = np.cumsum([0, *(part.count for part in parts)])
        state = [part.state + start for part, start in zip(parts, first[:-1], strict=True)]
        lower, upper = ([getattr(part, name) for part in parts] for name in ("lower", "upper"))
        return cls(np.concatenate(state), np.concatenate(lower), np.concatenate(upper), int(first[-1]))

    def select(self, which: NDArray[Any]) -> CommandPieces:
        """Return the pieces of some of the states."""
        rows = np.arange(self.count)[which]
        place = np.full(self.count, -1)
        place[rows] = np.arange(len(rows))
        kept = place[self.state] >= 0
        return CommandPieces(place[self.state[kept]], self.lower[kept], self.upper[kept], len(rows))

    def everywhere(self, holds: Booleans) -> Booleans:
        """Tell in which states something holds for every piece, (B,), of what holds for each, (P,)."""
        found = np.zeros(self.count, dtype=bool)
        found[self.state] = True  # a state without a piece is one of which nothing is known
        np.logical_and.at(found, self.state, holds)
        return found

    def hull(self) -> tuple[Floats, Floats]:
        """Return the ends of all pieces of each state, (B, A) each; NaN where nothing is known."""
        lower = np.full((self.count, self.lower.shape[1]), np.inf)
        upper = np.full_like(lower, -np.inf)
        np.minimum.at(lower, self.state, self.lower)
        np.maximum.at(upper, self.state, self.upper)
        empty = lower > upper
        return np.where(empty, np.nan, lower), np.where(empty, np.nan, upper)

    def reachable(self, found: ReachableSet) -> ReachableSet:
        """Return the hull of the commands in the place of what the network gives, (B, A)."""
        lower, upper = self.hull()
        nothing = np.full_like(lower, np.nan)  # of what is attained, and of rounding
        return replace(
            found,
            lower=lower,
            upper=upper,
            attained_lower=nothing,
            attained_upper=nothing,
            deviation=nothing,
        )


def _unknown(rows: Indices, policy: DrivenPolicy) -> tuple[Indices, Floats, Floats]:
    """Return one piece without bounds for each state of which nothing is known."""
    axes = policy.network.output_size if policy.choice is None else policy.choice.commands.shape[1]
    nothing = np.full((len(rows), axes), np.nan)
    return rows, nothing, nothing


def judge_pieces(states: JudgedStates, pieces: CommandPieces, contested: Contested) -> Judgement:
    """Judge states by every piece of their commands; as `judge`. **Sound:** yes, a state is safe if all pieces are."""
    owner = pieces.state
    if len(owner) == pieces.count and (owner == np.arange(pieces.count)).all():
        return judge(states, pieces.lower, pieces.upper, contested)
    each = judge(
        states.select(owner),
        pieces.lower,
        pieces.upper,
        Contested(contested.collision[owner], contested.danger[owner]),
    )
    return Judgement(*(pieces.everywhere(part) for part in (each.safe, each.danger, each.sampled)))
