"""Models as Stable-Baselines3 saves them, with weights that say something."""

from __future__ import annotations

import json
import warnings
import zipfile
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import stable_baselines3 as sb3
import torch
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

SIZE = 6
LOW, HIGH = np.array([0.0, -1.0], np.float32), np.array([0.5, 1.0], np.float32)


class Wander(gymnasium.Env):  # type: ignore[misc]
    """Observations that need a normaliser, actions that need scaling or are chosen."""

    def __init__(self, choices: int = 0, size: int = SIZE) -> None:
        self.observation_space = gymnasium.spaces.Box(-20.0, 20.0, (size,), np.float32)
        self.action_space = gymnasium.spaces.Discrete(choices) if choices else gymnasium.spaces.Box(LOW, HIGH)

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[np.ndarray, dict[str, Any]]:
        super().reset(seed=seed)
        return self._observe(), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        return self._observe(), 0.0, False, bool(self.np_random.random() < 0.1), {}

    def _observe(self) -> np.ndarray:
        shape = self.observation_space.shape
        return (3.0 + 2.0 * self.np_random.normal(size=shape)).astype(np.float32)


def saved(
    folder: Path,
    algorithm: str,
    *,
    choices: int = 0,
    size: int = SIZE,
    normalise: bool = False,
    settings: dict[str, Any] | None = None,
    **more: Any,
) -> tuple[Any, Any]:
    """Save ``model.zip`` (and ``vec_normalize.pkl``) of a few steps of training; return the model and normaliser."""
    torch.manual_seed(0)
    environment: Any = DummyVecEnv([lambda: Wander(choices, size)])
    environment.seed(0)
    normaliser = None
    if normalise:
        environment = normaliser = VecNormalize(environment, clip_obs=1.5)
        environment.reset()
        for _ in range(50):
            environment.step(np.array([1] if choices else [LOW]))
    if algorithm in ("TD3", "DDPG", "SAC", "DQN"):
        more = {"learning_starts": 4, "buffer_size": 50, "batch_size": 4, **more}
    else:
        more = {"n_steps": 8, **({"batch_size": 8} if algorithm == "PPO" else {}), **more}
    kwargs = {"net_arch": [16, 12], **(settings or {})}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model = getattr(sb3, algorithm)(
            "MlpPolicy", environment, policy_kwargs=kwargs, seed=0, device="cpu", **more
        )
        model.learn(8)
    with torch.no_grad():
        for parameter in model.policy.parameters():  # untrained actors say almost nothing
            parameter.add_(0.3 * torch.randn_like(parameter))
    model.save(folder / "model.zip")
    if normaliser is not None:
        normaliser.training = False
        normaliser.save(str(folder / "vec_normalize.pkl"))
    return model, normaliser


def observations(count: int = 200, size: int = SIZE) -> np.ndarray:
    return (3.0 + 2.0 * np.random.default_rng(0).normal(size=(count, size))).astype(np.float32)


def rewritten(path: Path, **changes: Any) -> Path:
    """Write the zip again with entries of `data` replaced (None removes one), or members by `member_NAME`."""
    target = path.with_name("changed.zip")
    members = {name.removeprefix("member_"): value for name, value in changes.items() if "member_" in name}
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(target, "w") as new:
        for name in old.namelist():
            content = old.read(name)
            if name == "data":
                data = json.loads(content)
                for key, value in changes.items():
                    if key not in ("data",) and not key.startswith("member_"):
                        data[key] = value
                content = json.dumps({k: v for k, v in data.items() if v is not None}).encode()
            new.writestr(name, members.get(name.replace(".", "_"), content))
    return target
