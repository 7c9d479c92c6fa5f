"""A robot with errors that are known is recorded: what is measured covers them, and little more."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from tests import bags
from viatool import load_errors, load_map
from viatool.cli import main
from viatool.errors import ConfigurationError, TrajectoryError
from viatool.identification import Bounding, Identification, measure_errors
from viatool.world import Lidar, Scenes, WorldMap

ROOM = """
schema_version: 1
arena: {shape: box, center: [3.0, 2.0], size: [6.0, 4.0]}
obstacles:
  - {shape: box, center: [3.0, 3.3], size: [0.8, 0.5]}
robot: {lidar: {field_of_view: 6.2, rays: 120, bins: 12, maximum_range: 8.0}}
"""
WIDEST = 1.5


@dataclass
class Flaws:
    """Errors of a robot; drawn within their bounds (of motors, at their ends), each scan, reading and command anew."""

    absolute: float = 0.0
    relative: float = 0.0
    bias: float = 0.0
    turned: float = 0.0
    missing: int = 0
    shift: float = 0.0
    delay: tuple[float, float] = (0.0, 0.0)
    lag: tuple[float, float] = (0.0, 0.0)
    acceleration: float = np.inf
    gain: float = 0.0
    offset: float = 0.0
    interval: tuple[float, float] = (0.1, 0.1)
    age: tuple[float, float] = (0.0, 0.0)
    seed: int = 0
    leave_out: tuple[str, ...] = field(default=())


def recorded(folder: Path, flaws: Flaws, *, seconds: float = 80.0, kind: str = "mcap") -> Path:
    """Drive to and fro along the room, command by command, and record it."""
    rng = np.random.default_rng(flaws.seed)
    times, commands = commanded(rng, flaws, seconds)
    clock = np.arange(0.0, seconds, 0.004)
    velocity = followed(rng, flaws, clock, times, commands)
    poses = np.array([1.0, 1.5, 0.0]) + np.concatenate([np.zeros((1, 3)), driven(velocity, 0.004)])[:-1]
    messages = [bags.static_transform("base_link", "laser", bags.START, (0.05, 0.0, 0.0))]
    for row in range(0, len(clock), 5):
        now = stamp(clock[row])
        message = bags.odometry(now, "map", poses[row])
        message.fields["twist"]["twist"] = bags.twist(*velocity[row].tolist())
        messages.append(message)
    lidar = load_map_text(folder).robot.lidar
    for at in np.arange(0.05, seconds, 0.1).tolist():
        pose = poses[int(at / 0.004)]
        messages.append(scanned(rng, flaws, folder, lidar, at, pose))
    for at, command in zip(times.tolist(), commands.tolist(), strict=True):
        messages.append(bags.Message("/cmd_vel", bags.TWIST, stamp(at), bags.twist(*command)))
    kept = [message for message in messages if message.topic not in flaws.leave_out]
    return bags.write_bag(folder / "run", kept, kind)


def stamp(seconds: float) -> int:
    return bags.START + round(1e9 * seconds)


def commanded(rng: np.random.Generator, flaws: Flaws, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Return when commands are given and what: held for two seconds each, ahead and back, and a little turn."""
    apart = rng.uniform(*flaws.interval, round(seconds / flaws.interval[0]))
    times = np.concatenate([[0.1], 0.1 + np.cumsum(apart)])
    if flaws.age[1] > 0.0:  # scans come at 0.05 s and every 0.1 s from then on
        times = 0.05 + 0.1 * np.arange(1, len(times) + 1) + rng.uniform(*flaws.age, len(times))
    times = times[times < seconds]
    ahead = np.array([0.0, 0.4, 0.0, -0.4, 0.0, 0.2, 0.0, -0.2])[(times // 2.0).astype(int) % 8]
    turning = np.array([0.0, 0.5, 0.0, -0.5])[(times // 2.0).astype(int) % 4]
    return times, np.stack([ahead, turning], axis=1)


def followed(
    rng: np.random.Generator, flaws: Flaws, clock: np.ndarray, times: np.ndarray, commands: np.ndarray
) -> np.ndarray:
    """Return the velocities that the robot has, by small steps; delay and lag change with every new command."""
    step, velocity, found = clock[1] - clock[0], np.zeros(2), np.zeros((len(clock), 2))
    new = np.concatenate([[True], np.any(np.diff(commands, axis=0) != 0.0, axis=1)])
    group = np.cumsum(new) - 1
    delay = rng.choice(flaws.delay, group[-1] + 1)[group]
    lag = rng.choice(flaws.lag, group[-1] + 1)[group]
    acts = np.maximum.accumulate(times + delay)
    last = np.searchsorted(acts, clock, side="right") - 1
    gain = 1.0 + flaws.gain * rng.choice([-1.0, 1.0], (len(clock) // 50 + 1, 2)).repeat(50, axis=0)
    offset = flaws.offset * rng.choice([-1.0, 1.0], (len(clock) // 50 + 1, 2)).repeat(50, axis=0)
    for row in range(len(clock)):
        target = commands[last[row]] * gain[row] + offset[row] if last[row] >= 0 else np.zeros(2)
        tau = lag[last[row]] if last[row] >= 0 else 0.0
        share = 1.0 if tau == 0.0 else 1.0 - np.exp(-step / tau)
        limit = flaws.acceleration * step
        velocity = velocity + np.clip((target - velocity) * share, -limit, limit)
        found[row] = velocity
    return found


def driven(velocity: np.ndarray, step: float) -> np.ndarray:
    heading = np.cumsum(velocity[:, 1]) * step
    moved = velocity[:, :1] * np.stack([np.cos(heading), np.sin(heading)], axis=1) * step
    return np.column_stack([np.cumsum(moved, axis=0), heading])


READ: dict[Path, WorldMap] = {}


def load_map_text(folder: Path) -> WorldMap:
    path = folder / "room.yaml"
    if path not in READ:
        path.write_text(ROOM)
        READ[path] = load_map(path)
    return READ[path]


def scanned(
    rng: np.random.Generator, flaws: Flaws, folder: Path, lidar: Lidar, at: float, pose: np.ndarray
) -> bags.Message:
    """Return a scan of a LiDAR that stands 5 cm before the robot's origin, where localisation errs by a shift."""
    true = pose + np.array([*(flaws.shift * rng.uniform(-1.0, 1.0, 2)), 0.0])
    mounted = true + np.array([0.05 * np.cos(true[2]), 0.05 * np.sin(true[2]), flaws.turned])
    scenes = Scenes.of(load_map_text(folder), [None])
    ranges = scenes.cast(mounted[None], np.zeros(1, int), lidar)[0]
    ranges = ranges * (1.0 + flaws.relative * rng.uniform(-1.0, 1.0, len(ranges)))
    ranges = (
        ranges + flaws.absolute * rng.uniform(-1.0, 1.0, len(ranges)) + flaws.bias * rng.uniform(-1.0, 1.0)
    )
    ranges[rng.choice(len(ranges), rng.integers(0, flaws.missing + 1), replace=False)] = np.inf
    return bags.scan(stamp(at), lidar.angles(), ranges, 0.0, lidar.maximum_range)


def measured(folder: Path, flaws: Flaws, **settings) -> Identification:  # type: ignore[no-untyped-def]
    return measure_errors(recorded(folder, flaws, **settings), load_map_text(folder))


def values(found: Identification) -> dict[str, object]:
    return {term.place: term.value for term in found.measured}


def test_errors_of_readings_are_covered_and_not_exaggerated(tmp_path: Path) -> None:
    found = values(measured(tmp_path, Flaws(absolute=0.03), seconds=30.0))
    assert 0.03 <= found["sensor.lidar.absolute"] <= WIDEST * 0.03
    assert not {"sensor.lidar.bias", "sensor.lidar.relative", "sensor.lidar.angle", "pose.x"} & found.keys()
    assert found["sensor.lidar.missing"] == 0


def test_errors_that_grow_with_the_range_are_told_apart(tmp_path: Path) -> None:
    found = values(measured(tmp_path, Flaws(relative=0.02, absolute=0.01), seconds=30.0))
    assert 0.02 / WIDEST <= found["sensor.lidar.relative"] <= WIDEST * 0.02
    for size in (1.0, 2.0, 5.0):
        bound = found["sensor.lidar.absolute"] + found["sensor.lidar.relative"] * size
        assert 0.01 + 0.02 * size <= 1.05 * bound
        assert bound <= WIDEST * (0.01 + 0.02 * size)


def test_what_scans_have_in_common_is_told_from_what_readings_have(tmp_path: Path) -> None:
    flaws = Flaws(absolute=0.01, bias=0.04, missing=3)
    found = values(measured(tmp_path, flaws, seconds=40.0))
    assert 0.04 <= found["sensor.lidar.bias"] <= WIDEST * 0.04
    assert 0.01 <= found["sensor.lidar.absolute"] <= WIDEST * 0.01
    assert found["sensor.lidar.missing"] in (2, 3)  # of flat surfaces: a lost ray near an edge is not counted


def test_pose_and_mount_are_told_by_fitting_scans_to_the_map(tmp_path: Path) -> None:
    flaws = Flaws(absolute=0.01, shift=0.05, turned=0.03)
    found = values(measured(tmp_path, flaws, seconds=40.0))
    for axis in ("x", "y"):
        assert 0.05 <= found[f"pose.{axis}"] <= WIDEST * 0.05
    assert 0.03 <= found["sensor.lidar.angle"] <= WIDEST * 0.03
    assert 0.01 <= found["sensor.lidar.absolute"] <= WIDEST * 0.01


def test_motors_and_clock_are_covered_and_not_exaggerated(tmp_path: Path) -> None:
    flaws = Flaws(absolute=0.01, delay=(0.06, 0.1), lag=(0.1, 0.16), interval=(0.08, 0.12))
    found = measured(tmp_path, flaws, seconds=64.0)
    told = values(found)
    for place, planted in (("timing.interval", flaws.interval),):
        low, high = told[place]
        assert low <= planted[0]
        assert planted[1] <= high
        assert high - low <= WIDEST * (planted[1] - planted[0])
    for place, planted in (("timing.delay", flaws.delay), ("actuation.linear.lag", flaws.lag)):
        low, high = told[place]
        width = planted[1] - planted[0]
        assert low <= planted[0] + 0.05 * width
        assert planted[1] - 0.05 * width <= high
        assert high - low <= WIDEST * width + 0.01  # resolution: odometry comes every 0.02 s
    assert "actuation.linear.acceleration" not in told


def test_limits_of_acceleration_and_tracking(tmp_path: Path) -> None:
    flaws = Flaws(absolute=0.01, acceleration=0.8, gain=0.05, offset=0.004)
    told = values(measured(tmp_path, flaws, seconds=48.0))
    for axis in ("linear", "angular"):
        for name in ("acceleration", "deceleration"):
            assert 0.8 / WIDEST <= told[f"actuation.{axis}.{name}"] <= 0.8
    bound = told["actuation.linear.absolute"] + 0.4 * told["actuation.linear.relative"]
    assert 1.05 * bound >= 0.004 + 0.4 * 0.05
    assert bound <= WIDEST * (0.004 + 0.4 * 0.05)


def test_the_age_of_scans_is_measured(tmp_path: Path) -> None:
    told = values(measured(tmp_path, Flaws(absolute=0.01, age=(0.01, 0.04)), seconds=30.0))
    assert 1.02 * told["timing.sensing"] >= 0.04
    assert told["timing.sensing"] <= WIDEST * 0.04


@pytest.mark.parametrize(
    ("topic", "lacks"),
    [
        ("/odom", {"sensor.lidar, pose", "actuation, timing.delay"}),
        ("/cmd_vel", {"actuation, timing"}),
        ("/scan", {"sensor.lidar, pose, timing.sensing"}),
    ],
)
def test_what_a_bag_lacks_is_named_and_the_rest_is_measured(
    tmp_path: Path, topic: str, lacks: set[str]
) -> None:
    found = measured(tmp_path, Flaws(absolute=0.02, leave_out=(topic,)), seconds=15.0)
    reasons = {term.place: term.reason for term in found.unmeasured}
    assert lacks <= reasons.keys()
    assert all("topic" in reasons[place] for place in lacks)
    assert found.measured
    assert all(place in found.to_yaml() for place in lacks)


def test_scans_without_stamps_tell_no_ranges(tmp_path: Path) -> None:
    rng, flaws = np.random.default_rng(0), Flaws()
    messages = [bags.odometry(stamp(0.1 * row), "map", np.array([1.0, 1.0, 0.0])) for row in range(40)]
    lidar = load_map_text(tmp_path).robot.lidar
    for row in range(40):
        message = scanned(rng, flaws, tmp_path, lidar, 0.1 * row, np.array([1.0, 1.0, 0.0]))
        message.fields["header"] = bags.header(0, "base_link")
        messages.append(message)
    found = measure_errors(bags.write_bag(tmp_path / "run", messages, "mcap"), load_map_text(tmp_path))
    assert "the scans have no stamps" in {term.reason for term in found.unmeasured}


def test_the_file_is_an_error_model_that_says_where_it_comes_from(tmp_path: Path) -> None:
    found = measured(tmp_path, Flaws(absolute=0.02, delay=(0.05, 0.06)), seconds=30.0)
    path = tmp_path / "robot-errors.yaml"
    path.write_text(found.to_yaml())
    model = load_errors(path)
    assert {place for place, *_ in model.stated()} == set(values(found))
    assert model.sensor["lidar"].absolute >= values(found)["sensor.lidar.absolute"]
    assert "samples; mean" in path.read_text()
    assert "# Not measured:" in path.read_text()


def test_bounds_are_rounded_outward() -> None:
    bounding = Bounding(1.0, 0.0)
    assert bounding.largest(np.array([0.1, -0.2])) == 0.2
    assert bounding.span(np.array([1.0, 2.0])) == (1.0, 2.0)
    assert Bounding(1.0, 0.25).slowest(np.array([1.0, 2.0])) == 0.8


@pytest.mark.parametrize("wrong", [{"quantile": 0.4}, {"quantile": 1.1}, {"margin": -0.1}])
def test_bounds_that_make_no_sense_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ConfigurationError, match=next(iter(wrong))):
        Bounding(**wrong)


def test_the_command_writes_the_file_and_tells_what_it_could_not_measure(tmp_path: Path) -> None:
    path = recorded(tmp_path, Flaws(absolute=0.02, leave_out=("/cmd_vel",)), seconds=10.0)
    load_map_text(tmp_path)
    target = tmp_path / "robot-errors.yaml"
    run = CliRunner().invoke(
        main, ["measure-errors", str(path), "--map", str(tmp_path / "room.yaml"), "--output", str(target)]
    )
    assert run.exit_code == 0, run.output
    assert "sensor.lidar.absolute" in run.output
    assert "not measured: actuation, timing: the bag has no command topic" in " ".join(run.output.split())
    assert load_errors(target).sensor["lidar"].absolute < 0.03


def test_what_is_no_bag_is_refused(tmp_path: Path) -> None:
    (tmp_path / "run.npz").write_bytes(b"")
    with pytest.raises(TrajectoryError, match="no ROS bag"):
        measure_errors(tmp_path / "run.npz", load_map_text(tmp_path))
