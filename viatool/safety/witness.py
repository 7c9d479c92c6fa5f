"""The search for counterexamples: observations within the box whose command, by the deployed program, fails."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from viatool.arrays import Booleans, Floats, Hull, Indices
from viatool.policy.network import Network
from viatool.safety.counterexamples import Witnesses
from viatool.safety.judged_states import JudgedStates
from viatool.schedule import check_time
from viatool.sets.chance import RowChance
from viatool.setting.admissible import AdmissibleSets
from viatool.setting.driven import DrivenPolicy
from viatool.taylor.attained import climb
from viatool.taylor.choices import margins
from viatool.taylor.propagation import Box

MARGIN = 1e-7
"""Metres by which a witness must fail, so that it fails again in whatever order the runtime sums."""

_INSTANTS = 20
"""Equal steps of a path, at whose ends it is looked at."""
_ROUNDS = 3
_STEPS = 4
_CONFIRMED = 6
_CHUNK = 256
_NUMBERS = 1_000_000
"""Numbers of observations from which is climbed at once."""
_AT_ONCE = 1024
"""States that are tried as they were received, and by one climb."""
_HOPEFUL = 2.0
"""Times what one step of a climb brought a state nearer that more of them may bring it."""
_STILL_HOPEFUL = 0.1
"""Times what a climb brought a state nearer that others may bring it."""
_BETWEEN = 1.5
"""Times what the corners and middles of a box of commands differ by that others of its commands may be nearer."""


class SearchablePolicy(Protocol):
    """What the search needs of a policy."""

    @property
    def network(self) -> Network:
        """The function, for gradients in float64."""

    def run(self, observations: ArrayLike, /) -> Floats:
        """Return the commands (B, A) of observations (B, n), as the deployed program computes them."""


def search_witnesses(
    policy: SearchablePolicy,
    states: JudgedStates,
    doubtful: Indices,
    observations: Floats,
    box: Box | AdmissibleSets,
    lower: Floats,
    upper: Floats,
    *,
    seed: int | Sequence[int] = 0,
    shared: Indices | None = None,
    aims: JudgedStates | None = None,
    thorough: bool = True,
    received: bool = True,
    progress: Callable[[int, int], None] | None = None,
) -> Witnesses:
    """Look for an observation within each box that makes the robot come nearer than the collision distance.

    Parameters
    ----------
    policy : Policy
        n inputs; it gives commands.
    states : JudgedStates
        N states.
    doubtful : ndarray
        (W,) the states to be searched, those that are not safe.
    observations : ndarray
        (N, n) float32 numbers that the policy received.
    box : Box or AdmissibleSets
        (N, n) what the network may take in each state.
    lower, upper : ndarray
        (N, A) bounds of the commands, which say where to aim.
    seed : int or sequence of int
        Of the random points, which those of a state alone depend on: what is found does not depend on other states.
    shared : ndarray, optional
        (N, n) the first of the inputs that hold the same reading as each, which a counterexample gives one number; by
        default every input is a reading of its own.
    aims : JudgedStates, optional
        The same states by paths that are cheaper, to aim with; what is found is confirmed in `states`.
    thorough : bool
        Whether everything is tried in every state; else only in those that one climb brought near to failing, where
        nearly all is found of what there is.
    received : bool
        Whether observations are tried as they were received; else that has been done.
    progress : callable, optional
        Called with the states that were looked at and the states in all.

    Returns
    -------
    Witnesses
        For some of the doubtful states.

    Notes
    -----
    Sound: yes, as nothing is claimed of a state without a witness, and every witness is confirmed: its
    numbers are float32 and within the box, its command comes from onnxruntime, and the exact clearance on
    its exact path is less than the distance by `MARGIN` (or 0).

    What is cheap is tried first: the observation as it was received, then one climb from there. The search aims in the
    space of commands: from the command of the box that comes nearest it takes the direction in which the clearance
    falls, follows the gradient of that combination of commands from corner to corner of the observation box, and takes
    the direction anew at the command it found.
    """
    asked = _Asked(
        policy, states, states if aims is None else aims, observations, box, (lower, upper), shared
    )
    found, left = [], []
    for some in _chunks(doubtful, _AT_ONCE):
        easy = asked.as_received(some if received else some[:0])
        found.append(easy)
        hard = asked.may_fail(np.setdiff1d(some, easy.state))
        if not _chooses(policy) and len(hard):
            climbed, hard = asked.climbed_once(hard, thorough=thorough)
            found.append(climbed)
        left.append(hard)
        if progress is not None:
            progress(sum(map(len, left)), len(doubtful))
    for some in _chunks(np.concatenate([doubtful[:0], *left]), _CHUNK):
        found.append(asked.everywhere(some, seed))
    return Witnesses.join(found, observations.shape[1], lower.shape[1])


def _chunks(rows: Indices, size: int) -> Iterator[Indices]:
    """Go through rows, so many at once, as long as there is time."""
    for start in range(0, len(rows), size):
        check_time()
        yield rows[start : start + size]


@dataclass(frozen=True, eq=False)
class _Asked:
    """What is asked of N states, of which some are looked at more closely than others."""

    policy: SearchablePolicy
    states: JudgedStates
    aims: JudgedStates
    observations: Floats
    box: Box | AdmissibleSets
    commands: Hull
    shared: Indices | None

    def as_received(self, rows: Indices) -> Witnesses:
        """Run observations as they were received, (R, n)."""
        return self._confirmed(self.observations[rows][:, None], rows)

    def may_fail(self, rows: Indices) -> Indices:
        """Return those of R states that may fail by what else is observed."""
        ends = self.commands[0][rows], self.commands[1][rows]
        return rows[_may_fail(self.policy, self.states.select(rows), self.aims.select(rows), *ends)]

    def climbed_once(self, rows: Indices, *, thorough: bool) -> tuple[Witnesses, Indices]:
        """Try one climb in each of R states, and return those in which others are to be tried."""
        points, hopeful = self._search(rows).once()
        found = self._confirmed(self._within(points[:, None], rows), rows)
        return found, np.setdiff1d(rows if thorough else rows[hopeful], found.state)

    def everywhere(self, rows: Indices, seed: int | Sequence[int]) -> Witnesses:
        """Try everything in R states."""
        observations, box = self.observations[rows], self.box.rows(rows)
        chance = RowChance(seed, self.states.select(rows).observing.poses, observations)
        if _chooses(self.policy):
            points = _towards_each_choice(self.policy.network, observations, box, chance)
        else:
            points = self._search(rows).candidates(chance)
        return self._confirmed(self._within(_around_rules(self.policy, points, box), rows), rows)

    def _search(self, rows: Indices) -> _Search:
        lower, upper = self.commands[0][rows], self.commands[1][rows]
        return _Search(
            self.policy.network, self.aims.select(rows), self.observations[rows], self.box.rows(rows),
            0.5 * (lower + upper), np.maximum(0.5 * (upper - lower), 1e-9),
        )  # fmt: skip

    def _within(self, points: Floats, rows: Indices) -> Floats:
        """Return points (R, K, n) as sensors may give them and programs receive them."""
        if self.shared is not None:
            points = _of_one_reading(points, self.shared[rows])
        return _received(points, self.observations[rows], self.box.rows(rows))

    def _confirmed(self, points: Floats, rows: Indices) -> Witnesses:
        """Return which of R states fail by one of their points (R, K, n), counted among all."""
        found = confirm(self.policy, self.states.select(rows), points)
        return replace(found, state=rows[found.state])


def _chooses(policy: SearchablePolicy) -> bool:
    """Tell whether commands are chosen from a table, so that they have no gradient."""
    return isinstance(policy, DrivenPolicy) and policy.choice is not None


def _may_fail(
    policy: SearchablePolicy, states: JudgedStates, aimed: JudgedStates, lower: Floats, upper: Floats
) -> Booleans:
    """Tell in which states a search is not in vain, (B,): some command of the box comes about as near as it takes.

    A proof bounds more than any run does, the more so where motors and moving things leave much open: most of what is
    not proved then fails by no command at all. By how much commands of the box differ is told by the paths that are
    aimed with. Where a choice is made commands are no box, and nothing is told.
    """
    if _chooses(policy):
        return np.ones(len(states), dtype=bool)
    rules = states.rules
    left = aimed.least_clearance(rules.clip(_levels(lower, upper)), _INSTANTS)
    middle = states.least_clearance(rules.clip(0.5 * (lower + upper))[:, None], _INSTANTS)[:, 0]
    spread = left.max(axis=1) - left.min(axis=1)
    return np.asarray(~(middle - _BETWEEN * spread >= rules.clearance.collision))


def _levels(lower: Floats, upper: Floats) -> Floats:
    """Return the corners and middles of boxes of commands, (B, 3^A, A)."""
    shares = np.array(list(product((0.0, 0.5, 1.0), repeat=lower.shape[1])))
    return np.asarray(lower[:, None] + shares * (upper - lower)[:, None])


def _of_one_reading(points: Floats, shared: Indices) -> Floats:
    """Give all inputs of points (B, K, n) that hold one reading one number: that of their first, or of their last."""
    batch, _, size = points.shape
    last = np.broadcast_to(np.arange(size), shared.shape).copy()
    state = np.broadcast_to(np.arange(batch)[:, None], shared.shape)
    np.maximum.at(last, (state, shared), np.arange(size))
    last = np.take_along_axis(last, shared, axis=1)
    sources = (np.broadcast_to(column[:, None], points.shape) for column in (shared, last))
    return np.concatenate([np.take_along_axis(points, source, axis=2) for source in sources], axis=1)


def _around_rules(policy: SearchablePolicy, points: Floats, box: Box | AdmissibleSets) -> Floats:
    """Return observations (B, K, n), and each where rules around the network apply and where they do not."""
    if not isinstance(policy, DrivenPolicy) or not policy.overrides:
        return points
    count, each, size = points.shape
    lower, upper = (np.repeat(end, each, axis=0) for end in (box.lower, box.upper))
    pushed = policy.overrides.around(points.reshape(-1, size), lower, upper)
    if isinstance(box, AdmissibleSets):
        repeated = box.rows(np.repeat(np.arange(count), each))
        pushed = [repeated.nearest(points) for points in pushed]
    return np.concatenate([points, *(points.reshape(count, each, size) for points in pushed)], axis=1)


def _received(points: Floats, nominal: Floats, box: Box | AdmissibleSets) -> Floats:
    """Return points (B, K, n) of sets as the float32 numbers that a program receives."""
    if isinstance(box, Box):
        return to_float32_within(points, nominal, box)
    return points.astype(np.float32).astype(np.float64)


def _towards_each_choice(
    network: Network, observations: Floats, box: Box | AdmissibleSets, chance: RowChance
) -> Floats:
    """Return for each of O choices observations (B, K, n) that rather select it."""
    corners = box.random_corner(chance)
    found = [observations]
    for seed in np.eye(network.output_size):
        wanted = np.broadcast_to(seed, (len(observations), len(seed)))
        found += [
            climb(margins(network), box, wanted, start, steps=_STEPS)[0] for start in (observations, corners)
        ]
    return np.stack(found, axis=1)


def to_float32_within(points: Floats, nominal: Floats, box: Box) -> Floats:
    """Round points to float32 numbers that lie within boxes in real arithmetic.

    Parameters
    ----------
    points : ndarray
        (B, K, n).
    nominal : ndarray
        (B, n) float32 numbers that are attained.
    box : Box
        (B, n) ends, rounded to float64.

    Returns
    -------
    ndarray
        (B, K, n) float64 holding float32 numbers; the nominal one where a box is too thin to hold another.
    """
    low, high = np.nextafter(box.lower, np.inf)[:, None], np.nextafter(box.upper, -np.inf)[:, None]
    rounded = np.clip(points, low, high).astype(np.float32)
    outside_high, outside_low = rounded > high, rounded < low
    rounded = np.where(outside_high, np.nextafter(rounded, np.float32(-np.inf)), rounded)
    rounded = np.where(outside_low, np.nextafter(rounded, np.float32(np.inf)), rounded)
    inside = (rounded >= low) & (rounded <= high)
    return np.where(inside, rounded.astype(np.float64), nominal[:, None])


def confirm(policy: SearchablePolicy, states: JudgedStates, candidates: Floats) -> Witnesses:
    """Run candidates through the deployed program and keep, for each state, the one that fails most.

    Parameters
    ----------
    policy, states
        As in `search_witnesses`.
    candidates : ndarray
        (B, K, n) float32 numbers within the boxes.

    Returns
    -------
    Witnesses
        At most one for each state.
    """
    count, each, size = candidates.shape
    if not count:
        return Witnesses.none(size, len(states.rules.lower))
    raw = np.asarray(policy.run(candidates.reshape(-1, size)), dtype=np.float64)
    actions = states.rules.clip(raw).reshape(count, each, -1)
    clearances, seconds, poses = states.closest_approach(actions)
    rows, best = np.arange(count), clearances.argmin(axis=1)
    left = clearances[rows, best]
    failed = (left < states.rules.clearance.collision - MARGIN - states.margin) | (left <= 0.0)
    rows, best = rows[failed], best[failed]
    here = states.observing.poses[rows]
    picked: list[Any] = [array[rows, best] for array in (candidates, actions, seconds, poses, clearances)]
    if not states.observing.movers:
        return Witnesses.among_what_stands(rows, *picked, here, here)
    moved = states.select(rows).nearest_movers(picked[1])
    return Witnesses.among_what_stands(rows, *picked, here, here).among(moved)


@dataclass(frozen=True, eq=False)
class _Search:
    """The search in float64, for a chunk of B states whose commands lie around centres (B, A), within radii."""

    network: Network
    states: JudgedStates
    observations: Floats
    box: Box | AdmissibleSets
    centre: Floats
    radius: Floats

    def of(self, rows: Indices) -> _Search:
        """Return that of some of the states."""
        return _Search(
            self.network, self.states.select(rows), self.observations[rows], self.box.rows(rows), self.centre[rows],
            self.radius[rows],
        )  # fmt: skip

    def once(self) -> tuple[Floats, Booleans]:
        """Return the observation to which one climb leads, (B, n), and where more may make the state fail, (B,).

        After its first step it goes on only where it came near to failing.
        """
        direction = self._descent(self._nearest_of_box())
        points = np.stack([self.observations, self._climb(self.observations, direction, steps=1)], axis=1)
        before, after = self._clearances(self._actions(points)).T
        limit = self.states.rules.clearance.collision
        on = np.flatnonzero(after - limit <= _HOPEFUL * (before - after))
        if len(on):
            further = self.of(on)
            points[on, 1] = further._climb(further.observations, direction[on])
            after[on] = further._clearances(further._actions(points[on, 1:]))[:, 0]
        return points[:, 1], after - limit <= _STILL_HOPEFUL * (before - after)

    def candidates(self, chance: RowChance) -> Floats:
        """Return the most promising observations (B, K, n) of every state."""
        aim = self._nearest_of_box()
        found = [self.observations]
        starts = [self.observations, *(self.box.random_corner(chance) for _ in range(2))]
        for _ in range(_ROUNDS):
            directions = [self._descent(aim), *self._diagonals(aim)]
            found += self._climb_each(starts, directions)
            points = np.stack(found, axis=1)
            actions = self._actions(points)
            nearest = self._clearances(actions).argsort(axis=1)[:, :_CONFIRMED]
            rows = np.arange(len(points))
            found = list(np.moveaxis(points[rows[:, None], nearest], 1, 0))
            starts, aim = [found[0]], actions[rows, nearest[:, 0]]
        return np.stack(found, axis=1)

    def _nearest_of_box(self) -> Floats:
        """Return the command of the action box, among its corners and middles, that comes nearest, (B, A)."""
        actions = _levels(self.centre - self.radius, self.centre + self.radius)
        return np.asarray(actions[np.arange(len(actions)), self._clearances(actions).argmin(axis=1)])

    def _descent(self, action: Floats) -> Floats:
        """Return the direction in the space of commands in which the clearance falls fastest, (B, A)."""
        axes = np.eye(action.shape[1])
        steps = np.concatenate([axes, -axes]) * 0.5 * self.radius[:, None]
        ahead, behind = np.split(self._clearances(action[:, None] + steps), 2, axis=1)
        return np.asarray((behind - ahead) / self.radius)

    def _diagonals(self, action: Floats) -> list[Floats]:
        """Return the direction from the middle of the box to a command, and its components."""
        outward = np.sign(action - self.centre) / self.radius
        return [outward, *(outward * axis for axis in np.eye(outward.shape[1]))]

    def _climb(self, start: Floats, direction: Floats, *, steps: int = _STEPS) -> Floats:
        """Go from corner to corner along the gradient of a combination of commands, (B, n)."""
        return climb(self.network, self.box, direction, start, steps=steps)[0]

    def _climb_each(self, starts: Sequence[Floats], directions: Sequence[Floats]) -> list[Floats]:
        """Climb from every start (B, n) in every direction (B, A), as many at once as fit."""
        rows, found = np.arange(len(self.observations)), []
        pairs = list(product(starts, directions))
        step = max(1, _NUMBERS // self.observations.size)
        for some in (pairs[first : first + step] for first in range(0, len(pairs), step)):
            start, direction = (np.concatenate(side) for side in zip(*some, strict=True))
            boxes = self.box.rows(np.tile(rows, len(some)))
            reached = climb(self.network, boxes, direction, start, steps=_STEPS)[0]
            found += np.split(reached, len(some))
        return found

    def _actions(self, points: Floats) -> Floats:
        flat = self.network(points.reshape(-1, points.shape[-1]))
        return flat.reshape(*points.shape[:-1], flat.shape[1])

    def _clearances(self, actions: Floats) -> Floats:
        """Return the least clearance (B, K) on the paths of commands (B, K, A)."""
        return self.states.least_clearance(self.states.rules.clip(actions), _INSTANTS)
