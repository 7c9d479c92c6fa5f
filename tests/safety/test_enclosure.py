from __future__ import annotations

import numpy as np
import pytest

from tests.safety.brute_force import FOOTPRINTS, clearance, drive, random_world, rim_of
from viatool.motion import twists
from viatool.motion.differential import DifferentialDrive
from viatool.motion.manoeuvre import Manoeuvre
from viatool.safety.enclosure import MotionBoxes, enclose
from viatool.safety.scene_poses import ScenePoses

GRID = np.linspace(0.0, 1.0, 7)


def random_cells(generator, count):
    """MotionBoxes of all sizes: over the whole range, flat in one or two directions, of one command."""
    low, high = np.array([-0.3, -2.0, 0.0]), np.array([1.0, 2.0, 1.0])
    ends = np.sort(generator.uniform(low, high, (2, count, 3)), axis=0)
    shrink = generator.choice([0.0, 0.1, 1.0], (count, 3))
    shrink[: count // 4] = (0.0, 0.0, 1.0)
    return MotionBoxes(np.arange(count), ends[0], ends[0] + shrink * (ends[1] - ends[0]))


def setting(seed, footprint, count=40):
    generator = np.random.default_rng(seed)
    world = random_world(seed)
    poses = np.column_stack([generator.uniform(-2.6, 2.6, (count, 2)), generator.uniform(-4, 4, count)])
    placed = ScenePoses.of(world, [None], poses, np.zeros(count, dtype=np.int64))
    return world, placed, random_cells(generator, count)


def dense_poses(cells, index, pose, manoeuvre):
    """Where commands of a grid over one cell bring the robot, at the cell's fractions."""
    low, high = cells.lower[index], cells.upper[index]
    v, w, s = (low[:, None] + GRID * (high - low)[:, None])[:, :]
    v, w, s = (part.ravel() for part in np.meshgrid(v, w, s))
    return drive(pose, v, w, s * manoeuvre.seconds(np.abs(v), np.abs(w)))


def excess(footprint, manoeuvre, seeds=range(8)):
    """The largest amount by which `least` exceeds a clearance that is found inside a cell."""
    worst = -np.inf
    for seed in seeds:
        world, placed, cells = setting(seed, footprint)
        found = enclose(cells, placed, manoeuvre, footprint)
        for index in range(len(cells)):
            poses = dense_poses(cells, index, placed.poses[index], manoeuvre)
            worst = max(worst, found.least[index] - clearance(world, poses, footprint).min())
    return worst


def manoeuvre_of(kind, footprint):
    return Manoeuvre(1.0) if kind == "swept" else Manoeuvre(0.1, 0.8, rim_of(footprint))


@pytest.mark.parametrize("kind", ["swept", "braking"])
@pytest.mark.parametrize("name", FOOTPRINTS)
def test_no_command_of_a_cell_comes_nearer_than_its_bound(name, kind):
    assert excess(FOOTPRINTS[name], manoeuvre_of(kind, FOOTPRINTS[name])) <= 0.0


@pytest.mark.parametrize("name", FOOTPRINTS)
def test_bounds_hold_for_commands_that_turn_by_more_than_a_circle(name):
    assert excess(FOOTPRINTS[name], Manoeuvre(6.0), seeds=range(4)) <= 0.0
    slow = Manoeuvre(0.1, 0.05, rim_of(FOOTPRINTS[name]))
    assert excess(FOOTPRINTS[name], slow, seeds=range(4)) <= 0.0


@pytest.mark.parametrize("name", ["circle", "square"])
@pytest.mark.parametrize("column", range(3))
def test_ends_that_are_crossed_or_nan_prove_and_refute_nothing(name, column):
    _, placed, cells = setting(0, FOOTPRINTS[name])
    crossed, lost = cells.lower.copy(), cells.lower.copy()
    crossed[:, column] = cells.upper[:, column] + 0.5
    lost[:, column] = np.nan
    for lower in (crossed, lost):
        found = enclose(
            MotionBoxes(cells.state, lower, cells.upper), placed, Manoeuvre(0.1), FOOTPRINTS[name]
        )
        assert not (found.least > -1e9).any()
        assert not (found.attained < 1e9).any()


def nothing(*arrays):
    return np.zeros(len(arrays[0]))


MUTANTS = {
    "other speeds": (
        (twists, "path_radii"),
        lambda right: lambda *a: (0.0 * right(*a)[0], *right(*a)[1:]),
        "point",
        "swept",
    ),
    "other turns": (
        (twists, "path_radii"),
        lambda right: lambda *a: (*right(*a)[:2], 0.0 * right(*a)[2]),
        "square",
        "swept",
    ),
    "sideways": ((twists, "sideways"), lambda right: nothing, "point", "swept"),
    "sagitta": (
        (DifferentialDrive, "sagitta"),
        lambda right: lambda move, *a: nothing(*a),
        "circle",
        "swept",
    ),
    "outline motion": (
        (DifferentialDrive, "outline_motion"),
        lambda right: lambda move, *a: nothing(*a),
        "wedge",
        "swept",
    ),
    "turning outline": (
        (DifferentialDrive, "outline_motion"),
        lambda right: lambda *a: right(*a[:4], 0.0),
        "square",
        "swept",
    ),
    "longer braking": (
        (twists, "path"),
        lambda right: lambda part, others, seconds: right(part, others, Manoeuvre(0.1)),
        "point",
        "braking",
    ),
}


@pytest.mark.parametrize("name", MUTANTS)
def test_brute_force_catches_a_bound_without_one_of_its_terms(monkeypatch, name):
    place, mutate, footprint, kind = MUTANTS[name]
    monkeypatch.setattr(*place, mutate(getattr(*place)))
    shape = FOOTPRINTS[footprint]
    worst = (excess(shape, manoeuvre_of(kind, shape), seeds=[seed]) for seed in range(8))
    assert any(amount > 0.0 for amount in worst)  # the first that shows it is enough


@pytest.mark.parametrize("name", FOOTPRINTS)
def test_the_centre_command_attains_what_it_is_said_to_attain(name):
    footprint, manoeuvre = FOOTPRINTS[name], Manoeuvre(0.3)
    for seed in range(4):
        world, placed, cells = setting(seed, footprint)
        found = enclose(cells, placed, manoeuvre, footprint)
        centre = 0.5 * (cells.lower + cells.upper)
        for index, (v, w, _) in enumerate(centre):
            fractions = np.linspace(cells.lower[index, 2], cells.upper[index, 2], 101)
            poses = drive(placed.poses[index], v, w, fractions * 0.3)
            assert clearance(world, poses, footprint).min() <= max(found.attained[index], 0.0) + 1e-4


def attained_too_low():
    """By how much the centre command keeps more than it is said to attain at most, on arcs that bend much."""
    footprint, manoeuvre, worst = FOOTPRINTS["circle"], Manoeuvre(1.0), -np.inf
    for seed in range(4):
        world, placed, _ = setting(seed, footprint)
        command = np.random.default_rng(seed).uniform((0.5, 1.0), (1.0, 2.0), (len(placed), 2))
        found = enclose(MotionBoxes.whole(command, command), placed, manoeuvre, footprint)
        for index, (v, w) in enumerate(command):
            poses = drive(placed.poses[index], v, w, np.linspace(0.0, 1.0, 201))
            left = clearance(world, poses, footprint).min()
            worst = max(worst, left - max(found.attained[index], 0.0))
    return worst


def test_an_arc_attains_what_its_chord_is_said_to():
    assert attained_too_low() <= 2e-3


def test_dense_arcs_catch_a_chord_without_its_sagitta(monkeypatch):
    monkeypatch.setattr(DifferentialDrive, "sagitta", lambda move, *given: nothing(*given))
    assert attained_too_low() > 0.02


def test_halves_cover_their_cell():
    cells = MotionBoxes.whole(np.array([[0.0, -1.0]]), np.array([[0.5, 1.0]]))
    halves = cells.halved(np.array([1]))
    np.testing.assert_array_equal(halves.lower, [[0.0, -1.0, 0.0], [0.0, 0.0, 0.0]])
    np.testing.assert_array_equal(halves.upper, [[0.5, 0.0, 1.0], [0.5, 1.0, 1.0]])
