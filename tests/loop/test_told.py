"""Outputs of the step before and the time that is left, over sets of states: runs by school formulas stay within."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.loop.noisy_runs import arc
from viatool import certify, mission, roll_out, verify
from viatool.errors import PolicyError
from viatool.loop.closed_loop import ClosedLoop
from viatool.loop.horizon import Horizon
from viatool.loop.runs import drive
from viatool.loop.told import OutputsBefore, Told
from viatool.loop.tube import TubeFollower
from viatool.places import Resolution, SearchBudget
from viatool.policy import Activation, Affine, Input, Network, PolicySpecification, load_policy, write_onnx
from viatool.policy.activations import activation
from viatool.sets.forms import PoseBoxes
from viatool.sets.states import StateBoxes
from viatool.setting.setting import Setting
from viatool.simulate import Places, observe_places
from viatool.taylor.outputs import output_range
from viatool.world import load_map

MAP = """\
schema_version: 1
arena: {shape: box, center: [0, 0], size: [6, 6]}
robot: {footprint: {shape: point}, control_interval: 0.1, max_linear: 0.3, max_angular: 1.0}
clearance: {collision: 0.4, danger: 0.5}
scenarios: [{name: ahead, start: [-1.0, 0.0, 0.0], goal: [1.0, 0.5]}]
"""
GOAL, EPISODE = np.array([1.0, 0.5]), 300
SCALE, OFFSET = np.array([0.25, 1.5]), np.array([0.1, 0.0])
LOWER, UPPER = np.array([0.0, -1.0]), np.array([0.3, 1.0])
EPS = {"far": 0.02, "bearing": 0.02, "raw": 0.01, "left": 0.0}
RADII = np.array([0.02, 0.02, 0.01, 0.01, 0.0])
CHANNELS = [
    {"name": "far", "kind": "goal_distance", "scale": 0.5},
    {"name": "bearing", "kind": "goal_bearing"},
    {"name": "raw", "kind": "previous_raw", "size": 2},
    {"name": "left", "kind": "steps_left", "scale": 0.01},
]
WEIGHTS = np.array([[0.5, 0.0], [0.0, 0.9], [0.5, 0.2], [0.1, 0.4], [0.15, 0.05]])
"""How far each input moves the two outputs before the squash."""


def described(channels=CHANNELS, **action):
    limits = [{"lower": 0.0, "upper": 0.3}, {"lower": -1.0, "upper": 1.0}]
    kinds = [("v", "m/s", "linear"), ("w", "rad/s", "angular")]
    actions = [
        {"name": name, "unit": unit, "kind": kind, "scale": scale, "offset": offset, **limit, **action}
        for (name, unit, kind), scale, offset, limit in zip(kinds, SCALE, OFFSET, limits, strict=True)
    ]
    return PolicySpecification.model_validate(
        {"schema_version": 2, "control_interval": 0.1, "observation": channels, "action": actions}
    )


def written(folder, spec, squash="Tanh"):
    size = spec.observation_size
    nodes = [
        Input(size),
        Affine((0,), (np.float32(WEIGHTS[:size].T).astype(float),), np.float32([-0.25, 0.0]).astype(float)),
        *([Activation(1, activation(squash), 2)] if squash else []),
    ]
    write_onnx(Network(tuple(nodes)), spec, folder / "policy.onnx")
    return load_policy(folder / "policy.onnx")


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    path = tmp_path_factory.mktemp("square") / "square.yaml"
    path.write_text(MAP)
    return load_map(path)


@pytest.fixture(scope="module")
def policy(tmp_path_factory):
    return written(tmp_path_factory.mktemp("policy"), described())


@pytest.fixture(scope="module")
def loop(policy, world):
    return ClosedLoop.of(policy, Setting.of(policy, world, EPS), world.scenarios[0], episode=EPISODE)


def sensed(poses, raw, left):
    """What sensors read, (B, 5), in their units."""
    dx, dy = GOAL[:, None] - poses[:, :2].T
    turned = np.arctan2(dy, dx) - poses[:, 2]
    bearing = np.arctan2(np.sin(turned), np.cos(turned))
    return np.column_stack([np.hypot(dx, dy), bearing, raw, np.broadcast_to(left, len(poses))])


def taken(readings):
    return readings * np.array([0.5, 1.0, 1.0, 1.0, 0.01])


def sent(raw):
    """The command that robots carry out of outputs (B, 2)."""
    return np.clip(SCALE * raw + OFFSET, LOWER, UPPER)


def errors(generator, count):
    free = generator.uniform(-1.0, 1.0, (count, 5))
    return RADII * np.where(generator.random((count, 1)) < 0.5, np.sign(free), free)


def cells_of(generator, count):
    """Cells with the outputs (C, 2) of which a command in each was made; the first are where robots stood."""
    raw = generator.uniform(-1.0, 1.0, (count, 2))
    raw[: count // 4] = 0.0
    before = sent(raw)
    before[: count // 4] = 0.0
    # ends that lie where the command is clipped, and others
    low = np.maximum(before - generator.uniform(0.0, 0.08, (count, 2)), LOWER)
    high = np.minimum(before + generator.uniform(0.0, 0.08, (count, 2)), UPPER)
    centre = generator.uniform((-2.0, -2.0, -2.8), (0.5, 2.0, 2.8), (count, 3))
    centre[:, 2] += np.arctan2(*(GOAL - centre[:, :2]).T[::-1])  # the goal is not behind
    return StateBoxes(PoseBoxes(centre, np.full((count, 3), 0.01)), low, high), raw


def missed(loop, cells, raw):
    """Tell what leaves its enclosure: the readings of cells (C,), and the commands that follow."""
    generator = np.random.default_rng(1)
    forms, commands = loop.sensors.enclose(cells).forms, loop.commands(cells)
    seen_outside = commands_outside = False
    for _ in range(20):
        poses = cells.poses.centre + generator.uniform(-1, 1, (len(cells), 3)) * cells.poses.radius
        readings = sensed(poses, raw, generator.integers(0, EPISODE + 1, len(cells)))
        seen = taken(readings + errors(generator, len(cells)))
        seen_outside |= bool(((seen < forms.lower - 1e-9) | (seen > forms.upper + 1e-9)).any())
        found = sent(loop.policy.outputs(seen))
        outside = (found < commands.lower) | (found > commands.upper)
        commands_outside |= bool(outside.any())
    return seen_outside, commands_outside


def test_what_was_given_before_lies_within_what_the_command_tells(loop):
    cells, raw = cells_of(np.random.default_rng(0), 400)
    assert missed(loop, cells, raw) == (False, False)
    tight = loop.sensors.enclose(cells).forms
    inner = ((cells.previous_lower > LOWER + 1e-6) & (cells.previous_upper < UPPER - 1e-6)).all(axis=1)
    width = (tight.upper - tight.lower)[inner, 2:4]
    told = (cells.previous_upper - cells.previous_lower)[inner] / SCALE + 0.02
    np.testing.assert_allclose(width, told, rtol=1e-6)  # as far as the command before varies, and no farther
    assert (tight.upper - tight.lower)[~inner, 2:4].max() > 1.0


@pytest.mark.parametrize("rule", ["clipped", "stood", "range", "episode"])
def test_each_rule_is_needed(loop, monkeypatch, rule):
    if rule == "clipped":
        monkeypatch.setattr(
            OutputsBefore, "_inner", lambda self, first, last: np.ones((2, *first.shape), bool)
        )
    elif rule == "stood":
        enclose = OutputsBefore.enclose

        def never(self, cells, states):
            apart = np.where(cells.previous_lower == 0.0, 1e-12, cells.previous_lower)
            return enclose(self, StateBoxes(cells.poses, apart, cells.previous_upper), states)

        monkeypatch.setattr(OutputsBefore, "enclose", never)
    elif rule == "range":
        narrow = loop.sensors.recollection.outputs
        monkeypatch.setitem(narrow.__dict__, "upper", np.full(2, 0.7))
    else:
        monkeypatch.setitem(loop.sensors.recollection.__dict__, "episode", 200)
    cells, raw = cells_of(np.random.default_rng(0), 400)
    assert missed(loop, cells, raw)[0]


def test_certified_cells_are_safe_whatever_was_given_before(policy, world):
    certificate = certify(
        policy, world, world.scenarios[0], eps=EPS, criterion="swept", resolution=Resolution(0.1, 1),
        budget=SearchBudget(share=0.03), seed=1,
    )  # fmt: skip
    assert "up to the 300 of an episode" in str(certificate.premises)
    table, generator = certificate.cell_table(), np.random.default_rng(0)
    proved = table["status"] == "certified"
    assert proved.sum() > 20
    lower, upper = table["lower"][proved], table["upper"][proved]
    counted = 0
    for _ in range(200):
        raw = generator.uniform(-1.0, 1.0, (len(lower), 2))
        raw[generator.random(len(raw)) < 0.2] = 0.0
        poses = generator.uniform(lower[:, :3], upper[:, :3])
        stood = (raw == 0.0).all(axis=1)
        before = np.where(stood[:, None], 0.0, sent(raw))
        there = ((before >= lower[:, 3:]) & (before <= upper[:, 3:])).all(axis=1)
        there &= 3.0 - np.abs(poses[:, :2]).max(axis=1) > 0.4
        counted += int(there.sum())
        readings = sensed(poses[there], raw[there], generator.integers(0, EPISODE + 1, int(there.sum())))
        found = sent(policy.outputs(taken(readings + errors(generator, int(there.sum())))))
        assert (3.0 - np.abs(arc(poses[there], found, 0.1)[:, :2]).max(axis=1) > 0.4 - 1e-6).all()
    assert counted > 1000


def begun(generator, count):
    """Recorded states under way: poses, commands before, and what was told of them."""
    poses = generator.uniform((-1.5, -1.0, -0.5), (-0.5, 1.0, 0.5), (count, 3))
    raw, left = generator.uniform(-1.0, 1.0, (count, 2)), generator.integers(20, EPISODE, count).astype(float)
    told = Told(np.stack([left, left], axis=1), np.stack([raw, raw], axis=1))
    return poses, raw, left, told


def strayed(loop, told_of=lambda told: told, steps=6):
    """Whether some run leaves its tube."""
    generator = np.random.default_rng(3)
    poses, raw, left, told = begun(generator, 40)
    follower = TubeFollower(loop, 0.3, Horizon(steps, 0.005, 0.005))
    tubes = follower.follow(poses, sent(raw), told=told_of(told))
    for _ in range(60):
        now = poses + generator.choice([-1.0, 1.0], poses.shape) * 0.005
        given = raw
        for k in range(steps):
            seen = taken(sensed(now, given, left - k) + errors(generator, len(now)))
            given = loop.policy.outputs(seen)
            now = arc(now, sent(given), 0.1)
            if not ((tubes.lower[:, k] - 1e-6 <= now) & (now <= tubes.upper[:, k] + 1e-6)).all():
                return True
    assert (tubes.upper - tubes.lower)[:, -1, :2].max() < 0.08
    return False


def test_runs_stay_in_their_tubes(loop, monkeypatch):
    assert not strayed(loop)
    assert strayed(loop, lambda told: Told(told.left + 100.0, told.raw))
    assert strayed(loop, lambda told: Told(told.left, 0.0 * told.raw))
    monkeypatch.setattr(Told, "after", lambda self, intervals: self)  # outputs of the first step for ever
    assert strayed(loop)


def test_runs_of_the_search_recall_what_they_gave(loop):
    generator = np.random.default_rng(5)
    poses, raw, left, told = begun(generator, 10)
    follower = TubeFollower(loop, 0.1, Horizon(4))
    runs = drive(follower, poses, sent(raw), np.zeros((10, 4, 5)), told=told)
    for k in range(4):
        seen = taken(sensed(runs.poses[:, k], raw, left - k))
        np.testing.assert_allclose(runs.observations[:, k], seen, atol=1e-6)
        raw = loop.policy.outputs(runs.observations[:, k])
    resting = drive(follower, poses, np.zeros((10, 2)), np.zeros((10, 1, 5)))
    np.testing.assert_allclose(
        resting.observations[:, 0], taken(sensed(poses, np.zeros((10, 2)), EPISODE)), atol=1e-6
    )


def test_a_mission_counts_its_own_time_and_simulated_runs_stay_in_it(policy, world):
    near = [replace(world.scenarios[0], start=(0.0, 0.2, 0.2))]
    found = mission(
        policy, world, eps=0.002, scenarios=near, start_error=(0.005, 0.005), time_limit=9.0
    ).missions[0]
    assert found.verdict == "proved", found.reason
    driven = roll_out(policy, world, near, horizon=90, noise=0.0)
    assert driven.outcomes.tolist() == ["success"]
    tube = found.proof.tube
    for k in range(1, len(driven)):
        here = tube.step == k
        inside = (tube.lower[here, :3] - 1e-6 <= driven.poses[k]) & (
            driven.poses[k] <= tube.upper[here, :3] + 1e-6
        )
        assert inside.all(axis=1).any(), k


def test_a_horizon_begins_with_what_was_recorded(policy, world):
    driven = roll_out(policy, world, horizon=150, noise=0.0)
    result = verify(policy, world, eps=0.001, trajectory=driven, horizon=Horizon(3))
    lower, upper = result.horizon.tubes.lower, result.horizon.tubes.upper
    for k in range(3):
        rows = np.arange(len(driven) - k - 1)
        after = driven.poses[rows + k + 1]
        known = np.isfinite(lower[rows, k]).all(axis=1)
        assert known.sum() > 20
        assert ((lower[rows, k] - 1e-6 <= after) & (after <= upper[rows, k] + 1e-6))[known].all()


def test_a_command_that_a_rule_sends_tells_nothing_of_the_outputs(tmp_path, world):
    rules = [{"when": {"far": {"below": 0.9}}, "command": [0.1, 0.0]}]
    spec = PolicySpecification.model_validate(
        {**described().model_dump(exclude_none=True), "overrides": rules}
    )
    ruled = written(tmp_path, spec)
    loop = ClosedLoop.of(ruled, Setting.of(ruled, world, 0.0), world.scenarios[0], episode=EPISODE)
    cells, _ = cells_of(np.random.default_rng(2), 20)
    forms = loop.sensors.enclose(cells).forms
    assert (forms.lower[:, 2:4] <= -1.0).all()
    assert (forms.upper[:, 2:4] >= 1.0).all()
    assert (forms.upper[:, 2:4] <= 1.00001).all()


def test_at_picked_poses_the_outputs_are_those_of_the_command_before(policy, world):
    setting = Setting.of(policy, world, EPS)
    observations = observe_places(policy, setting, Places(count=5)).observations
    standing = observations * np.array([1.0, 1.0, 0.0, 0.0, 1.0])
    np.testing.assert_allclose(observations[:, 2:4], policy.outputs(standing), atol=1e-6)


def test_what_nothing_bounds_is_refused_by_name(tmp_path, world):
    spec = described(CHANNELS[:3])
    linear = written(tmp_path, spec, squash="")
    with pytest.raises(
        PolicyError, match=r"'raw' of kind 'previous_raw' is not known .*nothing limits what"
    ) as raised:
        ClosedLoop.of(linear, Setting.of(linear, world, 0.0), world.scenarios[0])
    assert "clip" in raised.value.hint
    clipped = described([*CHANNELS[:2], {**CHANNELS[2], "clip": [-1.0, 1.0]}])
    held = written(tmp_path, clipped, squash="")
    cells, _ = cells_of(np.random.default_rng(2), 50)
    forms = ClosedLoop.of(held, Setting.of(held, world, 0.0), world.scenarios[0]).sensors.enclose(cells).forms
    assert (forms.lower[:, 2:] >= -2.1).all()
    assert (forms.upper[:, 2:] <= 2.1).all()  # readings; a clip at 1 makes no more of them
    timed = written(tmp_path, described(CHANNELS))
    with pytest.raises(PolicyError, match=r"'left' of kind 'steps_left' is not known .*how long an episode"):
        ClosedLoop.of(timed, Setting.of(timed, world, 0.0), world.scenarios[0])


@pytest.mark.parametrize("squash", ["Tanh", "Sigmoid", "Clip"])
def test_the_range_of_a_network_holds_what_its_program_gives(tmp_path, squash):
    generator = np.random.default_rng(4)
    function = activation("Clip", min=-0.5, max=0.75) if squash == "Clip" else activation(squash)
    weights = [
        generator.normal(0, 3, shape).astype(np.float32).astype(float) for shape in ((16, 3), (2, 16), (2, 2))
    ]
    nodes = (
        Input(3),
        Affine((0,), (weights[0],), np.zeros(16)),
        Activation(1, activation("Relu"), 16),
        Affine((2,), (weights[1],), np.zeros(2)),
        Activation(3, function, 2),
        Affine((4,), (weights[2],), np.array([0.5, -0.25])),
    )
    spec = PolicySpecification.model_validate(
        {
            "schema_version": 2,
            "observation": [{"name": "a", "kind": "other", "size": 3}],
            "action": [
                {"name": "v", "kind": "linear", "lower": -99.0, "upper": 99.0},
                {"name": "w", "kind": "angular", "lower": -99.0, "upper": 99.0},
            ],
        }
    )
    write_onnx(Network(nodes), spec, tmp_path / "policy.onnx")
    policy = load_policy(tmp_path / "policy.onnx")
    lower, upper = output_range(policy.own)
    given = policy.outputs(generator.normal(0, 30, (4000, 3)))
    assert (lower <= given).all()
    assert (given <= upper).all()
    assert (upper - lower <= 1.0001 * (given.max(axis=0) - given.min(axis=0))).all()
    bare = Network(nodes[:4])
    assert np.isinf(output_range([bare])).all()
