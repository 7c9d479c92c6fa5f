"""Scans that err as a whole: turned, past thin obstacles, and with rays that return nothing; over cells and for states.

What sensors read is drawn by an oracle of its own (`tests.sight.ray_oracle`), which shares no code with the bounds.
"""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import viatool
from tests.sight.ray_oracle import outlines, ranges
from viatool.errors import ConfigurationError
from viatool.loop import certifying
from viatool.loop.certifying import prove_cells
from viatool.loop.closed_loop import ClosedLoop
from viatool.places import Resolution, SearchBudget, certify
from viatool.sets import observations as over
from viatool.sets.forms import PoseBoxes
from viatool.sets.states import StateBoxes
from viatool.setting.setting import Setting
from viatool.setting.wishes import Wishes
from viatool.simulate.places import Places, observe_places
from viatool.taylor import elsewhere
from viatool.uncertainty import ErrorModel
from viatool.verification import verify
from viatool.verification.witness_file import witness_document
from viatool.world import Obstacles
from viatool.world.rings import ring_width

LAB = viatool.load_map("maps/lab.yaml")
POSTS = np.array(
    [[-1.6, 1.0, 0.03], [0.4, 0.6, 0.04], [1.1, -1.2, 0.02], [-0.5, -2.3, 0.05], [3.4, 0.2, 0.05]]
)
PLATE = np.array([[-0.2, 2.0], [0.9, 2.2], [0.88, 2.26], [-0.22, 2.06]])
WORLD = replace(LAB, obstacles=LAB.obstacles + Obstacles(POSTS, (PLATE,)))
NEEDLES = [[x, y, 0.003] for x in np.arange(-3.3, 3.4, 1.1) for y in np.arange(-3.3, 3.4, 1.1)]
NEEDLED = replace(LAB, obstacles=LAB.obstacles + Obstacles(np.array(NEEDLES), ()))
"""Where a ray alone decides whether something is seen."""
POLICY = viatool.load_policy("via")
SCENARIO = WORLD.scenarios[0]
LIDAR = POLICY.spec.channel("lidar").lidar.lidar()


def with_rays(count):
    """The policy, and its LiDAR with so many rays."""
    told = POLICY.spec.model_dump(mode="json", exclude_none=True)
    told["observation"][0]["lidar"]["rays"] = count
    policy = viatool.load_policy(POLICY.path, type(POLICY.spec).model_validate(told))
    return policy, policy.spec.channel("lidar").lidar.lidar()


TERMS = {
    "angle": {"absolute": 0.01, "angle": 0.05},
    "thin": {"absolute": 0.01, "thin": 0.1},
    "missing": {"absolute": 0.01, "missing": 1},
    "missing three": {"absolute": 0.01, "missing": 3},
    "all": {"absolute": 0.01, "relative": 0.02, "bias": 0.03, "angle": 0.03, "missing": 2, "thin": 0.1},
}


def setting_of(terms, job="certify", pose=None, world=WORLD, policy=POLICY):
    model = ErrorModel.model_validate({"sensor": {"lidar": terms}, "pose": pose or {}})
    wishes = Wishes(errors=model, prefer={"": "policy"})
    return Setting.of(policy, world, {"": 0.005}, wishes, [SCENARIO], job=job)


@cache
def solid():
    """Everything that rays meet, and what is left of it for rays that pass what is thin."""
    every = outlines(WORLD, SCENARIO)
    bare = outlines(LAB, SCENARIO)
    return every, bare


def unit(generator, *shape):
    drawn = generator.uniform(-1, 1, shape)
    return np.where(generator.random(shape) < 0.6, np.sign(drawn), drawn)


def rays_read(generator, poses, terms):
    """What rays (B, R) read at poses, turned and past thin obstacles."""
    turned = poses + terms.get("angle", 0.0) * unit(generator, len(poses), 1) * [0.0, 0.0, 1.0]
    every, bare = solid()
    seen = ranges(turned, LIDAR.angles(), every, LIDAR.maximum_range)
    if terms.get("thin"):
        past = ranges(turned, LIDAR.angles(), bare, LIDAR.maximum_range)
        all_alike = np.repeat(generator.random((len(poses), LIDAR.bins)) < 0.5, LIDAR.each, axis=1)
        seen = np.where(
            np.where(generator.random() < 0.5, all_alike, generator.random(seen.shape) < 0.5), past, seen
        )
    return np.maximum(seen, LIDAR.minimum_range)


