"""Verdicts of geometry: what no command could endanger, and what the policy's own commands cannot."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from viatool.arrays import Booleans, Floats
from viatool.safety.judged_states import JudgedStates
from viatool.safety.proof import Proof, ProofEffort, prove_clearance
from viatool.sets.bounds import require_ordered
from viatool.setting.criteria import SAMPLED

_COARSE = ProofEffort(tolerance=1e-4)
_CHUNK = 4096  # states that are judged together, so that memory stays flat


@dataclass(frozen=True, eq=False)
class Contested:
    """Which of N states some admissible command of the robot could make fail.

    Parameters
    ----------
    collision, danger : ndarray
        (N,) bool: by coming as near as d_col, and as near as d_danger.
    """

    collision: Booleans
    danger: Booleans

    @property
    def either(self) -> Booleans:
        """Return the states whose commands have to be known, (N,)."""
        return self.collision | self.danger


@dataclass(frozen=True, eq=False)
class Judgement:
    """What holds in N states.

    Parameters
    ----------
    safe, danger : ndarray
        (N,) bool: the criterion holds at d_col, and at d_danger.
    sampled : ndarray
        (N,) bool: the paper's nine commands pass at d_col.
    """

    safe: Booleans
    danger: Booleans
    sampled: Booleans

    def __post_init__(self) -> None:
        if any(part.dtype != np.bool_ for part in (self.safe, self.danger, self.sampled)):
            raise TypeError("verdicts are booleans: a NaN would count as true")

    @property
    def all_hold(self) -> Booleans:
        """Return in which states nothing is left open, (N,): tighter bounds of commands would tell nothing new."""
        return self.safe & self.danger & self.sampled


def find_contested(states: JudgedStates) -> Contested:
    """Return which states geometry alone does not settle, at both distances.

    What is contested at the smaller distance is at the larger one.
    """
    clearance = states.rules.clearance
    contested = ~states.out_of_reach
    wider, rows = contested.copy(), np.flatnonzero(contested)
    if rows.size:
        some = states.select(rows)
        contested[rows] = _contested(some, clearance.collision)
        left = np.flatnonzero(~contested[rows])
        wider[rows[left]] = _contested(some.select(left), clearance.danger)
    return Contested(contested, wider)


def judge(states: JudgedStates, lower: Floats, upper: Floats, contested: Contested) -> Judgement:
    """Judge states by the criterion of their rules, at both distances.

    Parameters
    ----------
    states : JudgedStates
        N states.
    lower, upper : ndarray
        (N, 2) what the policy can command. Only those of contested states are read: all others may be NaN, as where
        actions were not bounded because geometry alone settles a state.
    contested : Contested
        The states that are looked at; all others are safe.

    Returns
    -------
    Judgement
        Of N states.

    Raises
    ------
    BoundsError
        If the bounds of a contested state are NaN or crossed.

    Notes
    -----
    Sound: `safe` and `danger` by `prove`, unless the criterion samples; `sampled` proves nothing.
    """
    clearance, asked = states.rules.clearance, states.rules.asked
    nine = replace(states, rules=states.rules.sampled)
    sampled = _hold(sample, nine, lower, upper, clearance.collision, contested.collision)
    test = _proved if asked.proves else sample
    safe = (
        sampled
        if asked is SAMPLED
        else _hold(test, states, lower, upper, clearance.collision, contested.collision)
    )
    danger = _hold(test, states, lower, upper, clearance.danger, contested.danger)
    return Judgement(safe, danger, sampled)


def _hold(
    test: Callable[[JudgedStates, Floats, Floats, float], Booleans],
    states: JudgedStates,
    lower: Floats,
    upper: Floats,
    distance: float,
    contested: Booleans,
) -> Booleans:
    """Return (N,) where a test holds, looking at the contested states alone; of no other does it have to."""
    holds = ~contested
    if not contested.any():
        return holds
    rows = np.flatnonzero(contested & states.provable)
    for start in range(0, len(rows), _CHUNK):
        some = rows[start : start + _CHUNK]
        holds[some] = test(states.select(some), lower[some], upper[some], distance)
    return holds


def _proved(states: JudgedStates, lower: Floats, upper: Floats, distance: float) -> Booleans:
    return prove(states, lower, upper, distance).proved


def _contested(states: JudgedStates, distance: float) -> Booleans:
    """Return (N,) which states are not settled, looking at some at a time."""
    contested, rows = np.ones(len(states), dtype=bool), np.flatnonzero(states.provable)
    for start in range(0, len(rows), _CHUNK):
        some = rows[start : start + _CHUNK]
        contested[some] = ~settle(states.select(some), distance)
    return contested


def settle(states: JudgedStates, threshold: float) -> Booleans:
    """Tell which states no admissible command of the robot could make fail: geometry alone settles them.

    Parameters
    ----------
    states : JudgedStates
        B states.
    threshold : float
        The clearance to be exceeded, in metres.

    Returns
    -------
    ndarray
        (B,) bool. The others are contested; what lies within 0.1 mm of the line counts as contested.

    Notes
    -----
    Sound: yes. Clearance changes by at most the way that is driven, which settles most states with one
    distance; the rest get the proof of `prove_clearance` over the full range of commands.
    """
    rules, motion = states.rules, states.motion
    here = states.acting if motion is None else states.observing
    lower, upper = states.boxes(
        *(np.broadcast_to(end, (len(states), len(end))) for end in (rules.lower, rules.upper))
    )
    if motion is None:
        manoeuvre, end = rules.manoeuvre, np.ones(len(states))
        way: Floats | float = manoeuvre.longest(lower, upper)
        latest = manoeuvre.counted_between(lower, lower, upper, end, end)[1]
        settled = states.prove_waiting(threshold).proved
    else:
        way, latest = motion.longest, motion.stands
        settled = np.ones(len(states), dtype=bool)
    away = here.clearance(latest)[0] - rules.footprint.reach
    near = ~(away > threshold + way + here.extent + 1e-6 * (here.scale + here.fastest * latest))
    if here.movers and motion is None:  # which most often make some extreme command fail when its path ends
        moving = near & here.met
        settled[moving] &= ~_fails_at_the_end(states.select(moving), threshold)
    near &= settled
    if not near.any():
        return settled
    some = states.select(near)
    settled[near] = prove_clearance(
        here.select(near),
        lower[near],
        upper[near],
        threshold,
        some.motion or rules.manoeuvre,
        rules.footprint,
        _COARSE,
    ).proved
    return settled


def _fails_at_the_end(states: JudgedStates, threshold: float) -> Booleans:
    """Tell in which states some of the robot's extreme commands come too near where their paths end, (B,)."""
    lower, upper = states.rules.lower, states.rules.upper
    fails = np.zeros(len(states), dtype=bool)
    for shares in product((1.0, 0.0, 0.5), repeat=len(lower)):
        rows = np.flatnonzero(~fails)
        actions = np.broadcast_to(lower + np.array(shares) * (upper - lower), (len(rows), 1, len(lower)))
        fails[rows] = (states.select(rows).clearance(actions, np.ones(1)) < threshold).any(axis=(1, 2))
    return fails


