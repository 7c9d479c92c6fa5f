"""What an environment is made of: the map, the engine, and the spaces of observations and actions."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from gymnasium.spaces import Box, Discrete, Space
from numpy.typing import ArrayLike

from viatool.arrays import Floats
from viatool.channels import Extent, Quantities
from viatool.errors import ConfigurationError
from viatool.motion.kinematics import motion_of
from viatool.policy import load_policy, load_specification
from viatool.policy.action_channels import ActionChannel
from viatool.policy.command_map import Chosen, CommandMap, Picked
from viatool.policy.specification import ObservationChannel, PolicySpecification
from viatool.policy.specified import specification_of
from viatool.setting.reconcile import with_robot
from viatool.setting.setting import Setting
from viatool.setting.wishes import Wishes
from viatool.simulate.conditions import Conditions
from viatool.simulate.engines import make_simulator
from viatool.simulate.observation import navigation_channels
from viatool.simulate.simulator import Simulator
from viatool.simulate.task import NavigationTask
from viatool.world import Robot, Scenario, WorldMap, load_map

Where = WorldMap | str | os.PathLike[str]
Meaning = PolicySpecification | str | os.PathLike[str]

_BUDGET = 0.0


@dataclass(frozen=True, kw_only=True)
class EnvironmentOptions:
    """The parameters of both kinds of environment, which `gymnasium.make` and `make_vec` take by name.

    Parameters
    ----------
    map : WorldMap or path
        Where to drive; or the name of a sample, such as lab.
    engine : str
        "kinematic" or "bullet".
    robot : str, optional
        A robot that is known by name, instead of the map's.
    noise : float, optional
        Standard deviation of the LiDAR's rays in metres; None is the map's.
    delay, dropout, drift, acceleration, lidar_rate
        As for `viatool.simulate.Conditions`.
    horizon : int, optional
        Steps after which an episode is truncated; None is the task's 300.
    scenarios : str or sequence of Scenario
        "random" draws one from the map's generator at every reset, "fixed" takes the map's one after the other.
    observation : PolicySpecification or path, optional
        The columns of the observation: a specification, a YAML file of one, or a policy (ONNX) that carries one. By
        default those of the policies that `viatool train` exports: LiDAR bins, goal distance, cosine and sine of its
        bearing, previous v and omega, and the budget of the CVaR constraint, which is 0. What a policy remembers is not
        among them: who drives carries it from step to step, as `viatool.policy.memory.CarriedMemory` does.
    task : NavigationTask, optional
        Rewards and goal radius.
    lidar : str, optional
        Of the bullet engine: "rays" or "analytic".
    workers : int
        Processes of the bullet engine.
    """

    map: Where
    engine: str = "kinematic"
    robot: str | None = None
    noise: float | None = None
    delay: float = 0.0
    dropout: float = 0.0
    drift: float = 0.0
    acceleration: float | None = None
    lidar_rate: float | None = None
    horizon: int | None = None
    scenarios: Literal["random", "fixed"] | Sequence[Scenario] = "random"
    observation: Meaning | None = None
    task: NavigationTask | None = None
    lidar: str | None = None
    workers: int = 1
    world_map: WorldMap = field(init=False, repr=False)
    specification: PolicySpecification = field(init=False, repr=False)
    choice: Chosen | None = field(init=False, repr=False)
    command_map: CommandMap = field(init=False, repr=False)

    def __post_init__(self) -> None:
        world_map = self.map if isinstance(self.map, WorldMap) else load_map(Path(self.map))  # or a sample
        if self.robot is not None:
            world_map = with_robot(world_map, self.robot)
        meaning = self._meaning(world_map.robot)
        asked = Setting.of_specification(
            meaning, world_map, 0.0, Wishes(robot=self.robot), name="observation"
        )
        object.__setattr__(self, "world_map", asked.world_map)
        object.__setattr__(self, "specification", asked.spec)
        object.__setattr__(self, "choice", asked.choice)
        object.__setattr__(self, "command_map", asked.command_map)

    def simulator(self, robots: int) -> Simulator:
        """Return a simulator of E robots."""
        return make_simulator(
            self.engine,
            self.world_map,
            robots,
            workers=self.workers,
            lidar=self.lidar,
            scenarios=self._scenarios(),
            horizon=self.horizon,
            task=self.task,
            channels=self.specification.sensed,
            frames=self.specification.frames,
            conditions=Conditions(
                self.noise, self.dropout, self.lidar_rate, self.delay, self.drift, self.acceleration
            ),
        )

    def observation_space(self) -> Space[Any]:
        """Return the limits of the columns, (n,) float32."""
        quantities = Quantities.of(
            self.specification.sensed, self.world_map.robot, self.specification.frames
        ).require("bounds")
        low, high = quantities.bounds(Extent(*self.world_map.bounds))
        fixed = self.specification.fixed_values()[: quantities.size]
        width = ~np.isnan(fixed)  # of a constant; a space needs some
        return Box((low - width).astype(np.float32), (high + width).astype(np.float32), dtype=np.float32)

    def action_space(self) -> Space[Any]:
        """Return the limits of a command, (A,) float32: for a differential drive v in m/s and omega in rad/s.

        Of a specification that chooses among K commands, the numbers 0 to K - 1; of wheels and cars the limits of the
        actions from which a command is computed, in the order of the specification.
        """
        if self.choice is not None:
            return Discrete(self.choice.actions)
        if not isinstance(self.command_map, Picked):
            limits = np.array([(action.lower, action.upper) for action in self.specification.action])
            return Box(*limits.T.astype(np.float32), dtype=np.float32)
        robot = self.world_map.robot
        low, high = (end.astype(np.float32) for end in motion_of(robot).limits(robot))
        return Box(low, high, dtype=np.float32)

    def commands(self, actions: ArrayLike) -> Floats:
        """Return the commands (..., A) of actions: themselves, those of their table, or what is computed of them."""
        if self.choice is not None:
            return self.choice.commands[np.asarray(actions, dtype=np.int64)]
        numbers = np.asarray(actions, dtype=np.float64)
        return numbers if isinstance(self.command_map, Picked) else self.command_map(numbers)

    def _scenarios(self) -> Sequence[Scenario] | None:
        if not isinstance(self.scenarios, str):
            return tuple(self.scenarios)
        if self.scenarios not in ("random", "fixed"):
            raise ConfigurationError(f"unknown scenarios '{self.scenarios}'", "choose random or fixed")
        return None if self.scenarios == "random" else self.world_map.scenarios

    def _meaning(self, robot: Robot) -> PolicySpecification:
        given = self.observation
        if isinstance(given, PolicySpecification):
            return given
        if given is None:
            return task_specification(robot)
        if Path(given).suffix.lower() in (".yaml", ".yml"):
            return load_specification(Path(given))
        return specification_of(load_policy(given), "give a specification (YAML) as observation")


def task_specification(robot: Robot) -> PolicySpecification:
    """Return the specification of a policy that learns the task: also the sidecar of its export.

    Parameters
    ----------
    robot : Robot
        Its LiDAR, limits and control interval.
    """
    return PolicySpecification(
        observation=[
            *navigation_channels(robot.lidar),
            ObservationChannel(name="budget", kind="budget", value=_BUDGET),
        ],
        action=_actions(robot),
        robot=robot.name,
        control_interval=robot.control_interval,
    )


def information(
    cost: Any, success: Any, collision: Any, clearance: Any, goal_distance: Any
) -> dict[str, Any]:
    """Return what `info` holds after a step, of one robot or of all."""
    return {
        "cost": cost,
        "is_success": success,
        "collision": collision,
        "clearance": clearance,
        "goal_distance": goal_distance,
    }


def _actions(robot: Robot) -> list[ActionChannel]:
    """Return what commands a robot, in the usual way, with its limits."""
    ranges = {
        "linear": ("v", "m/s", robot.min_linear, robot.max_linear),
        "angular": ("omega", "rad/s", -robot.max_angular, robot.max_angular),
        "lateral": ("side", "m/s", -robot.max_lateral, robot.max_lateral),
        "steering": ("steering", "rad", -robot.max_steering, robot.max_steering),
        "linear_acceleration": ("a", "m/s^2", robot.min_acceleration, robot.max_acceleration),
        "angular_acceleration": (
            *("alpha", "rad/s^2"),
            *(-robot.max_angular_acceleration, robot.max_angular_acceleration),
        ),
    }
    usual = motion_of(robot).takes[0]
    return [
        ActionChannel.model_validate({"name": name, "unit": unit, "lower": low, "upper": high, "kind": kind})
        for kind, (name, unit, low, high) in ((kind, ranges[kind]) for kind in usual)
    ]
