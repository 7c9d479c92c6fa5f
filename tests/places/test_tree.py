from __future__ import annotations

import numpy as np

from viatool.places.search import Frontier
from viatool.places.tree import Lattice, Nodes

LATTICE = Lattice.over((-2.0, -1.0, 2.0, 1.5), (np.array([0.0, -1.0]), np.array([0.5, 1.0])), (0.05, 0.05, 2))


def test_roots_fill_the_map_and_all_headings():
    lower, upper = LATTICE.bounds(LATTICE.roots())
    np.testing.assert_allclose(lower.min(axis=0), [-2.0, -1.0, -np.pi, 0.0, -1.0])
    np.testing.assert_allclose(upper.max(axis=0), [2.0, 1.5, np.pi, 0.5, 1.0])
    np.testing.assert_allclose(LATTICE.volumes(LATTICE.roots()).sum(), 4.0 * 2.5 * 2.0 * np.pi)
    assert (LATTICE.size[:3] * np.exp2(-LATTICE.deepest[:3]) <= 0.05 + 1e-12).all()


def test_halves_meet_and_keep_the_volume():
    generator = np.random.default_rng(0)
    nodes = LATTICE.roots().select(generator.integers(0, len(LATTICE.roots()), 50))
    whole = LATTICE.volumes(nodes)
    for _ in range(6):
        axis = generator.integers(0, 5, len(nodes))
        halves = nodes.halved(axis)
        (lower, upper), (outer_lower, outer_upper) = LATTICE.bounds(halves), LATTICE.bounds(nodes)
        rows = np.arange(len(nodes))
        assert (upper[0::2][rows, axis] == lower[1::2][rows, axis]).all()
        assert (lower[0::2] == outer_lower).all()
        assert (upper[1::2] == outer_upper).all()
        assert (LATTICE.volumes(halves).reshape(-1, 2).sum(axis=1) == LATTICE.volumes(nodes)).all()
        nodes = halves
    np.testing.assert_array_equal(LATTICE.volumes(nodes).reshape(50, -1).sum(axis=1), whole)


def test_the_frontier_gives_the_largest_cells_first_and_every_cell_once():
    roots = LATTICE.roots().select(slice(0, 20))
    small = roots.halved(np.zeros(20, np.int64))
    frontier = Frontier(Nodes.join([small, roots]))
    first = frontier.take(15)
    rest = Nodes.join([frontier.take(7), frontier.take(10**6)])
    assert (first.level == 0).all()
    assert len(first) + len(rest) == 60
    assert (
        len(np.unique(np.concatenate([np.hstack([n.level, n.index]) for n in (first, rest)]), axis=0)) == 60
    )
    assert not len(frontier.take(5))