def read(generator, poses, terms):
    """What bins (B, E) read at poses within the terms; rays that are lost return nothing, whatever the errors."""
    rays = rays_read(generator, poses, terms)
    count = len(poses)
    lost = np.zeros(rays.shape, dtype=bool)
    for row in range(count):
        many = generator.integers(0, terms.get("missing", 0) + 1)
        nearest = rays[row].argsort()[: 3 * LIDAR.each]
        lost[row, generator.choice(nearest, size=many, replace=False)] = True
    alike = unit(generator, count, LIDAR.bins).repeat(LIDAR.each, axis=1)
    rays = rays * (1.0 + terms.get("relative", 0.0) * alike) + terms.get("absolute", 0.0) * alike
    rays = rays + terms.get("bias", 0.0) * unit(generator, count, 1)
    return np.where(lost, LIDAR.maximum_range, rays).reshape(count, LIDAR.bins, -1).min(axis=2)


def cells_at(loop, count=40, side=0.01):
    generator = np.random.default_rng(4)
    poses = generator.uniform((-3.5, -3.5, -3.2), (3.5, 3.5, 3.2), (20 * count, 3))
    free = loop.geometry.still.clearance(poses[:, :2], np.zeros(len(poses), np.int64)) > 0.42
    poses = poses[free][:count]
    lower = generator.uniform((0.0, -1.0), (0.4, 0.6), (len(poses), 2))
    return StateBoxes(
        PoseBoxes(poses, generator.uniform(0.2, 1.0, (len(poses), 3)) * side), lower, lower + 0.02
    )


def escapes(loop, cells, bounds, terms, tries=25):
    """By how much commands of onnxruntime leave those of cells at most."""
    generator, worst = np.random.default_rng(0), -np.inf
    for _ in range(tries):
        poses = cells.poses.centre + unit(generator, len(cells), 3) * cells.poses.radius
        between = 0.5 + 0.5 * unit(generator, len(cells), 2)
        previous = cells.previous_lower + between * (cells.previous_upper - cells.previous_lower)
        seen = loop.sensors.read(poses, previous)
        seen[:, :20] = read(generator, poses, terms)
        seen[:, 20:25] += 0.005 * unit(generator, len(cells), 5)
        actions = loop.rules.clip(POLICY.run(seen.astype(np.float32).astype(float)))
        worst = max(worst, float(np.maximum(actions - bounds.upper, bounds.lower - actions).max()))
    return worst


def loop_of(terms, **options):
    return ClosedLoop.of(POLICY, setting_of(terms, **options), SCENARIO)


@pytest.mark.parametrize("name", TERMS)
def test_no_command_leaves_the_bounds_of_its_cell(name):
    loop = loop_of(TERMS[name])
    cells = cells_at(loop)
    assert escapes(loop, cells, loop.commands(cells), TERMS[name]) <= 1e-12


@pytest.mark.parametrize("term", ["angle", "thin", "missing"])
def test_onnxruntime_catches_a_term_that_is_left_out_over_cells(term):
    terms = {"absolute": 0.005, term: TERMS["all"][term]}
    loop = loop_of({name: value for name, value in terms.items() if name != term})
    cells = cells_at(loop, side=1e-3)
    assert escapes(loop, cells, loop.commands(cells), terms) > 1e-3


def test_widths_are_those_of_the_narrowest_side():
    assert ring_width(PLATE) == pytest.approx(0.06, abs=0.003)
    assert ring_width(np.array([[0, 0], [3, 0], [3, 1], [1, 1], [1, 2], [0, 2.0]])) == pytest.approx(
        2.0, rel=1e-9
    )


def test_terms_of_size_zero_change_no_bit_over_cells():
    cells = cells_at(loop_of({"absolute": 0.01}))
    plain, zero = (
        loop_of({"absolute": 0.01, **more}).commands(cells)
        for more in ({}, {"angle": 0.0, "missing": 0, "thin": 0.0})
    )
    for name in ("lower", "upper"):
        np.testing.assert_array_equal(getattr(plain, name), getattr(zero, name))


