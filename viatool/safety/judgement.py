"""Verdicts of geometry: what no command could endanger, and what the policy's own commands cannot."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.safety.motion import advance
from viatool.safety.proof import Effort, Proof, prove_clearance
from viatool.safety.rules import Rules
from viatool.safety.situations import Situations

Floats = NDArray[np.float64]
Booleans = NDArray[np.bool_]

# The paper discretises the interval "into multiple time steps"; 10 steps of 10 ms here, with both ends.
SAMPLED_FRACTIONS = np.linspace(0.0, 1.0, 11)
_COARSE = Effort(tolerance=1e-4)


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

    def waiting_proved(self, threshold: float) -> Booleans:
        """Tell in which states the footprint keeps its clearance during the dead time, (B,)."""
        if self.previous is None or not self.rules.delay:
            return np.ones(len(self), dtype=bool)
        rules, held = self.rules, self.previous
        return prove_clearance(self.situations, held, held, threshold, rules.waiting, rules.footprint).proved

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


def settle(case: Case, threshold: float) -> Booleans:
    """Tell which states no admissible command of the robot could make fail: geometry alone settles them.

    Parameters
    ----------
    case : Case
        B states.
    threshold : float
        The clearance to be exceeded, in metres.

    Returns
    -------
    ndarray
        (B,) bool. The others are contested; what lies within 0.1 mm of the line counts as contested.

    Notes ----- Sound: yes. Clearance changes by at most the way that is driven, which settles most states
    with one distance; the rest get the proof of `prove_clearance` over the full range of commands.
    """
    rules, here = case.rules, case.acting
    lower, upper = (np.broadcast_to(end, (len(case), 2)) for end in (rules.lower, rules.upper))
    away = here.scenes.clearance(here.poses[:, :2], here.scene) - rules.footprint.reach
    way = rules.manoeuvre.longest(rules.lower, rules.upper)
    near = ~(away > threshold + way + 1e-6 * here.scale)
    settled = case.waiting_proved(threshold)
    near &= settled
    settled[near] = prove_clearance(
        here.select(near), lower[near], upper[near], threshold, rules.manoeuvre, rules.footprint, _COARSE
    ).proved
    return settled


def prove(case: Case, lower: Floats, upper: Floats, threshold: float) -> Proof:
    """Decide whether every command of a box keeps its clearance at every instant.

    Parameters
    ----------
    case : Case
        B states.
    lower, upper : ndarray
        (B, 2) what the policy can command, v in m/s and omega in rad/s.
    threshold : float
        The clearance to be exceeded, in metres.

    Returns
    -------
    Proof
        Of B states, dead time included.

    Notes
    -----
    Sound: yes. The robot clips a command to its limits, which is monotone, so the clipped ends bound the box.
    """
    rules = case.rules
    proof = prove_clearance(
        case.acting, rules.clip(lower), rules.clip(upper), threshold, rules.manoeuvre, rules.footprint
    )
    waiting = case.waiting_proved(threshold)
    return Proof(proof.proved & waiting, proof.refuted | ~waiting)


def sample(case: Case, lower: Floats, upper: Floats, threshold: float) -> Booleans:
    """Judge by nine commands, as the paper does.

    Parameters
    ----------
    case : Case
        B states.
    lower, upper : ndarray
        (B, 2) what the policy can command.
    threshold : float
        The clearance to be exceeded, in metres.

    Returns
    -------
    ndarray
        (B,) bool: the lower, middle and upper value of v and omega keep their clearance at every time step.

    Notes
    -----
    Sound: no. Nine commands at some instants do not speak for the others (equation 7 of the paper).
    """
    lower, upper = case.rules.clip(lower), case.rules.clip(upper)
    steps = np.array([(v, w) for v in (0.0, 0.5, 1.0) for w in (0.0, 0.5, 1.0)])
    actions = lower[:, None] + steps * (upper - lower)[:, None]  # (B, 9, 2)
    clearances = case.clearance(case.paths(actions, SAMPLED_FRACTIONS))
    return np.asarray((clearances > threshold).all(axis=(1, 2)))
