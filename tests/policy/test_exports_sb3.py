"""Stable-Baselines3, CleanRL, RSL-RL and rl_games actors, exported by the recipes of docs/exporting.md."""

from __future__ import annotations

import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.policy.test_exports_torch import assert_enclosed, export
from viatool.errors import PolicyError
from viatool.policy import load_policy

torch = pytest.importorskip("torch")
sb3 = pytest.importorskip("stable_baselines3")
gymnasium = pytest.importorskip("gymnasium")

SIZE = 6
LOW, HIGH = np.array([0.0, -1.0], np.float32), np.array([0.5, 1.0], np.float32)


class Wander(gymnasium.Env):  # type: ignore[misc]
    """Observations that need a normaliser, actions that need scaling."""

    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (SIZE,), np.float32)
    action_space = gymnasium.spaces.Box(LOW, HIGH)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        super().reset(seed=seed)
        return self._observe(), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        return self._observe(), 0.0, False, bool(self.np_random.random() < 0.1), {}

    def _observe(self) -> np.ndarray:
        return (3.0 + 2.0 * self.np_random.normal(size=SIZE)).astype(np.float32)


def documented_recipes() -> dict[str, Any]:
    """The Python blocks of the documentation, executed."""
    text = (Path(__file__).parents[2] / "docs" / "exporting.md").read_text(encoding="utf-8")
    names: dict[str, Any] = {}
    for block in re.findall(r"```python\n(.*?)```", text, re.DOTALL):
        exec(block, names)
    return names


@pytest.fixture(scope="module")
def recipes() -> dict[str, Any]:
    return documented_recipes()


def trained(algorithm: str, normalise: bool) -> tuple[Any, Any]:
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

    environment: Any = DummyVecEnv([Wander])
    normaliser = None
    if normalise:
        environment = normaliser = VecNormalize(environment, clip_obs=5.0)
        environment.reset()
        for _ in range(200):
            environment.step(np.array([LOW]))
    model = getattr(sb3, algorithm)(
        "MlpPolicy", environment, policy_kwargs={"net_arch": [16, 16]}, seed=0, device="cpu"
    )
    with torch.no_grad():
        for parameter in model.policy.parameters():  # untrained actors say almost nothing
            parameter.add_(0.3 * torch.randn_like(parameter))
    return model, normaliser


@pytest.mark.parametrize("normalise", [False, True], ids=["raw", "VecNormalize"])
@pytest.mark.parametrize("algorithm", ["TD3", "DDPG", "SAC", "PPO", "A2C"])
def test_the_recipe_gives_the_action_of_predict(
    algorithm: str, normalise: bool, recipes: dict[str, Any], tmp_path: Path
) -> None:
    torch.manual_seed(0)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model, normaliser = trained(algorithm, normalise)
        recipes["export_sb3"](model, str(tmp_path / "policy.onnx"), normaliser)

    policy = load_policy(tmp_path / "policy.onnx")
    observations = (3.0 + 2.0 * np.random.default_rng(0).normal(size=(100, SIZE))).astype(np.float32)
    seen = normaliser.normalize_obs(observations) if normaliser is not None else observations
    expected, _ = model.predict(seen, deterministic=True)
    np.testing.assert_allclose(policy.run(observations), expected, atol=2e-5)
    np.testing.assert_allclose(policy(observations), expected, atol=2e-5)
    assert (expected.std(axis=0) > 1e-3).all()
    assert_enclosed(policy)


class Deterministic(torch.nn.Module):  # type: ignore[misc]
    """SAC's actor as Stable-Baselines3's own documentation exports it."""

    def __init__(self, actor: Any) -> None:
        super().__init__()
        self.actor = actor

    def forward(self, x: Any) -> Any:
        return self.actor(x, deterministic=True)


