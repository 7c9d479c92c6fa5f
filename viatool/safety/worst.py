"""The command of a set that comes nearest to something, of those at its corners and in its middle."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Floats
from viatool.safety.counterexamples import Witnesses
from viatool.safety.judged_states import JudgedStates
from viatool.safety.nearest import describe_each_nearest, describe_mover
from viatool.safety.pieces import CommandPieces
from viatool.world import Scenario, WorldMap

_TOGETHER = 2**16
"""Commands times states that are driven together, about."""


@dataclass(frozen=True, eq=False)
class ClosestCommands:
    """Of each of B states a command, and where it comes nearest.

    Parameters
    ----------
    command : ndarray
        (B, A) as the robot carries it out; NaN where none is known.
    clearance, seconds : ndarray
        (B,) metres that are left, and when.
    pose : ndarray
        (B, 3) where the robot is then.
    """

    command: Floats
    clearance: Floats
    seconds: Floats
    pose: Floats

    @classmethod
    def of(cls, judged: JudgedStates, pieces: CommandPieces) -> ClosestCommands:
        """Return the worst of the ends and middles of all pieces of B states, each from the middle of its poses.

        Notes
        -----
        Sound: as an upper bound of the least clearance; commands between may come nearer.
        """
        count, axes = len(judged), pieces.lower.shape[1]
        found = cls(
            np.full((count, axes), np.nan),
            np.full(count, np.nan),
            np.full(count, np.nan),
            np.full((count, 3), np.nan),
        )
        shares = np.array(list(product((0.0, 0.5, 1.0), repeat=axes)))
        known = np.isfinite(pieces.upper - pieces.lower).all(axis=1) & judged.known[pieces.state]
        rows = np.flatnonzero(known)
        step = max(1, _TOGETHER // (len(shares) * 65))
        for first in range(0, len(rows), step):
            some = rows[first : first + step]
            found._take(judged, pieces.state[some], pieces.lower[some], pieces.upper[some], shares)
        return found

    def met(self, found: Witnesses) -> ClosestCommands:
        """Return the same with the counterexamples of some of the states in their place."""
        other = replace(self, **{each.name: getattr(self, each.name).copy() for each in fields(self)})
        other.command[found.state], other.clearance[found.state] = found.action, found.clearance
        other.seconds[found.state], other.pose[found.state] = found.seconds, found.pose
        return other

    def _take(
        self, judged: JudgedStates, state: NDArray[np.int64], lower: Floats, upper: Floats, shares: Floats
    ) -> None:
        """Let pieces (P, A) count where they come nearer than what is known."""
        low, high = judged.rules.clip(lower)[:, None], judged.rules.clip(upper)[:, None]
        actions = low + shares * (high - low)
        clearance, seconds, poses = judged.select(state).closest_approach(actions)
        best, each = clearance.argmin(axis=1), np.arange(len(state))
        least = clearance[each, best]
        order = np.lexsort([least, state])
        first = order[np.unique(state[order], return_index=True)[1]]
        nearer = first[~(least[first] >= self.clearance[state[first]])]
        there = state[nearer]
        self.command[there] = actions[nearer, best[nearer]]
        self.clearance[there] = least[nearer]
        self.seconds[there] = seconds[nearer, best[nearer]]
        self.pose[there] = poses[nearer, best[nearer]]


def name_obstacles(
    world_map: WorldMap,
    scenarios: tuple[Scenario | None, ...],
    judged: JudgedStates,
    found: ClosestCommands,
) -> list[str]:
    """Return what each of B commands comes nearest to, in words; nothing where no command is known.

    Parameters
    ----------
    world_map, scenarios
        What stands there, and in the scenes of the states.
    judged : JudgedStates
        B states.
    found : ClosestCommands
        Their commands.
    """
    names = np.full(len(judged), "", dtype=object)
    known = np.isfinite(found.clearance)
    scene = judged.observing.scene
    for index in np.unique(scene[known]).tolist():
        rows = np.flatnonzero(known & (scene == index))
        poses = found.pose[rows]
        names[rows] = describe_each_nearest(world_map, scenarios[index], poses, judged.rules.footprint)
    rows = np.flatnonzero(known & judged.observing.met)
    if rows.size:
        moved = judged.select(rows).nearest_movers(found.command[rows])
        for row, label, origin, velocity in zip(
            rows.tolist(), moved.labels.tolist(), moved.origin, moved.velocity, strict=True
        ):
            if label:
                names[row] = describe_mover(
                    label, np.array([origin.real, origin.imag]), np.array([velocity.real, velocity.imag])
                )
    return [str(name) for name in names]
