"""What networks take of readings: angles at the half turn, rays anywhere, scales, clips, reciprocals and frames."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from viatool import load_map
from viatool.channels import (
    BoxView,
    Frames,
    LidarSpecification,
    Quantities,
    View,
    see_precisely,
)
from viatool.channels.encoding import Encoding
from viatool.errors import EnclosureError, PolicyError
from viatool.policy import ObservationChannel, PolicySpecification
from viatool.sets.forms import Forms, PoseBoxes
from viatool.sets.states import StateBoxes
from viatool.sight.shapes import Shapes
from viatool.world import Scenes

LAB = load_map(Path("maps/lab.yaml"))
SCENARIO = LAB.scenarios[0]
ROBOT = LAB.robot
SCENES = Scenes.of(LAB, [SCENARIO])
SHAPES = Shapes.of(LAB, SCENARIO)
ROUNDING = 2e-6


def channel(kind, **rest):
    return ObservationChannel(name=f"{kind}_{len(rest)}_{rest.get('scale', 1)}", kind=kind, **rest)


def scan(name, size, encoded=None, **lidar):
    described = LidarSpecification(rays=lidar.pop("rays", size), bins=size, maximum_range=3.5, **lidar)
    return ObservationChannel(name=name, size=size, kind="lidar", lidar=described, **(encoded or {}))


_KINDS = """goal_bearing goal_x goal_y goal_x_map goal_y_map pose_x pose_y heading heading_cosine heading_sine
linear_velocity lateral_velocity angular_velocity"""
PLAIN = [channel(kind) for kind in _KINDS.split()]
ENCODED = [
    channel("goal_distance", scale=0.1, offset=-0.5),
    channel("goal_distance", clip=(0.0, 3.0)),
    channel("goal_bearing", scale=-57.29577951308232),
    channel("goal_bearing", scale=0.3183, clip=(-0.5, 0.9)),
    channel("previous_angular", scale=2.0, offset=0.25, clip=(-1.0, 1.0)),
    channel("pose_x", scale=-3.0, clip=(-6.0, 6.0)),
]
TURTLE = 2.0 * np.pi / 40
SCANS = [
    scan("once_around", 40, {"scale": 1 / 3.5}, start=0.0, step=TURTLE),
    scan("clockwise", 24, start=np.pi / 2, step=np.pi / 23, order="clockwise"),
    scan("listed", 5, angles=(0.3, -2.0, 3.1, -0.4, 1.7)),
    scan("means", 8, rays=40, start=-1.0, step=0.05, reduce="mean"),
    scan("every_third", 20, rays=60, field_of_view=2.0, reduce="first"),
    scan("nothing_is_0", 30, start=-3.0, step=0.2, no_return=0.0),
    scan("least_with_0", 10, rays=30, start=-3.0, step=0.2, no_return=0.0),
    scan("mean_with_10", 10, rays=30, start=-3.0, step=0.2, no_return=10.0, reduce="mean"),
    scan("inverse", 20, {"reciprocal": True, "clip": (0.0, 4.0)}, field_of_view=np.pi, minimum_range=0.1),
    scan("shifted", 16, {"scale": 1 / 6, "offset": -0.5}, field_of_view=np.pi),
]
ALL = [*PLAIN, *ENCODED, *SCANS]


def goal_behind(generator, count):
    """Poses of which many look away from the goal, so that its bearing is near a half turn."""
    poses = generator.uniform((-4.9, -4.9, -3.2), (4.9, 4.9, 3.2), (20 * count, 3))
    poses = poses[SCENES.clearance(poses[:, :2], np.zeros(len(poses), np.int64)) > 0.4][:count]
    away = np.arctan2(*(np.array(SCENARIO.goal) - poses[:, :2]).T[::-1])
    poses[::3, 2] = away[::3] + np.pi + generator.normal(0.0, 0.01, len(poses[::3]))
    poses[1::3, 2] = np.pi + generator.normal(0.0, 0.01, len(poses[1::3]))
    return poses


def cells_at(generator, count, side):
    centre = goal_behind(generator, count)
    lower = generator.uniform((0.0, -1.0), (0.4, 0.6), (count, 2))
    radius = generator.uniform(0.1, 1.0, (count, 3)) * side
    return StateBoxes(PoseBoxes(centre, radius), lower, lower + np.array([0.1, 0.4]))


def enclose(observed, cells, radii=None):
    dry = np.zeros(len(cells), dtype=bool)
    view = BoxView(cells, cells.forms, SHAPES, np.array(SCENARIO.goal), dry)
    return observed.require("measure", "enclose").enclose(view, radii)


def read(observed, poses, previous):
    count = len(poses)
    goals = np.broadcast_to(np.array(SCENARIO.goal), (count, 2))
    return observed.read(View(SCENES, poses, np.zeros(count, np.int64), goals, previous, eyes=see_precisely))


def escapes(observed, cells, sightings, generator, radii, rounds=20):
    """Return by how much what is observed in cells leaves every one of their parts, (n,) at most."""
    worst = np.full(observed.size, -np.inf)
    for _ in range(rounds):
        z = generator.uniform(-1, 1, (len(cells), 5))
        z[::2] = np.sign(z[::2])
        half = 0.5 * (cells.previous_upper - cells.previous_lower)
        poses = cells.poses.centre + z[:, :3] * cells.poses.radius
        readings = read(observed, poses, cells.previous_lower + (1.0 + z[:, 3:]) * half)
        readings = readings + radii * generator.choice([-1.0, 0.0, 1.0], readings.shape)
        seen = observed.observe(readings)[sightings.cell]
        forms = sightings.forms
        linear = forms.centre + np.einsum("cs,csn->cn", z[sightings.cell], forms.slope)
        excess = np.abs(seen - linear) - forms.rest - ROUNDING * (1.0 + np.abs(seen))
        for column in range(observed.size):
            least = np.full(len(cells), np.inf)
            np.minimum.at(least, sightings.cell, excess[:, column])
            worst[column] = max(worst[column], least.max())
    return worst


@pytest.mark.parametrize("side", [0.003, 0.05, 0.3])
@pytest.mark.parametrize("one", ALL, ids=lambda one: one.name)
def test_what_the_network_takes_lies_within_what_encloses_it(one, side):
    generator = np.random.default_rng(0)
    observed = Quantities.of([one], ROBOT)
    cells, radii = cells_at(generator, 150, side), np.full(observed.size, 0.01)
    if one.reciprocal:  # a reading of 0 has none
        radii = np.minimum(radii, 0.5 * one.lidar.minimum_range)
    assert escapes(observed, cells, enclose(observed, cells, radii), generator, radii).max() <= 0.0


def test_all_angles_together_are_on_all_sides_of_the_half_turn():
    """A set that reaches over the half turn in heading and in bearing is observed in four parts."""
    generator = np.random.default_rng(1)
    observed = Quantities.of([*PLAIN, *ENCODED], ROBOT)
    cells = cells_at(generator, 120, 0.05)
    goal = np.array(SCENARIO.goal)
    cells.poses.centre[:10] = np.array([goal[0] + 1.0, goal[1], np.pi - 1e-3]) + generator.normal(
        0, 1e-3, (10, 3)
    )
    cells.poses.centre[10:20] = np.array([goal[0] - 1.0, goal[1], np.pi]) + generator.normal(0, 1e-3, (10, 3))
    sightings = enclose(observed, cells, np.zeros(observed.size))
    assert np.bincount(sightings.cell)[10:20].min() == 4
    forms, size = sightings.forms, len(cells)
    for _ in range(20):
        z = generator.uniform(-1, 1, (size, 5))
        half = 0.5 * (cells.previous_upper - cells.previous_lower)
        previous = cells.previous_lower + (1.0 + z[:, 3:]) * half
        seen = observed.observe(read(observed, cells.poses.centre + z[:, :3] * cells.poses.radius, previous))
        linear = forms.centre + np.einsum("cs,csn->cn", z[sightings.cell], forms.slope)
        inside = np.abs(seen[sightings.cell] - linear) <= forms.rest + ROUNDING * (1.0 + np.abs(linear))
        held = np.zeros(size, dtype=bool)
        held[sightings.cell[inside.all(axis=1)]] = True
        assert held.all()


def test_an_angle_that_is_not_split_would_be_caught(monkeypatch):
    monkeypatch.setattr(Quantities, "_other_sides", lambda self, view: iter(()))
    generator = np.random.default_rng(0)
    observed = Quantities.of([channel("goal_bearing")], ROBOT)
    cells = cells_at(generator, 150, 0.05)
    assert escapes(observed, cells, enclose(observed, cells), generator, np.zeros(1)).max() > 1.0


@pytest.mark.parametrize("part", ["FEW_ROUNDINGS", "_reciprocal_forms", "clipped"])
def test_sampling_catches_encodings_that_leave_something_out(monkeypatch, part):
    import viatool.channels.encoding as module

    def without_rest(form, *ends):
        return replace(original(form, *ends), rest=0.0 * form.rest)

    place = Forms if part == "clipped" else module
    original = getattr(place, part)
    generator = np.random.default_rng(0)
    value = generator.uniform(0.5, 1.5, (400, 1))
    slope = np.broadcast_to(np.array([0.3, 0.1, 0.0])[None, :, None], (400, 3, 1))
    form = Forms(value, slope, np.full((400, 1), 0.02))
    encoding = {
        "FEW_ROUNDINGS": Encoding(0.1, 0.3),
        "_reciprocal_forms": Encoding(reciprocal=True),
        "clipped": Encoding(clip=(0.6, 1.2)),
    }[part]
    if part == "FEW_ROUNDINGS":
        monkeypatch.setattr(module, part, 0.0)
        form = replace(form, slope=0.0 * slope, rest=0.0 * form.rest)
    else:
        monkeypatch.setattr(place, part, without_rest)
    found, worst = encoding.forms(form), 0.0
    for _ in range(50):
        z = generator.uniform(-1, 1, (400, 3))
        at = (form.centre + np.einsum("cs,csk->ck", z, form.slope)).astype(np.float32)
        at = at + (form.rest * generator.choice([-1, 1], (400, 1))).astype(np.float32)
        scaled = np.float32(encoding.scale) * (1 / at if encoding.reciprocal else at) + np.float32(
            encoding.offset
        )
        seen = scaled if encoding.clip is None else np.clip(scaled, *encoding.clip)
        linear = found.centre + np.einsum("cs,csk->ck", z, found.slope)
        worst = max(worst, float((np.abs(seen - linear) - found.rest).max()))
    assert worst > 1e-9


@pytest.mark.parametrize(
    "encoding",
    [
        Encoding(), Encoding(-2.0, 0.5), Encoding(0.25, 0.0, (0.0, 0.5)), Encoding(3.0, -1.0, (-1.0, 2.0), True),
        Encoding(1.0, 0.0, None, True),
    ],
)  # fmt: skip
def test_the_box_around_a_recorded_input_holds_every_reading_within_eps(encoding):
    generator, eps = np.random.default_rng(3), 0.05
    true = generator.uniform(0.2, 6.0, 4000).astype(np.float32).astype(np.float64)
    recorded = encoding.apply(true.astype(np.float32)).astype(np.float32).astype(np.float64)
    least, most = encoding.readings(recorded)
    lower, upper = encoding.enclose(least - eps, most + eps)
    for sign in (-1.0, 0.3, 1.0):
        noisy = true + sign * eps
        seen = encoding.apply(noisy.astype(np.float32) if encoding else noisy)
        assert (lower <= seen).all()
        assert (seen <= upper).all()
    inner = encoding.enclose(least - eps, most + eps, within=True)
    assert (inner[0] >= lower).all()
    assert (inner[1] <= upper).all()


@pytest.mark.parametrize(
    ("encoding", "eps"), [(Encoding(1e-3, 10.0, None, True), 1.0), (Encoding(-1e3, -1.8, (0.3, 2000.0)), 1.0)]
)
def test_what_a_large_input_was_rounded_by_counts_where_it_becomes_a_small_one(encoding, eps):
    """A reading of 1.03 stands in 10.00097 up to 1 mm; of 0.03, its reciprocal is 1000 times as steep."""
    true = np.random.default_rng(4).uniform(1.02, 1.06, 4000) * np.sign(encoding.scale)
    recorded = encoding.apply(true).astype(np.float32).astype(np.float64)
    least, most = encoding.readings(recorded)
    lower, upper = encoding.enclose(least - eps, most + eps)
    for noisy in (true - np.sign(true) * eps, true):
        seen = encoding.apply(noisy).astype(np.float32)
        assert (lower <= seen).all()
        assert (seen <= upper).all()


def test_the_end_of_a_clip_counts_as_float32_holds_it():
    encoding = Encoding(0.5, 0.0, (0.0, 0.1))
    stored = np.float64(np.float32(0.1))
    assert stored > 0.1
    lower, upper = encoding.enclose(
        *(end + sign * 0.01 for end, sign in zip(encoding.readings(stored), (-1, 1), strict=True))
    )
    assert lower < 0.1
    assert upper == stored


@pytest.mark.parametrize("eps", [0.0, 1e-9, 0.05])
@pytest.mark.parametrize(
    "encoding",
    [
        Encoding(0.25, 0.1), Encoding(1e-3, 0.0, (0.0, 1000.0)), Encoding(-2.0, 0.5, (-3.0, 0.25)),
        Encoding(1.0, 0.0, (0.0, 40.0), True), Encoding(-0.1, 0.0, (-4.0, 0.0), True),
    ],
)  # fmt: skip
def test_every_input_of_a_counterexample_is_that_of_a_reading_within_eps(encoding, eps):
    generator = np.random.default_rng(5)
    true = generator.uniform(0.02, 3.0, 500)
    recorded = encoding.apply(true).astype(np.float32).astype(np.float64)
    least, most = encoding.readings(recorded, within=True)
    lower, upper = encoding.enclose(least - eps, most + eps, within=True)
    assert (lower <= upper).all()
    for share in (0.0, 0.37, 1.0):
        taken = lower + share * (upper - lower)
        if encoding.clip is not None:  # what was clipped, or is, may be anything beyond
            inside = (taken > encoding.clip[0]) & (taken < encoding.clip[1])
            inside &= (recorded > np.float32(encoding.clip[0])) & (recorded < np.float32(encoding.clip[1]))
        else:
            inside = np.ones(taken.shape, dtype=bool)
        assert inside.sum() > 100
        readings = [(value[inside] - encoding.offset) / encoding.scale for value in (taken, recorded)]
        if encoding.reciprocal:
            readings = [1.0 / value for value in readings]
        assert (np.abs(readings[0] - readings[1]) <= eps + 1e-12 * np.abs(readings[1])).all()


def test_eps_stays_in_the_unit_of_the_sensor():
    spec = PolicySpecification(
        schema_version=2,
        observation=[
            scan("scan", 4, {"scale": 0.25}, start=0.0, step=1.0),
            channel("goal_bearing", scale=1 / np.pi),
        ],
        action=[
            {"name": "v", "lower": 0, "upper": 1, "kind": "linear"},
            {"name": "w", "lower": -1, "upper": 1},
        ],
    )
    lower, upper = spec.inputs.box(np.full((1, 5), 0.5), spec.radii({"scan": 0.1, "": 0.2}))
    np.testing.assert_allclose((upper - lower)[0], [0.05, 0.05, 0.05, 0.05, 0.4 / np.pi], rtol=1e-4)
    assert spec.radii(0.1).tolist() == [0.1] * 5


def test_the_reciprocal_of_nothing_is_refused():
    with pytest.raises(EnclosureError, match="clip"):
        Encoding(reciprocal=True).enclose(np.array([-0.01]), np.array([0.3]))


def test_rays_point_where_the_specification_says():
    """A robot in a corridor: the wall is to the left, so only rays to the left are short."""
    pose = np.array([[0.0, 0.0, 0.0]])
    left, right = np.deg2rad(80), np.deg2rad(-80)
    for one, expected in (
        (scan("listed", 2, angles=(left, right)), (left, right)),
        (scan("started", 2, start=left, step=right - left), (left, right)),
        (scan("reversed", 2, field_of_view=left - right, order="clockwise"), (left, right)),
    ):
        np.testing.assert_allclose(one.lidar.lidar().angles(), expected, atol=1e-12)
        seen = read(Quantities.of([one], ROBOT), pose, np.zeros((1, 2)))
        alone = [
            read(Quantities.of([scan("one", 1, angles=(angle,))], ROBOT), pose, np.zeros((1, 2)))[0, 0]
            for angle in expected
        ]
        np.testing.assert_allclose(seen[0], alone)


def test_a_full_circle_of_version_2_has_no_ray_twice():
    text = {
        "observation": [
            {
                "name": "scan",
                "kind": "lidar",
                "lidar": {"field_of_view": 6.2832, "rays": 360, "maximum_range": 3.5},
            }
        ],
        "action": [{"name": "v", "lower": 0, "upper": 1, "kind": "linear"}],
    }
    spec = PolicySpecification.model_validate({**text, "schema_version": 2})
    angles = spec.observation[0].lidar.lidar().angles()
    assert spec.observation[0].size == 360
    np.testing.assert_allclose(np.diff(angles), np.pi / 180)
    assert angles[-1] < np.pi - 0.01


@pytest.mark.parametrize("view", [6.29, 270.0, 360.0])
def test_degrees_are_not_taken_for_a_full_circle(view):
    one = {
        "name": "scan",
        "kind": "lidar",
        "lidar": {"field_of_view": view, "rays": 40, "maximum_range": 3.5},
    }
    text = {"observation": [one], "action": [{"name": "v", "lower": 0, "upper": 1, "kind": "linear"}]}
    with pytest.raises(ValidationError, match=r"field_of_view is .* in radians"):
        PolicySpecification.model_validate({**text, "schema_version": 2})


@pytest.mark.parametrize("clip", [(0.0, 4.0), (-3.0, 0.1), (0.5, 30.0)])
def test_the_reciprocal_of_what_may_be_0_lies_within_its_clip(clip):
    """Sets around the goal, and beside it: how far it is may be 0, also by the error of the sensor."""
    generator = np.random.default_rng(6)
    observed = Quantities.of([channel("goal_distance", reciprocal=True, clip=clip), channel("pose_x")], ROBOT)
    cells, radii = cells_at(generator, 120, 0.1), np.array([0.05, 0.0])
    cells.poses.centre[:60, :2] = np.array(SCENARIO.goal) + generator.normal(0.0, 0.15, (60, 2))
    sightings = enclose(observed, cells, radii)
    assert escapes(observed, cells, sightings, generator, radii).max() <= 0.0
    unknown = np.ptp([sightings.forms.lower[:, 0], sightings.forms.upper[:, 0]], axis=0) > 0.99 * np.ptp(clip)
    assert 5 < unknown.sum() < 70
    with pytest.raises(EnclosureError, match="its reciprocal anything\nhint: give the channel the `clip`"):
        enclose(Quantities.of([channel("goal_distance", reciprocal=True)], ROBOT), cells)


@pytest.mark.parametrize("kind", ["goal_distance", "pose_x"])
def test_a_reading_without_bounds_is_refused_by_its_channel(kind):
    observed = Quantities.of([channel("heading"), channel(kind, reciprocal=True)], ROBOT)
    with pytest.raises(EnclosureError, match=f"channel '{kind}_1_1' of kind '{kind}': a reading may be 0"):
        observed.inputs.box(np.array([[0.1, 5.0]]), np.array([0.0, 0.3]))


@pytest.mark.parametrize(
    ("lidar", "message"),
    [
        ({"start": 0.0, "step": 0.1, "rays": 80}, "more than a full turn"),
        ({"start": 0.0, "step": 0.0, "rays": 3}, "rays 0 and 1 overlap"),
        ({"angles": (0.0, 1.0, 6.283185307)}, "rays 0 and 2 overlap"),
        ({"angles": (0.0, 90.0, 180.0)}, "span 180 rad, .* in radians, not in degrees"),
        ({"angles": (-10.0, -5.0, 0.0)}, "span 10 rad, .* in radians, not in degrees"),
        ({"angles": (9.0, 10.0)}, "points at 10 rad, outside of any scan"),
        ({"start": -30.0, "step": 1.0, "rays": 3}, "points at -30 rad, outside of any scan"),
        ({"field_of_view": 270.0, "rays": 40}, "field_of_view is 270.0 rad, .* in radians"),
        ({"start": 0.0, "rays": 3}, "belong together"),
        ({"rays": 3}, "give one of"),
        ({"field_of_view": 3.0, "start": 0.0, "step": 0.1, "rays": 3}, "give one of"),
        ({"angles": (0.0, 1.0), "rays": 3}, "2 angles for 3 rays"),
    ],
)
def test_rays_that_make_no_scan_are_refused(lidar, message):
    with pytest.raises(ValidationError, match=message):
        LidarSpecification(maximum_range=3.5, **lidar)


def test_frames_are_filled_in_their_order():
    channels = [channel("goal_distance"), channel("heading")]
    readings, past = np.array([[10.0, 1.0]]), np.array([[[11.0, 2.0], [12.0, 3.0], [13.0, 4.0], [14.0, 5.0]]])
    whole = Quantities.of(channels, ROBOT, Frames(count=3, stride=2))
    assert whole.observe(readings, past).tolist() == [[14.0, 5.0, 12.0, 3.0, 10.0, 1.0]]
    assert whole.observe(readings).tolist() == [[10.0, 1.0] * 3]
    assert whole.observe(readings, past[:, :1]).tolist() == [[11.0, 2.0, 11.0, 2.0, 10.0, 1.0]]
    each = [one.model_copy(update={"frames": Frames(count=2, order="newest_first")}) for one in channels]
    assert Quantities.of(each, ROBOT).observe(readings, past).tolist() == [[10.0, 11.0, 1.0, 2.0]]
    with pytest.raises(PolicyError, match="frames that are up to 4 steps old"):
        whole.require("enclose")
