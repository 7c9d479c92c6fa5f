"""Largest memory of reading and writing recorded states, as npz, csv and bags, beside what the states themselves take.

    python tests/benchmarks/streaming.py [--states 100000 1000000] [--kinds npz csv mcap sqlite3 rosbag1]

Makes recordings of made-up states in a temporary folder (a bag of a million scans takes about a gigabyte there), and
reads and writes each in a process of its own, whose largest resident size the system tells.
"""

from __future__ import annotations

import argparse
import resource
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

import numpy as np

EPISODE = 250  # states
CHANNELS = 26
KINDS = ("npz", "csv", "mcap", "sqlite3", "rosbag1")


def make_trajectory(states: int):
    from viatool.trajectory import Trajectory
    from viatool.world import Scenario

    rng = np.random.default_rng(0)
    episodes = -(-states // EPISODE)
    return Trajectory(
        poses=rng.uniform(-4.0, 4.0, (states, 3)),
        observations=rng.uniform(0.2, 7.0, (states, CHANNELS)).astype(np.float32),
        actions=rng.uniform(-1.0, 1.0, (states, 2)),
        episode=np.arange(states) // EPISODE,
        time=0.1 * (np.arange(states) % EPISODE),
        outcomes=np.full(episodes, "success"),
        costs=np.zeros(episodes),
        scenarios=tuple(Scenario(f"drive-{n}", (0.0, 0.0, 0.0), (1.0, 1.0)) for n in range(episodes)),
    )


def make_bag(path: Path, states: int, kind: str) -> Path:
    """Write scans, odometry and commands; messages are patched as bytes, which is many times as fast."""
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import StoragePlugin, Writer

    from tests.bags import ROS1, ROS2, START, Message, build, odometry, scan, twist

    first = kind == "rosbag1"
    store = ROS1 if first else ROS2
    target = path.with_suffix(".bag") if first else path
    plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
    angles = np.linspace(-np.pi / 2, np.pi / 2, 180)
    templates = (
        odometry(START, "map", np.zeros(3)),
        scan(START, angles, np.full(180, 2.0), 0.2, 7.0),
        Message("/cmd_vel", "geometry_msgs/msg/Twist", START, twist(0.3, 0.1)),
    )
    templates[1].fields["header"]["frame_id"] = "base_link"
    serialize = store.serialize_ros1 if first else store.serialize_cdr
    with Writer1(target) if first else Writer(target, version=9, storage_plugin=plugin) as writer:
        prepared = []
        for message in templates:
            connection = writer.add_connection(message.topic, message.type, typestore=store)
            raw = bytearray(serialize(build(store, message.type, message.fields), message.type))
            prepared.append((connection, raw))
        for number in range(states):
            now = START + 100_000_000 * number
            for shift, (connection, raw) in enumerate(prepared):
                if connection.topic != "/cmd_vel":
                    struct.pack_into("<II", raw, 4, *divmod(now, 10**9))
                writer.write(connection, now + 1_000_000 * (shift + 1), bytes(raw))
    return target


def measure(action: str, path: Path, states: int) -> None:
    """Do one thing, and print the largest resident size (MB) and the seconds of CPU that it took."""
    from tests.safety.hand_made_policy import specification
    from viatool.trajectory import BagSettings, load_trajectory, write_trajectory

    if action == "make":
        make_trajectory(states)
    elif action == "write":
        write_trajectory(path, make_trajectory(states))
    elif path.suffix in (".npz", ".csv"):
        assert len(load_trajectory(path)) == states
    else:
        found = load_trajectory(path, specification(), BagSettings(goal=(1.0, 1.0)))
        assert len(found) == states
    used = resource.getrusage(resource.RUSAGE_SELF)
    print(used.ru_maxrss / 1000, used.ru_utime + used.ru_stime)


def apart(action: str, path: Path, states: int) -> tuple[float, float]:
    command = [sys.executable, __file__, "--measure", action, str(path), "--states", str(states)]
    out = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, cwd=ROOT).stdout.split()
    return float(out[0]), float(out[1])


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--states", type=int, nargs="+", default=[100_000, 1_000_000])
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS)
    parser.add_argument("--measure", nargs=2, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.measure:
        measure(given.measure[0], Path(given.measure[1]), given.states[0])
        return
    for states in given.states:
        each = 8 * (3 + CHANNELS + 2 + 2)
        print(f"{states:,} states of {each} bytes: {each * states / 1e6:.0f} MB", flush=True)
        print(f"  {'no file at all':<18} {apart('make', Path('none'), states)[0]:7.0f} MB", flush=True)
        for kind in given.kinds:
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder) / f"states.{kind}"
                if kind in ("npz", "csv"):
                    written, seconds = apart("write", path, states)
                    print(f"  {f'write {kind}':<18} {written:7.0f} MB {seconds:7.1f} s CPU", flush=True)
                else:
                    started = time.process_time()
                    path = make_bag(Path(folder) / "bag", states, kind)
                    print(f"  ({kind} made in {time.process_time() - started:.0f} s CPU)", flush=True)
                read, seconds = apart("read", path, states)
                print(f"  {f'read {kind}':<18} {read:7.0f} MB {seconds:7.1f} s CPU", flush=True)


if __name__ == "__main__":
    main()
