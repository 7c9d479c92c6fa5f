"""Obstacles that move in simulation: within the model, seen where they are, and attacking what is proved."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import shapely
from click.testing import CliRunner

import viatool
from viatool.cli import main
from viatool.errors import ConfigurationError
from viatool.setting.setting import Setting
from viatool.setting.wishes import Wishes
from viatool.simulate import Conditions, NavigationSimulator
from viatool.simulate.roll_out import drive
from viatool.trajectory import load_trajectory
from viatool.uncertainty import ErrorModel
from viatool.world import Obstacles, Scenario

LAB = viatool.load_map("lab")
TABLE = np.array([[-1.0, 1.0], [0.4, 1.1], [0.2, 1.9], [-1.1, 2.0]])
HALL = replace(LAB, obstacles=LAB.obstacles + Obstacles(polygons=(TABLE,), names=("table",)))
PILLAR = Obstacles(np.array([[3.0, 0.0, 0.2]]))
SCENARIOS = (
    Scenario("a", (-4.0, -3.0, 0.5), (4.2, 0.5)),
    Scenario("b", (3.5, 1.0, 2.0), (-3.0, -3.0), PILLAR),
)
TERMS = {"speed": 0.3, "named": {"fixed-1": 0.8, "fixed-2": 0.0}, "roams": {"fixed-3": 0.4, "table": 0.2}}


def model(**terms):
    return ErrorModel.model_validate({"obstacles": terms})


@pytest.fixture(scope="module")
def policy():
    return viatool.load_policy("via")


def simulator_of(errors, *, adversary=False, world=HALL, scenarios=SCENARIOS):
    return NavigationSimulator(
        world, len(scenarios), scenarios=scenarios, noise=0.0, errors=errors, adversary=adversary, seed=3
    )


def shapes_around(simulator, robot):
    """What is around a robot, but for the walls: circles and polygon corners as the simulator has them."""
    scenes, scene = simulator.around()
    column = scene[robot]
    centres, radii = scenes._centres[:, column], scenes._radii[:, column]
    there = np.abs(centres) < 1e6
    corners = scenes._first[:, column]
    return centres[there], radii[there], corners[np.abs(corners) < 1e6]


@pytest.mark.parametrize("adversary", [False, True])
def test_things_keep_to_the_model_and_fill_it(adversary):
    simulator = simulator_of(model(**TERMS), adversary=adversary)
    simulator.reset()
    home = [shapes_around(simulator, robot) for robot in (0, 1)]
    assert [len(one[0]) for one in home] == [4, 5]
    before, fastest, farthest = home, 0.0, 0.0
    radii = {
        0.26: 0.8,
        0.56: 0.0,
        0.98: 0.3,
        0.2: 0.3,
    }  # by radius: fixed-1, fixed-2, fixed-4, the scenario's
    for _ in range(60):
        simulator.step(np.tile([0.05, 0.3], (2, 1)))
        now = [shapes_around(simulator, robot) for robot in (0, 1)]
        for (old, _, _), (new, sizes, corners), (first, _, ring) in zip(before, now, home, strict=True):
            for was, at, start, size in zip(old, new, first, sizes, strict=True):
                if round(float(size), 2) == 0.14:
                    assert abs(at - start) <= 0.4 + 1e-12
                    farthest = max(farthest, abs(at - start) / 0.4)
                else:
                    limit = radii[round(float(size), 2)] * 0.1
                    assert abs(at - was) <= limit + 1e-12
                    fastest = max(fastest, abs(at - was) / limit if limit else 0.0)
            assert np.ptp(corners - ring) < 1e-12  # rigid
            assert np.abs(corners - ring).max() <= 0.2 + 1e-12
        before = now
    assert fastest > 0.9
    assert farthest > 0.9


def test_readings_are_of_where_things_are(policy):
    simulator = simulator_of(model(**TERMS))
    simulator.reset()
    for _ in range(20):
        step = simulator.step(np.tile([0.1, 0.2], (2, 1)))
    fan = simulator.observer.fans[0]
    for robot in (0, 1):
        centres, radii, corners = shapes_around(simulator, robot)
        solid = [
            shapely.Point(c.real, c.imag).buffer(r, quad_segs=256)
            for c, r in zip(centres, radii, strict=True)
        ]
        solid.append(shapely.Polygon(np.column_stack([corners.real, corners.imag])))
        outside = shapely.box(-9, -9, 9, 9) - shapely.Polygon(HALL.arena)
        world = shapely.union_all([*solid, outside])
        x, y, theta = simulator.poses[robot]
        angle = theta + fan.lidar.angles()
        rays = shapely.linestrings([[(x, y), (x + 7 * np.cos(a), y + 7 * np.sin(a))] for a in angle])
        hit = shapely.distance(shapely.intersection(rays, world), shapely.Point(x, y))
        ranges = np.clip(np.fmin(np.nan_to_num(hit, nan=7.0), 7.0), 0.2, 7.0).reshape(20, -1).min(axis=1)
        np.testing.assert_allclose(step.observation[robot, :20], ranges, atol=5e-3)


def test_terms_of_nothing_change_no_bit(policy):
    asked = Setting.of(policy, HALL, 0.0, Wishes(), SCENARIOS, job="simulate")
    nothing = model(speed=0.0, named={"fixed-1": 0.0}, roams={"table": 0.0})
    plain, still = (drive(policy, asked, errors=errors, seed=2) for errors in (None, nothing))
    np.testing.assert_array_equal(plain.trajectory.observations, still.trajectory.observations)
    assert still.trajectory.people.shape[1] == 0


def test_a_robot_that_stands_is_at_no_fault():
    close = (Scenario("near", (-2.0, 2.0, 0.0), (4.2, 0.5)),)
    simulator = simulator_of(model(speed=1.0), adversary=True, scenarios=close, world=LAB)
    simulator.reset()
    steps = [simulator.step(np.zeros((1, 2))) for _ in range(30)]
    assert steps[-1].clearance[0] < LAB.clearance.collision
    assert not any(step.collision[0] for step in steps)
    assert not steps[-1].cost[0]
    assert simulator.step(np.array([[0.1, 0.0]])).collision[0]


def test_an_adversary_comes_nearer_than_chance(policy):
    errors = model(speed=0.3)
    asked = Setting.of(policy, LAB, 0.0, Wishes(errors=errors), LAB.scenarios, job="simulate")
    chance, worst = (
        drive(policy, asked, errors=errors, adversary=adversary, seed=1) for adversary in (False, True)
    )
    assert worst.least_clearance.mean() < chance.least_clearance.mean() - 0.02
    assert (worst.trajectory.outcomes == "collision").sum() > (
        chance.trajectory.outcomes == "collision"
    ).sum()


def test_no_state_that_is_proved_is_driven_into_by_what_moves(policy):
    """Driven by an adversary, then verified with what walked there: what is safe kept its distance."""
    errors = ErrorModel.model_validate({"obstacles": {"speed": 0.3}, "sensor": {"lidar": {"absolute": 0.01}}})
    scenarios = LAB.scenarios[:6]
    asked = Setting.of(policy, LAB, 0.0, Wishes(errors=errors), scenarios, job="simulate")
    safe = total = unproved = 0
    for adversary, seed in ((True, 1), (True, 2), (False, 3)):
        driven = drive(policy, asked, errors=errors, adversary=adversary, noise=0.0, seed=seed)
        kept = driven.clearances > LAB.clearance.collision
        found = viatool.verify(
            policy, LAB, eps=0.01, errors=model(people=0.3), trajectory=driven.trajectory, only_contested=True
        )
        safe += int((found.judgement.safe & ~kept).sum())
        total += int(found.judgement.safe.sum())
        alone = replace(driven.trajectory, people=np.zeros((len(kept), 0, 5)))
        blind = viatool.verify(policy, LAB, eps=0.01, trajectory=alone, only_contested=True)
        unproved += int((blind.judgement.safe & ~kept).sum())
    assert total > 300
    assert safe == 0
    assert unproved > 0  # as if the map's obstacles had stayed where they were


def test_simulate_moves_things_and_verify_takes_where_they_were(tmp_path):
    errors, target = tmp_path / "moving.yaml", tmp_path / "drive.npz"
    errors.write_text("obstacles: {speed: 0.3}\n")
    run = CliRunner().invoke(
        main, ["simulate", "via", "--map", "lab", "--errors", str(errors), "-o", str(target)]
    )
    assert run.exit_code == 0, run.output
    driven = load_trajectory(target)
    assert driven.people.shape[1] == 8
    verify = [
        "verify",
        "via",
        "--map",
        "lab",
        "--trajectory",
        str(target),
        "--only-contested",
        "--eps",
        "0.01",
        "-q",
    ]
    refused = CliRunner().invoke(main, [*verify, "--errors", str(errors)])
    assert refused.exit_code == 2
    assert "nobody says how they move" in " ".join(refused.output.split())
    errors.write_text("obstacles: {people: 0.3}\n")
    assert CliRunner().invoke(main, [*verify, "--errors", str(errors)]).exit_code == 0


def test_people_walk_about_and_are_what_verify_judges(policy):
    """Sampled and adversarial: people within their speed, seen, recorded, and no contact in a state that is safe."""
    errors = model(people=0.6)
    asked = Setting.of(policy, LAB, 0.0, Wishes(errors=errors), LAB.scenarios[:6], job="simulate")
    bad, blind, total = 0, 0, 0
    for adversary in (False, True):
        driven = drive(
            policy,
            asked,
            errors=errors,
            adversary=adversary,
            conditions=Conditions(noise=0.0, people=2),
            seed=4,
        )
        seen = driven.trajectory
        assert seen.people.shape[1:] == (2, 5)
        first = seen.people[seen.time == 0.0]
        assert (
            np.hypot(*np.moveaxis(first[:, :, :2] - seen.poses[seen.time == 0.0][:, None, :2], 2, 0)) > 1.5
        ).all()
        follows = np.diff(seen.episode) == 0
        moved = np.hypot(*np.moveaxis(np.diff(seen.people[:, :, :2], axis=0), 2, 0))[follows]
        assert 0.05 < moved.max() <= 0.06 + 1e-9
        kept = driven.clearances > LAB.clearance.collision
        found = viatool.verify(policy, LAB, eps=0.01, errors=errors, trajectory=seen, only_contested=True)
        bad += int((found.judgement.safe & ~kept).sum())
        total += int(found.judgement.safe.sum())
        alone = replace(seen, people=np.zeros((len(kept), 0, 5)))
        plain = viatool.verify(policy, LAB, eps=0.01, trajectory=alone, only_contested=True)
        blind += int((plain.judgement.safe & ~kept).sum())
    assert bad == 0
    assert blind > 0
    assert total > 200


def test_a_drive_among_what_roams_tells_where_it_was(policy):
    """Else it could be verified as if it had been where the map shows it."""
    errors = model(roams={"fixed-3": 0.4})
    asked = Setting.of(policy, LAB, 0.0, Wishes(errors=errors), LAB.scenarios[:2], job="simulate")
    seen = drive(policy, asked, errors=errors, seed=1).trajectory
    assert seen.people.shape[1:] == (1, 5)
    away = np.hypot(*(seen.people[:, 0, :2] - [-2.77, -0.96]).T)
    assert 0.3 < away.max() <= 0.4 + 1e-9
    assert (seen.people[:, 0, 2:] == [0.0, 0.0, 0.14]).all()
    with pytest.raises(ConfigurationError, match="nobody says how they move"):
        viatool.verify(policy, LAB, eps=0.01, errors=errors, trajectory=seen)


def test_people_and_their_speed_belong_together(policy):
    for errors, people in ((model(people=1.0), 0), (model(), 2)):
        with pytest.raises(ConfigurationError, match="belong together"):
            drive(
                policy,
                Setting.of(policy, LAB, 0.0, Wishes(errors=errors), job="simulate"),
                errors=errors,
                conditions=Conditions(people=people),
            )
    with pytest.raises(ConfigurationError, match="-1 people"):
        Conditions(people=-1)


def test_what_does_not_move_is_refused_by_name(policy):
    for term in ("returns", "hidden"):
        with pytest.raises(ConfigurationError, match=f"obstacles.{term}"):
            Setting.of(policy, LAB, 0.0, Wishes(errors=model(**{term: 1.0})), job="simulate")
    with pytest.raises(ConfigurationError, match=r"obstacles\.speed"):
        Setting.of(policy, LAB, 0.0, Wishes(errors=model(speed=1.0)), job="simulate with bullet")
    with pytest.raises(ConfigurationError, match="in fixed scenarios alone"):
        NavigationSimulator(LAB, 2, errors=model(speed=1.0))