def prove(
    states: JudgedStates, lower: Floats, upper: Floats, threshold: float, effort: ProofEffort | None = None
) -> Proof:
    """Decide whether every command of a box keeps its clearance at every instant.

    Parameters
    ----------
    states : JudgedStates
        B states.
    lower, upper : ndarray
        (B, A) what the policy can command.
    threshold : float
        The clearance to be exceeded, in metres.
    effort : ProofEffort, optional
        Where to stop.

    Returns
    -------
    Proof
        Of B states, dead time included.

    Notes
    -----
    Sound: yes. The robot clips a command to its limits, which is monotone, so the clipped ends bound the box.
    """
    rules = states.rules
    require_ordered("commands", lower, upper)  # before they are clipped, which would hide it
    if states.motion is not None:
        return prove_clearance(
            states.observing,
            rules.clip(lower),
            rules.clip(upper),
            threshold,
            states.motion,
            rules.footprint,
            effort,
        )
    held = states.boxes(rules.clip(lower), rules.clip(upper))
    proof = prove_clearance(states.acting, *held, threshold, rules.manoeuvre, rules.footprint, effort)
    waiting = states.prove_waiting(threshold)
    return Proof(proof.proved & waiting.proved, proof.refuted | waiting.refuted)


def sample(states: JudgedStates, lower: Floats, upper: Floats, threshold: float) -> Booleans:
    """Judge by the commands and instants that the criterion samples: by nine commands, as the paper does.

    Parameters
    ----------
    states : JudgedStates
        B states.
    lower, upper : ndarray
        (B, A) what the policy can command.
    threshold : float
        The clearance to be exceeded, in metres.

    Returns
    -------
    ndarray
        (B,) bool: every combination of the lower, middle and upper value of each axis keeps its clearance at every
        time step.

    Notes
    -----
    Sound: no. Nine commands at some instants do not speak for the others (equation 7 of the paper).
    """
    require_ordered("commands", lower, upper)
    lower, upper = states.rules.clip(lower), states.rules.clip(upper)
    asked = states.rules.asked
    shares = np.array(list(product(asked.levels, repeat=lower.shape[1])))  # (9, 2) of two axes
    actions = lower[:, None] + shares * (upper - lower)[:, None]  # (B, 9, A)
    clearances = states.clearance(actions, np.array(asked.instants))
    return np.asarray((clearances > threshold).all(axis=(1, 2)))