@pytest.mark.parametrize(
    ("term", "sizes"), [("angle", (0, 0.02, 0.05)), ("thin", (0, 0.08, 0.12)), ("missing", (0, 1, 2))]
)
def test_verdicts_of_cells_fall_with_every_term(term, sizes):
    cells, widths, held = cells_at(loop_of({}), count=60, side=0.03), [], []
    for size in sizes:
        loop = loop_of({"absolute": 0.01, term: size})
        bounds = loop.commands(cells)
        widths.append(float((bounds.upper - bounds.lower).sum()))
        held.append(loop.all_hold(cells, bounds.pieces))
    assert widths[0] < widths[1] < widths[2]
    assert not (held[1] & ~held[0]).any()
    assert not (held[2] & ~held[1]).any()


def near(loop, count, side=0.005):
    """Cells near something, where what is commanded decides."""
    cells = cells_at(loop, count, side)
    cells = cells.select(np.flatnonzero(~loop.holds(cells, *loop.any_commands(len(cells)))))
    return cells.select(np.flatnonzero(loop.all_hold(cells, loop.commands(cells, complete=False).pieces)))


def read_losing(generator, poses, count, lidar):
    """What bins (B, E) read at poses when rays are lost: the nearest of some bins, all of one or one of each."""
    rays = ranges(poses, lidar.angles(), outlines(NEEDLED, SCENARIO), lidar.maximum_range)
    rays = np.sort(np.maximum(rays, lidar.minimum_range).reshape(len(poses), lidar.bins, -1), axis=2)
    nothing = np.full((*rays.shape[:2], count), lidar.maximum_range)
    rays = np.concatenate([rays, nothing], axis=2)
    rows, lost = np.arange(len(poses)), np.zeros((len(poses), lidar.bins), dtype=int)
    gain = rays[:, :, count] - rays[:, :, 0]
    order = np.argsort(-gain * generator.random(gain.shape), axis=1)
    spread = generator.random(len(poses)) < 0.5
    for number in range(count):
        lost[rows, np.where(spread, order[:, number], order[:, 0])] += 1
    return np.take_along_axis(rays, lost[:, :, None], axis=2)[:, :, 0]


def wrongly_proved(terms, rays, count=8000, tries=30):
    """In how many cells that hold commands of onnxruntime with lost rays do not; and how many hold, of how many."""
    policy, lidar = with_rays(rays)
    loop = ClosedLoop.of(policy, setting_of(terms, world=NEEDLED, policy=policy), SCENARIO)
    cells, generator = near(loop, count), np.random.default_rng(0)
    holds = prove_cells(loop, cells).holds
    some = cells.select(np.flatnonzero(holds))
    lower, upper = np.full((len(some), 2), np.inf), np.full((len(some), 2), -np.inf)
    for _ in range(tries if len(some) else 0):
        poses = some.poses.centre + unit(generator, len(some), 3) * some.poses.radius
        seen = loop.sensors.read(poses, some.previous_lower)
        seen[:, :20] = read_losing(generator, poses, terms["missing"], lidar)
        returned = seen[:, :20] < lidar.maximum_range
        seen[:, :20] += terms["absolute"] * unit(generator, len(poses), 20) * returned
        actions = loop.rules.clip(policy.run(seen.astype(np.float32).astype(float)))
        lower, upper = np.minimum(lower, actions), np.maximum(upper, actions)
    wrong = ~loop.holds(some, lower, upper) if len(some) else np.zeros(0, dtype=bool)
    return int(wrong.sum()), int(holds.sum()), len(cells)


@pytest.mark.parametrize(("missing", "rays"), [(1, 20), (1, 180), (2, 60), (3, 180)])
def test_cells_hold_whatever_rays_are_lost(missing, rays):
    wrong, held, count = wrongly_proved({"absolute": 0.01, "missing": missing}, rays)
    assert wrong == 0
    assert held < count
    assert missing > 2 or held > 10


def forget_choices(monkeypatch):
    right = over.ObservationSets.choices
    monkeypatch.setattr(over.ObservationSets, "choices", lambda self, *how: list(right(self, *how))[:1])


def forget_the_largest(monkeypatch):
    right = elsewhere.FewSymbols.most
    monkeypatch.setattr(
        elsewhere.FewSymbols, "most", lambda self, slope: right(replace(self, elsewhere=self.usual), slope)
    )


