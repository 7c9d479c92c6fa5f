"""The layouts of public projects: each policy of the zoo is inspected, driven and verified as it is specified."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from viatool import load_policy, reach
from viatool.cli import main

ZOO = Path("examples/zoo")
LAYOUTS = sorted(path.parent.name for path in ZOO.glob("*/specification.yaml"))
RECURRENT = "sb3_recurrent"
"""Carries a state from step to step: verified where it drove."""
REMEMBERING = {
    "f1tenth_drl": "frames that are up to",
    "rl_collision_avoidance": "frames that are up to",
    RECURRENT: "'h' of kind 'memory' holds what the policy remembers",
}
"""Stacked frames and memory: refused by name where a set of poses is asked about."""
LARGE = {"navrep", "rl_collision_avoidance", "ros_jackal"}
"""Scans of 512 to 1080 rays: some tens of seconds each."""


def marked(layouts, large=LARGE):
    return [pytest.param(one, marks=pytest.mark.slow) if one in large else one for one in layouts]


def run(command, layout, *options):
    policy, spec = ZOO / layout / "policy.onnx", ZOO / layout / "specification.yaml"
    return CliRunner().invoke(main, [command, str(policy), "--spec", str(spec), *map(str, options)])


def room(layout):
    own = ZOO / layout / "map.yaml"
    return own if own.exists() else ZOO / "room.yaml"


def test_there_are_fifteen_layouts_each_with_a_policy_and_a_row_in_the_docs():
    assert len(LAYOUTS) >= 15
    page = Path("docs/trained-with.md").read_text("utf-8")
    assert [layout for layout in LAYOUTS if f"`{layout}`" not in page] == []
    assert [layout for layout in LAYOUTS if not (ZOO / layout / "policy.onnx").exists()] == []


@pytest.mark.parametrize("layout", marked(LAYOUTS))
def test_a_layout_is_inspected_driven_and_verified(layout, tmp_path):
    assert run("inspect", layout).exit_code == 0
    drive = f"trajectory:{tmp_path / 'drive.npz'}"
    driven = run("simulate", layout, "--map", room(layout), "--time-limit", 0.5, "--output", drive)
    assert driven.exit_code == 0, driven.output
    states_of = ["--trajectory", tmp_path / "drive.npz"] if layout == RECURRENT else ["--poses", "random:4"]
    report, states = tmp_path / "report.json", tmp_path / "states.npz"
    verified = run(
        "verify", layout, "--map", room(layout), "--eps", 0.01, *states_of, "--refine", "none",
        "--output", f"json:{report}", "--output", f"states:{states}",
    )  # fmt: skip
    assert verified.exit_code == 0, verified.output
    assert json.loads(report.read_text())["states"] >= 4
    with np.load(states) as table:
        lower, upper = table["observation_lower"], table["observation_upper"]
        assert (lower <= table["observation"]).all()
        assert (table["observation"] <= upper).all()
    policy = load_policy(ZOO / layout / "policy.onnx", ZOO / layout / "specification.yaml")
    free = policy.spec.radii(0.01) > 0.0
    moved = (upper - lower)[:, free].max(axis=0)
    assert (moved > 0.0).all()


@pytest.mark.parametrize("layout", marked(LAYOUTS, LARGE | {"metadrive"}))
def test_places_are_certified_or_refused_by_name(layout):
    asked = run(
        "certify",
        layout,
        "--map",
        room(layout),
        "--scenario",
        0,
        "--eps",
        0.01,
        "--sample",
        1e-5,
        "--halvings",
        0,
    )
    if layout in REMEMBERING:
        assert asked.exit_code == 2
        assert REMEMBERING[layout] in " ".join(asked.output.split())
    else:
        assert asked.exit_code == 0, asked.output


def test_speeds_that_nothing_limits_are_driven_and_verified_but_fill_no_cells():
    free = "archcomp_nav", "--map", ZOO / "room.yaml", "--eps", 0.01
    asked = run("verify", *free)
    assert asked.exit_code == 0, asked.output
    assert "v unlimited" in asked.output
    refused = run("certify", *free, "--sample", 1e-5)
    assert refused.exit_code == 2
    assert "hold every state that the robot's motion may have" in refused.output


def test_bounds_of_accelerations_hold_what_the_network_gives():
    policy = load_policy(ZOO / "archcomp_nav" / "policy.onnx", ZOO / "archcomp_nav" / "specification.yaml")
    sets = reach(policy, np.zeros((1, policy.input_size)), eps=0.01)
    assert (sets.lower <= policy(np.zeros((1, policy.input_size)))).all()


def test_the_commands_among_which_a_policy_chooses_are_listed():
    told = run("inspect", "robotis_dqn").output
    assert "the largest of 5 numbers" in told
    assert "0 to 4" not in told
    rows = [line.split() for line in told.splitlines()]
    table = [(int(row[0]), float(row[1]), float(row[2])) for row in rows if len(row) == 3 and row[1] == "0.2"]
    assert table == [(0, 0.2, 1.5), (1, 0.2, 0.75), (2, 0.2, 0.0), (3, 0.2, -0.75), (4, 0.2, -1.5)]
