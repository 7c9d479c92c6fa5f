"""However a box of starts is cut, each start lies in one of its parts."""

from __future__ import annotations

import numpy as np
import pytest

from viatool.missions.starts import Starts

LOWER, UPPER = np.array([[2.9, -1.0, 0.3, 0.1]]), np.array([[3.1, -0.7, 0.3, 0.2]])


@pytest.mark.parametrize("answers", [[1.0, 1.0, 1.0, 1.0], [0.1, 3.0, 9.0, 0.0], [1e-9, 0.0, 0.0, 0.0]])
@pytest.mark.parametrize("most", [3, 50, 1000])
def test_a_grid_holds_every_start_in_no_more_parts_than_asked(answers, most):
    parts = Starts(LOWER, UPPER).gridded(np.array(answers), most)
    assert 2 <= len(parts) <= most
    assert (parts.lower[:, 2] == parts.upper[:, 2]).all()  # of no extent
    share = np.random.default_rng(0).random((2000, 4))
    share[:16] = [[a, b, 0.0, c] for a in (0.0, 1.0) for b in (0.0, 1.0) for c in (0.0, 1.0)] * 2
    points = LOWER + share * (UPPER - LOWER)
    points[:16] = np.where(share[:16] == 1.0, UPPER, LOWER)
    inside = (points[:, None] >= parts.lower) & (points[:, None] <= parts.upper)
    assert inside.all(axis=2).any(axis=1).all()


def test_sides_that_are_answered_to_more_are_cut_finer():
    parts = Starts(LOWER, UPPER).gridded(np.array([1.0, 4.0, 0.0, 0.0]), 50)
    counts = [len(np.unique(parts.lower[:, side])) for side in range(4)]
    assert counts == [5, 10, 1, 1]


def test_halves_meet():
    both = Starts(LOWER, UPPER).halved(np.array([0]), np.array([[1.0, 2.0, 0.0, 0.0]]))
    assert both.upper[0, 1] == both.lower[1, 1] == -0.85
    assert (np.minimum(*both.lower) == LOWER[0]).all()
    assert (np.maximum(*both.upper) == UPPER[0]).all()