@pytest.mark.parametrize(("mutate", "missing"), [(forget_choices, 1), (forget_the_largest, 3)])
def test_onnxruntime_catches_cells_that_hold_for_some_choices_alone(monkeypatch, mutate, missing):
    monkeypatch.setattr(certifying, "_may_hold", lambda loop, cells, *_: np.ones(len(cells), dtype=bool))
    mutate(monkeypatch)
    assert wrongly_proved({"absolute": 0.01, "missing": missing}, 20)[0] > 0


@pytest.fixture(scope="module")
def trajectory():
    """Poses all over the free space."""
    setting = setting_of({}, job="verify")
    return observe_places(POLICY, setting, Places(count=250), seed=3)


def verified(trajectory, terms, pose=None, **options):
    model = ErrorModel.model_validate({"sensor": {"lidar": terms}, "pose": pose or {}})
    return verify(
        POLICY, WORLD, eps={"": 0.005}, errors=model, trajectory=trajectory, refine="none",
        **{"clearance": 0.5, "danger": 0.6, "criterion": "braking", **options},
    )  # fmt: skip


def drawn(generator, recorded, poses, terms):
    """Observations (B, n) that might have been recorded instead: the scan changes as that of the map does."""
    steady = np.random.default_rng(0)
    here = read(steady, poses, {})
    there = read(generator, poses, {name: terms[name] for name in ("angle", "thin") if name in terms})
    seen = recorded.copy()
    scan = recorded[:, :20] + (there - here)
    scan = scan * (1.0 + terms.get("relative", 0.0) * unit(generator, *scan.shape))
    scan = scan + terms.get("absolute", 0.0) * unit(generator, *scan.shape)
    scan = scan + terms.get("bias", 0.0) * unit(generator, len(scan), 1)
    seen[:, :20] = np.clip(scan, LIDAR.minimum_range, LIDAR.maximum_range)
    for row in range(len(scan)):
        lost = generator.choice(20, size=generator.integers(0, terms.get("missing", 0) + 1), replace=False)
        seen[row, lost] = generator.uniform(seen[row, lost], LIDAR.maximum_range)
    return seen


@pytest.mark.parametrize("name", ["angle", "thin", "all"])
def test_no_admissible_observation_of_a_state_leaves_the_bounds(trajectory, name):
    terms, generator = TERMS[name], np.random.default_rng(1)
    result = verified(trajectory, terms, only_contested=True)
    rows = np.flatnonzero(result.contested.collision)
    assert len(rows) > 5
    for _ in range(12):
        seen = drawn(generator, result.observations[rows], result.poses[rows], terms)
        actions = POLICY.run(seen.astype(np.float32).astype(float))
        assert (actions >= result.lower[rows]).all()
        assert (actions <= result.upper[rows]).all()


@pytest.mark.parametrize("term", ["angle", "thin"])
def test_onnxruntime_catches_a_term_that_is_left_out(trajectory, term):
    terms, generator, worst = {"absolute": 0.01, term: TERMS["all"][term]}, np.random.default_rng(1), -np.inf
    result = verified(trajectory, {"absolute": 0.01})
    for _ in range(10):
        seen = drawn(generator, result.observations, result.poses, terms)
        actions = POLICY.run(seen.astype(np.float32).astype(float))
        worst = max(worst, np.nanmax(np.maximum(actions - result.upper, result.lower - actions)))
    assert worst > 1e-3


def test_terms_of_size_zero_change_no_bit(trajectory):
    plain, zero = (
        verified(trajectory, {"absolute": 0.01, **more}) for more in ({}, {"angle": 0.0, "thin": 0.0})
    )
    for name in ("lower", "upper", "verdict", "witness"):
        np.testing.assert_array_equal(getattr(plain, name), getattr(zero, name))


@pytest.mark.parametrize("term", ["angle", "thin"])
def test_verdicts_of_states_fall_with_every_term(trajectory, term):
    safe = []
    for factor in (0, 1, 2):
        terms = {"absolute": 0.01, term: factor * TERMS["all"][term]}
        safe.append(verified(trajectory, terms, only_contested=True).judgement.safe)
    assert not (safe[1] & ~safe[0]).any()
    assert not (safe[2] & ~safe[1]).any()
    assert safe[2].sum() < safe[0].sum()


