"""The gymnasium environments, and a policy that Stable-Baselines3 trains in one."""

from __future__ import annotations

import re
import warnings
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

import viatool
from tests.choosing import TABLE, choosing_specification
from tests.needs import needs_pybullet
from viatool.errors import ConfigurationError
from viatool.policy.specification import ObservationChannel, PolicySpecification
from viatool.simulate import NavigationSimulator
from viatool.simulate.gym import ID, NavigationEnvironment
from viatool.world import load_map

LAB = "maps/lab.yaml"


def make(**setting: Any) -> NavigationEnvironment:
    environment = gymnasium.make(ID, map=LAB, **setting).unwrapped
    assert isinstance(environment, NavigationEnvironment)
    return environment


@pytest.mark.parametrize("engine", ["kinematic", pytest.param("bullet", marks=needs_pybullet)])
def test_gymnasium_accepts_the_environment(engine: str) -> None:
    check_env(make(engine=engine, noise=0.02, delay=0.05, drift=0.01))


def test_stable_baselines_accepts_the_environment() -> None:
    from stable_baselines3.common.env_checker import check_env as check

    with warnings.catch_warnings():
        # It recommends actions in [-1, 1]; ours are in m/s and rad/s, and TD3 and SAC scale them.
        warnings.filterwarnings("ignore", message=".*symmetric and normalized Box action space")
        check(make())


def test_steps_are_those_of_the_simulator() -> None:
    environment = make(scenarios="fixed", noise=0.0, horizon=40)
    twin = NavigationSimulator(load_map(LAB), 1, scenarios=load_map(LAB).scenarios, noise=0.0, horizon=40)
    observation, _ = environment.reset(seed=3)
    assert observation[:25] == pytest.approx(twin.reset()[0])
    for _ in range(40):
        observation, reward, terminated, truncated, info = environment.step(np.array([0.5, 0.1], np.float32))
        step = twin.step(np.array([[0.5, 0.1]], np.float32))
        assert observation[:25] == pytest.approx(step.observation[0], abs=1e-6)
        assert observation[25] == 0.0
        assert (reward, info["cost"]) == (pytest.approx(step.reward[0]), step.cost[0])
        assert (terminated, truncated) == (step.terminated[0], step.truncated[0])
        assert (info["is_success"], info["collision"]) == (step.success[0], step.collision[0])
        if terminated or truncated:
            break
    assert terminated or truncated


def test_the_shipped_policies_drive_in_it() -> None:
    policy = viatool.load_policy("policies/via.onnx")
    environment = make()
    assert environment.observation_space.shape == (policy.input_size,)
    ends = []
    for episode in range(3):
        observation, _ = environment.reset(seed=episode)
        over = False
        while not over:
            action = policy.run(observation[None])[0].astype(np.float32)
            observation, _, terminated, truncated, info = environment.step(action)
            over = terminated or truncated
        ends.append(info["is_success"])
    assert all(ends)
    assert make(observation="policies/via.onnx").specification == policy.spec


def test_other_observations_can_be_asked_for() -> None:
    specification = PolicySpecification(
        observation=[ObservationChannel(name="far", kind="goal_distance")],
        action=make().specification.action,
    )
    observation, _ = make(observation=specification).reset(seed=0)
    assert observation.shape == (1,)


@pytest.mark.parametrize("mode", [AutoresetMode.SAME_STEP, AutoresetMode.NEXT_STEP])
def test_a_batch_resets_its_robots_as_gymnasium_says(mode: AutoresetMode) -> None:
    robots = 16
    batch = gymnasium.make_vec(ID, num_envs=robots, map=LAB, horizon=30, autoreset_mode=mode)
    assert batch.metadata["autoreset_mode"] == mode
    observations, _ = batch.reset(seed=1)
    assert observations in batch.observation_space
    ended = np.zeros(robots, bool)
    finals = 0
    for _ in range(70):
        before = ended
        observations, rewards, terminated, truncated, info = batch.step(
            np.tile(np.array([0.5, 0.2], np.float32), (robots, 1))
        )
        assert observations in batch.observation_space
        ended = terminated | truncated
        begun = before if mode == AutoresetMode.NEXT_STEP else ended
        assert (observations[begun, 23:25] == 0.0).all()  # no command was given yet
        assert (info["_cost"] == ~begun).all()
        if mode == AutoresetMode.NEXT_STEP:
            assert (rewards[before] == 0.0).all()
            assert not ended[before].any()
            assert "final_obs" not in info
        elif ended.any():
            finals += int(ended.sum())
            assert (info["_final_obs"] == ended).all()
            last = np.stack(info["final_obs"][ended])
            assert last[:, 23] == pytest.approx(0.5)
            assert (info["final_info"]["collision"][ended] == (rewards[ended] == -100.0)).all()
    assert finals > robots or mode == AutoresetMode.NEXT_STEP


