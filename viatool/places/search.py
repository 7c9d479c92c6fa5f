"""The search: cells are judged in batches, largest first, and halved where they stay open."""

from __future__ import annotations

from collections import defaultdict

import numpy as np

from viatool.arrays import Floats, Indices
from viatool.loop.certifying import prove_cells
from viatool.loop.closed_loop import ClosedLoop
from viatool.loop.command_bounds import CommandBounds
from viatool.loop.refuting import refute
from viatool.motion.manoeuvre import Manoeuvre
from viatool.places.findings import BLOCKED, CERTIFIED, REFUTED, SETTLED, UNKNOWN, CellFindings
from viatool.places.tree import Lattice, Nodes
from viatool.schedule import check_time
from viatool.sets.states import StateBoxes

_BATCH = 4096
_POSE = 3


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


def search(loop: ClosedLoop, lattice: Lattice, roots: Nodes, *, seed: int = 0) -> CellFindings:
    """Judge the cells of some roots until all are decided or smallest.

    Parameters
    ----------
    loop : ClosedLoop
        What is asked.
    lattice : Lattice
        How the roots are cut.
    roots : Nodes
        R roots.
    seed : int
        Of the search for counterexamples.

    Returns
    -------
    CellFindings
        Every point of the roots lies in exactly one leaf, up to boundaries. The same for the same roots.
    """
    frontier, found = Frontier(roots), []
    while len(nodes := frontier.take(_BATCH)):
        check_time()
        settled, contested = _geometry(loop, lattice, nodes, frontier)
        judged = [_judge(loop, lattice, contested, frontier, seed)] if len(contested) else []
        found += [settled, *judged]
    return CellFindings.join(found)


def _geometry(
    loop: ClosedLoop, lattice: Lattice, nodes: Nodes, frontier: Frontier
) -> tuple[CellFindings, Nodes]:
    """Return what is blocked or settled, and the rest; what is larger than the grain is halved."""
    boxes = lattice.cells(nodes).poses
    blocked = loop.blocked(boxes)
    level = nodes.level[:, :_POSE]
    young = (level <= lattice.grain[:_POSE]).all(axis=1) & ~blocked
    settled = np.zeros(len(nodes), dtype=bool)
    settled[young] = loop.settled(boxes.select(young))
    coarse = young & ~settled & (level < lattice.grain[:_POSE]).any(axis=1)
    if coarse.any():
        large = nodes.select(coarse)
        frontier.add(large.halved(_largest_axis(large, lattice.grain)))
    found = CellFindings.of(
        nodes.select(blocked | settled), np.where(blocked, BLOCKED, SETTLED)[blocked | settled]
    )
    return found, nodes.select(~(blocked | settled | coarse))


def _judge(loop: ClosedLoop, lattice: Lattice, nodes: Nodes, frontier: Frontier, seed: int) -> CellFindings:
    """Return the nodes that are certified, refuted or smallest; the others are halved."""
    cells = lattice.cells(nodes)
    proofs = prove_cells(loop, cells)
    certified, commands = proofs.holds, proofs.commands
    smallest = (nodes.level >= lattice.deepest).all(axis=1)
    open_ = np.flatnonzero(~certified & ~smallest)
    if len(open_):
        axis = _loosest_axis(loop, lattice, nodes.select(open_), commands.select(open_))
        frontier.add(nodes.select(open_).halved(axis))
    status = np.where(certified, CERTIFIED, UNKNOWN)
    last = np.flatnonzero(~certified & smallest)
    found = refute(loop, cells.select(last), commands.select(last), seed=seed) if len(last) else None
    if found is not None:
        status[last[found.witnesses.state]] = REFUTED
    decided = certified | smallest
    return CellFindings.of(nodes.select(decided), status[decided], found)


def _largest_axis(nodes: Nodes, deepest: Indices) -> Indices:
    """Return the axis of the pose that was halved least, of those that may be halved."""
    level = np.where(nodes.level < deepest, nodes.level.astype(np.float64), np.inf)[:, :_POSE]
    return np.asarray(_POSE - 1 - level[:, ::-1].argmin(axis=1))  # theta first


def _loosest_axis(loop: ClosedLoop, lattice: Lattice, nodes: Nodes, commands: CommandBounds) -> Indices:
    """Return the axis whose extent costs most: the command box that it widens, or the places that it spreads."""
    rules = loop.rules
    cells = lattice.cells(nodes)
    axes = len(rules.kinematics.axes)
    lost = rules.manoeuvre.loss(*loop.given_in(cells, commands.lower, commands.upper))
    loss = lost[:, :axes].sum(axis=1)
    spread = lost[:, axes:] if rules.kinematics.state else _spread_while_waiting(loop, cells)
    places = cells.poses.extent
    score = np.column_stack(
        [
            commands.influence[:, :1] * loss[:, None] + places[:, None],
            commands.influence[:, 1:3] * loss[:, None] + spread[:, :2],
        ]
    )
    score = np.column_stack([score, np.zeros((len(score), 3 - score.shape[1]))])  # a state of one number
    may = np.column_stack(
        [(nodes.level < lattice.deepest)[:, :_POSE].any(axis=1), (nodes.level < lattice.deepest)[:, _POSE:]]
    )
    choice = np.where(may, score, -np.inf).argmax(axis=1)
    return np.where(choice == 0, _largest_axis(nodes, lattice.deepest), _POSE - 1 + choice)


def _spread_while_waiting(loop: ClosedLoop, cells: StateBoxes) -> Floats:
    """Return how far each entry of the command before spreads the places at which the next one acts, (C, A)."""
    rules = loop.rules
    wait = Manoeuvre(rules.delay, kinematics=rules.kinematics)
    return wait.loss(cells.previous_lower, cells.previous_upper)