def test_a_witness_obeys_the_model_exactly(trajectory):
    """What a witness file says of the errors makes the observation, by rays of the oracle."""
    terms = {"absolute": 0.01, "angle": 0.2, "thin": 0.12}
    pose = {"x": 0.02, "y": 0.02, "theta": 0.02}
    for more in ({}, pose):
        plain = verified(trajectory, {"absolute": 0.01}, more, only_contested=True)
        result = verified(trajectory, terms, more, only_contested=True)
        document = json.loads(json.dumps(witness_document(result)))["witnesses"]
        new = [one for one in document if plain.verdict[one["state"]] != "unsafe"]
        assert new
        turned = passed = 0
        for entry in document:
            recorded = result.observations[entry["state"]][:20]
            told = entry.get("errors", {}).get("lidar", {})
            pose_then = np.array(entry["pose"])[None]
            turned_then = pose_then + told.get("angle", 0.0) * np.array([0.0, 0.0, 1.0])
            away = np.abs(pose_then[0] - result.poses[entry["state"]])
            assert (away <= np.array([more.get(axis, 0.0) for axis in ("x", "y", "theta")])).all()
            assert abs(told.get("angle", 0.0)) <= terms["angle"]
            every, bare = solid()
            here, there = (
                np.maximum(ranges(at, LIDAR.angles(), every, LIDAR.maximum_range), LIDAR.minimum_range)
                for at in (pose_then, turned_then)
            )
            past = ranges(turned_then, LIDAR.angles(), bare, LIDAR.maximum_range)
            bins = np.repeat(np.isin(np.arange(20), told.get("passed", [])), LIDAR.each)
            change = np.where(bins, past, there)[0].reshape(20, -1).min(axis=1) - here[0].reshape(20, -1).min(
                axis=1
            )
            expected = np.clip(recorded + change, LIDAR.minimum_range, LIDAR.maximum_range)
            assert np.abs(np.array(entry["observation"])[:20] - expected).max() <= 0.01 + 1e-5
            turned += "angle" in told
            passed += "passed" in told
        assert turned
        assert passed


def test_what_each_term_costs_is_told(trajectory):
    terms = {"absolute": 0.01, "angle": 0.05, "thin": 0.1}
    result = verified(trajectory, terms, only_contested=True, explain_errors=True)
    told = {one.term for one in result.error_costs.terms}
    assert {"sensor.lidar.angle", "sensor.lidar.thin"} <= told
    assert "changed by as much as that of the map" in result.assumptions()["sensor_error"]


def test_certify_takes_the_terms_and_says_so():
    model = ErrorModel.model_validate({"sensor": {"lidar": TERMS["all"]}})
    smallest = Resolution(0.1, 0)
    found = certify(
        POLICY, WORLD, eps={"": 0.005}, errors=model, budget=SearchBudget(share=1e-4), resolution=smallest
    )
    told = {premise.name: premise.value for premise in found.premises}
    assert told["sensor.lidar.angle"] == "0.03 rad"
    assert told["sensor.lidar.thin"] == "0.1 m"
    assert told["sensor.lidar.missing"] == "2 rays"


@pytest.mark.parametrize(
    ("sensor", "said"),
    [
        ({"goal_distance": {"angle": 0.1}}, "sensor.goal_distance.angle: the channel is no LiDAR"),
        ({"goal_distance": {"thin": 0.1}}, "sensor.goal_distance.thin: the channel is no LiDAR"),
    ],
)
def test_what_a_channel_does_not_have_is_refused_by_name(sensor, said):
    model = ErrorModel.model_validate({"sensor": sensor})
    with pytest.raises(ConfigurationError, match=said):
        Setting.of(POLICY, WORLD, 0.01, Wishes(errors=model), job="verify")


def test_thin_obstacles_of_an_occupancy_map_are_refused_by_name():
    office, model = (
        viatool.load_map("maps/office-grid.yaml"),
        ErrorModel.model_validate({"sensor": {"lidar": {"thin": 0.1}}}),
    )
    assert office.obstacles.grid is not None
    with pytest.raises(ConfigurationError, match="thin: the cells of an occupancy map"):
        Setting.of(POLICY, office, 0.01, Wishes(errors=model, prefer={"": "map"}), job="certify")
