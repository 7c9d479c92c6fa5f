"""A dead time, in which the command before goes on; and footprints with corners."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.loop.plant import Plant
from tests.safety.brute_force import drive_all
from viatool import load_map, load_policy
from viatool.loop.closed_loop import ClosedLoop
from viatool.loop.waiting import after_waiting
from viatool.motion.differential import DifferentialDrive
from viatool.motion.law import Kinematics
from viatool.motion.manoeuvre import Manoeuvre
from viatool.places import Resolution, SearchBudget, certify
from viatool.sets.forms import PoseBoxes
from viatool.world import Footprint, simple_polygon

ROOM, POLICY = load_map(Path("maps/room.yaml")), load_policy(Path("policies/via.onnx"))
SCENARIO, DELAY = ROOM.scenarios[0], 0.2
OUTLINE = Footprint(
    "polygon", polygon=simple_polygon(np.array([[-0.1, -0.1], [0.2, -0.1], [0.2, 0.1], [-0.1, 0.1]]), "")
)
SETTINGS = {"delay": {"delay": DELAY}, "outline": {"footprint": OUTLINE, "clearance": 0.2}}


def beyond(delay=0.5, faster=1.0):
    """By how much sampled places and headings leave their box after the dead time, at most."""
    generator = np.random.default_rng(0)
    centre = generator.uniform((-2, -2, -math.pi), (2, 2, math.pi), (300, 3))
    boxes = PoseBoxes(centre, generator.uniform(0, 0.05, (300, 3)) * generator.choice([0.0, 1.0], (300, 3)))
    lower = generator.uniform((-0.3, -1.0), (0.3, 0.8), (300, 2)) * [1.0, faster]
    upper = lower + generator.uniform(0.0, 0.3, (300, 2)) * generator.choice([0.0, 1.0], (300, 2))
    after = after_waiting(boxes, Manoeuvre(delay), lower, upper)
    signs = np.array(np.meshgrid(*[[-1.0, 1.0]] * 5)).reshape(5, -1).T  # (32, 5)
    poses = (boxes.centre[:, None] + signs[:, :3] * boxes.radius[:, None]).reshape(-1, 3)
    commands = np.where(signs[:, 3:] > 0, upper[:, None], lower[:, None]).reshape(-1, 2)
    ends = drive_all(poses, *commands.T, np.array([delay]), np.float64).reshape(300, 32, 3)
    away = ends - after.centre[:, None]
    away[..., 2] = np.angle(np.exp(1j * away[..., 2]))
    return float((np.abs(away) - after.radius[:, None]).max())


@pytest.mark.parametrize(("delay", "faster"), [(0.5, 1.0), (2.0, 9.0)])
def test_poses_after_a_dead_time_lie_within_their_box(delay, faster):
    """Also after more than a circle: up to 18 rad."""
    assert beyond(delay, faster) <= 0.0


@pytest.mark.parametrize("rule", ["away", "turned", "from elsewhere"])
def test_driving_catches_a_box_without_one_of_its_terms(monkeypatch, rule):
    deviation, elsewhere = DifferentialDrive.deviation, Kinematics.from_elsewhere
    if rule == "from elsewhere":
        monkeypatch.setattr(Kinematics, "from_elsewhere", lambda *given: 0.0 * np.array(elsewhere(*given)))
    else:

        def without(*given):
            found = deviation(*given)
            return replace(found, **{rule: 0.0 * getattr(found, rule)})

        monkeypatch.setattr(DifferentialDrive, "deviation", without)
    assert beyond() > 1e-4


@pytest.fixture(scope="module", params=SETTINGS)
def case(request):
    """A certificate, and the same robot by school formulas."""
    found = certify(
        POLICY, ROOM, SCENARIO, eps=0.01, resolution=Resolution(0.1, 0), budget=SearchBudget(share=0.02), seed=2,
        **SETTINGS[request.param],
    )  # fmt: skip
    return found, plant_of(request.param)


def plant_of(name):
    world = ROOM.with_clearance(SETTINGS[name].get("clearance"), None)
    return Plant(
        POLICY,
        world,
        SCENARIO,
        0.01,
        SETTINGS[name].get("footprint", Footprint()),
        SETTINGS[name].get("delay", 0.0),
    )


def worst_of(found, robot, count):
    table = found.cell_table()
    proved = np.isin(table["status"], ["certified", "uncontested"])
    left = robot.margins(table["lower"][proved], table["upper"][proved], np.random.default_rng(1), count)
    assert len(left) > 0.3 * count
    return float(left.min())


def test_sampled_states_of_proved_cells_keep_their_clearance(case):
    assert worst_of(*case, 2500) > 0.0


def test_counterexamples_violate_in_the_simulator_as_well(case):
    found, robot = case
    states = np.hstack([found.findings.pose, found.findings.previous])
    assert len(states) > 30
    assert robot.free(states[:, :3]).all()
    paths = robot.paths(states, robot.command(found.findings.observation.astype(float)))
    assert (robot.away(paths).min(axis=1) < robot.distance + 1e-3).all()


def test_sampling_catches_certificates_that_forget_the_dead_time(monkeypatch):
    monkeypatch.setattr(
        ClosedLoop,
        "holds",
        lambda asked, cells, *ends: asked._keep_clear(cells.poses, asked.rules.manoeuvre, *ends),
    )
    found = certify(
        POLICY,
        ROOM,
        SCENARIO,
        eps=0.01,
        resolution=Resolution(0.08, 0),
        budget=SearchBudget(share=0.05),
        delay=DELAY,
    )
    assert worst_of(found, plant_of("delay"), 2500) < -1e-3


def test_the_command_before_counts_where_it_leads_into_a_wall():
    """At the rim, heading for the wall at x = 2: after standing all is well, after driving it is not."""
    from viatool.sets.states import StateBoxes
    from viatool.setting.setting import Setting
    from viatool.setting.wishes import Wishes

    wishes = Wishes("braking", delay=DELAY)
    asked = ClosedLoop.of(POLICY, Setting.of(POLICY, ROOM, 0.01, wishes), SCENARIO)
    boxes = PoseBoxes(np.array([[1.5, 0.0, 0.0]] * 2), np.full((2, 3), 0.01))
    before = np.array([[0.0, 0.0], [0.5, 0.0]])
    stop = np.zeros((2, 2))
    assert asked.holds(StateBoxes(boxes, before, before), stop, stop).tolist() == [True, False]
