"""``viatool/Navigation-v0``: one robot."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np

from viatool.arrays import Singles
from viatool.policy.specification import PolicySpecification
from viatool.simulate.gym.options import EnvironmentOptions, information


class NavigationEnvironment(gymnasium.Env[Singles, Singles]):
    """Drive to a goal among obstacles.

    Parameters
    ----------
    **setting
        As for `viatool.simulate.gym.options.EnvironmentOptions`; `map` is needed.

    Notes
    -----
    Actions are v in m/s and omega in rad/s, or the number of a command where the specification has a choice;
    rules around a policy (`overrides`) are not applied. `info` holds `cost` (1 within the danger clearance, else 0),
    `is_success`, `collision`, `clearance` and `goal_distance` (metres).
    """

    metadata = {"render_modes": []}  # noqa: RUF012  # as the base class has it

    def __init__(self, **setting: Any) -> None:
        self.setting = EnvironmentOptions(**setting)
        self.simulator = self.setting.simulator(1)
        self.observation_space = self.setting.observation_space()
        self.action_space = self.setting.action_space()
        self._fresh = True

    @property
    def specification(self) -> PolicySpecification:
        """What the numbers mean; write it beside an exported policy."""
        return self.setting.specification

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Singles, dict[str, Any]]:
        """Begin the next episode."""
        super().reset(seed=seed)
        if seed is not None or self._fresh:
            self.simulator.reseed(int(self.np_random.integers(2**31)))
            self._fresh = False
        return self.simulator.reset()[0].astype(np.float32), {}

    def step(self, action: Singles) -> tuple[Singles, float, bool, bool, dict[str, Any]]:
        """Hold a command for one control interval."""
        step = self.simulator.step(self.setting.commands(action)[None])
        told = information(
            float(step.cost[0]),
            bool(step.success[0]),
            bool(step.collision[0]),
            float(step.clearance[0]),
            float(step.goal_distance[0]),
        )
        observation = step.observation[0].astype(np.float32)
        return observation, float(step.reward[0]), bool(step.terminated[0]), bool(step.truncated[0]), told

    def close(self) -> None:
        """Give back what the engine holds."""
        self.simulator.close()
