"""The search: cells are judged in batches, largest first, and halved where they stay open."""

from __future__ import annotations

from collections import defaultdict

import numpy as np

from viatool.arrays import Floats, Indices
from viatool.loop.certifying import prove_cells
from viatool.loop.closed_loop import ClosedLoop
from viatool.loop.command_bounds import CommandBounds
from viatool.loop.refuting import Refutations, Suspects
from viatool.motion.manoeuvre import Manoeuvre
from viatool.places.findings import BLOCKED, CERTIFIED, REFUTED, SETTLED, UNKNOWN, CellFindings
from viatool.places.tree import Lattice, Nodes
from viatool.schedule import check_time
from viatool.sets.states import StateBoxes

_BATCH = 4096
_POSE = 3
_LEFT_BY_HALVING = np.array([2.0 / 3.0, 0.5, 0.5])
"""Share of what the extent of the pose, of which one of three is halved, and of each other one costs after it."""


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
        smallest = lattice.halvings(contested) == 0
        found += [
            settled,
            *_certify(loop, lattice, contested.select(~smallest), frontier),
            _decide(loop, lattice, contested.select(smallest), seed),
        ]
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


def _certify(loop: ClosedLoop, lattice: Lattice, nodes: Nodes, frontier: Frontier) -> list[CellFindings]:
    """Return the nodes that are certified; the others are halved, as often as hardly any part is certified."""
    if not len(nodes):
        return []
    proofs = prove_cells(loop, lattice.cells(nodes))
    certified = nodes.select(proofs.holds)
    found = [CellFindings.of(certified, np.full(len(certified), CERTIFIED))]
    open_ = np.flatnonzero(~proofs.holds)
    if len(open_):
        nodes = nodes.select(open_)
        cost = _cost_of_extents(loop, lattice, nodes, proofs.commands.select(open_))
        left = lattice.halvings(nodes)
        left = np.where(left % 2 > 0, np.maximum(left - 3, 0), left - 2)
        parts, blocked = _halved(loop, lattice, nodes, cost, left)
        frontier.add(parts)
        found += blocked
    return found


def _decide(loop: ClosedLoop, lattice: Lattice, nodes: Nodes, seed: int) -> CellFindings:
    """Return smallest nodes as certified, refuted or unknown.

    Most of them that fail do so by what is observed without an error: that is tried before anything is bounded.
    """
    if not len(nodes):
        return CellFindings.join([])
    cells, status = lattice.cells(nodes), np.full(len(nodes), UNKNOWN)
    suspects = Suspects.of(loop, cells, seed=seed)
    easily = suspects.as_received()
    status[easily.witnesses.state] = REFUTED
    left = np.flatnonzero(status == UNKNOWN)
    if not len(left):
        return CellFindings.of(nodes, status, easily)
    proofs = prove_cells(loop, cells.select(left))
    status[left[proofs.holds]] = CERTIFIED
    doubtful = np.flatnonzero(status[suspects.cell] == UNKNOWN)
    commands = proofs.commands.select(np.searchsorted(left, suspects.cell[doubtful]))
    hardly = suspects.elsewhere(doubtful, commands, seed=seed)
    status[hardly.witnesses.state] = REFUTED
    return CellFindings.of(nodes, status, Refutations.join([easily, hardly]))


def _largest_axis(nodes: Nodes, deepest: Indices) -> Indices:
    """Return the axis of the pose that was halved least, of those that may be halved."""
    level = np.where(nodes.level < deepest, nodes.level.astype(np.float64), np.inf)[:, :_POSE]
    return np.asarray(_POSE - 1 - level[:, ::-1].argmin(axis=1))  # theta first


def _halved(
    loop: ClosedLoop, lattice: Lattice, nodes: Nodes, cost: Floats, left: Indices
) -> tuple[Nodes, list[CellFindings]]:
    """Return the parts of nodes, cut where extents cost most, until so many halvings are left; and those blocked.

    Parameters
    ----------
    loop, lattice, nodes
        N nodes.
    cost : ndarray
        (N, 3) as `_cost_of_extents` gives it.
    left : ndarray
        (N,) less than now.
    """
    level = nodes.level
    may = np.column_stack(
        [(level < lattice.deepest)[:, :_POSE].any(axis=1), (level < lattice.deepest)[:, _POSE:]]
    )
    choice = np.where(may, cost, -np.inf).argmax(axis=1)
    axis = np.where(choice == 0, _largest_axis(nodes, lattice.deepest), _POSE - 1 + choice)
    parts, left = nodes.halved(axis), np.repeat(left, 2)
    cost = np.repeat(cost * np.where(choice[:, None] == np.arange(3), _LEFT_BY_HALVING, 1.0), 2, axis=0)
    more = lattice.halvings(parts) > left
    if not more.any():
        return parts, []
    blocked = more & loop.blocked(lattice.cells(parts).poses)
    more &= ~blocked
    found = CellFindings.of(parts.select(blocked), np.full(blocked.sum(), BLOCKED))
    smaller, others = _halved(loop, lattice, parts.select(more), cost[more], left[more])
    return Nodes.join([parts.select(~(more | blocked)), smaller]), [found, *others]


def _cost_of_extents(loop: ClosedLoop, lattice: Lattice, nodes: Nodes, commands: CommandBounds) -> Floats:
    """Return what the extents of the pose and of both others cost, (N, 3): command boxes widened, places spread."""
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
    return np.column_stack([score, np.zeros((len(score), 3 - score.shape[1]))])  # a state of one number


def _spread_while_waiting(loop: ClosedLoop, cells: StateBoxes) -> Floats:
    """Return how far each entry of the command before spreads the places at which the next one acts, (C, A)."""
    rules = loop.rules
    wait = Manoeuvre(rules.delay, kinematics=rules.kinematics)
    return wait.loss(cells.previous_lower, cells.previous_upper)
