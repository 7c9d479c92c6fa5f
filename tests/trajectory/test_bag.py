"""Bags of the project's own simulator, read back, and everything that can be wrong with a bag."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.bags import (
    KINDS,
    MILLISECOND,
    drive_messages,
    header,
    odometry,
    only_file,
    static_transform,
    transform,
    write_bag,
)
from tests.safety.hand_made_policy import specification, write_policy
from viatool.channels import Frames
from viatool.errors import ConfigurationError, EmptyEvaluationError, PolicyError, TrajectoryError
from viatool.policy import ObservationChannel, load_policy
from viatool.trajectory import BagSettings, Topics, load_trajectory
from viatool.world import load_map

LAB = load_map("maps/lab.yaml")
GOAL = LAB.scenarios[0].goal
SETTINGS = BagSettings(goal=GOAL)
SPECIFICATION = specification()


@pytest.fixture(scope="module")
def policy(tmp_path_factory):
    return load_policy(
        write_policy(tmp_path_factory.mktemp("policy") / "policy.onnx", SPECIFICATION, caution=0.05)
    )


@pytest.fixture(scope="module")
def plain(policy):
    return drive_messages(policy, LAB)


@pytest.fixture(scope="module")
def drifted(policy):
    return drive_messages(policy, LAB, drift=(1.0, -2.0, 0.7), mount=0.4)


def read(path, messages, kind="mcap", settings=SETTINGS, spec=SPECIFICATION, **options):
    return load_trajectory(write_bag(path / "run", messages, kind, **options), spec, settings)


def changed(messages, topic, row, **fields):
    """Return the messages with fields of one message of a topic replaced."""
    messages = copy.deepcopy(messages)
    [message for message in messages if message.topic == topic][row].fields.update(fields)
    return messages


def told(trajectory):
    return "; ".join(trajectory.notes)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("case", ["plain", "drifted"])
def test_a_bag_holds_the_states_that_the_simulator_drove(tmp_path, request, kind, case):
    messages, driven = request.getfixturevalue(case)
    states = read(tmp_path, messages, kind)
    np.testing.assert_allclose(states.poses, driven.poses, atol=1e-12)
    np.testing.assert_allclose(states.observations, driven.observations, atol=5e-5)
    np.testing.assert_allclose(states.time, driven.time, atol=1e-9)
    assert states.outcomes.tolist() == ["unknown"]
    assert f"all {len(driven)} scans" in told(states)
    assert ("moved by the recorded transform from 'map'" in told(states)) == (case == "drifted")


@pytest.mark.parametrize("case", ["plain", "drifted"])
def test_scans_that_are_read_a_few_at_a_time_give_the_same_states(tmp_path, request, monkeypatch, case):
    messages = request.getfixturevalue(case)[0]
    messages = changed(messages, "/scan", 2, ranges=np.full(180, np.nan, np.float32))
    messages = [
        m for m in messages if m.received > messages[0].received + 400 * MILLISECOND or m.topic != "/cmd_vel"
    ]
    whole = read(tmp_path, messages)
    for together in (1, 7):
        monkeypatch.setattr("viatool.trajectory.bag._SCANS", together)
        parts = load_trajectory(tmp_path / "run", SPECIFICATION, SETTINGS)
        assert parts.notes == whole.notes
        for name in ("poses", "observations", "time"):
            np.testing.assert_array_equal(getattr(parts, name), getattr(whole, name))
    assert "without a recent command" not in told(whole)
    assert "left out: 1 with a bin" in told(whole)
    late = changed(messages, "/scan", 14, header=header(10**9, "laser"))
    with pytest.raises(TrajectoryError, match=r"goes back by .* in message 14"):
        read(tmp_path / "late", late)
    wrong = changed(messages, "/scan", 9, range_max=0.0)
    with pytest.raises(TrajectoryError, match="scan 9 has the first angle"):
        read(tmp_path / "wrong", wrong)


@pytest.mark.parametrize("at_once", [7, 1000])
def test_frames_are_filled_with_what_was_recorded_before(tmp_path, plain, monkeypatch, at_once):
    """Every second interval back, three times: what has no such past is left out and told."""
    monkeypatch.setattr("viatool.trajectory.bag._SCANS", at_once)
    messages, driven = plain
    stacked = SPECIFICATION.model_copy(update={"schema_version": 2, "frames": Frames(count=3, stride=2)})
    found = read(tmp_path, messages, spec=stacked)
    seen = driven.observations.astype(np.float32).astype(np.float64)
    expected = np.concatenate([seen[:-4], seen[2:-2], seen[4:]], axis=1)
    np.testing.assert_allclose(found.observations, expected, atol=1e-4)
    assert "4 without the frames before" in told(found)


def test_measured_velocities_are_those_of_the_odometry(tmp_path, plain):
    messages, driven = plain
    channels = [*SPECIFICATION.observation, ObservationChannel(name="turning", kind="angular_velocity")]
    spinning = copy.deepcopy(messages)
    rates = 5.0 * np.sin(np.arange(len(driven)))  # faster than half a turn a second
    for rate, message in zip(rates, [m for m in spinning if m.topic == "/odom"], strict=True):
        message.fields["twist"]["twist"]["angular"]["z"] = float(rate)
    found = read(tmp_path, spinning, spec=SPECIFICATION.model_copy(update={"observation": channels}))
    np.testing.assert_allclose(found.observations[:, -1], rates[-len(found) :], atol=1e-5)


@pytest.mark.parametrize("kind", ["mcap", "sqlite3"])
def test_the_file_of_a_bag_is_enough(tmp_path, plain, kind):
    folder = write_bag(tmp_path / "run", plain[0], kind)
    states = load_trajectory(only_file(folder), SPECIFICATION, SETTINGS)
    assert len(states) == len(plain[1])


def test_odometry_is_the_map_frame_only_on_the_users_word(tmp_path, plain, drifted):
    messages = [m for m in drifted[0] if m.topic != "/tf"]
    with pytest.raises(TrajectoryError, match="no transform from 'map' to 'odom'") as caught:
        read(tmp_path, messages)
    assert "--frame odom" in caught.value.hint
    states = read(tmp_path / "again", messages, settings=replace(SETTINGS, frame="odom"))
    assert "'odom', taken as the map's" in told(states)
    assert np.abs(states.poses - drifted[1].poses).max() > 0.5


def test_poses_are_interpolated_between_stamps_and_never_beyond(tmp_path, plain):
    messages = copy.deepcopy(plain[0])
    for message in messages:
        if message.topic == "/scan":
            stamp = message.fields["header"]["stamp"]
            now = stamp["sec"] * 10**9 + stamp["nanosec"] + 50 * MILLISECOND
            message.fields["header"] = header(now, "laser")
    states = read(tmp_path, messages)
    middle = 0.5 * (plain[1].poses[:-1, :2] + plain[1].poses[1:, :2])
    np.testing.assert_allclose(states.poses[:, :2], middle, atol=1e-9)
    assert "left out: 1 without a pose" in told(states)


def test_a_gap_in_the_odometry_leaves_its_scans_out(tmp_path, plain):
    rows = [row for row, m in enumerate(plain[0]) if m.topic == "/odom"]
    messages = [m for row, m in enumerate(plain[0]) if row not in rows[20:30]]
    states = read(tmp_path, messages)
    np.testing.assert_allclose(states.poses, np.delete(plain[1].poses, np.s_[20:30], axis=0), atol=1e-12)
    assert "left out: 10 without a pose" in told(states)


def test_a_gap_in_the_commands_leaves_the_scans_out_that_have_no_recent_one(tmp_path, plain):
    rows = [row for row, m in enumerate(plain[0]) if m.topic == "/cmd_vel"]
    messages = [m for row, m in enumerate(plain[0]) if row not in rows[20:30]]
    states = read(tmp_path, messages)
    assert "left out: 6 without a recent command" in told(states)
    assert len(states) == len(plain[1]) - 6


def test_readings_that_are_no_distances_are_told_and_never_invented(tmp_path, plain):
    scans = [m for m in plain[0] if m.topic == "/scan"]
    ranges = [m.fields["ranges"].copy() for m in scans[:4]]
    ranges[0][0:9] = np.nan  # the whole first bin
    ranges[1][0:8] = np.nan  # all but one ray of it
    ranges[2][9] = -np.inf
    ranges[3][18] = 0.0
    messages = plain[0]
    for row, values in enumerate(ranges):
        messages = changed(messages, "/scan", row, ranges=values)
    states = read(tmp_path, messages)
    expected = plain[1].observations[1:]
    assert len(states) == len(expected)
    assert "left out: 1 with a bin that measured nothing" in told(states)
    assert "18 of" in told(states)
    assert "not measurements" in told(states)
    np.testing.assert_allclose(states.observations[0, 0], min(ranges[1][8], 7.0), atol=1e-6)
    np.testing.assert_allclose(states.observations[1, 1], 0.2, atol=1e-6)
    np.testing.assert_allclose(states.observations[3:], expected[3:], atol=5e-5)


def test_a_sensor_with_more_rays_all_around_is_binned_like_the_policys(tmp_path, plain):
    angles = np.linspace(-np.pi, np.pi, 720, endpoint=False)
    messages = plain[0]
    for row in range(len(plain[1])):
        ranges = np.where(np.abs(angles) < np.pi / 2 + 0.01, 1.0 + 0.1 * angles, 0.3).astype(np.float32)
        messages = changed(
            messages,
            "/scan",
            row,
            ranges=ranges,
            angle_min=-np.pi,
            angle_increment=np.pi / 360,
            range_max=3.5,
        )
    states = read(tmp_path, messages)
    assert (np.diff(states.observations[:, :20], axis=1) > 0).all()
    assert states.observations[:, :20].min() > 0.8
    assert "720 rays binned like the policy's 180" in told(states)
    assert "sees 3.5 m far" in told(states)


def test_names_that_are_not_the_usual_ones_are_found_or_asked_for(tmp_path, plain):
    messages = copy.deepcopy(plain[0])
    for message in messages:
        message.topic = {"/scan": "/front/laser", "/cmd_vel": "/drive"}.get(message.topic, message.topic)
    assert len(read(tmp_path, messages)) == len(plain[1])
    second = copy.deepcopy([m for m in messages if m.topic == "/front/laser"])
    for message in second:
        message.topic = "/rear/laser"
    with pytest.raises(TrajectoryError, match="several scan topics: /front/laser, /rear/laser"):
        read(tmp_path / "two", messages + second)
    asked = replace(SETTINGS, topics=Topics(scan="/front/laser"))
    assert len(read(tmp_path / "asked", messages + second, settings=asked)) == len(plain[1])
    with pytest.raises(TrajectoryError, match="'/none'"):
        read(tmp_path / "none", messages, settings=replace(SETTINGS, topics=Topics(scan="/none")))
    measured = replace(SETTINGS, topics=Topics(command="/odom"))
    states = read(tmp_path / "measured", [m for m in messages if m.topic != "/drive"], settings=measured)
    assert (states.observations[:, 23:25] == 0.0).all()


@pytest.mark.parametrize(("topic", "name"), [("/scan", "scans"), ("/odom", "odometry")])
def test_messages_that_nobody_stamped_are_refused(tmp_path, plain, topic, name):
    messages = copy.deepcopy(plain[0])
    for message in messages:
        if message.topic == topic:
            message.fields["header"]["stamp"] = {"sec": 0, "nanosec": 0}
    with pytest.raises(TrajectoryError, match=f"the headers of {name} have no stamps"):
        read(tmp_path, messages)


@pytest.mark.parametrize("topic", ["/scan", "/odom", "/cmd_vel", "/tf_static"])
def test_a_missing_topic_is_named(tmp_path, plain, topic):
    with pytest.raises(TrajectoryError, match={"/tf_static": "no transform"}.get(topic, "the bag has no")):
        read(tmp_path, [m for m in plain[0] if m.topic != topic])


def wrong(name, messages):
    """Return messages with one thing wrong."""
    first = [m for m in messages if m.topic == "/odom"][5]
    nan = odometry(0, "map", np.array([np.nan, 0.0, 0.0])).fields["pose"]
    zero = copy.deepcopy(first.fields["pose"])
    zero["pose"]["orientation"] = dict.fromkeys("xyzw", 0.0)
    early = header(10**9, "laser")
    return {
        "clock of scans": lambda: changed(messages, "/scan", 5, header=early),
        "clock of odometry": lambda: changed(messages, "/odom", 5, header=header(10**9, "map")),
        "nan pose": lambda: changed(messages, "/odom", 5, pose=nan),
        "no rotation": lambda: changed(messages, "/odom", 5, pose=zero),
        "frames change": lambda: changed(messages, "/odom", 5, child_frame_id="other"),
        "scan frames": lambda: changed(messages, "/scan", 5, header=header(2 * 10**18, "other")),
        "narrow": lambda: changed(messages, "/scan", 5, angle_increment=0.01),
        "no range": lambda: changed(messages, "/scan", 5, range_max=0.0),
        "nan step": lambda: changed(messages, "/scan", 5, angle_increment=float("nan")),
        "nan command": lambda: changed(messages, "/cmd_vel", 5, linear={"x": np.nan, "y": 0.0, "z": 0.0}),
        "tilted": lambda: [*messages, tilted()],
        "moving": lambda: [
            *(m for m in messages if m.topic != "/tf_static"),
            *(
                transform("/tf", "base_link", "laser", m.received, (0.0, 0.0, 0.1 * row))
                for row, m in enumerate(m for m in messages if m.topic == "/odom")
            ),
        ],
        "two parents": lambda: [*messages, static_transform("map", "laser", 0, (0.0, 0.0, 0.0))],
    }[name]()


def tilted(roll=0.0, pitch=0.3, turn=0.0):
    """Return the transform of a LiDAR that is turned about z, then pitched about its y, then rolled about its x."""
    message = static_transform("base_link", "laser", 0, (0.0, 0.0, 0.0))
    message.fields["transforms"][0]["transform"]["rotation"] = rotation(roll, pitch, turn)
    return message


def rotation(roll, pitch, turn):
    x, y, z, w = Rotation.from_euler("ZYX", [turn, pitch, roll]).as_quat().tolist()
    return {"x": x, "y": y, "z": z, "w": w}


def mounted(messages, roll, pitch, turn, *, upside_down):
    """Return messages of a drive whose LiDAR sits so on the robot: its rays as it would have recorded them."""
    messages = [m for m in copy.deepcopy(messages) if m.topic != "/tf_static"]
    for message in messages:
        if message.topic == "/scan":
            fields = message.fields
            angles = fields["angle_min"] + fields["angle_increment"] * np.arange(180)  # on the robot
            if upside_down:
                fields["ranges"], angles = fields["ranges"][::-1].copy(), turn - angles[::-1]
            else:
                angles = angles - turn
            fields["angle_min"], fields["angle_max"] = float(angles[0]), float(angles[-1])
    return [*messages, tilted(roll, pitch, turn)]


# Rolled by half a turn, and the same as a pitch by half a turn, which faces backwards as well.
UPSIDE_DOWN = {
    "rolled": (np.pi, 0.0, 0.0),
    "rolled and turned": (np.pi, 0.0, 0.7),
    "pitched": (0.0, np.pi, np.pi),
    "nearly level": (np.pi - 0.01, 0.01, -0.4),
}


@pytest.mark.parametrize("name", UPSIDE_DOWN)
def test_a_lidar_that_hangs_upside_down_counts_its_rays_from_the_other_side(tmp_path, plain, name):
    roll, pitch, turn = UPSIDE_DOWN[name]
    heading = np.arctan2(*(Rotation.from_euler("ZYX", [turn, pitch, roll]).as_matrix()[1::-1, 0]))
    messages = mounted(plain[0], roll, pitch, heading, upside_down=True)
    messages[-1] = tilted(roll, pitch, turn)
    states = read(tmp_path, messages)
    np.testing.assert_allclose(states.observations, plain[1].observations, atol=5e-5)
    assert "upside down" in told(states)
    assert "upside down" not in told(read(tmp_path / "upright", plain[0]))


def test_a_base_that_lies_upside_down_in_the_tree_turns_its_children_over(tmp_path, plain):
    """The robot's own frame points downwards (as in marine robots) and the LiDAR's upwards: the sensor hangs in it."""
    messages = [m for m in copy.deepcopy(plain[0]) if m.topic != "/tf_static"]
    plate = tilted(np.pi, 0.0, 0.5)
    plate.fields["transforms"][0]["child_frame_id"] = "plate"
    laser = tilted(np.pi, 0.0, 0.5)  # rolled back; a turn within the plate runs the other way
    laser.fields["transforms"][0]["header"] = header(0, "plate")
    states = read(tmp_path, [*messages, plate, laser])
    np.testing.assert_allclose(states.observations, plain[1].observations, atol=5e-5)
    assert "upside down" not in told(states)


@pytest.mark.parametrize(
    ("roll", "pitch", "degrees"), [(0.0, 0.3, "17.2"), (0.03, 0.0, "1.7"), (np.pi - 0.2, 0.0, "168.5")]
)
def test_a_lidar_that_is_not_level_is_refused_with_its_tilt(tmp_path, plain, roll, pitch, degrees):
    messages = [*plain[0], tilted(roll, pitch, 0.4)]
    with pytest.raises(TrajectoryError, match=rf"'laser' is tilted within 'base_link' by {degrees} degrees"):
        read(tmp_path, messages)
    assert len(read(tmp_path / "level", [*plain[0], tilted(0.01, 0.01, 0.0)])) == len(plain[1])


def test_a_robot_that_lies_upside_down_is_refused(tmp_path, plain, drifted):
    over = copy.deepcopy([m for m in plain[0] if m.topic == "/odom"][5].fields["pose"])
    over["pose"]["orientation"] = rotation(np.pi, 0.0, 0.3)
    with pytest.raises(TrajectoryError, match="odometry message 5 has the robot upside down"):
        read(tmp_path, changed(plain[0], "/odom", 5, pose=over))
    messages = copy.deepcopy(drifted[0])
    for message in messages:
        if message.topic == "/tf":
            message.fields["transforms"][0]["transform"]["rotation"] = rotation(np.pi, 0.0, 0.7)
    with pytest.raises(TrajectoryError, match="'odom' lies upside down in 'map'"):
        read(tmp_path / "tree", messages)


@pytest.mark.parametrize("kind", ["mcap", "sqlite3"])
def test_the_folder_of_a_bag_that_lost_its_metadata_is_read(tmp_path, plain, kind):
    folder = write_bag(tmp_path / "run", plain[0], kind)
    whole = load_trajectory(folder, SPECIFICATION, SETTINGS)
    (folder / "metadata.yaml").unlink()
    (folder / "notes.txt").write_text("copied by hand", encoding="utf-8")
    states = load_trajectory(folder, SPECIFICATION, SETTINGS)
    np.testing.assert_array_equal(states.observations, whole.observations)
    assert states.scenarios[0].name == "run"


@pytest.mark.parametrize("kind", ["mcap", "sqlite3"])
def test_the_parts_of_a_split_bag_without_metadata_are_read_in_their_order(tmp_path, plain, kind):
    half = plain[0][len(plain[0]) // 2].received
    frames = [m for m in plain[0] if m.topic == "/tf_static"]
    late = [m for m in plain[0] if m.received >= half]
    parts = [[m for m in plain[0] if m.received < half], [*frames, *late]]
    (tmp_path / "run").mkdir()
    for number, messages in enumerate(parts):
        file = only_file(write_bag(tmp_path / f"part{number}", messages, kind))
        file.rename(tmp_path / "run" / f"run_{number}{file.suffix}")
    states = load_trajectory(tmp_path / "run", SPECIFICATION, SETTINGS)
    np.testing.assert_allclose(states.poses, plain[1].poses, atol=1e-12)
    (tmp_path / "run" / f"run_0{file.suffix}").rename(tmp_path / "run" / f"other{file.suffix}")
    with pytest.raises(
        TrajectoryError, match=r"holds 2 files \(other.*, run_1.*\) and no metadata.yaml"
    ) as caught:
        load_trajectory(tmp_path / "run", SPECIFICATION, SETTINGS)
    assert "name one of the files" in caught.value.hint


def test_a_folder_that_is_no_bag_is_named_as_a_folder(tmp_path):
    (tmp_path / "empty").mkdir()
    with pytest.raises(TrajectoryError, match=r"empty' is a folder without metadata.yaml and without a .bag"):
        load_trajectory(tmp_path / "empty", SPECIFICATION, SETTINGS)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("clock of scans", "clock of the scan messages goes back by .* in message 5"),
        ("clock of odometry", "clock of the odometry messages goes back"),
        ("nan pose", "odometry message 5 has the pose"),
        ("no rotation", "odometry message 5 has the pose"),
        ("frames change", "odometry changes its frames"),
        ("scan frames", "from several frames: laser, other"),
        ("narrow", "leaves bin 12 .* without a ray|leaves bin"),
        ("no range", "scan 5 has the first angle"),
        ("nan step", "scan 5 has the first angle"),
        ("nan command", "command 5 is"),
        ("tilted", "'laser' is tilted"),
        ("moving", "moves on the robot"),
        ("two parents", "'laser' lies in"),
    ],
)
def test_what_is_wrong_with_a_bag_is_named_with_its_path(tmp_path, plain, name, message):
    with pytest.raises(TrajectoryError, match=message) as caught:
        read(tmp_path, wrong(name, plain[0]))
    assert str(tmp_path / "run") in caught.value.message
    assert caught.value.hint


def test_what_is_wrong_elsewhere_in_the_tree_of_frames_does_not_matter(tmp_path, plain):
    camera = tilted()
    camera.fields["transforms"][0]["child_frame_id"] = "camera"
    other = transform("/tf", "map", "camera", plain[0][0].received, (0.0, 0.0, 0.0))
    assert len(read(tmp_path, [*plain[0], camera, other])) == len(plain[1])


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("kept", [0, 300, 20_000])
def test_a_cut_off_bag_is_refused(tmp_path, plain, kind, kept):
    path = write_bag(tmp_path / "run", plain[0], kind)
    file = path if path.is_file() else only_file(path)
    file.write_bytes(file.read_bytes()[:kept])
    with pytest.raises(TrajectoryError, match="not a readable bag"):
        load_trajectory(path, SPECIFICATION, SETTINGS)


@pytest.mark.parametrize("kind", KINDS)
def test_a_bag_without_messages_leaves_nothing_to_evaluate(tmp_path, plain, kind):
    with pytest.raises(EmptyEvaluationError, match="holds no scans"):
        read(tmp_path, plain[0], kind, empty=("/scan",))
    with pytest.raises(EmptyEvaluationError, match="holds no odometry"):
        read(tmp_path / "poses", plain[0], kind, empty=("/odom",))


def test_scans_without_any_measurement_leave_nothing_to_evaluate(tmp_path, plain):
    messages = plain[0]
    for row in range(len(plain[1])):
        messages = changed(messages, "/scan", row, ranges=np.full(180, np.nan, np.float32))
    with pytest.raises(EmptyEvaluationError, match="with a bin that measured nothing"):
        read(tmp_path, messages)


def test_what_a_bag_does_not_hold_is_asked_for(tmp_path, plain):
    with pytest.raises(ConfigurationError, match="observes its goal"):
        read(tmp_path, plain[0], settings=BagSettings())
    with pytest.raises(ConfigurationError, match="goal of the bag is"):
        BagSettings(goal=(float("nan"), 0.0))
    with pytest.raises(PolicyError, match="no"):
        load_trajectory(tmp_path / "run", None, SETTINGS)
    unfixed = specification()
    channels = [*unfixed.observation[:-1], unfixed.observation[-1].model_copy(update={"value": None})]
    with pytest.raises(PolicyError, match="'budget'"):
        load_trajectory(tmp_path / "run", specification(observation=channels), SETTINGS)
