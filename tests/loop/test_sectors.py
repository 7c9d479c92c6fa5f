from __future__ import annotations

import numpy as np
import pytest

from viatool.loop import sectors
from viatool.loop.sectors import HEADING, cut_by_heading
from viatool.sets.forms import Forms

SECTOR = 0.01


def sets(generator, count=40, symbols=7):
    """Sets of states of a few tubes, some of them thin or without extent."""
    slope = generator.normal(0.0, 0.02, (count, symbols, 5)) * generator.uniform(0, 1, (count, symbols, 1))
    slope[::7, :, HEADING] = 0.0
    slope[::5] = 0.0
    rest = generator.uniform(0.0, 0.005, (count, 5)) * generator.integers(0, 2, (count, 1))
    return np.sort(generator.integers(0, 6, count)), Forms(
        generator.normal(0, 1, (count, 5)) * 0.05, slope, rest
    )


def points(generator, states, each=3000):
    """Points (C, each, 5) of sets, many of them at corners."""
    count, symbols = states.slope.shape[:2]
    s, e = generator.uniform(-1, 1, (count, each, symbols)), generator.uniform(-1, 1, (count, each, 5))
    s[:, ::2], e[:, ::2] = np.sign(s[:, ::2]), np.sign(e[:, ::2])
    aligned = np.sign(states.slope)[:, None, :, :] * generator.choice([-1, 1], (count, each // 3, 1, 5))
    which = generator.integers(0, 5, each // 3)
    s[:, : each // 3] = np.take_along_axis(aligned, which[None, :, None, None], axis=3)[..., 0]
    return states.centre[:, None] + s @ states.slope + e * states.rest[:, None]


def uncovered(generator, most=64):
    """The share of points of sets that lie in no part of their tube."""
    tube, states = sets(generator)
    parts = cut_by_heading(tube, states, (states.lower, states.upper), SECTOR, most)
    assert np.bincount(parts.tube, minlength=6).max() <= most
    missed = 0
    for index, found in enumerate(points(generator, states)):
        of = parts.tube == tube[index]
        within = (found[:, None] >= parts.lower[of] - 1e-12) & (found[:, None] <= parts.upper[of] + 1e-12)
        missed += int((~within.all(axis=2).any(axis=1)).sum())
    return missed


@pytest.mark.parametrize("most", [1, 3, 64])
def test_every_state_lies_in_a_part_of_its_tube(most):
    assert all(uncovered(np.random.default_rng(seed), most) == 0 for seed in range(4))


def test_parts_are_no_wider_than_a_sector_and_tighter_than_the_sets():
    generator = np.random.default_rng(5)
    tube, states = sets(generator)
    parts = cut_by_heading(tube, states, (states.lower, states.upper), SECTOR, 10_000)
    widths = parts.upper - parts.lower
    assert widths[:, HEADING].max() <= SECTOR * (1 + 1e-9)
    assert widths.min() >= 0.0
    one = Forms(np.zeros((1, 5)), np.full((1, 1, 5), 0.1), np.zeros((1, 5)))  # a line through all dimensions
    line = cut_by_heading(np.zeros(1, np.int64), one, (one.lower, one.upper), SECTOR, 100)
    assert (line.upper - line.lower).max() < 1.01 * SECTOR


def without_the_symbols(states, k):
    return states.rest + np.abs(k) * states.rest[:, HEADING, None]


def without_the_rests(states, k):
    return np.abs(states.slope - k[:, None] * states.slope[:, :, HEADING, None]).sum(axis=1)


def without_the_rest_of_the_heading(states, k):
    return without_the_rests(states, k) + states.rest


@pytest.mark.parametrize(
    ("name", "mutant"),
    [
        ("left_over", without_the_symbols),
        ("left_over", without_the_rests),
        ("left_over", without_the_rest_of_the_heading),
        ("join", lambda lower, upper, first: (lower[first], upper[first])),
    ],
)
def test_sampling_catches_parts_that_leave_something_out(monkeypatch, name, mutant):
    monkeypatch.setattr(sectors, name, mutant)
    assert sum(uncovered(np.random.default_rng(seed)) for seed in range(4)) > 0
