"""Sides of jumps: of the poses that count on each side, cast rays read what its forms say, and no pose is lost."""

from __future__ import annotations

import numpy as np
import pytest

from tests.sight.ray_oracle import outlines, scan
from tests.sight.test_scan import LIDARS, ROUNDING, boxes_in
from tests.world.random_worlds import ARENAS, random_world
from viatool.sight import scan as sight
from viatool.sight import windows
from viatool.sight.scan import enclose_losing, enclose_scan, gaps_of
from viatool.sight.shapes import Shapes
from viatool.sight.windows import Windows, sides_of

SAMPLES = 96


def sampled(world, scenario, boxes, lidar, generator):
    """Symbols (C, S, 3) of poses in boxes, a third of them at corners, and what is read there, (C, S, bins)."""
    z = generator.uniform(-1, 1, (len(boxes), SAMPLES, 3))
    z[:, : SAMPLES // 3] = np.sign(z[:, : SAMPLES // 3])
    poses = (boxes.centre[:, None] + z * boxes.radius[:, None]).reshape(-1, 3)
    return z, scan(poses, lidar, outlines(world, scenario)).reshape(len(boxes), SAMPLES, -1)


def escapes(forms, z, readings):
    """By how much readings (C, S, bins) leave forms (C, bins), in each sample at most, (C, S)."""
    linear = forms.centre[:, None] + np.einsum("cjk,csj->csk", forms.slope, z)
    return (np.abs(readings - linear) - forms.rest[:, None]).max(axis=2)


def scenes(seed, arena="box", name="half turn", count=150):
    generator = np.random.default_rng(seed)
    world, scenarios = random_world(generator, ARENAS[arena], 2)
    boxes = boxes_in(world, scenarios[0], generator, count, sizes=(0.005, 0.02, 0.05, 0.2))
    z, readings = sampled(world, scenarios[0], boxes, LIDARS[name], generator)
    return generator, Shapes.of(world, scenarios[0]), boxes, LIDARS[name], z, readings


def escape_of_windows(seed, arena="box", name="half turn"):
    """By how much readings leave the forms of any windows, at poses that count for these."""
    generator, shapes, boxes, lidar, z, readings = scenes(seed, arena, name)
    gaps, worst = gaps_of(boxes, shapes, lidar), -np.inf
    any_reading = np.sort(generator.uniform(0.3, lidar.maximum_range, (2, len(boxes), lidar.bins)), axis=0)
    some = np.arange(lidar.bins) == generator.integers(lidar.bins, size=(len(boxes), 1))
    between = np.maximum(readings[:, generator.integers(SAMPLES)], 0.3)  # not what limits make of ranges
    for lower, upper in (
        (np.where(some, any_reading[0], -np.inf), np.where(some, any_reading[1], np.inf)),
        (np.where(gaps.width > 0, gaps.middle, -np.inf), np.full(some.shape, np.inf)),
        (np.full(some.shape, -np.inf), np.where(gaps.width > 0, gaps.middle, np.inf)),
        (np.where(some, between, -np.inf), np.full(some.shape, np.inf)),
        (np.full(some.shape, -np.inf), np.where(some, between, np.inf)),
    ):
        forms, _ = enclose_losing(boxes, shapes, lidar, 0, Windows(lower, upper))
        counts = ((lower[:, None] <= readings) & (readings <= upper[:, None])).all(axis=2)
        assert counts.any()
        worst = max(worst, escapes(forms, z, readings)[counts].max())
    return worst


@pytest.mark.parametrize("name", LIDARS)
@pytest.mark.parametrize("arena", ARENAS)
def test_readings_at_poses_that_count_lie_within_their_forms(arena, name):
    for seed in range(3):
        assert escape_of_windows(seed, arena, name) <= ROUNDING


def lost_poses(seed, jumps=2):
    """How many poses are on no side of the jumps of their box."""
    _, shapes, boxes, lidar, z, readings = scenes(seed)
    sides = sides_of({"lidar": gaps_of(boxes, shapes, lidar)}, jumps)
    forms, _ = enclose_losing(boxes.select(sides.row), shapes, lidar, 0, sides.windows["lidar"])
    held = np.zeros((len(boxes), SAMPLES), dtype=bool)
    np.logical_or.at(held, sides.row, escapes(forms, z[sides.row], readings[sides.row]) <= ROUNDING)
    jumping = np.unique(sides.row)
    assert len(jumping) > 10
    return int((~held[jumping]).sum())


@pytest.mark.parametrize("jumps", [1, 2, 3])
def test_every_pose_is_on_some_side(jumps):
    assert [lost_poses(seed, jumps) for seed in range(4)] == [0, 0, 0, 0]


def test_sides_of_jumps_are_as_tight_as_walls():
    _, shapes, boxes, lidar, _, readings = scenes(0)
    gaps, whole = gaps_of(boxes, shapes, lidar), enclose_scan(boxes, shapes, lidar)
    small = (boxes.radius <= 0.02).all(axis=1)
    wide = small[:, None] & (gaps.width > 0.3)
    beyond = np.where(gaps.width > 0, gaps.middle, -np.inf), np.full(gaps.width.shape, np.inf)
    for lower, upper in (beyond, (-beyond[1], np.where(gaps.width > 0, gaps.middle, np.inf))):
        forms, _ = enclose_losing(boxes, shapes, lidar, 0, Windows(lower, upper))
        assert np.median(forms.rest[wide] / whole.rest[wide]) < 0.1
    never = (readings - gaps.middle[:, None]).min(
        where=readings > gaps.middle[:, None], initial=np.inf, axis=1
    )
    assert (never[gaps.width > 0] >= 0.5 * gaps.width[gaps.width > 0] - ROUNDING).all()


def drop_what_may_be_read(monkeypatch):
    right = Windows.may_read
    monkeypatch.setattr(
        Windows,
        "may_read",
        lambda self, seen, slack: right(Windows(self.lower, self.upper - 0.05), seen, slack),
    )


def drop_what_may_be_met(monkeypatch):
    right = Windows.may_read
    monkeypatch.setattr(
        Windows,
        "may_read",
        lambda self, seen, slack: right(Windows(self.lower + 0.05, self.upper), seen, slack),
    )


def trust_what_may_be_missed(monkeypatch):
    """Take the nearest of what may be met for met."""
    right = sight._bins

    def bins(parts, count, lidar, slack, windows=None):
        for part in parts:
            part.certain[:] |= windows is not None
        return right(parts, count, lidar, slack, windows)

    monkeypatch.setattr(sight, "_bins", bins)


@pytest.mark.parametrize("engine", ["numpy"], indirect=True)
@pytest.mark.parametrize("mutate", [drop_what_may_be_read, drop_what_may_be_met, trust_what_may_be_missed])
def test_cast_rays_catch_windows_that_keep_too_little(monkeypatch, mutate):
    mutate(monkeypatch)
    assert max(escape_of_windows(seed) for seed in range(3)) > 1e-4


def test_cast_rays_catch_sides_that_leave_poses_out(monkeypatch):
    right = windows.sides_of

    def nearer_alone(gaps, most):
        found = right(gaps, most)
        first = np.unique(found.row, return_index=True)[1]
        return windows.Sides(
            found.row[first], {name: one.select(first) for name, one in found.windows.items()}
        )

    monkeypatch.setattr("tests.sight.test_windows.sides_of", nearer_alone)
    assert sum(lost_poses(seed) for seed in range(3)) > 0
