from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.loop.plant import Plant
from viatool import load_map, load_policy
from viatool.errors import ConfigurationError, EmptyEvaluationError
from viatool.places import STATUSES, Campaign, Resolution, SearchBudget, campaign, certify
from viatool.safety import ScenePoses
from viatool.schedule import Deadline, Processes, Serial
from viatool.world import Scenario

ROOM, POLICY = load_map(Path("maps/room.yaml")), load_policy(Path("policies/via.onnx"))
SCENARIO = ROOM.scenarios[0]


@pytest.fixture(scope="module")
def certificate():
    return certify(
        POLICY,
        ROOM,
        SCENARIO,
        eps=0.01,
        resolution=Resolution(0.05, 0),
        budget=SearchBudget(share=0.03),
        seed=3,
    )


def test_sampled_states_of_proved_cells_keep_their_clearance(certificate):
    """By a simulator that shares no code: other rays, other integration, shapely's distances."""
    table = certificate.cell_table()
    proved = np.isin(table["status"], ["certified", "uncontested"])
    lower, upper = table["lower"][proved], table["upper"][proved]
    generator = np.random.default_rng(0)
    left = Plant(POLICY, ROOM, SCENARIO, 0.01).margins(lower, upper, generator, 4000)
    assert len(left) > 3000
    assert left.min() > 0.0


def test_every_counterexample_is_free_within_its_cell_and_violates_again(certificate):
    found, lattice = certificate.findings, certificate.lattice
    refuted = found.nodes.select(found.status == STATUSES.index("refuted"))
    lower, upper = lattice.bounds(refuted)
    states = np.hstack([found.pose, found.previous])
    assert len(found.pose) > 50
    assert (states >= lower - 1e-9).all()
    assert (states <= upper + 1e-9).all()
    here = ScenePoses.of(ROOM, [SCENARIO], found.pose, np.zeros(len(found.pose), np.int64))
    assert (here.still.clearance(found.pose[:, :2], here.scene) > 0.4).all()
    actions = np.clip(certificate.setting.command_map(POLICY.run(found.observation)), [0.0, -1.0], [0.5, 1.0])
    np.testing.assert_allclose(actions, found.action, atol=1e-6)
    assert (found.clearance < 0.4).all()


def test_counterexamples_observe_what_the_sensors_may_give(certificate):
    from tests.sight.ray_oracle import outlines, scan

    found = certificate.findings
    readings = scan(found.pose, ROOM.robot.lidar, outlines(ROOM, SCENARIO))
    assert np.abs(found.observation[:, :20] - readings).max() <= 0.01
    np.testing.assert_allclose(found.observation[:, 23:25], found.previous, atol=0.01)


def test_volumes_are_exact_and_add_up(certificate):
    volume = certificate.to_json()["volume"]
    examined = certificate.examined / certificate.roots * 16.0 * 2.0 * np.pi
    np.testing.assert_allclose(sum(volume.values()), examined)
    np.testing.assert_allclose(certificate.raster.volumes.sum(axis=(1, 2, 3)), list(volume.values()))
    part, total = certificate.contested
    assert 0 < part < total <= certificate.free[1]


def test_workers_and_interruptions_change_nothing(monkeypatch, tmp_path):
    monkeypatch.setattr(campaign.RootWork, "piece", 2)
    share = SearchBudget(share=0.4)  # four pieces

    def run(scheduler, budget, *, resume):
        return certify(
            POLICY, ROOM, SCENARIO, eps=0.01, resolution=Resolution(0.25, 0), budget=budget, seed=3,
            campaign=Campaign(scheduler, tmp_path / "kept", resume),
        )  # fmt: skip

    part = run(Serial(), replace(share, cells=1), resume=False)
    assert part.examined < part.roots
    whole = run(Processes(2), share, resume=True)
    alone = certify(POLICY, ROOM, SCENARIO, eps=0.01, resolution=Resolution(0.25, 0), budget=share, seed=3)
    assert part.examined < whole.examined == alone.examined
    assert whole.units == alone.units
    np.testing.assert_array_equal(whole.findings.observation, alone.findings.observation)
    with pytest.raises(ConfigurationError, match="radii"):
        certify(
            POLICY, ROOM, SCENARIO, eps=0.02, resolution=Resolution(0.25, 0), seed=3,
            campaign=Campaign(Serial(), tmp_path / "kept", True),
        )  # fmt: skip


