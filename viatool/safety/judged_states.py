"""States together with what is asked of them, and the exact paths and clearances of commands."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Booleans, Floats
from viatool.safety.proof import Proof, prove_clearance
from viatool.safety.scene_poses import ScenePoses
from viatool.setting.rules import Rules

DENSE_FRACTIONS = np.linspace(0.0, 1.0, 65)


@dataclass(frozen=True, eq=False)
class JudgedStates:
    """B states and what is asked of them.

    Parameters
    ----------
    rules : Rules
        What is asked.
    observing : ScenePoses
        Where the robot stands when the policy observes.
    under_way : ndarray or None
        (B, W, 2) commands that act one after the other before the new one does, the oldest first; NaN where a
        command is not known. Needed when the rules have a dead time.
    """

    rules: Rules
    observing: ScenePoses
    under_way: Floats | None = None

    def __post_init__(self) -> None:
        expected = self.rules.dead_time.commands
        found = 0 if self.under_way is None else self.under_way.shape[1]
        if expected and found != expected:
            raise ValueError(f"{found} commands are on their way, the dead time holds {expected}")

    def __len__(self) -> int:
        """Return the number of states."""
        return len(self.observing)

    def select(self, which: NDArray[Any]) -> JudgedStates:
        """Return some of the states."""
        under_way = None if self.under_way is None else self.under_way[which]
        return replace(self, observing=self.observing.select(which), under_way=under_way)

    @cached_property
    def waits(self) -> tuple[tuple[float, ScenePoses, Floats], ...]:
        """Return the W waits before the new command acts: seconds, where each begins, and the command (B, 2) held."""
        found, here = [], self.observing
        for index, seconds in enumerate(self.rules.dead_time.durations):
            assert self.under_way is not None
            held = self.under_way[:, index]
            found.append((seconds, here, held))
            here = here.moved(self.rules.kinematics.advance(here.poses, held, seconds))
        return tuple(found)

    @cached_property
    def acting(self) -> ScenePoses:
        """Where the robot stands when the new command begins to act."""
        if not self.waits:
            return self.observing
        seconds, here, held = self.waits[-1]
        return here.moved(self.rules.kinematics.advance(here.poses, held, seconds))

    @property
    def known(self) -> Booleans:
        """Tell of which states every command on its way is known, (B,); nothing is proved of the others."""
        if not self.waits or self.under_way is None:
            return np.ones(len(self), dtype=bool)
        return np.asarray(np.isfinite(self.under_way).all(axis=(1, 2)))

    def prove_waiting(self, threshold: float) -> Proof:
        """Decide whether the footprint keeps its clearance during the dead time, for B states."""
        proof = Proof(self.known.copy(), np.zeros(len(self), dtype=bool))
        for manoeuvre, (_, here, held) in zip(self.rules.waiting, self.waits, strict=True):
            wait = prove_clearance(here, held, held, threshold, manoeuvre, self.rules.footprint)
            proof = Proof(proof.proved & wait.proved, proof.refuted | wait.refuted)
        return proof

    def paths(self, actions: Floats, fractions: Floats) -> Floats:
        """Return the poses of commands over the whole time that is judged.

        Parameters
        ----------
        actions : ndarray
            (B, A, 2) commands of each state, as the robot carries them out.
        fractions : ndarray
            (F,) of the path, and of each of the W waits before it.

        Returns
        -------
        ndarray
            (B, A, (W + 1) F, 3), the waits first.
        """
        acting = self.rules.manoeuvre.path(self.acting.poses[:, None, None], actions[:, :, None], fractions)
        waits = [
            manoeuvre.path(here.poses[:, None, None], held[:, None, None], fractions)
            for manoeuvre, (_, here, held) in zip(self.rules.waiting, self.waits, strict=True)
        ]
        return np.concatenate([*(np.broadcast_to(wait, acting.shape) for wait in waits), acting], axis=2)

    def clearance(self, paths: Floats) -> Floats:
        """Return the exact clearance of the footprint at poses (B, ..., 3), as (B, ...) metres."""
        shape, at = paths.shape[:-1], self.observing
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
        seconds = np.take_along_axis(self._clock(actions), at, axis=2)[..., 0]
        poses = np.take_along_axis(paths, at[..., None], axis=2)[:, :, 0]
        return np.take_along_axis(clearances, at, axis=2)[..., 0], seconds, poses

    def _clock(self, actions: Floats) -> Floats:
        """Return the seconds since the observation at the poses of `paths` at `DENSE_FRACTIONS`, (B, A, (W + 1) F)."""
        acting = self.rules.delay + self.rules.manoeuvre.clock(actions[:, :, None], DENSE_FRACTIONS)
        durations = np.array([seconds for seconds, _, _ in self.waits])
        begins = np.cumsum(durations) - durations
        waits = (begins[:, None] + durations[:, None] * DENSE_FRACTIONS).ravel()
        shape = (*actions.shape[:2], len(waits))
        return np.concatenate([np.broadcast_to(waits, shape), acting], axis=2)
