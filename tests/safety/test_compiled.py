"""The compiled proof of clearance: brute force in other formulas, numpy as its reference, and each of its terms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.safety.brute_force import FOOTPRINTS, random_world, rim_of
from tests.safety.test_pose_boxes import found_within, setting
from tests.world.random_worlds import ARENAS
from tests.world.random_worlds import random_world as world_and_scenarios
from viatool.motion.differential import DifferentialDrive
from viatool.motion.holonomic import HolonomicDrive
from viatool.motion.manoeuvre import Manoeuvre
from viatool.safety import compiled
from viatool.safety.proof import ProofEffort, prove_clearance
from viatool.safety.scene_poses import ScenePoses
from viatool.world import Scenes

ROUGH, USUAL = ProofEffort(levels=0), ProofEffort(8, 64, 1e-4)


@pytest.fixture(autouse=True)
def engine(monkeypatch):
    monkeypatch.setenv("VIATOOL_ENGINE", "compiled")


def manoeuvre_of(kind, name):
    return Manoeuvre(0.5) if kind == "swept" else Manoeuvre(0.1, 0.8, rim_of(FOOTPRINTS[name]))


def wrongly_proved(cases, name, manoeuvre, effort=ROUGH):
    """How many boxes are proved, at some distance, of which a corner comes nearer; and how many are proved."""
    wrong = proved = 0
    for world, placed, lower, upper in cases:
        attained = found_within(world, placed, lower, upper, manoeuvre, FOOTPRINTS[name])
        for threshold in np.linspace(0.0, 1.0, 41):
            found = prove_clearance(placed, lower, upper, threshold, manoeuvre, FOOTPRINTS[name], effort)
            wrong += int((found.proved & (attained <= threshold)).sum())
            proved += int(found.proved.sum())
    return wrong, proved


@pytest.mark.parametrize("effort", [ROUGH, USUAL], ids=["rough", "usual"])
@pytest.mark.parametrize("kind", ["swept", "braking"])
@pytest.mark.parametrize("name", ["point", "circle"])
def test_no_corner_of_a_proved_box_comes_nearer(name, kind, effort):
    cases = [setting(seed, count=60) for seed in range(3)]
    wrong, proved = wrongly_proved(cases, name, manoeuvre_of(kind, name), effort)
    assert wrong == 0
    assert proved > 1000


def narrow(seed, radii, half):
    """The boxes of `setting` with other half-widths of poses and commands."""
    world, placed, lower, upper = setting(seed, count=80)
    middle = 0.5 * (lower + upper)
    wide = np.broadcast_to(np.array(radii), placed.radii.shape)
    return world, replace(placed, radii=wide), middle - half, middle + half


MUTANTS = {
    "speeds": (Manoeuvre(0.5), (0.0, 0.0, 0.0), (0.3, 0.0)),
    "turns": (Manoeuvre(0.8), (0.0, 0.0, 0.0), (0.0, 1.0)),
    "sideways": (Manoeuvre(0.8), (0.0, 0.0, 0.0), (0.0, 1.0)),
    "sagitta": (Manoeuvre(1.5), (0.0, 0.0, 0.0), (0.0, 0.0)),
    "places": (Manoeuvre(0.1), (0.1, 0.1, 0.0), (0.0, 0.0)),
    "headings": (Manoeuvre(0.8), (0.0, 0.0, 0.8), (0.0, 0.0)),
    "way": (Manoeuvre(0.8), (0.0, 0.0, 0.0), (0.0, 0.0)),
}


@pytest.mark.parametrize("name", [name for name, _ in compiled.Deviations._fields_])
def test_brute_force_catches_a_proof_without_one_of_its_terms(monkeypatch, name):
    manoeuvre, *sizes = MUTANTS[name]
    cases = [narrow(seed, *sizes) for seed in range(4)]
    assert wrongly_proved(cases, "point", manoeuvre)[0] == 0
    factors = (0.0 if other == name else 1.0 for other, _ in compiled.Deviations._fields_)
    monkeypatch.setattr(compiled, "WHOLE", compiled.Deviations(*factors))
    assert wrongly_proved(cases, "point", manoeuvre)[0] > 0


def robots(arena, kinematics, count=150):
    """Boxes of poses and commands in several scenes, some of them in obstacles and off the map."""
    generator = np.random.default_rng(7)
    world, scenarios = world_and_scenarios(generator, ARENAS[arena], 4)
    poses = np.column_stack([generator.uniform(-5, 5, (count, 2)), generator.uniform(-4, 4, count)])
    placed = ScenePoses.of(world, scenarios, poses, generator.integers(0, len(scenarios), count))
    radii = generator.uniform(0.0, 0.05, (count, 3)) * generator.choice([0.0, 1.0], (count, 3))
    axes = len(kinematics.axes)
    lower = generator.uniform(-1.0, 1.0, (count, axes)) * generator.choice([0.0, 1.0], (count, axes))
    return replace(placed, radii=radii), lower, lower + generator.uniform(0.0, 0.2, (count, axes))


@pytest.mark.parametrize(
    "kinematics", [DifferentialDrive(), HolonomicDrive()], ids=["differential", "holonomic"]
)
@pytest.mark.parametrize("arena", ARENAS)
def test_both_engines_prove_and_refute_the_same(monkeypatch, arena, kinematics):
    placed, lower, upper = robots(arena, kinematics)
    differ = proved = refuted = 0
    for boxed, kind in ((True, "swept"), (False, "braking")):
        manoeuvre = replace(manoeuvre_of(kind, "circle"), kinematics=kinematics)
        states = placed if boxed else replace(placed, radii=None)
        found = []
        for engine in ("compiled", "numpy"):
            monkeypatch.setenv("VIATOOL_ENGINE", engine)
            found.append(prove_clearance(states, lower, upper, 0.1, manoeuvre, FOOTPRINTS["circle"]))
        differ += int(
            (found[0].proved != found[1].proved).sum() + (found[0].refuted != found[1].refuted).sum()
        )
        proved, refuted = proved + int(found[0].proved.sum()), refuted + int(found[0].refuted.sum())
    assert differ <= 2  # what lies on the edge, by the order of roundings or the shapes that are left out
    assert proved > 50
    assert refuted > 50


@pytest.mark.parametrize(
    "kinematics", [DifferentialDrive(), HolonomicDrive()], ids=["differential", "holonomic"]
)
@pytest.mark.parametrize("arena", ARENAS)
def test_the_nearest_instants_are_those_of_numpy(arena, kinematics):
    placed, lower, upper = robots(arena, kinematics)
    placed, actions = replace(placed, radii=None), np.stack([lower, upper, 0.0 * lower], axis=1)
    manoeuvre, footprint = (
        replace(manoeuvre_of("braking", "circle"), kinematics=kinematics),
        FOOTPRINTS["circle"],
    )
    question = compiled.question_of(placed, manoeuvre, footprint)
    assert question is not None
    found, step = compiled.nearest(question, placed, actions, 20)
    fractions = np.linspace(0.0, 1.0, 21)
    paths = manoeuvre.path(placed.poses[:, None, None], actions[:, :, None], fractions)
    rows = np.repeat(np.arange(len(lower)), 3 * 21)
    there = replace(placed.select(rows), poses=paths.reshape(-1, 3))
    left = there.footprint_clearance(footprint, np.zeros(len(rows)))[0].reshape(-1, 3, 21)
    np.testing.assert_allclose(found, left.min(axis=2), rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(
        np.take_along_axis(left, step[..., None], 2)[..., 0], found, rtol=0.0, atol=1e-12
    )


@pytest.mark.parametrize("which", ["x", "y", "theta", "radius"])
def test_what_is_not_a_number_is_neither_proved_nor_refuted(which):
    _, placed, lower, upper = setting(0)
    poses, radii = placed.poses.copy(), placed.radii.copy()
    if which == "radius":
        radii[:] = np.inf
    else:
        poses[:, ["x", "y", "theta"].index(which)] = np.nan
    states = replace(placed, poses=poses, radii=radii)
    question = compiled.question_of(states, Manoeuvre(0.3), FOOTPRINTS["point"], 0.1, USUAL)
    proved, refuted = compiled.decide(question, states, lower, upper)
    assert not proved.any()
    assert not refuted.any()
    assert compiled.decide(question, placed, np.nan * lower, upper)[0].sum() == 0


def test_what_the_compiled_engine_does_not_cover_is_left_to_numpy():
    _, placed, _, _ = setting(0)
    swept, point = Manoeuvre(0.5), FOOTPRINTS["point"]
    assert compiled.question_of(placed, swept, point) is not None
    assert compiled.question_of(placed, swept, FOOTPRINTS["square"]) is None
    assert compiled.question_of(placed, swept, point, -0.1) is None
    world, nowhere = random_world(0), np.full((1, 1, 3), np.nan)
    lost = replace(placed, still=Scenes(world.arena, world.obstacles, nowhere, np.zeros((1, 0, 4))))
    assert compiled.question_of(lost, swept, point) is None
