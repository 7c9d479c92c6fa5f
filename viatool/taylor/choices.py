"""Which of several outputs may be the largest: what a policy may choose anywhere in a box of observations.

A command is excluded where some other output is larger, and which one that is may change over the box. So of every
command the margin is bounded from above, ``min over j of (output k - output j)``, as one more network behind the
policy's own: what the outputs have in common cancels, and branch and bound may split where another output takes over.
What cannot be excluded is attacked: a command is attained where the program chooses it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations

import numpy as np

from viatool.arrays import Booleans, Floats, Indices
from viatool.errors import SelfCheckError
from viatool.policy.assembly import Assembly, Computed, Term
from viatool.policy.network import Network
from viatool.taylor.approximation import Approximation
from viatool.taylor.attained import climb
from viatool.taylor.deviation import runtime_deviation
from viatool.taylor.memory import blocks_of_parts
from viatool.taylor.mixtures import excluded_by_means
from viatool.taylor.parts import BoxParts, examine, whole_boxes
from viatool.taylor.propagation import Box, is_curved, propagate
from viatool.taylor.refinement import (
    Extrema,
    extrema_of,
    joined,
    refine_by_pieces,
    refine_monotone,
    seeded_upper,
    unfold,
)
from viatool.taylor.rounding import widen
from viatool.taylor.splitting import largest_of_each

Program = Callable[[Floats], Floats]
"""Observations (P, n) to outputs (P, K)."""

_AT_ONCE = 8
"""Parts of one question that are split in one round."""
_STARTS = 3
"""Points of a box from which a command is sought: the middle, and corners."""


@dataclass(frozen=True, eq=False)
class Choices:
    """The commands that a policy may choose in B boxes of observations.

    Parameters
    ----------
    possible : ndarray
        ``(B, K)`` bool: False is proved, whatever the program rounds; where two outputs may be equal both are possible.
    attained : ndarray
        ``(B, K)`` bool: the program chooses the command at an observation that was found in the box.
    """

    possible: Booleans
    attained: Booleans

    @classmethod
    def hull(cls, choices: Sequence[Choices]) -> Choices:
        """Return what holds for every one of several programs over the same B boxes."""
        return cls(
            np.logical_or.reduce([one.possible for one in choices]),
            np.logical_or.reduce([one.attained for one in choices]),
        )


def enclose_choices(
    network: Network,
    box: Box,
    program: Program,
    *,
    rule: Approximation = "chebyshev",
    arithmetic: str = "float32",
    parts: int = 0,
) -> Choices:
    """Find which of K outputs may be the largest in each of B boxes.

    Parameters
    ----------
    network : Network
        n inputs, K outputs.
    box : Box
        ``(B, n)``.
    program : callable
        What runs; it decides what is attained.
    rule : str
        How activations are approximated.
    arithmetic : str
        As in `viatool.reach`.
    parts : int
        Parts of a box that are examined for one command that is neither excluded nor attained; with 0 there is one
        pass over each box alone.

    Returns
    -------
    Choices
        ``(B, K)``.

    Notes
    -----
    **Sound:** yes. Command k is excluded where ``output k - output j`` of the exact network, plus by how much the
    program's difference may stray from it, is below 0 for some j at every observation of the box.
    """
    excluded, stray = _excluded_at_once(network, box, rule, arithmetic)
    attained = chosen_by(program, box.centre, network.output_size)
    if arithmetic == "float32":
        require_not_excluded(attained, excluded)
    for start in _starts(box):
        state, command = np.nonzero(~excluded & ~attained)
        if not state.size:
            break
        seed = np.eye(network.output_size)[command]
        points, _ = climb(margins(network), box.rows(state), seed, start[state])
        np.logical_or.at(attained, state, chosen_by(program, points, network.output_size))
    possible = ~excluded
    if parts and is_curved(network):
        state, command = np.nonzero(possible & ~attained)
        found = _settle_curved(network, box.rows(state), command, stray[state, command], program, rule, parts)
        possible[state, command] = found.possible
        attained[state, command] = found.attained
        return Choices(possible | attained, attained)
    state, command = np.nonzero(possible & ~attained)
    if parts and state.size:
        found = _settle(network, box.rows(state), command, stray[state, command], program, rule, parts)
        possible[state, command] = found.possible
        attained[state, command] = found.attained
    return Choices(possible | attained, attained)


@lru_cache(maxsize=64)
def differences(network: Network) -> Network:
    """Return the network followed by ``output k - output j`` for all pairs k < j."""
    size = network.output_size
    first, second = _pairs(size)
    assembly, outputs = _behind(network)
    weights = np.eye(size)[first] - np.eye(size)[second]
    return assembly.network(_combined(assembly, Term(outputs, weights)))


@lru_cache(maxsize=64)
def margins(network: Network) -> Network:
    """Return the network followed by ``min over j of (output k - output j)`` for every k."""
    same = np.eye(network.output_size)
    assembly, outputs = _behind(network)
    turns = range(1, network.output_size)
    least = [_combined(assembly, Term(outputs, same - np.roll(same, turn, axis=1))) for turn in turns]
    while len(least) > 1:  # in pairs, so that few minima follow each other
        pairs = zip(least[::2], least[1::2], strict=False)
        least = [_lesser(assembly, first, second) for first, second in pairs] + least[len(least) // 2 * 2 :]
    return assembly.network(least[0])


def _lesser(assembly: Assembly, first: Computed, second: Computed) -> Computed:
    """Add ``min(x, y) = x - relu(x - y)``, whose kink branch and bound can split."""
    same = np.eye(first.size)
    excess = assembly.activation(_combined(assembly, Term(first, same), Term(second, -same)), "Relu")
    return _combined(assembly, Term(first, same), Term(excess, -same))


def _behind(network: Network) -> tuple[Assembly, Computed]:
    """Return what goes on behind the nodes of a network, and its outputs as the program compares them."""
    assembly = Assembly.behind(network)
    outputs = Computed(len(network.nodes) - 1, (network.output_size,), network.nodes[-1].precision)
    return assembly, assembly.cast(outputs, "float64")


def _combined(assembly: Assembly, *terms: Term) -> Computed:
    """Add a sum of weighted values."""
    count = terms[0].weights.shape[0]
    return assembly.affine(terms, np.zeros(count), (count,), "float64")


def _pairs(size: int) -> tuple[Indices, Indices]:
    """Return all pairs k < j of K outputs."""
    first, second = np.array(list(combinations(range(size), 2)), dtype=np.intp).reshape(-1, 2).T
    return first, second


def _excluded_at_once(
    network: Network, box: Box, rule: Approximation, arithmetic: str
) -> tuple[Booleans, Floats]:
    """Return which commands one pass over each box excludes, (B, K), and by how much their margins may stray."""
    between, size = differences(network), network.output_size
    passes = propagate(between, box, rule=rule)
    hulls = [enclosure.hull for enclosure in passes]
    extrema = refine_by_pieces(between, extrema_of(box, *hulls[-1]), passes)
    hulls[-1] = unfold(extrema.bound, between.output_size)
    deviation = np.zeros_like(hulls[-1][0])
    if arithmetic == "float32":
        deviation = runtime_deviation(between, hulls)
    lower, upper = widen(*hulls[-1], deviation)
    first, second = _pairs(size)
    stray = np.zeros((len(lower), size, size))
    stray[:, first, second] = stray[:, second, first] = deviation
    return excluded_by(lower, upper, size), np.asarray(stray.max(axis=2))


def excluded_by(lower: Floats, upper: Floats, size: int) -> Booleans:
    """Return which of K commands bounds (B, P) of all `differences` exclude, (B, K). **Sound:** yes, NaN does not."""
    first, second = _pairs(size)
    above = np.full((len(lower), size, size), np.inf)  # of output k - output j
    above[:, first, second], above[:, second, first] = upper, -lower
    return np.asarray((above < 0.0).any(axis=2))


def chosen_by(program: Program, points: Floats, size: int) -> Booleans:
    """Return what a program chooses at points (P, n), (P, K) with one True in each row."""
    chosen = np.zeros((len(points), size), dtype=bool)
    chosen[np.arange(len(points)), np.argmax(program(points), axis=1)] = True
    return chosen


def require_not_excluded(chosen: Booleans, excluded: Booleans) -> None:
    """Refuse a program that chooses what is excluded, (B, K) each.

    Raises
    ------
    SelfCheckError
        If there is a state in which it does.
    """
    if (chosen & excluded).any():
        row, command = np.argwhere(chosen & excluded)[0]
        raise SelfCheckError(
            f"the loaded network and onnxruntime disagree: in state {row} the program chooses command {command}, "
            "which the network's bounds exclude",
            "report this model: it was read wrongly, and no verdict may rest on it",
        )


def _starts(box: Box) -> list[Floats]:
    """Return where the search begins: the middle of each box, and random corners, the same in every run."""
    generator = np.random.default_rng(box.lower.shape)
    corners = [generator.random(box.lower.shape) < 0.5 for _ in range(_STARTS - 1)]
    return [box.centre, *(np.where(high, box.upper, box.lower) for high in corners)]


def _settle_curved(
    network: Network,
    box: Box,
    command: Indices,
    stray: Floats,
    program: Program,
    rule: Approximation,
    parts: int,
) -> Choices:
    """Exclude or attain P commands of a curved network, each in a box of its own; (P,) each."""
    attained = np.zeros(command.size, dtype=bool)

    def hits(points: Floats, owner: Indices) -> Booleans:
        hit = np.argmax(program(points), axis=1) == command[owner]
        attained[owner[hit]] = True
        return np.asarray(hit)

    excluded = excluded_by_means(network, box, command, stray, rule=rule, parts=parts, attained=hits)
    return Choices(~excluded, attained)


def _settle(
    network: Network,
    box: Box,
    command: Indices,
    stray: Floats,
    program: Program,
    rule: Approximation,
    parts: int,
) -> Choices:
    """Exclude or attain P commands, each in a box of its own, by branch and bound; (P,) each."""
    beyond = margins(network)
    seed = np.eye(network.output_size)[command]
    extrema = _margins_of(beyond, box, seed, rule)
    enough = -(stray * (1.0 + 1e-12))  # a margin below this is one of the program, too
    attained, given_up = np.zeros(command.size, dtype=bool), np.zeros(command.size, dtype=bool)
    spent = np.zeros(command.size, dtype=np.intp)
    fresh = whole_boxes(extrema, np.flatnonzero(~(extrema.bound < enough)))
    waiting = whole_boxes(extrema, np.zeros(0, dtype=np.intp))
    while fresh.owner.size:
        left = waiting
        for block in blocks_of_parts(beyond, fresh.owner.size):
            examined, points = examine(beyond, extrema, fresh.rows(block), enough, rule)
            _attack(beyond, program, examined, points, command, stray, attained)
            np.add.at(spent, examined.owner, 1)
            left = left.joined(examined.rows(np.flatnonzero(~(examined.bound < enough[examined.owner]))))
        given_up[left.owner[left.next_node == 0]] = True
        given_up[left.owner] |= (spent >= parts)[left.owner]
        left = left.rows(np.flatnonzero(~(attained | given_up)[left.owner]))
        chosen = largest_of_each(left, _AT_ONCE)
        waiting = left.rows(np.flatnonzero(~chosen))
        fresh = left.rows(np.flatnonzero(chosen)).halves()
    return Choices(attained | given_up, attained)


def _margins_of(beyond: Network, box: Box, seed: Floats, rule: Approximation) -> Extrema:
    """Bound the margin that each seed (P, K) names over a box of its own, on the face where it is largest."""
    found = []
    for block in blocks_of_parts(beyond, len(seed)):
        some = box.rows(block)
        passes = propagate(beyond, some, rule=rule)
        asked = Extrema(some, seed[block], seeded_upper(passes[-1].hull, seed[block]))
        found.append(refine_monotone(beyond, asked, passes, rule=rule))
    return joined(found)


def _attack(
    beyond: Network,
    program: Program,
    parts: BoxParts,
    points: Floats,
    command: Indices,
    stray: Floats,
    attained: Booleans,
) -> None:
    """Run the program at the points of parts (K, n) that may attain their command, and note where it does."""
    wanted = command[parts.owner]
    value = beyond(points)[np.arange(len(points)), wanted]
    near = np.flatnonzero(value >= -stray[parts.owner])
    if near.size:
        hit = np.argmax(program(points[near]), axis=1) == wanted[near]
        attained[parts.owner[near[hit]]] = True
