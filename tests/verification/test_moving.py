"""Things that move, from the error model to the report: what is refused, what is found, and its replay."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

import viatool
from viatool.errors import ConfigurationError, TrajectoryError
from viatool.safety.moving import movers_around
from viatool.setting.moving import check_moving
from viatool.setting.setting import Setting
from viatool.setting.wishes import Wishes
from viatool.trajectory import load_trajectory
from viatool.trajectory.files import write_trajectory
from viatool.uncertainty import ErrorModel
from viatool.verification.observing import BlockSensors
from viatool.verification.source import Source
from viatool.verification.witness_file import load_witnesses, replay, witness_document
from viatool.world.seen import RETURN

TERMS = {
    "speed": {"speed": 1.2},
    "returns": {"returns": 1.2},
    "hidden": {"hidden": 1.2, "behind": 2.0},
    "people": {"people": 1.2},
    "roams": {"roams": {"pillar-1": 0.8, "desk-3": 0.8, "coffee-table": 0.8}},
}


def model(**terms):
    return ErrorModel.model_validate({"obstacles": terms})


@pytest.fixture(scope="module")
def policy():
    return viatool.load_policy("via")


@pytest.fixture(scope="module")
def office():
    return viatool.load_map("office")


@pytest.fixture(scope="module")
def states(policy, office):
    setting = Setting.of(policy, office, 0.01, Wishes("braking"), office.scenarios[:3], job="verify")
    driven = Source().states(policy, setting)
    return driven.select(np.arange(0, len(driven), 9))


def with_people(states):
    """One person beside each second state, who walks on at 0.4 m/s, and nobody at the others."""
    people = np.full((len(states), 2, 5), np.nan)
    ahead = states.poses[:, :2] + 1.0 * np.column_stack(
        [np.cos(states.poses[:, 2]), np.sin(states.poses[:, 2])]
    )
    people[::2, 1] = np.column_stack([ahead, np.full((len(states), 2), 0.4), np.full(len(states), 0.2)])[::2]
    return replace(states, people=people)


def verified(policy, office, states, terms):
    seen = with_people(states) if "people" in terms else states
    return viatool.verify(
        policy,
        office,
        eps=0.01,
        errors=model(**terms),
        trajectory=seen,
        criterion="braking",
        only_contested=True,
    )


@pytest.mark.parametrize("name", TERMS)
def test_a_term_costs_verdicts_and_its_counterexamples_are_driven_again(
    policy, office, states, name, tmp_path
):
    bare = viatool.verify(
        policy, office, eps=0.01, trajectory=states, criterion="braking", only_contested=True
    )
    found = verified(policy, office, states, TERMS[name])
    assert found.judgement.safe.sum() < bare.judgement.safe.sum()
    assert (found.judgement.safe <= bare.judgement.safe).all()
    assert (found.contested.collision >= bare.contested.collision).all()
    assert "obstacles." in found.assumptions()["obstacles"]
    assert "anywhere within its region where it roams" in found.assumptions()["obstacles"]
    moved = found.witnesses.mover != ""
    assert moved.any()
    path = tmp_path / "witnesses.json"
    path.write_text(json.dumps(witness_document(found)), encoding="utf-8")
    again = replay(policy, office, load_witnesses(path))
    assert again.violates.all()
    np.testing.assert_allclose(again.clearance, found.witnesses.clearance, atol=1e-6)
    speed = np.hypot(*found.witnesses.velocity[moved].T)
    np.testing.assert_allclose(speed[speed > 0.0], 1.2, atol=1e-9)
    entry = next(e for e in witness_document(found)["witnesses"] if "moved" in e["closest"])
    assert entry["closest"]["moved"]["what"] in entry["closest"]["obstacle"]


def test_more_speed_costs_more(policy, office, states):
    safe = [verified(policy, office, states, {"returns": speed}).judgement.safe for speed in (0.0, 0.3, 1.0)]
    assert (safe[2] <= safe[1]).all()
    assert (safe[1] <= safe[0]).all()
    assert safe[2].sum() < safe[0].sum()


@pytest.mark.parametrize("suffix", ["npz", "csv"])
def test_people_are_read_back_as_they_were_written(states, policy, suffix, tmp_path):
    told = with_people(states)
    path = tmp_path / f"drive.{suffix}"
    write_trajectory(path, told, policy.spec)
    again = load_trajectory(path, policy.spec)
    np.testing.assert_array_equal(again.people, told.people)
    assert load_trajectory(path, policy.spec).select(np.arange(3)).people.shape == (3, 2, 5)


def test_half_a_person_is_refused(states):
    people = np.full((len(states), 1, 5), np.nan)
    people[0, 0, :2] = 1.0
    with pytest.raises(TrajectoryError, match="person 0"):
        replace(states, people=people)


@pytest.mark.parametrize(
    ("terms", "said"),
    [
        ({"named": {"throne": 1.0}}, r"obstacles\.named\.throne.*no such obstacle"),
        ({"roams": {"throne": 1.0}}, r"obstacles\.roams\.throne.*no such obstacle"),
        ({"named": {"desk-1": 1.0}, "roams": {"desk-1": 1.0}}, "same obstacle"),
        ({"behind": 1.0}, "nothing is hidden"),
        ({"hidden": 1.0}, "does not look all around"),
    ],
)
def test_what_means_nothing_is_refused_by_name(policy, office, terms, said):
    with pytest.raises(ConfigurationError, match=said):
        Setting.of(policy, office, 0.01, Wishes("braking", errors=model(**terms)), job="verify")


@pytest.mark.parametrize("term", [{"missing": 1}, {"thin": 0.1}])
def test_terms_that_hide_what_was_seen_are_refused(policy, office, term):
    errors = ErrorModel.model_validate({"obstacles": {"returns": 1.0}, "sensor": {"lidar": term}})
    with pytest.raises(ConfigurationError, match=rf"lidar\.{next(iter(term))} together"):
        check_moving(errors, policy.spec, office)


SEEN = {
    "relative": {"sensor": {"lidar": {"relative": 0.1}}},
    "bias": {"sensor": {"lidar": {"bias": 0.05}}},
    "angle": {"sensor": {"lidar": {"angle": 0.1}}},
    "pose": {"pose": {"x": 0.05, "y": 0.05, "theta": 0.02}},
}


@pytest.mark.parametrize("name", SEEN)
def test_what_was_seen_is_where_its_readings_err_to(policy, office, states, name, tmp_path):
    """Beside every other error things that were seen cost more, and counterexamples are driven again."""
    some = states.select(np.arange(0, len(states), 2))

    def found(**errors):
        return viatool.verify(
            policy, office, eps=0.01, errors=ErrorModel.model_validate(errors), trajectory=some,
            criterion="braking", only_contested=True, refine="none",
        )  # fmt: skip

    moving = {"obstacles": {"returns": 1.0}}
    both, alone, still = found(**SEEN[name], **moving), found(**moving), found(**SEEN[name])
    for less in (alone, still):
        assert (both.judgement.safe <= less.judgement.safe).all()
        assert (both.contested.collision >= less.contested.collision).all()
    assert both.judgement.safe.sum() < still.judgement.safe.sum()
    path = tmp_path / "witnesses.json"
    path.write_text(json.dumps(witness_document(both)), encoding="utf-8")
    assert len(both.witnesses)
    assert replay(policy, office, load_witnesses(path)).violates.all()


def from_elsewhere(found):
    """By how much the things of counterexamples are elsewhere than what was seen from where the robot then was."""
    w, states = found.witnesses, found.trajectory
    seen = np.isin(w.mover, [RETURN])
    at, start = w.state[seen], w.start[seen]
    assert seen.sum() > 2
    (around,) = movers_around(
        found.setting, states.scenarios, start, states.episode[at], states.observations[at], states.people[at]
    )
    origin = w.origin[seen] @ np.array([1.0, 1j])
    return around.capsules.clearance(origin, around.index, np.zeros(len(at)))[0]


def test_a_counterexample_has_what_was_seen_around_the_pose_where_the_robot_was(
    policy, office, states, monkeypatch
):
    errors = ErrorModel.model_validate({**SEEN["pose"], "obstacles": {"returns": 1.0}})

    def found():
        return viatool.verify(
            policy, office, eps=0.01, errors=errors, trajectory=states.select(np.arange(0, len(states), 2)),
            criterion="braking", only_contested=True, refine="none",
        )  # fmt: skip

    assert (from_elsewhere(found()) < 1e-9).all()
    monkeypatch.setattr(
        BlockSensors, "_really", lambda self, at, rows, true: replace(at, poses=true, radii=None)
    )
    assert from_elsewhere(found()).max() > 0.01


MADE_OF = {"relative": 0.1, "bias": 0.05, "absolute": 0.06, "angle": 0.08}


def nearer_than_said(office, policy, stated):
    """Scans of which the nearest thing, by arithmetic of its own, was nearer than the movers say."""
    errors = ErrorModel.model_validate({"obstacles": {"returns": 1.0}, "sensor": {"lidar": stated}})
    setting = Setting.of(policy, office, 0.0, Wishes(errors=errors), job="verify")
    lidar, generator, count = office.robot.lidar, np.random.default_rng(0), 200
    share, each, common = generator.choice([-1.0, 1.0], (3, count, 1))
    true = generator.uniform(0.5, 3.0, (count, lidar.rays))
    read = true * (1.0 + 0.1 * share) + 0.06 * each + 0.05 * common
    observations = np.zeros((count, policy.input_size))
    observations[:, : lidar.bins] = read.reshape(count, lidar.bins, -1).min(axis=2)
    poses, nobody = np.zeros((count, 3)), np.zeros((count, 0, 5))
    (seen,) = movers_around(setting, [None], poses, np.zeros(count, int), observations, nobody)
    away = seen.capsules.clearance(np.zeros(count, complex), seen.index, np.zeros(count))[0]
    return int((true.min(axis=1) < away - 1e-9).sum())


@pytest.mark.parametrize("term", ["relative", "bias", "absolute"])
def test_a_scan_is_made_of_things_that_are_no_nearer_than_said(policy, office, term):
    assert nearer_than_said(office, policy, MADE_OF) == 0
    less = {name: value for name, value in MADE_OF.items() if name != term}
    assert nearer_than_said(office, policy, less) > 0


def test_people_need_the_term_and_the_term_needs_people(policy, office, states):
    with pytest.raises(ConfigurationError, match="nobody says how they move"):
        viatool.verify(policy, office, eps=0.01, trajectory=with_people(states))
    with pytest.raises(ConfigurationError, match="tell of no people"):
        viatool.verify(policy, office, eps=0.01, trajectory=states, errors=model(people=1.0))


def test_the_state_table_keeps_people(policy, office, states, tmp_path):
    """Else the table, verified again, would speak of rooms without them."""
    errors = model(people=1.2)
    told = with_people(states)
    found = viatool.verify(policy, office, eps=0.01, errors=errors, trajectory=told, criterion="braking")
    np.savez(tmp_path / "states.npz", **found.state_table())
    again = load_trajectory(tmp_path / "states.npz", policy.spec)
    np.testing.assert_array_equal(again.people, told.people)
    plain = viatool.verify(policy, office, eps=0.01, trajectory=states, criterion="braking")
    assert "people" not in plain.state_table()


def test_simulated_states_are_those_of_the_motors_of_the_model(policy):
    lab = viatool.load_map("lab")
    late = {
        "actuation": {"linear": {"acceleration": 1.0, "lag": [0.1, 0.2]}},
        "timing": {"interval": [0.08, 0.12]},
        "sensor": {"lidar": {"absolute": 0.01, "bias": 0.2}},
        "obstacles": {"speed": 0.2},
    }

    def states(seed, **part):
        wishes = Wishes("braking", errors=ErrorModel.model_validate(part))
        setting = Setting.of(policy, lab, {"": 0.01, "lidar": 0.01}, wishes, lab.scenarios[:1], job="verify")
        source = Source(seed=seed)
        return source.states(policy, setting), source.words(setting)

    (first, words), (again, _), (other, _) = (states(seed, **late) for seed in (0, 0, 1))
    plain, ideal = states(0, sensor=late["sensor"], obstacles=late["obstacles"])
    np.testing.assert_array_equal(first.poses, again.poses)
    assert not np.array_equal(first.poses[:20], other.poses[:20])
    assert np.ptp(np.diff(first.time)) > 0.01
    assert np.ptp(np.diff(plain.time)) < 1e-9
    speed = np.hypot(*np.diff(first.poses[:4, :2], axis=0).T) / np.diff(first.time[:4])
    assert (speed[:2] < 0.8 * np.abs(first.actions[:2, 0])).all()  # it takes time
    assert "motors and timing drawn" in words
    assert "motors" not in ideal
