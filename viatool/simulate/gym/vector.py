"""``viatool/Navigation-v0`` for many robots at once, on one batched simulator."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from viatool.arrays import Booleans, Floats, Singles
from viatool.errors import ConfigurationError
from viatool.policy.specification import PolicySpecification
from viatool.simulate.gym.options import EnvironmentOptions, information


class NavigationVectorEnvironment(VectorEnv[Singles, Singles, NDArray[Any]]):
    """E robots, each in a scenario of its own.

    Parameters
    ----------
    num_envs : int
        E.
    autoreset_mode : AutoresetMode or str
        ``SAME_STEP`` (default): a robot that is done begins its next episode in the same step; its last observation
        is in ``info["final_obs"]`` and its last info in ``info["final_info"]``. ``NEXT_STEP``: it is returned as
        it ended, and begins anew in the next step, which ignores its action and gives it reward 0. ``DISABLED``:
        call ``reset(options={"reset_mask": done})``.
    **setting
        As for `viatool.simulate.gym.options.EnvironmentOptions`; `map` is needed.
    """

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012

    def __init__(
        self, num_envs: int = 1, autoreset_mode: AutoresetMode | str = AutoresetMode.SAME_STEP, **setting: Any
    ) -> None:
        if num_envs < 1:
            raise ConfigurationError(f"{num_envs} environments", "ask for at least one")
        self.num_envs = num_envs
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        self.setting = EnvironmentOptions(**setting)
        self.simulator = self.setting.simulator(num_envs)
        self.single_observation_space = self.setting.observation_space()
        self.single_action_space = self.setting.action_space()
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._done = np.zeros(num_envs, dtype=bool)
        self._fresh = True

    @property
    def specification(self) -> PolicySpecification:
        """What the numbers mean; write it beside an exported policy."""
        return self.setting.specification

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Singles, dict[str, Any]]:
        """Begin the next episode of all robots, or of those of ``options["reset_mask"]``, (E,) bool."""
        first = seed[0] if isinstance(seed, list) else seed
        super().reset(seed=first)
        if first is not None or self._fresh:
            self.simulator.reseed(int(self.np_random.integers(2**31)))
            self._fresh = False
        mask = None if options is None else options.get("reset_mask")
        which = np.ones(self.num_envs, dtype=bool) if mask is None else np.asarray(mask, dtype=bool)
        self._done &= ~which
        return self.simulator.reset(which).astype(np.float32), {}

    def step(self, actions: Singles) -> tuple[Singles, Floats, Booleans, Booleans, dict[str, Any]]:
        """Let every robot hold a command for one control interval."""
        step = self.simulator.step(self.setting.commands(actions))
        reward, terminated, truncated = step.reward, step.terminated, step.truncated
        told = information(step.cost, step.success, step.collision, step.clearance, step.goal_distance)
        observations = step.observation.astype(np.float32)
        there = np.ones(self.num_envs, dtype=bool)
        if self.autoreset_mode == AutoresetMode.NEXT_STEP and self._done.any():
            there = ~self._done
            observations = self.simulator.reset(self._done).astype(np.float32)
            reward, terminated, truncated = reward * there, terminated & there, truncated & there
        self._done = terminated | truncated
        info: dict[str, Any] = {}
        if self.autoreset_mode == AutoresetMode.SAME_STEP and self._done.any():
            info = self._final(observations, told)
            observations = self.simulator.reset(self._done).astype(np.float32)
            there = ~self._done
        for name, values in told.items():
            info[name], info[f"_{name}"] = np.where(there, values, np.zeros_like(values)), there.copy()
        return observations, reward, terminated, truncated, info

    def close_extras(self, **kwargs: Any) -> None:
        """Give back what the engine holds."""
        self.simulator.close()

    def _final(self, observations: Singles, told: dict[str, Any]) -> dict[str, Any]:
        """Return the last observation and info of the robots that are done."""
        last = np.full(self.num_envs, None, dtype=object)
        for robot in np.flatnonzero(self._done):
            last[robot] = observations[robot].copy()
        final: dict[str, Any] = {}
        for name, values in told.items():
            final[name] = np.where(self._done, values, np.zeros_like(values))
            final[f"_{name}"] = self._done.copy()
        return {
            "final_obs": last,
            "_final_obs": self._done.copy(),
            "final_info": final,
            "_final_info": self._done.copy(),
        }
