from __future__ import annotations

import itertools
import json
from dataclasses import replace
from fractions import Fraction
from functools import partial

import numpy as np
import onnxruntime
import pytest

from tests.safety.brute_force import clearance, drive
from tests.safety.hand_made_policy import specification, write_policy
from viatool.errors import ConfigurationError, EmptyEvaluationError, PolicyError, TrajectoryError
from viatool.policy import ActionChannel, load_policy
from viatool.safety.reasons import Reasons
from viatool.simulate import roll_out
from viatool.taylor import ReachableSet, memory
from viatool.trajectory import Trajectory, load_trajectory, write_trajectory
from viatool.verification import job, observing, verify
from viatool.world import Obstacles, load_map

LAB = "maps/lab.yaml"
DISTANCES = {"clearance": 0.6, "danger": 0.8}
KEYS = {
    "schema_version", "policy", "map", "eps", "criterion", "arithmetic", "engine", "states", "verdicts",
    "safety_rate", "sampled_safety_rate", "danger_rate", "contested_rate", "close_rate", "stake", "task",
    "reachable_width", "seconds", "versions", "assumptions",
    "premises", "unsafe_states", "close", "reasons", "reasons_left_out",
}  # fmt: skip


@pytest.fixture(scope="module")
def policy_path(tmp_path_factory):
    return write_policy(tmp_path_factory.mktemp("policy") / "policy.onnx", specification(), caution=0.05)


@pytest.fixture(scope="module")
def policy(policy_path):
    return load_policy(policy_path)


@pytest.fixture(scope="module")
def scenarios():
    return load_map(LAB).generator.draw(24, 1)


@pytest.fixture(scope="module")
def driven(policy, scenarios):
    return roll_out(policy, load_map(LAB), scenarios)


@pytest.fixture(scope="module")
def result(policy, driven):
    """Asks for more clearance than the robot kept, so that many states are contested and many unsafe."""
    return verify(policy, LAB, eps=0.03, trajectory=driven, **DISTANCES)


def test_the_run_has_all_that_the_tests_speak_of(result):
    assert set(result.verdict) >= {"safe", "unsafe"}
    assert result.contested.collision.sum() > len(result.witnesses) > 20


def test_the_report_has_the_keys_of_the_contract_and_is_plain_json(result):
    report = result.to_json()
    assert set(report) == KEYS | {"recording"}  # the states were given, so they are compared with the map
    assert json.loads(json.dumps(report, allow_nan=False)) == report
    assert set(report["reachable_width"]) == {"v", "omega"}
    assert set(report["safety_rate"]) == {"overall", "success", "collision", "timeout"}


def test_the_figures_add_up(result):
    report = result.to_json()
    assert sum(report["verdicts"].values()) == report["states"] == len(result.verdict)
    assert report["safety_rate"]["overall"]["safe"] == report["verdicts"]["safe"]
    assert report["danger_rate"]["overall"]["safe"] <= report["verdicts"]["safe"]
    contested = report["contested_rate"]["overall"]
    assert report["states"] - contested["total"] == report["verdicts"]["safe"] - contested["safe"]
    assert report["sampled_safety_rate"]["overall"]["safe"] >= report["verdicts"]["safe"]


def test_the_state_table_has_one_row_for_each_state(result):
    table, states = result.state_table(), len(result.verdict)
    shapes = {name: array.shape for name, array in table.items()}
    assert shapes == {
        "pose": (states, 3), "observation": (states, 26), "eps": (states, 26),
        "observation_lower": (states, 26), "observation_upper": (states, 26), "witness": (states, 26),
        "lower": (states, 2), "upper": (states, 2), "verdict": (states,), "episode": (states,),
        "danger": (states,), "sampled": (states,), "contested": (states,), "outcome": (24,),
    }  # fmt: skip
    unsafe = table["verdict"] == "unsafe"
    assert np.isfinite(table["witness"][unsafe]).all()
    assert np.isnan(table["witness"][~unsafe]).all()
    assert (table["eps"][:, 25] == 0.0).all()


