"""What a LiDAR saw, and could not see, as things that may come: against regions that are drawn by hand."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from viatool.world import Lidar
from viatool.world.seen import HIDDEN, RETURN, Unseen, Wedges, things_around

SINGLE = Lidar(
    field_of_view=2.0 * np.pi * 179 / 180, rays=180, bins=180, minimum_range=0.1, maximum_range=5.0
)
BINNED = Lidar(rays=180, bins=20, minimum_range=0.1, maximum_range=5.0)
FIRST = Lidar(
    field_of_view=None,
    start=-2.0,
    step=0.1,
    rays=40,
    bins=20,
    reduce="first",
    minimum_range=0.1,
    maximum_range=5.0,
)
LIDARS = {"single": SINGLE, "binned": BINNED, "first": FIRST}
ERROR = 0.02


def readings(lidar, seed, count=3):
    generator = np.random.default_rng(seed)
    least = generator.uniform(0.5, 4.0, (count, lidar.bins))
    least[:, ::7] = 5.0 - ERROR
    return least, np.minimum(least + 2.0 * ERROR, 5.0)


def sectors(lidar, bins_of):
    """Directions (right, left) of what each ray looks at, by hand: half of the way to its neighbours."""
    angles = lidar.angles()[:: lidar.each] if lidar.reduce == "first" else lidar.angles()
    order = np.argsort(angles)
    gap = np.median(np.diff(angles[order]))
    return [(angles[k] - 0.5 * gap, angles[k] + 0.5 * gap, bins_of(k)) for k in order]


def ring(low, high, right, left):
    turns = np.linspace(right, left, 33)
    ends = np.concatenate([high * np.exp(1j * turns), low * np.exp(1j * turns[::-1])])
    return shapely.Polygon(np.column_stack([ends.real, ends.imag]))


def solids(lidar, least, most, hidden, behind, turned=0.0):
    """Where something may be around a LiDAR at the origin that is turned, (B,) shapes drawn by hand."""
    each = 1 if lidar.reduce == "first" else lidar.each
    beyond = hidden is not None or each > 1
    found = []
    for low, high in zip(least, most, strict=True):
        parts = [
            ring(low[b], 9.0 if beyond else high[b], right, left)
            for right, left, b in sectors(lidar, lambda k: k // each)
        ]
        if hidden is not None:
            around = shapely.Point(0, 0).buffer(9.0, quad_segs=360)
            looked = shapely.union_all([ring(0.0, 12.0, a, b) for a, b, _ in sectors(lidar, lambda k: 0)])
            blind = around.difference(looked.buffer(1e-9, quad_segs=1)).difference(
                shapely.Point(0, 0).buffer(behind, quad_segs=720)
            )
            parts.append(blind)
        whole = shapely.union_all(parts)
        found.append(shapely.affinity.rotate(whole, turned, origin=(0.0, 0.0), use_radians=True))
    return found


def places_around(generator, side=0.45):
    """Points (200, 2) around the sensor, and where these are on the map."""
    inside = generator.uniform(-side, side, (200, 2))
    return inside, (inside[:, 0] + 1j * inside[:, 1]) * np.exp(0.7j) + (0.3 - 0.2j)


@pytest.mark.parametrize("name", LIDARS)
@pytest.mark.parametrize("hidden", [None, 1.0])
def test_nothing_that_was_seen_or_hidden_is_nearer_than_the_capsules_say(name, hidden):
    lidar = LIDARS[name]
    least, most = readings(lidar, seed=3)
    pose = np.array([[0.3, -0.2, 0.7]]).repeat(len(least), axis=0)
    behind = None if hidden is None else 0.8
    capsules = things_around(lidar, least, most, pose, Unseen(1.0, hidden, behind))
    generator = np.random.default_rng(1)
    for row, solid in enumerate(solids(lidar, least, most, hidden, behind)):
        inside, places = places_around(generator)
        away = shapely.distance(shapely.points(inside), solid)
        index = np.full(200, row)
        for seconds in (0.0, 0.25):
            found = capsules.clearance(places, index, np.full(200, seconds))[0]
            assert (found <= np.maximum(away - seconds, 0.0) + 1e-5)[away > seconds].all()
        found = capsules.clearance(places, index, np.zeros(200))[0]
        free = away > 1e-3
        assert free.mean() > 0.2
        assert (found >= 0.95 * away - 0.02)[free].all()


def farther(lidar, hidden, turn, turned, seed=5):
    """By how much the capsules of a scan that may turn are farther at most than what stands around a turned one.

    From places that are seen to be free.
    """
    least, most = readings(lidar, seed)
    pose = np.array([[0.3, -0.2, 0.7]]).repeat(len(least), axis=0)
    behind = None if hidden is None else 0.8
    capsules = things_around(lidar, least, most, pose, Unseen(1.0, hidden, behind), turn)
    generator, worst = np.random.default_rng(2), -np.inf
    for row, solid in enumerate(solids(lidar, least, most, hidden, behind, turned)):
        inside, places = places_around(generator, 0.3)
        away = shapely.distance(shapely.points(inside), solid)
        found = capsules.clearance(places, np.full(200, row), np.zeros(200))[0]
        worst = max(worst, float((found - away)[away > 0.0].max()))
    return worst


@pytest.mark.parametrize("name", LIDARS)
@pytest.mark.parametrize("hidden", [None, 1.0])
@pytest.mark.parametrize("turn", [0.02, 0.3])
def test_a_scan_that_turns_shows_things_wherever_it_may_look(name, hidden, turn):
    lidar = LIDARS[name]
    for turned in turn * np.array([-1.0, -0.4, 0.7, 1.0]):
        assert farther(lidar, hidden, turn, turned) <= 1e-5
    assert max(farther(lidar, hidden, 0.0, turned) for turned in (-turn, turn)) > 1e-3


def test_a_scan_that_may_turn_all_around_is_as_near_as_its_nearest_reading():
    least, most = readings(SINGLE, seed=3)
    whole = things_around(SINGLE, least, most, np.zeros((3, 3)), Unseen(None, 1.0, 9.0), 3.1)
    away = whole.clearance(np.zeros(3, complex), np.arange(3), np.zeros(3))[0]
    np.testing.assert_allclose(away, least.min(axis=1), rtol=0.01)


def test_what_stands_too_near_to_be_measured_is_at_the_robot():
    least, most = readings(SINGLE, seed=3)
    least[:, 5] = 0.0
    capsules = things_around(SINGLE, least, most, np.zeros((3, 3)), Unseen(1.0, None, None))
    assert capsules.clearance(np.zeros(3, complex), np.arange(3), np.zeros(3))[0].max() <= 1e-12


def test_a_corner_hides_what_no_return_shows():
    """Half of the fan sees 1 m far, half 4 m: beside the edge something hidden is near, and no return is."""
    least = np.where(np.arange(180) < 90, 1.0, 4.0)[None].repeat(2, axis=0)
    place, index = np.array([1.5j + 1.5, 0.0j]), np.arange(2)
    lidar = Lidar(field_of_view=2.0 * np.pi * 179 / 180, rays=180, bins=180, maximum_range=5.0)
    seen = things_around(lidar, least, least, np.zeros((2, 3)), Unseen(1.0, None, None))
    unseen = things_around(lidar, least, least, np.zeros((2, 3)), Unseen(None, 1.0, None))
    near, far = (some.clearance(place, index, np.zeros(2))[0] for some in (unseen, seen))
    assert near[0] == pytest.approx(1.5, abs=0.05)  # behind what is seen at 1 m ahead
    assert far[0] > near[0]
    np.testing.assert_allclose([near[1], far[1]], 1.0, atol=1e-3)
    assert set(seen.labels) == {RETURN}
    assert set(unseen.labels) == {HIDDEN}


@pytest.mark.parametrize(
    ("name", "blind"), [("single", 0.0), ("binned", np.pi), ("first", 2.0 * np.pi - 4.0)]
)
def test_wedges_go_round_once(name, blind):
    wedges = Wedges.of(LIDARS[name])
    widths = wedges.left - wedges.right
    assert (widths > 0.0).all()
    assert widths.sum() == pytest.approx(2.0 * np.pi)
    np.testing.assert_allclose(np.exp(1j * wedges.left), np.exp(1j * np.roll(wedges.right, -1)), atol=1e-9)
    assert widths[wedges.blind].sum() == pytest.approx(blind, abs=0.03)
    assert set(wedges.bin[~wedges.blind]) == set(range(LIDARS[name].bins))