def test_a_batch_can_be_reset_by_hand_and_is_seeded() -> None:
    batch = gymnasium.make_vec(ID, num_envs=4, map=LAB, autoreset_mode=AutoresetMode.DISABLED)
    first, _ = batch.reset(seed=5)
    again, _ = batch.reset(seed=5)
    assert (first == again).all()
    mask = np.array([True, False, False, True])
    changed, _ = batch.reset(options={"reset_mask": mask})
    assert ((changed != first).any(axis=1) == mask).all()


def test_wrong_settings_are_refused() -> None:
    for wrong, reason in (
        ({"engine": "gazebo"}, "unknown engine"),
        ({"robot": "pepper"}, "unknown robot"),
        ({"scenarios": "all"}, "unknown scenarios"),
    ):
        with pytest.raises(ConfigurationError, match=reason):
            make(**wrong)
    with pytest.raises(ConfigurationError, match="0 environments"):
        gymnasium.make_vec(ID, num_envs=0, map=LAB)


def test_td3_of_stable_baselines_learns_in_it_and_its_export_is_verified(tmp_path: Path) -> None:
    from stable_baselines3 import TD3

    environment = gymnasium.make("viatool.simulate.gym:viatool/Navigation-v0", map=LAB, horizon=60)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = TD3(
            "MlpPolicy",
            environment,
            learning_starts=200,
            policy_kwargs={"net_arch": [16, 16]},
            seed=0,
            device="cpu",
        )
        before = [parameter.detach().clone() for parameter in model.actor.parameters()]
        model.learn(400)
        names: dict[str, Any] = {}
        text = Path("docs/exporting.md").read_text(encoding="utf-8")
        exec(re.findall(r"```python\n(.*?)```", text, re.DOTALL)[0], names)
        names["export_sb3"](model, str(tmp_path / "policy.onnx"))
    after = list(model.actor.parameters())
    assert any((a != b).any() for a, b in zip(before, after, strict=True))
    sidecar = tmp_path / "robot.yaml"
    inner = environment.unwrapped
    assert isinstance(inner, NavigationEnvironment)
    sidecar.write_text(inner.specification.to_yaml(), encoding="utf-8")

    policy = viatool.load_policy(tmp_path / "policy.onnx", sidecar)
    observation, _ = environment.reset(seed=1)
    expected, _ = model.predict(observation, deterministic=True)
    assert policy.run(observation[None])[0] == pytest.approx(expected, abs=1e-5)
    lab = load_map(LAB)
    result = viatool.verify(policy, lab, eps=0.01, scenarios=lab.scenarios[:1])
    assert len(result.trajectory) > 0
    assert result.safety_rate is not None


def test_a_choice_is_a_number_and_sends_the_command_of_its_table() -> None:
    environment = make(observation=choosing_specification())
    assert environment.action_space == gymnasium.spaces.Discrete(len(TABLE))
    environment.reset(seed=3)
    observation, *_ = environment.step(np.int64(3))
    np.testing.assert_allclose(observation[23:25], TABLE[3], atol=1e-6)
    many = gymnasium.make_vec(ID, num_envs=2, map=LAB, observation=choosing_specification())
    many.reset(seed=3)
    observations, *_ = many.step(np.array([1, 4]))
    np.testing.assert_allclose(observations[:, 23:25], [TABLE[1], TABLE[4]], atol=1e-6)