@pytest.mark.parametrize("algorithm", ["TD3", "SAC"])
def test_the_bare_actor_is_read_too(algorithm: str, tmp_path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model, _ = trained(algorithm, normalise=False)
    module = Deterministic(model.policy.actor) if algorithm == "SAC" else model.policy
    policy = load_policy(export(module, tmp_path / "policy.onnx", dynamo=False))
    assert policy.output_size == 2
    assert_enclosed(policy)


def test_a_sampled_action_is_refused_by_name(tmp_path: Path) -> None:
    class Sampled(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.net = torch.nn.Linear(SIZE, 2)

        def forward(self, x: Any) -> Any:
            mean = self.net(x)
            return mean + torch.randn_like(mean)

    with pytest.raises(PolicyError, match=r"RandomNormalLike.*stochastic") as refusal:
        load_policy(export(Sampled(), tmp_path / "policy.onnx", dynamo=False))
    assert "deterministic" in refusal.value.hint


def test_the_cleanrl_recipe(recipes: dict[str, Any], tmp_path: Path) -> None:
    torch.manual_seed(0)
    actor = torch.nn.Sequential(torch.nn.Linear(SIZE, 16), torch.nn.Tanh(), torch.nn.Linear(16, 2))
    module = recipes["CleanRLActor"](actor, np.linspace(-1, 1, SIZE), np.linspace(0.5, 2, SIZE))
    policy = load_policy(export(module, tmp_path / "policy.onnx", dynamo=True))
    observations = torch.randn(100, SIZE)
    np.testing.assert_allclose(policy(observations.numpy()), module(observations).detach().numpy(), atol=1e-5)
    assert_enclosed(policy)


class EmpiricalNormalisation(torch.nn.Module):  # type: ignore[misc]
    """As RSL-RL computes it: the standard deviation is raised by a hundredth."""

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("mean", torch.linspace(-1, 1, SIZE)[None])
        self.register_buffer("std", torch.linspace(0.5, 2, SIZE)[None])

    def forward(self, x: Any) -> Any:
        return (x - self.mean) / (self.std + 1e-2)


@pytest.mark.parametrize("normalise", [False, True], ids=["bare", "normalised"])
def test_the_rsl_rl_recipe(normalise: bool, recipes: dict[str, Any], tmp_path: Path) -> None:
    torch.manual_seed(0)
    actor = torch.nn.Sequential(torch.nn.Linear(SIZE, 16), torch.nn.ELU(), torch.nn.Linear(16, 2))
    normaliser = EmpiricalNormalisation() if normalise else None
    path = tmp_path / "policy.onnx"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        recipes["export_rsl_rl"](actor, str(path), SIZE, normaliser)
    policy = load_policy(path)
    assert policy.maps.before.startswith("inside the model" if normalise else "nothing")
    observations = torch.randn(50, SIZE)
    expected = actor(normaliser(observations) if normaliser else observations).detach().numpy()
    np.testing.assert_allclose(policy(observations.numpy()), expected, atol=1e-5)


def test_the_rl_games_recipe(recipes: dict[str, Any], tmp_path: Path) -> None:
    torch.manual_seed(0)
    network, statistics = torch.nn.Module(), torch.nn.Module()
    network.actor_mlp = torch.nn.Sequential(torch.nn.Linear(SIZE, 16), torch.nn.ELU())
    network.mu, network.mu_act = torch.nn.Linear(16, 2), torch.nn.Identity()
    statistics.running_mean = torch.linspace(-1, 1, SIZE, dtype=torch.float64)
    statistics.running_var = torch.linspace(0.5, 2, SIZE, dtype=torch.float64)
    statistics.epsilon = 1e-5
    module = recipes["RlGamesActor"](network, statistics)
    policy = load_policy(export(module, tmp_path / "policy.onnx", dynamo=False))
    assert "clipped to [-5, 5]" in policy.maps.before
    observations = torch.randn(50, SIZE)
    np.testing.assert_allclose(policy(observations.numpy()), module(observations).detach().numpy(), atol=1e-5)
    assert_enclosed(policy)
