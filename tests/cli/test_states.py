"""Recorded states, bags and sampled poses on the command line: what works, and how each bad input exits."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from click.testing import Result

from tests.bags import Message, drive_messages, header, odometry, only_file, scan, write_bag
from viatool.policy import load_policy
from viatool.trajectory import Trajectory
from viatool.world import load_map

Run = Callable[..., Result]
VERIFY = ("verify", "policy.onnx", "--map", "map.yaml", "--eps", "0.01", "--only-contested")
GOAL = ("--goal", "1.5,0")
Recording = tuple[list[Message], Trajectory]


@pytest.fixture(scope="module")
def recording(hall: Path) -> Recording:
    messages, driven = drive_messages(load_policy(hall / "policy.onnx"), load_map(hall / "map.yaml"))
    return messages, driven


@pytest.fixture
def bag(recording: Recording, tmp_path: Path) -> Path:
    return write_bag(tmp_path / "run", recording[0], "mcap")


def arrays_of(path: Path) -> dict[str, np.ndarray]:
    with np.load(path) as archive:
        return dict(archive)


@pytest.mark.parametrize("kind", ["rosbag1", "sqlite3", "mcap"])
def test_a_bag_gives_the_verdicts_of_the_drive_that_it_recorded(
    run: Run, recording: Recording, tmp_path: Path, kind: str
) -> None:
    path, states = write_bag(tmp_path / "run", recording[0], kind), tmp_path / "states.npz"
    result = run(*VERIFY, "--trajectory", path, *GOAL, "--output", f"states:{states}")
    assert result.exit_code == 0, result.output
    table, driven = arrays_of(states), recording[1]
    np.testing.assert_allclose(table["pose"], driven.poses, atol=1e-9)
    np.testing.assert_allclose(table["observation"], driven.observations, atol=5e-5)
    simulated = tmp_path / "simulated.npz"
    run(*VERIFY, "--noise", "0", "--output", f"states:{simulated}")
    expected = arrays_of(simulated)
    first = expected["episode"] == 0
    np.testing.assert_array_equal(table["verdict"], expected["verdict"][first])
    assert (table["verdict"] == "unsafe").any()


def test_the_report_says_what_was_made_of_the_bag(run: Run, bag: Path, tmp_path: Path) -> None:
    report = tmp_path / "report.json"
    arguments = ("--trajectory", bag, *GOAL, "--output", f"json:{report}", "--output")
    assert run(*VERIFY, *arguments, f"figure:{tmp_path / 'run.png'}").exit_code == 0
    assumed = json.loads(report.read_text())["assumptions"]["states"]
    for text in (f"read from {bag}", "taken as the map's", "before the first one", "scans of the bag"):
        assert text in assumed
    named = ("--scan-topic", "/scan", "--odom-topic", "/odom", "--cmd-topic", "/cmd_vel", "--frame", "/map")
    assert run(*VERIFY, "--trajectory", only_file(bag), *GOAL, *named).exit_code == 0


def truncated(messages: list[Message], path: Path) -> Path:
    bag = write_bag(path, messages, "mcap")
    only_file(bag).write_bytes(only_file(bag).read_bytes()[:5000])
    return bag


def with_row(messages: list[Message], topic: str, **fields: object) -> list[Message]:
    """Return the messages with one of a topic changed."""
    row = [index for index, message in enumerate(messages) if message.topic == topic][3]
    old = messages[row]
    new = Message(old.topic, old.type, old.received, {**old.fields, **fields})
    return [*messages[:row], new, *messages[row + 1 :]]


def nowhere() -> dict[str, object]:
    return dict(odometry(0, "map", np.array([np.nan, 0.0, 0.0])).fields["pose"])


BAD_BAGS: dict[str, tuple[int, str, Callable[[list[Message], Path], Path]]] = {
    "truncated": (2, "not a readable bag", truncated),
    "no scan topic": (
        2,
        "no scan topic",
        lambda m, p: write_bag(p, [x for x in m if x.topic != "/scan"], "mcap"),
    ),
    "clock goes back": (
        2,
        "clock of the scan messages goes back",
        lambda m, p: write_bag(p, with_row(m, "/scan", header=header(10**9, "laser")), "mcap"),
    ),
    "wrong frame": (
        2,
        "no transform from 'map' to 'odom'",
        lambda m, p: write_bag(p, in_odom(m), "mcap"),
    ),
    "nan pose": (2, "has the pose", lambda m, p: write_bag(p, with_row(m, "/odom", pose=nowhere()), "mcap")),
    "no messages": (
        5,
        "holds no scans",
        lambda m, p: write_bag(p, m, "mcap", empty=("/scan", "/odom", "/cmd_vel")),
    ),
    "nothing measured": (5, "no scan is left", lambda m, p: write_bag(p, blind(m), "mcap")),
    "no bag": (2, "--goal is for a bag", lambda m, p: text(p)),
    "nothing there": (2, "is not a file", lambda m, p: p.with_suffix(".mcap")),
}


def in_odom(messages: list[Message]) -> list[Message]:
    return [
        Message(
            m.topic, m.type, m.received, {**m.fields, "header": {**m.fields["header"], "frame_id": "odom"}}
        )
        if m.topic == "/odom"
        else m
        for m in messages
    ]


def blind(messages: list[Message]) -> list[Message]:
    angles = np.linspace(-np.pi / 2, np.pi / 2, 180)
    dark = scan(0, angles, np.full(180, np.nan), 0.2, 7.0).fields
    return [
        Message(m.topic, m.type, m.received, {**dark, "header": m.fields["header"]})
        if m.topic == "/scan"
        else m
        for m in messages
    ]


def text(path: Path) -> Path:
    path = path.with_suffix(".txt")
    path.write_text("no bag")
    return path


@pytest.mark.parametrize("name", BAD_BAGS)
def test_a_bad_bag_exits_with_one_clear_message(
    run: Run, recording: Recording, tmp_path: Path, name: str
) -> None:
    code, message, write = BAD_BAGS[name]
    result = run(*VERIFY, "--trajectory", write(recording[0], tmp_path / "run"), *GOAL)
    assert result.exit_code == code, result.output
    assert message in result.stderr
    assert result.stderr.count("error:") == 1
    assert "hint:" in result.stderr


HEAD = "episode,time,x,y,theta," + ",".join(f"observation_{index}" for index in range(26))
ROW = "0,{time},{x},-2,0," + ",".join(["1"] * 26)
BAD_TABLES = {
    "empty file": ("", 2, "empty"),
    "no rows": (HEAD, 5, "no states"),
    "nan": (f"{HEAD}\n{ROW.format(time=0, x='nan')}", 2, "not finite"),
    "infinite": (f"{HEAD}\n{ROW.format(time=0, x='inf')}", 2, "not finite"),
    "clock goes back": (f"{HEAD}\n{ROW.format(time=1, x=0)}\n{ROW.format(time=0, x=0)}", 2, "goes back"),
    "cut off": (f"{HEAD}\n{ROW.format(time=0, x=0)[:20]}", 2, "cells"),
    "no column": (f"{HEAD.replace('theta', 'phi')}\n{ROW.format(time=0, x=0)}", 2, "theta"),
    "too few observations": ("episode,time,x,y,theta,observation_0\n0,0,0,-2,0,1", 2, "26"),
}


@pytest.mark.parametrize("name", BAD_TABLES)
def test_a_bad_table_exits_with_one_clear_message(run: Run, tmp_path: Path, name: str) -> None:
    content, code, message = BAD_TABLES[name]
    path = tmp_path / "run.csv"
    path.write_text(content + "\n" if content else "")
    result = run(*VERIFY, "--trajectory", path)
    assert result.exit_code == code, result.output
    assert message in result.stderr
    assert result.stderr.count("error:") == 1


@pytest.mark.parametrize("kept", [0, 100, 1000])
def test_a_cut_off_npz_exits_with_2(run: Run, tmp_path: Path, kept: int) -> None:
    path = tmp_path / "run.npz"
    assert run("simulate", "policy.onnx", "--map", "map.yaml", "--output", path).exit_code == 0
    path.write_bytes(path.read_bytes()[:kept])
    assert run(*VERIFY, "--trajectory", path).exit_code == 2


@pytest.mark.parametrize(
    ("poses", "more"),
    [
        ("grid", ()),
        ("grid:0.8", ("--goal", "2,2", "--goal", "-2,-2")),
        ("random:200", GOAL),
        ("random:50", ()),
    ],
)
def test_poses_all_over_the_map_are_verified_and_drawn(
    run: Run, tmp_path: Path, poses: str, more: tuple[str, ...]
) -> None:
    report, picture = tmp_path / "report.json", tmp_path / "places.png"
    outputs = ("--output", f"json:{report}", "--output", f"figure:{picture}")
    result = run(*VERIFY, "--poses", poses, *more, *outputs)
    assert result.exit_code == 0, result.output
    document = json.loads(report.read_text())
    assert picture.read_bytes().startswith(b"\x89PNG")
    if poses.startswith("random"):
        assert document["states"] == int(poses[7:])
    assert document["task"]["episodes"] == (1 if more == GOAL else 2)
    assert "only poses that keep the collision distance" in document["assumptions"]["states"]


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (("--poses", "grid:0"), 2, "grid:0"),
        (("--poses", "random"), 2, "random"),
        (("--poses", "random:0"), 2, "random:0"),
        (("--poses", "everywhere"), 2, "everywhere"),
        (("--poses", "grid:0.0001"), 2, "more than"),
        (("--poses", "grid", "--goal", "0,0.55"), 2, "lies in an obstacle"),
        (("--poses", "grid", "--goal", "9,9"), 2, "off the map"),
        (("--poses", "grid", "--clearance", "3"), 5, "no free place"),
        (("--poses", "grid", "--trajectory", "map.yaml"), 2, "without --trajectory"),
        (("--goal", "1,1"), 2, "--goal is for"),
        (("--goal", "1"), 2, "x,y"),
        (("--goal", "1,nan"), 2, "x,y"),
        (("--scan-topic", "/scan"), 2, "for a bag"),
    ],
)
def test_options_that_make_no_sense_exit_with_one_message(
    run: Run, arguments: tuple[str, ...], code: int, message: str
) -> None:
    result = run(*VERIFY, *arguments)
    assert result.exit_code == code, result.output
    assert message in result.stderr


def test_a_bag_needs_one_goal(run: Run, bag: Path) -> None:
    assert "give --goal" in run(*VERIFY, "--trajectory", bag).stderr
    assert run(*VERIFY, "--trajectory", bag).exit_code == 2
    assert run(*VERIFY, "--trajectory", bag, *GOAL, *GOAL).exit_code == 2


@pytest.mark.parametrize("which", ["lab-3", "3"])
def test_scenarios_are_chosen_by_name_or_number(run: Run, tmp_path: Path, which: str) -> None:
    found = tmp_path / "states.npz"
    assert (
        run(
            "verify",
            "via",
            "--map",
            "lab",
            "--eps",
            "0.01",
            "--scenario",
            which,
            "-q",
            "-o",
            f"states:{found}",
        ).exit_code
        == 0
    )
    every = tmp_path / "all.npz"
    assert run("verify", "via", "--map", "lab", "--eps", "0.01", "-q", "-o", f"states:{every}").exit_code == 0
    chosen, among = arrays_of(found), arrays_of(every)
    assert (chosen["outcome"] == among["outcome"][3:4]).all()
    np.testing.assert_array_equal(chosen["pose"][0], among["pose"][among["episode"] == 3][0])


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--scenario", "lab-99"), "has no scenario 'lab-99'"),
        (("--scenario", "10"), "has 10 scenarios, so none of number 10"),
        (("--scenario", "lab-1", "--scenarios", "3"), "leave one out"),
    ],
)
def test_scenarios_that_do_not_exist_are_refused(run: Run, options: tuple[str, ...], said: str) -> None:
    found = run("verify", "via", "--map", "lab", "--eps", "0.01", *options)
    assert found.exit_code == 2
    assert said in found.stderr
