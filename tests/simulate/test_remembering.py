"""Policies that remember are driven as their file runs by itself: one session that carries its state."""

from __future__ import annotations

from pathlib import Path

import gymnasium
import numpy as np
import pytest

from tests.needs import needs_pybullet
from tests.remembering import SENSED, Deployed, written
from viatool.errors import PolicyError
from viatool.policy import Policy, load_policy
from viatool.policy.memory import CarriedMemory
from viatool.setting.setting import Setting
from viatool.simulate import Places, observe_places, roll_out
from viatool.simulate.gym import ID
from viatool.trajectory import Trajectory, load_trajectory, write_trajectory
from viatool.world import load_map

ROOM = load_map("examples/zoo/room.yaml")
LIMITS = np.array([[0.0, -1.0], [0.5, 1.0]])


def replayed(policy: Policy, driven: Trajectory, **initial: float) -> np.ndarray:
    """The commands that the file gives for what was sensed, one session for each episode; checks what it remembers."""
    assert policy.spec is not None
    deployed, commands = Deployed(policy.path, dict(policy.spec.memory), initial), []
    for row in range(len(driven)):
        if driven.time[row] == 0.0:
            deployed.begin()
        np.testing.assert_array_equal(driven.observations[row, SENSED:], deployed.numbers)
        action = deployed.step(driven.observations[row, :SENSED])
        commands.append(np.clip(action * [0.25, 1.0] + [0.25, 0.0], *LIMITS))
    return np.array(commands)


@pytest.mark.parametrize("engine", ["kinematic", pytest.param("bullet", marks=needs_pybullet)])
@pytest.mark.parametrize("kind", ["GRU", "LSTM"])
def test_a_drive_carries_the_memory_and_begins_anew_with_each_episode(
    engine: str, kind: str, tmp_path: Path
) -> None:
    policy = load_policy(*written(tmp_path, kind))
    scenarios = ROOM.scenarios[:3]
    driven = roll_out(policy, ROOM, scenarios, engine=engine, horizon=25, noise=0.02)
    assert driven.episodes == 3
    assert len(np.unique(driven.observations[:, SENSED], axis=0)) > 20
    np.testing.assert_array_equal(replayed(policy, driven), driven.actions)


def test_more_episodes_than_robots_each_begin_with_the_initial_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from viatool.simulate import NavigationSimulator

    policy = load_policy(*written(tmp_path, channels="{name: h, kind: memory, initial: 0.4}"))
    monkeypatch.setattr(NavigationSimulator, "largest", 2)
    driven = roll_out(policy, ROOM, [*ROOM.scenarios, *ROOM.scenarios], horizon=12)
    assert driven.episodes == 8
    np.testing.assert_array_equal(replayed(policy, driven, h=0.4), driven.actions)


@pytest.mark.parametrize("suffix", ["npz", "csv"])
def test_files_keep_the_memory_of_each_state(suffix: str, tmp_path: Path) -> None:
    policy = load_policy(*written(tmp_path, "LSTM"))
    driven = roll_out(policy, ROOM, ROOM.scenarios[:2], horizon=6)
    write_trajectory(tmp_path / f"run.{suffix}", driven, policy.spec)
    again = load_trajectory(tmp_path / f"run.{suffix}", policy.spec)
    np.testing.assert_array_equal(again.observations, driven.observations)
    if suffix == "csv":
        assert ",h_0,h_1,h_2,h_3,h_4,h_5,c_0," in (tmp_path / "run.csv").read_text("utf-8").splitlines()[0]


def test_an_environment_senses_and_who_drives_remembers(tmp_path: Path) -> None:
    policy = load_policy(*written(tmp_path))
    assert policy.spec is not None
    environment = gymnasium.make(ID, map=ROOM, observation=policy.spec, scenarios="fixed", noise=0.0)
    assert environment.observation_space.shape == (SENSED,)
    sensed, _ = environment.reset(seed=0)
    memory, commands = CarriedMemory(policy.spec, 1), []
    for _ in range(15):
        observation = memory.beside(sensed[None])
        commands.append(policy.run(observation)[0])
        memory.carry(policy, observation)
        sensed, *_ = environment.step(commands[-1].astype(np.float32))
    driven = roll_out(policy, ROOM, ROOM.scenarios[:1], horizon=15, noise=0.0)
    np.testing.assert_allclose(commands, driven.actions, atol=1e-5)


def test_poses_that_were_picked_have_no_memory(tmp_path: Path) -> None:
    policy = load_policy(*written(tmp_path))
    with pytest.raises(PolicyError, match="'h' of kind 'memory' holds what the policy remembers"):
        observe_places(policy, Setting.of(policy, ROOM, 0.01), Places(count=3))
