"""The search: cells are judged in batches, largest first, and halved where they stay open."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from viatool.certify.judging import Commands, Question
from viatool.certify.refuting import Refutations, refute
from viatool.certify.tree import Lattice, Nodes

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Booleans = NDArray[np.bool_]

BLOCKED, SETTLED, CERTIFIED, REFUTED, UNKNOWN = range(5)
STATUSES = ("blocked", "uncontested", "certified", "refuted", "unknown")
_BATCH = 4096
_POSE = 3


@dataclass(frozen=True)
class Budget:
    """When to stop: what is still open then is unknown.

    Parameters
    ----------
    seconds : float
        Wall-clock time.
    cells : int
        Cells that are judged.
    """

    seconds: float = np.inf
    cells: int = 2**62


@dataclass(eq=False)
class Ledger:
    """What became of the cells: leaves of the tree with their status, and the counterexamples.

    Parameters
    ----------
    leaves : dict
        For each status the nodes that have it.
    refutations : list of Refutations
        `witnesses.state` counts the refuted leaves in order.
    judged : int
        Cells that were looked at.
    complete : bool
        Whether the search ended by itself, not by its budget.
    """

    leaves: dict[int, list[Nodes]] = field(default_factory=lambda: defaultdict(list))
    refutations: list[Refutations] = field(default_factory=list)
    judged: int = 0
    complete: bool = True

    def nodes(self, status: int) -> Nodes:
        """Return all leaves of a status."""
        return Nodes.join(self.leaves[status])


class Frontier:
    """Open cells by size."""

    def __init__(self, nodes: Nodes) -> None:
        self._open: dict[int, list[Nodes]] = defaultdict(list)
        self.add(nodes)

    def add(self, nodes: Nodes) -> None:
        """Add nodes."""
        depth = nodes.level.sum(axis=1, dtype=np.int64)
        for level in np.unique(depth):
            self._open[int(level)].append(nodes.select(depth == level))

    def take(self, count: int) -> Nodes:
        """Remove and return up to `count` of the largest nodes; none when nothing is open."""
        taken: list[Nodes] = []
        while count > 0 and self._open:
            level = min(self._open)
            nodes = self._open[level].pop()
            if not self._open[level]:
                del self._open[level]
            if len(nodes) > count:
                self._open[level].append(nodes.select(slice(count, None)))
                nodes = nodes.select(slice(count))
            taken.append(nodes)
            count -= len(nodes)
        return Nodes.join(taken)


def search(
    question: Question,
    lattice: Lattice,
    budget: Budget,
    *,
    seed: int = 0,
    progress: Callable[[Ledger, Frontier], None] | None = None,
) -> Ledger:
    """Judge the cells of a lattice until all are decided, smallest, or the budget is spent.

    Parameters
    ----------
    question : Question
        What is asked.
    lattice : Lattice
        The cells.
    budget : Budget
        When to stop.
    seed : int
        Of the search for counterexamples.
    progress : callable, optional
        Called after each batch.

    Returns
    -------
    Ledger
        Every point of the lattice lies in exactly one leaf, up to boundaries.
    """
    ledger, frontier, start = Ledger(), Frontier(lattice.roots()), time.perf_counter()
    while len(nodes := frontier.take(_BATCH)):
        if time.perf_counter() - start > budget.seconds or ledger.judged >= budget.cells:
            ledger.complete = False
            break
        ledger.judged += len(nodes)
        nodes = _geometry(question, lattice, nodes, ledger, frontier)
        if len(nodes):
            _judge(question, lattice, nodes, ledger, frontier, seed)
        if progress is not None:
            progress(ledger, frontier)
    while len(nodes):  # only after a break
        ledger.leaves[UNKNOWN].append(nodes)
        nodes = frontier.take(2**40)
    return ledger


def _geometry(
    question: Question, lattice: Lattice, nodes: Nodes, ledger: Ledger, frontier: Frontier
) -> Nodes:
    """Set aside what is blocked or settled, halve what is larger than the grain, and return the rest."""
    boxes = lattice.cells(nodes).poses
    blocked = question.blocked(boxes)
    level = nodes.level[:, :_POSE]
    young = (level <= lattice.grain[:_POSE]).all(axis=1) & ~blocked
    settled = np.zeros(len(nodes), dtype=bool)
    settled[young] = question.settled(boxes.select(young))
    ledger.leaves[BLOCKED].append(nodes.select(blocked))
    ledger.leaves[SETTLED].append(nodes.select(settled))
    coarse = young & ~settled & (level < lattice.grain[:_POSE]).any(axis=1)
    if coarse.any():
        large = nodes.select(coarse)
        frontier.add(large.halved(_largest_axis(large, lattice.grain)))
    return nodes.select(~(blocked | settled | coarse))


def _judge(
    question: Question, lattice: Lattice, nodes: Nodes, ledger: Ledger, frontier: Frontier, seed: int
) -> None:
    """Certify, refute or halve nodes."""
    cells = lattice.cells(nodes)
    commands = question.commands(cells)
    certified = question.holds(cells.poses, commands.lower, commands.upper)
    ledger.leaves[CERTIFIED].append(nodes.select(certified))
    smallest = (nodes.level >= lattice.deepest).all(axis=1)
    open_ = np.flatnonzero(~certified & ~smallest)
    if len(open_):
        axis = _loosest_axis(question, lattice, nodes.select(open_), commands.select(open_))
        frontier.add(nodes.select(open_).halved(axis))
    last = np.flatnonzero(~certified & smallest)
    if len(last):
        found = refute(question, cells.select(last), commands.select(last), seed=seed)
        refuted = np.zeros(len(last), dtype=bool)
        refuted[found.witnesses.state] = True
        ledger.refutations.append(found)
        ledger.leaves[REFUTED].append(nodes.select(last[refuted]))
        ledger.leaves[UNKNOWN].append(nodes.select(last[~refuted]))


def _largest_axis(nodes: Nodes, deepest: Integers) -> Integers:
    """Return the axis of the pose that was halved least, of those that may be halved."""
    level = np.where(nodes.level < deepest, nodes.level.astype(np.float64), np.inf)[:, :_POSE]
    return np.asarray(_POSE - 1 - level[:, ::-1].argmin(axis=1))  # theta first


def _loosest_axis(question: Question, lattice: Lattice, nodes: Nodes, commands: Commands) -> Integers:
    """Return the axis whose extent costs most: the command box that it widens, or the places that it spreads."""
    rules = question.rules
    speed = np.maximum(np.abs(commands.lower), np.abs(commands.upper))
    seconds = rules.manoeuvre.seconds(speed[:, 0], speed[:, 1])
    width = commands.upper - commands.lower
    loss = width[:, 0] * seconds + 0.5 * speed[:, 0] * width[:, 1] * np.square(seconds)
    places = lattice.cells(nodes).poses.extent
    score = np.column_stack(
        [
            commands.influence[:, :1] * loss[:, None] + places[:, None],
            commands.influence[:, 1:] * loss[:, None],
        ]
    )
    may = np.column_stack(
        [(nodes.level < lattice.deepest)[:, :_POSE].any(axis=1), (nodes.level < lattice.deepest)[:, _POSE:]]
    )
    choice = np.where(may, score, -np.inf).argmax(axis=1)
    return np.where(choice == 0, _largest_axis(nodes, lattice.deepest), _POSE - 1 + choice)