def test_when_the_time_is_up_the_first_roots_are_reported_whoever_worked():
    """A clock that goes on by a second with every look at it, so that no machine is too slow."""
    looks = itertools.count()
    run = {"eps": 0.01, "resolution": Resolution(0.05, 0), "seed": 3}
    until = Deadline.after(120.0, lambda: float(next(looks)))
    part = certify(POLICY, ROOM, SCENARIO, budget=SearchBudget(until), **run)
    assert 4 < part.examined < part.roots
    assert next(looks) < 145
    same = certify(
        POLICY, ROOM, SCENARIO, budget=SearchBudget(share=(part.examined - 0.5) / part.roots), **run
    )
    assert same.examined == part.examined
    assert {name: part.units[name] for name in ("blocked", "uncontested", "certified")} == {
        name: same.units[name] for name in ("blocked", "uncontested", "certified")
    }


class Late(Serial):
    """Workers that have not started when the time is up."""

    workers = 3

    def run(self, work, pieces, told=None):
        for piece in pieces:
            if piece is None:
                return
            yield piece, (None, 0.0)


@pytest.mark.parametrize(
    ("seconds", "scheduler", "words", "hint"),
    [
        (60.0, Late(), "60 s left .* none of 3 workers had started", "give 1 worker"),
        (1e-9, Serial(), "used up before the search could begin", "raise the budget"),
    ],
)
def test_a_budget_too_short_for_one_root_is_named_as_the_cause(seconds, scheduler, words, hint):
    with pytest.raises(EmptyEvaluationError, match=words) as caught:
        certify(
            POLICY, ROOM, SCENARIO, eps=0.01, resolution=Resolution(0.25, 0),
            budget=SearchBudget(Deadline.after(seconds)), campaign=Campaign(scheduler),
        )  # fmt: skip
    assert hint in caught.value.hint


def test_a_budget_of_cells_is_the_same_for_every_scheduler(monkeypatch):
    monkeypatch.setattr(campaign.RootWork, "piece", 1)
    run = {"eps": 0.01, "resolution": Resolution(0.25, 0), "budget": SearchBudget(cells=1000), "seed": 3}
    found = [
        certify(POLICY, ROOM, SCENARIO, campaign=Campaign(who), **run) for who in (Serial(), Processes(2))
    ]
    assert 0 < found[0].examined == found[1].examined < found[0].roots
    assert found[0].units == found[1].units


def test_what_a_pose_observes_is_what_the_oracle_casts():
    from tests.loop.test_observation import question
    from tests.sight.ray_oracle import outlines, scan

    asked = question()
    poses = np.array([[-1.0, 0.0, 0.3], [3.0, -1.0, 2.0]])
    from tests.loop.test_observation import LAB
    from tests.loop.test_observation import SCENARIO as LAB_SCENARIO

    seen = asked.sensors.measure(poses, np.zeros((2, 2)))
    np.testing.assert_allclose(
        seen[:, :20], scan(poses, LAB.robot.lidar, outlines(LAB, LAB_SCENARIO)), atol=1e-6
    )


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"criterion": "sampled"}, ConfigurationError, "proves nothing"),
        ({"scenario": Scenario("", (0, 0, 0), (-0.5, 0.6))}, ConfigurationError, "lies in an obstacle"),
        ({"clearance": 3.0, "resolution": Resolution(0.3, 0)}, EmptyEvaluationError, "no free place"),
        ({"resolution": Resolution(0.001, 0)}, ConfigurationError, "too many"),
    ],
)
def test_what_cannot_be_certified_is_refused(options, error, words):
    given = {"scenario": SCENARIO, "eps": 0.01} | options
    with pytest.raises(error, match=words):
        certify(POLICY, ROOM, given.pop("scenario"), **given)


def test_the_simulator_drives_the_arcs_of_the_criterion_and_sees_refuted_cells_fail(certificate):
    """What the attempts to break certificates rest on: the criterion's paths, and failures where there are some."""
    robot, generator = Plant(POLICY, ROOM, SCENARIO, 0.01), np.random.default_rng(1)
    states = generator.uniform((-1, -1, -3, 0, -1), (1, 1, 3, 0.5, 1), (50, 5))
    commands = generator.uniform((0, -1), (0.5, 1), (50, 2))
    ends = certificate.rules.manoeuvre.path(states[:, :3], commands, np.ones(50))
    np.testing.assert_allclose(robot.paths(states, commands)[:, -1], ends, atol=1e-9)
    table = certificate.cell_table()
    refuted = table["status"] == "refuted"
    left = robot.margins(table["lower"][refuted], table["upper"][refuted], generator, 2000)
    assert (left < 0.0).mean() > 0.03
