"""Nothing that a real robot may do comes nearer than what is proved of it: fine steps, measured by shapely."""

from __future__ import annotations

import numpy as np
import pytest

from tests.motion.actuated_runs import TERMS, Driver, limits, machine
from tests.safety.brute_force import FOOTPRINTS, clearance, random_world, rim_of
from viatool.motion.actuated import ActuatedMotion
from viatool.motion.arcs import wrap_angle
from viatool.safety.enclosure import MotionBoxes
from viatool.safety.scene_poses import ScenePoses
from viatool.safety.varying import enclose_varying

RUNS, NEAR = 80, 1e-3
DRIVES = ("differential", "holonomic", "ackermann")


def placed_runs(seed, kinematics, terms, footprint):
    """Runs of a random machine from poses on a map, with boxes around everything that is only known to lie in one."""
    generator = np.random.default_rng(seed)
    asked = machine(generator, kinematics, terms, rim_of(footprint))
    ends = limits(kinematics)
    runs = Driver(generator, kinematics, asked, RUNS, asked.history).drive(*ends)
    world = random_world(seed)
    starts = np.column_stack([generator.uniform(-2.6, 2.6, (RUNS, 2)), generator.uniform(-4.0, 4.0, RUNS)])
    radii = generator.uniform(0.0, (0.05, 0.05, 0.1), (RUNS, 3)) * generator.choice([0.0, 1.0], (RUNS, 1))
    centre = starts + radii * generator.uniform(-1.0, 1.0, (RUNS, 3))
    turned = np.exp(1j * starts[:, 2])[:, None] * (runs.poses[..., 0] + 1j * runs.poses[..., 1])
    place = starts[:, :1] + 1j * starts[:, 1:2] + turned
    poses = np.stack([place.real, place.imag, wrap_angle(starts[:, 2:] + runs.poses[..., 2])], axis=-1)
    around = generator.uniform(0.0, 0.2, runs.before.shape)
    known = None
    if "measured" in terms:
        error = generator.uniform(0.0, 0.05, (RUNS, 3))
        off = error * generator.uniform(-0.99, 0.99, (RUNS, 3))
        known = runs.had + off - error, runs.had + off + error
    before = np.maximum(runs.before - around, ends[0]), np.minimum(runs.before + around, ends[1])
    course = ActuatedMotion(asked, before, known)
    placed = ScenePoses.of(world, [None], centre, np.zeros(RUNS, dtype=np.int64))
    size = generator.uniform(0.0, 0.3, runs.new.shape) * generator.choice([0.0, 1.0], (RUNS, 1))
    share = generator.uniform(0.0, 1.0, runs.new.shape)
    lower, upper = runs.new - share * size, runs.new + (1.0 - share) * size
    parts = np.sort(generator.uniform(0.0, 1.0, (2, RUNS, 1)), axis=0)
    parts[:, generator.random(RUNS) < 0.3] = np.array([0.0, 1.0])[:, None, None]
    cells = MotionBoxes(
        np.arange(RUNS),
        np.hstack([lower, parts[0], -radii]),
        np.hstack([upper, parts[1], radii]),
        lower.shape[1],
    )
    return world, placed, course, cells, runs, poses


def excess(seed, kinematics, terms, name):
    """The largest amount by which a bound exceeds the clearance of a run of its cell."""
    footprint = FOOTPRINTS[name]
    world, placed, course, cells, runs, poses = placed_runs(seed, kinematics, terms, footprint)
    least, worst = enclose_varying(cells, placed, course, footprint).least, -np.inf
    start, end = (part * course.end for part in cells.fractions)
    lag = 3.0 * course.machine.actuation.of("lag")[:, 1].max() if course.machine.deceleration else 0.0
    for run in range(RUNS):
        some = (
            (runs.time >= start[run])
            & (runs.time <= end[run])
            & (np.arange(len(runs.time)) <= runs.counts[run])
        )
        some &= (runs.time <= course.end[run] - lag) | (end[run] == course.end[run])
        if some.any():
            left = clearance(world, poses[run, some][::3], footprint).min()
            worst = max(worst, least[run] - left)
    return worst


@pytest.mark.parametrize("name", ["circle", "square"])
@pytest.mark.parametrize("kinematics", DRIVES)
def test_no_run_comes_nearer_than_the_bound_of_its_cell(kinematics, name):
    terms = TERMS if name == "square" else TERMS[:-1]
    assert excess(0, kinematics, terms, name) <= NEAR