def test_every_witness_lies_in_its_box_and_fails_when_it_is_replayed_elsewhere(
    result, policy_path, scenarios
):
    session = onnxruntime.InferenceSession(policy_path, providers=["CPUExecutionProvider"])
    lab = load_map(LAB)
    for row, state in enumerate(result.witnesses.state):
        witness = result.witness[state]
        for value, centre, radius in zip(witness, result.observations[state], result.radii, strict=True):
            assert abs(Fraction(value) - Fraction(centre)) <= Fraction(radius)
        assert (witness.astype(np.float32) == witness).all()
        v, omega = session.run(None, {"observation": witness[None].astype(np.float32)})[0][0].astype(float)
        own = scenarios[result.episode[state]].obstacles
        world = replace(lab, obstacles=Obstacles(np.concatenate([lab.obstacles.circles, own.circles])))
        path = drive(result.poses[state], np.clip(v, 0, 0.5), np.clip(omega, -1, 1), np.linspace(0, 0.1, 200))
        left = clearance(world, path, world.robot.footprint)
        assert left.min() < 0.6
        assert abs(left.min() - result.witnesses.clearance[row]) < 1e-5


def test_no_command_of_the_deployed_program_leaves_the_bounds_or_fails_in_a_safe_state(result, policy):
    generator = np.random.default_rng(0)
    state = generator.integers(len(result.verdict), size=20_000)
    noise = generator.uniform(-1, 1, (len(state), 26)) * result.radii
    inside = (result.observations[state] + noise).astype(np.float32)
    actions = policy.run(inside)
    assert (actions >= result.lower[state]).all()
    assert (actions <= result.upper[state]).all()


def test_a_repetition_gives_the_same_result(result, policy, driven):
    again = verify(policy, LAB, eps=0.03, trajectory=driven, **DISTANCES)
    for name, array in result.state_table().items():
        np.testing.assert_array_equal(array, again.state_table()[name], err_msg=name)


def test_only_contested_changes_no_verdict(result, policy, driven):
    quick = verify(policy, LAB, eps=0.03, trajectory=driven, **DISTANCES, only_contested=True)
    np.testing.assert_array_equal(quick.verdict, result.verdict)
    assert quick.danger_rate == result.danger_rate
    skipped = np.isnan(quick.lower).all(axis=1)
    np.testing.assert_array_equal(skipped, ~quick.contested.either)
    json.dumps(quick.to_json(), allow_nan=False)


