"""States of a policy that remembers are verified with the memory that was recorded, or computed over whole episodes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

import viatool
from tests.bags import SCAN, drive_messages, write_bag
from tests.remembering import HIDDEN, RAYS, SENSED, Deployed, written
from viatool.cli import main
from viatool.errors import PolicyError, TrajectoryError
from viatool.policy import Policy, load_policy
from viatool.setting.recalled import recalled
from viatool.setting.setting import Setting
from viatool.simulate import Places, roll_out
from viatool.trajectory import BagSettings, Trajectory, load_trajectory, write_trajectory
from viatool.verification.witness_file import load_witnesses, replay
from viatool.world import Lidar, load_map

ROOM = load_map("examples/zoo/room.yaml")
EPS = {"": 0.05, "lidar": 0.1}


@pytest.fixture(scope="module")
def policy(tmp_path_factory: pytest.TempPathFactory) -> Policy:
    return load_policy(*written(tmp_path_factory.mktemp("policy"), strength=3.0))


@pytest.fixture(scope="module")
def driven(policy: Policy) -> Trajectory:
    return roll_out(policy, ROOM, ROOM.scenarios[:3], horizon=25, noise=0.0)


def escaping(policy: Policy, result: Any, memory: Any = None, samples: int = 30) -> int:
    """Count actions outside of their bounds: of observations within eps, beside the recorded memory or another."""
    assert policy.spec is not None
    deployed = Deployed(policy.path, dict(policy.spec.memory))
    rng, outside = np.random.default_rng(0), 0
    radii = result.setting.radii[:SENSED]
    inputs = policy.spec.inputs
    for row in range(0, len(result.poses), 7):
        deployed.remember(result.observations[row, SENSED:] if memory is None else memory[row])
        for k in range(samples):
            error = rng.choice([-1.0, 1.0], SENSED) if k % 2 else rng.uniform(-1.0, 1.0, SENSED)
            scale = np.where(inputs.channel[:SENSED] == 0, 0.2, 1.0)
            seen = result.observations[row, :SENSED] + 0.999 * scale * radii * error
            action = deployed.step(seen, carry=False).astype(np.float64) * [0.25, 1.0] + [0.25, 0.0]
            action = np.clip(action, [0.0, -1.0], [0.5, 1.0])
            outside += int(((action < result.lower[row]) | (action > result.upper[row])).any())
    return outside


@pytest.mark.parametrize("kind", ["GRU", "LSTM"])
def test_bounds_hold_for_the_recorded_memory_and_not_for_another(kind: str, tmp_path: Path) -> None:
    policy = load_policy(*written(tmp_path, kind, strength=3.0))
    driven = roll_out(policy, ROOM, ROOM.scenarios[:3], horizon=25, noise=0.0)
    result = viatool.verify(policy, ROOM, eps=EPS, trajectory=driven)
    assert escaping(policy, result) == 0
    assert (result.setting.radii[SENSED:] == 0.0).all()
    assert result.assumptions()["memory"].startswith("as it was in each state (h 6")
    remembered = driven.observations[:, SENSED:]
    forgotten = np.zeros_like(remembered)
    assert escaping(policy, result, forgotten) > 0
    emptied = replace(driven, observations=np.hstack([driven.observations[:, :SENSED], forgotten]))
    mutant = viatool.verify(policy, ROOM, eps=EPS, trajectory=emptied)
    assert escaping(policy, mutant, remembered) > 0  # a verification that forgets is caught


def test_what_was_not_recorded_is_computed_over_each_episode(policy: Policy, driven: Trajectory) -> None:
    setting = Setting.of(policy, ROOM, 0.01)
    bare = replace(driven, observations=driven.observations[:, :SENSED])
    found = recalled(policy, setting, bare)
    np.testing.assert_array_equal(found.observations, driven.observations)
    assert "the policy's memory is not recorded: onnxruntime computed it" in found.notes[-1]
    assert recalled(policy, setting, driven) is driven
    result, expected = (viatool.verify(policy, ROOM, eps=EPS, trajectory=one) for one in (bare, driven))
    np.testing.assert_array_equal(result.verdict, expected.verdict)
    np.testing.assert_array_equal(result.lower, expected.lower)
    assert "is not recorded: onnxruntime computed it" in result.assumptions()["states"]


@pytest.mark.parametrize("suffix", ["npz", "csv"])
def test_files_without_the_memory_are_completed(
    policy: Policy, driven: Trajectory, suffix: str, tmp_path: Path
) -> None:
    assert policy.spec is not None
    sensing = policy.spec.model_copy(update={"observation": policy.spec.sensed})
    bare = replace(driven, observations=driven.observations[:, :SENSED])
    write_trajectory(tmp_path / f"run.{suffix}", bare, sensing)
    result = viatool.verify(policy, ROOM, eps=EPS, trajectory=tmp_path / f"run.{suffix}")
    np.testing.assert_array_equal(result.observations, driven.observations)


def test_recordings_over_which_no_memory_can_be_followed_are_refused(
    policy: Policy, driven: Trajectory, tmp_path: Path
) -> None:
    setting = Setting.of(policy, ROOM, 0.01)
    bare = replace(driven, observations=driven.observations[:, :SENSED])
    keep = np.ones(len(bare), dtype=bool)
    keep[10] = False
    mixed = np.r_[0:5, np.flatnonzero(bare.episode == 1)[:1], 5:8]
    for broken, said in (
        (bare.select(keep), "row 10 of across is not one control interval"),
        (bare.select(np.arange(1, len(bare))), r"across begins at 0.1 s \(step 1\) in row 0, not"),
        (replace(bare, time=2.0 * bare.time), "row 1 of across is not one control interval"),
        (replace(bare, steps=bare.steps + 5), r"across begins at 0 s \(step 5\) in row 0, not at its start"),
        (replace(bare, steps=2 * bare.steps), "row 1 of across is not one control interval"),
        (replace(bare, clocked=False), "without the times"),
        (replace(bare, connected=False), "without the times"),
        (bare.select(mixed), r"across begins at 0.5 s \(step 5\) in row 6, not"),
    ):
        with pytest.raises(TrajectoryError, match=said):
            recalled(policy, setting, broken)
    wide = replace(driven, observations=driven.observations[:, : SENSED + 1])
    with pytest.raises(TrajectoryError, match=rf"has {SENSED + 1} observation entries"):
        viatool.verify(policy, ROOM, eps=0.01, trajectory=wide)
    write_trajectory(tmp_path / "run.csv", driven, policy.spec)
    text = (tmp_path / "run.csv").read_text("utf-8").replace("h_3", "g_3", 1)
    (tmp_path / "run.csv").write_text(text, "utf-8")
    with pytest.raises(TrajectoryError, match="lacks the column 'h_3'"):
        load_trajectory(tmp_path / "run.csv", policy.spec)


def test_a_bag_is_completed_or_refused(policy: Policy, tmp_path: Path) -> None:
    lidar = Lidar(field_of_view=3.14159, rays=RAYS, bins=RAYS, minimum_range=0.0, maximum_range=5.0)
    world_map = ROOM.with_robot(replace(ROOM.robot, lidar=lidar))
    messages, driven = drive_messages(policy, world_map)
    settings = BagSettings(goal=ROOM.scenarios[0].goal)
    bag = load_trajectory(write_bag(tmp_path / "run", messages, "mcap"), policy.spec, settings)
    assert bag.observations.shape[1] == SENSED
    found = recalled(policy, Setting.of(policy, ROOM, 0.01), bag)
    assert policy.spec is not None
    deployed = Deployed(policy.path, dict(policy.spec.memory))
    for row in found.observations:
        np.testing.assert_array_equal(row[SENSED:], deployed.numbers)
        deployed.step(row[:SENSED])
    np.testing.assert_allclose(found.observations, driven.observations, atol=1e-4)
    at = [index for index, message in enumerate(messages) if message.type == SCAN][4]
    gap = write_bag(tmp_path / "gap", messages[:at] + messages[at + 1 :], "mcap")
    with pytest.raises(TrajectoryError, match="is not one control interval"):
        viatool.verify(policy, ROOM, eps=0.01, trajectory=gap, bag=settings)


def test_counterexamples_keep_the_memory_and_are_replayed(
    policy: Policy, driven: Trajectory, tmp_path: Path
) -> None:
    assert policy.spec is not None
    write_trajectory(tmp_path / "run.npz", driven)
    spec = tmp_path / "spec.yaml"
    spec.write_text(policy.spec.to_yaml(), "utf-8")
    shared = ["--spec", str(spec), "--map", "examples/zoo/room.yaml"]
    asked = ["verify", str(policy.path), *shared, "--eps", "0.3", "--clearance", "0.9"]
    asked += ["--trajectory", str(tmp_path / "run.npz")]
    witnesses, states = tmp_path / "witnesses.json", tmp_path / "states.npz"
    done = CliRunner().invoke(main, [*asked, "-o", f"witnesses:{witnesses}", "-o", f"states:{states}"])
    assert done.exit_code == 0, done.output
    file = load_witnesses(witnesses)
    assert len(file) > 0
    again = replay(policy, ROOM, file)
    assert again.violates.all()
    assert CliRunner().invoke(main, ["replay", str(witnesses), *shared]).exit_code == 0
    with np.load(states) as table:
        rows = [entry["state"] for entry in file.entries]
        np.testing.assert_array_equal(file.observations[:, SENSED:], table["observation"][rows, SENSED:])
        np.testing.assert_array_equal(
            table["observation_lower"][:, SENSED:], table["observation"][:, SENSED:]
        )
        np.testing.assert_array_equal(
            table["observation_upper"][:, SENSED:], table["observation"][:, SENSED:]
        )
        verdict = table["verdict"]
    deployed = Deployed(policy.path, dict(policy.spec.memory))
    for seen, command in zip(file.observations, again.actions, strict=True):
        deployed.remember(seen[SENSED:])
        action = np.clip(deployed.step(seen[:SENSED]) * [0.25, 1.0] + [0.25, 0.0], [0.0, -1.0], [0.5, 1.0])
        np.testing.assert_allclose(command, action, atol=1e-6)
    repeated = viatool.verify(policy, ROOM, eps=0.3, clearance=0.9, trajectory=states)
    np.testing.assert_array_equal(repeated.verdict, verdict)


def test_what_asks_about_sets_of_poses_refuses_a_memory_before_any_work(
    policy: Policy, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Policy, "run", None)
    for ask in (
        lambda: viatool.verify(policy, ROOM, eps=0.01, horizon=2),
        lambda: viatool.verify(policy, ROOM, eps=0.01, places=Places(count=4)),
        lambda: viatool.certify(policy, ROOM, eps=0.01),
    ):
        with pytest.raises(
            PolicyError, match="'h' of kind 'memory' holds what the policy remembers"
        ) as refused:
            ask()
        assert "verify recorded or simulated states" in refused.value.hint


def test_a_diagnosis_drives_and_refuses_a_recording(policy: Policy, driven: Trajectory) -> None:
    from viatool.doctor import diagnose

    found = diagnose(policy, ROOM, ROOM.scenarios[:2], horizon=5)
    assert found.setting.spec.memory
    with pytest.raises(PolicyError, match="what it remembered was another under each reading"):
        diagnose(policy, ROOM, trajectory=driven)


def test_an_error_of_the_memory_is_counted_where_it_is_named(policy: Policy, driven: Trajectory) -> None:
    result = viatool.verify(policy, ROOM, eps={**EPS, "h": 0.2}, trajectory=driven)
    assert "h 6 within 0.2" in result.assumptions()["memory"]
    rng = np.random.default_rng(1)
    other = driven.observations[:, SENSED:] + 0.199 * rng.choice([-1.0, 1.0], (len(driven), HIDDEN))
    assert escaping(policy, result, other) == 0
    exact = viatool.verify(policy, ROOM, eps=EPS, trajectory=driven)
    assert escaping(policy, exact, other) > 0
