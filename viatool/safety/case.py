"""States together with what is asked of them, and the exact paths and clearances of commands."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Floats
from viatool.motion.arcs import advance
from viatool.safety.proof import Proof, prove_clearance
from viatool.safety.situations import Situations
from viatool.setting.rules import Rules

DENSE_FRACTIONS = np.linspace(0.0, 1.0, 65)


@dataclass(frozen=True, eq=False)
class Case:
    """B states and what is asked of them.

    Parameters
    ----------
    rules : Rules
        What is asked.
    situations : Situations
        Where the robot stands when the policy observes.
    previous : ndarray or None
        (B, 2) commands that go on for the dead time; needed when the rules have a delay.
    """

    rules: Rules
    situations: Situations
    previous: Floats | None = None

    def __len__(self) -> int:
        """Return the number of states."""
        return len(self.situations)

    def select(self, which: NDArray[Any]) -> Case:
        """Return some of the states."""
        previous = None if self.previous is None else self.previous[which]
        return replace(self, situations=self.situations.select(which), previous=previous)

    @cached_property
    def acting(self) -> Situations:
        """Where the robot stands when the new command begins to act."""
        if self.previous is None or not self.rules.delay:
            return self.situations
        poses = advance(self.situations.poses, self.previous, self.rules.delay)
        return self.situations.moved(poses)

    def prove_waiting(self, threshold: float) -> Proof:
        """Decide whether the footprint keeps its clearance during the dead time, for B states."""
        if self.previous is None or not self.rules.delay:
            return Proof(np.ones(len(self), dtype=bool), np.zeros(len(self), dtype=bool))
        rules, held = self.rules, self.previous
        return prove_clearance(self.situations, held, held, threshold, rules.waiting, rules.footprint)

    def paths(self, actions: Floats, fractions: Floats) -> Floats:
        """Return the poses of commands over the whole time that is judged.

        Parameters
        ----------
        actions : ndarray
            (B, A, 2) commands of each state, as the robot carries them out.
        fractions : ndarray
            (F,) of the path, and of the dead time if there is one.

        Returns
        -------
        ndarray
            (B, A, F, 3), or (B, A, 2 F, 3) with the dead time first.
        """
        acting = self.rules.manoeuvre.path(self.acting.poses[:, None, None], actions[:, :, None], fractions)
        if self.previous is None or not self.rules.delay:
            return acting
        waiting = self.rules.waiting.path(
            self.situations.poses[:, None, None], self.previous[:, None, None], fractions
        )
        return np.concatenate([np.broadcast_to(waiting, acting.shape), acting], axis=2)

    def clearance(self, paths: Floats) -> Floats:
        """Return the exact clearance of the footprint at poses (B, ..., 3), as (B, ...) metres."""
        shape, at = paths.shape[:-1], self.situations
        each = int(np.prod(shape[1:], dtype=np.int64))
        found = at.scenes.footprint_clearance(
            paths.reshape(-1, 3), self.rules.footprint, np.repeat(at.scene, each)
        )
        return np.asarray(found.reshape(shape))

    def closest_approach(self, actions: Floats) -> tuple[Floats, Floats, Floats]:
        """Find where commands come nearest to an obstacle.

        Parameters
        ----------
        actions : ndarray
            (B, A, 2) commands, as the robot carries them out.

        Returns
        -------
        tuple of ndarray
            Clearance (B, A) in metres, seconds since the observation (B, A), and pose (B, A, 3) at that
            instant.

        Notes
        -----
        Sound: as an upper bound of the least clearance, under rounding only; the instant is found by
        sampling.
        """
        paths = self.paths(actions, DENSE_FRACTIONS)
        clearances = self.clearance(paths)
        at = clearances.argmin(axis=2)[..., None]
        waits = paths.shape[2] - len(DENSE_FRACTIONS)
        acts_at = DENSE_FRACTIONS[np.maximum(at[..., 0] - waits, 0)]
        seconds = np.where(
            at[..., 0] < waits,
            self.rules.delay * DENSE_FRACTIONS[np.minimum(at[..., 0], len(DENSE_FRACTIONS) - 1)],
            (self.rules.delay if waits else 0.0) + self.rules.manoeuvre.clock(actions, acts_at),
        )
        poses = np.take_along_axis(paths, at[..., None], axis=2)[:, :, 0]
        return np.take_along_axis(clearances, at, axis=2)[..., 0], seconds, poses