def test_of_many_states_a_sample_tells_how_wide_actions_are(result, policy, driven, monkeypatch):
    monkeypatch.setattr("viatool.verification.job._BOUNDED", len(result.verdict) // 7)
    few = verify(policy, LAB, eps=0.03, trajectory=driven, **DISTANCES)
    every = verify(policy, LAB, eps=0.03, trajectory=driven, **DISTANCES, widths=True)
    assert "one in 7" in few.engine["bounded"]
    assert "bounded" not in every.engine
    np.testing.assert_array_equal(few.verdict, every.verdict)
    sample = np.arange(len(few.verdict)) % 7 == 0
    np.testing.assert_array_equal(np.isfinite(few.lower).all(axis=1), sample | few.contested.either)
    widths = (every.upper - every.lower)[sample]
    for action, width in zip(few.actions, widths.T, strict=True):
        assert few.reachable_width()[action.name]["mean"] == pytest.approx(width.mean())


def test_bounds_of_a_large_network_are_refined_only_where_a_verdict_depends_on_them(result, monkeypatch):
    near = np.flatnonzero(result.contested.either)[:30].tolist()
    near = np.array(sorted({*near, *range(20)}))
    large, some = load_policy("policies/via-256.onnx"), result.trajectory.select(near)
    quick = verify(large, LAB, eps=0.03, trajectory=some, **DISTANCES)
    assert quick.engine["refined"] == "where a verdict depends on it"
    monkeypatch.setattr(memory, "_SMALL", np.inf)
    tight = verify(large, LAB, eps=0.03, trajectory=some, **DISTANCES)
    assert "refined" not in tight.engine
    np.testing.assert_array_equal(quick.verdict, tight.verdict)
    assert quick.danger_rate == tight.danger_rate
    contested = tight.contested.either
    assert 0 < contested.sum() < len(contested)
    assert (quick.lower <= tight.lower + 1e-9).all()
    assert (quick.upper >= tight.upper - 1e-9).all()
    settled = (quick.upper - quick.lower)[~contested].mean()
    assert settled > 1.01 * (tight.upper - tight.lower)[~contested].mean()
    monkeypatch.setattr(memory, "_SMALL", 0.0)
    monkeypatch.setattr(memory, "_KEPT_IN_PASSING", 0.0)
    none = verify(large, LAB, eps=0.03, trajectory=some, **DISTANCES)
    assert none.engine["bounded"] == "contested states alone"
    np.testing.assert_array_equal(none.verdict, tight.verdict)
    np.testing.assert_array_equal(np.isnan(none.upper).all(axis=1), ~contested)


def test_bounds_are_refined_where_no_attained_command_fails_and_only_there(result, policy, monkeypatch):
    """A robot that may do anything is asked about again unless it is known to do what fails."""
    monkeypatch.setattr(memory, "_SMALL", 0.0)
    monkeypatch.setattr(job, "find_reasons", lambda *asked: Reasons())
    some = result.trajectory.select(np.flatnonzero(result.contested.either))
    least, most = (
        np.array([getattr(each, end) for each in policy.spec.action]) for end in ("lower", "upper")
    )
    stand, ahead, unknown = np.zeros(2), np.array([most[0], 0.0]), np.full(2, np.nan)
    asked = []

    def reach(attained, policy, observations, eps, **engine):
        asked.append(len(observations))
        bounds = (least, most) if engine["refine"] == "none" else (stand, stand)
        return ReachableSet(
            *(np.tile(each, (len(observations), 1)) for each in (*bounds, attained, attained, stand))
        )

    def asked_again(attained):
        monkeypatch.setattr(observing, "reach", partial(reach, attained))
        found = verify(policy, LAB, eps=0.03, trajectory=some, clearance=0.6, danger=0.6, close=0)
        return asked[-1], (found.judgement.safe & found.contested.collision).sum()

    again, proved = asked_again(stand)
    assert again == proved > 4  # of all the others not even standing is safe
    assert 0 < asked_again(ahead)[0] < again
    everywhere, proved_of_unknown = asked_again(unknown)
    assert everywhere > 100
    assert proved_of_unknown == proved


@pytest.mark.parametrize("suffix", ["npz", "csv"])
def test_a_recorded_trajectory_gives_the_verdicts_of_the_driven_one(result, policy, tmp_path, suffix):
    path = tmp_path / f"run.{suffix}"
    write_trajectory(path, result.trajectory, policy.spec)
    again = verify(policy, LAB, eps=0.03, trajectory=path, only_contested=True, **DISTANCES)
    np.testing.assert_array_equal(again.verdict, result.verdict)
    assert again.contested_rate == result.contested_rate


def test_fixed_channels_take_their_value_whatever_was_recorded(result, policy):
    observations = result.observations.copy()
    observations[:, 25] = np.arange(len(observations))
    other = verify(policy, LAB, eps=0.0, trajectory=replace(result.trajectory, observations=observations))
    assert (other.observations[:, 25] == np.float64(np.float32(7.3))).all()


def test_recorded_numbers_are_rounded_as_the_program_rounds_them(policy, driven):
    recorded = replace(driven, observations=driven.observations + 1e-10)
    received = verify(policy, LAB, eps=0.0, trajectory=recorded, only_contested=True).observations
    assert (received == received.astype(np.float32)).all()
    np.testing.assert_allclose(received, driven.observations, rtol=1e-6, atol=1e-9)


def test_braking_and_delay_only_ask_for_more(result, policy):
    for more in ({"criterion": "braking"}, {"delay": 0.05}):
        stricter = verify(
            policy, LAB, eps=0.03, trajectory=result.trajectory, only_contested=True, **DISTANCES, **more
        )
        assert not (stricter.judgement.safe & ~result.judgement.safe).any()
        assert stricter.judgement.safe.sum() < result.judgement.safe.sum()


def test_a_larger_footprint_is_never_safer(result, policy):
    options = {"trajectory": result.trajectory, "eps": 0.03, "clearance": 0.5, "only_contested": True}
    safe = [
        verify(policy, LAB, footprint=footprint, **options).judgement.safe
        for footprint in ("point", 0.1, 0.3, [[-0.4, -0.4], [0.4, -0.4], [0.4, 0.4], [-0.4, 0.4]])
    ]
    for smaller, larger in itertools.pairwise(safe):
        assert not (larger & ~smaller).any()


def test_the_paper_criterion_can_be_asked_for(result, policy):
    sampled = verify(
        policy,
        LAB,
        eps=0.03,
        trajectory=result.trajectory,
        clearance=0.5,
        criterion="sampled",
        only_contested=True,
    )
    assert sampled.safety_rate == sampled.sampled_safety_rate


def test_radii_by_channel(result, policy):
    only = verify(policy, LAB, eps={"lidar": 0.02, "": 0.0}, trajectory=result.trajectory)
    assert (only.radii[:20] == 0.02).all()
    assert (only.radii[20:] == 0.0).all()
    assert only.to_json()["eps"] == {"lidar": 0.02, "": 0.0}


def test_progress_counts_every_stage_to_its_end(result, policy):
    told = {}
    verify(
        policy, LAB, eps=0.03, trajectory=result.trajectory, clearance=0.5, close=20,
        progress=lambda stage, done, total: told.update({stage: (done, total)}),
    )  # fmt: skip
    assert told == {"states": (len(result.verdict), len(result.verdict)), "close places": (20, 20)}


@pytest.mark.parametrize(
    "options",
    [
        {"eps": -1.0},
        {"eps": float("nan")},
        {"eps": {"sonar": 0.1, "": 0.0}},
        {"criterion": "hoping"},
        {"interval": 0.0},
        {"delay": -0.1},
        {"footprint": "big"},
        {"footprint": -1.0},
        {"clearance": -0.1},
    ],
)
def test_options_out_of_range_are_refused(policy, options):
    with pytest.raises(ConfigurationError) as caught:
        verify(policy, LAB, **{"eps": 0.01, **options})
    assert caught.value.hint


def trajectory_of(size, states=1, actions=2):
    return Trajectory(
        poses=np.zeros((states, 3)),
        observations=np.ones((states, size)),
        actions=np.zeros((states, actions)),
        episode=np.zeros(states, dtype=int),
        time=np.arange(states),
        outcomes=np.array(["unknown"]),
        costs=np.array([np.nan]),
        scenarios=(None,),
    )


def test_what_does_not_fit_is_refused(policy, tmp_path):
    with pytest.raises(EmptyEvaluationError):
        verify(policy, LAB, eps=0.01, trajectory=trajectory_of(26, states=0))
    with pytest.raises(TrajectoryError, match="25 observation entries"):
        verify(policy, LAB, eps=0.01, trajectory=trajectory_of(25))
    with pytest.raises(PolicyError, match="no specification"):
        verify(write_policy(tmp_path / "foreign.onnx"), LAB, eps=0.01)
    with pytest.raises(PolicyError):
        verify(write_policy(tmp_path / "wide.onnx", specification(), size=27), LAB, eps=0.01)
    blind = specification(action=[ActionChannel(name=name, lower=0, upper=1) for name in ("left", "right")])
    with pytest.raises(PolicyError, match="of kind 'linear'"):
        verify(write_policy(tmp_path / "blind.onnx", blind), LAB, eps=0.01)


def test_another_control_interval_has_to_be_named(tmp_path, result):
    slow = write_policy(tmp_path / "slow.onnx", specification(control_interval=0.2))
    with pytest.raises(ConfigurationError, match=r"every 0\.2 s"):
        verify(slow, LAB, eps=0.01, trajectory=result.trajectory)
    longer = verify(slow, LAB, eps=0.01, trajectory=result.trajectory, interval=0.2)
    assert longer.rules.interval == 0.2


def test_one_state_without_outcome_is_enough(policy):
    alone = verify(policy, LAB, eps=0.01, trajectory=trajectory_of(26))
    assert alone.to_json()["task"]["success_rate"] is None
    assert alone.safety_rate.overall.total == 1
    assert alone.safety_rate.success.total == 0


def test_a_trajectory_carries_the_obstacles_of_its_episodes(result, tmp_path, policy):
    path = tmp_path / "run.npz"
    write_trajectory(path, result.trajectory)
    for left, right in zip(load_trajectory(path).scenarios, result.trajectory.scenarios, strict=True):
        np.testing.assert_array_equal(left.obstacles.circles, right.obstacles.circles)
        assert (left.name, left.start, left.goal) == (right.name, right.start, right.goal)


def test_a_recording_that_lies_off_the_map_as_a_whole_is_refused(policy, tmp_path):
    here, far = np.zeros((2, 3)), np.full((2, 3), 500.0)
    seen = np.ones((2, policy.input_size))
    np.savez(tmp_path / "far.npz", pose=far, observation=seen)
    with pytest.raises(TrajectoryError, match=r"every pose lies off the map .*x 500 to 500 m") as refused:
        verify(policy, LAB, eps=0.01, trajectory=tmp_path / "far.npz", close=0)
    assert "frame of the map" in refused.value.hint
    np.savez(tmp_path / "some.npz", pose=np.stack([here[0], far[0]]), observation=seen)
    assert len(verify(policy, LAB, eps=0.01, trajectory=tmp_path / "some.npz", close=0).verdict) == 2
