"""The kinematic simulator: many robots at once, each in its own scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from viatool.errors import ConfigurationError
from viatool.policy.specification import ObservationChannel
from viatool.simulate.motion import advance
from viatool.simulate.observation import Observer, Situation, navigation_channels
from viatool.simulate.scenarios import FixedScenarios, RandomScenarios
from viatool.simulate.task import NavigationTask
from viatool.world import Scenario, ScenarioGenerator, WorldMap

Floats = NDArray[np.float64]
Booleans = NDArray[np.bool_]
Indices = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Step:
    """What one control interval did to E robots.

    Parameters
    ----------
    observation : ndarray
        (E, n) after the step; of a robot that is done, its last.
    reward, cost : ndarray
        (E,); the cost is 1 within the danger clearance, else 0.
    terminated, truncated : ndarray
        (E,) bool: ended by goal or collision; ended by the horizon alone.
    success, collision : ndarray
        (E,) bool; a robot that collides at its goal has collided.
    clearance, goal_distance : ndarray
        (E,) after the step, in metres.
    """

    observation: Floats
    reward: Floats
    cost: Floats
    terminated: Booleans
    truncated: Booleans
    success: Booleans
    collision: Booleans
    clearance: Floats
    goal_distance: Floats

    @property
    def done(self) -> Booleans:
        """Return which robots need a reset, (E,) bool."""
        return self.terminated | self.truncated


class NavigationSimulator:
    """E robots that drive to goals among obstacles, in lockstep and without a loop over robots.

    Parameters
    ----------
    world_map : WorldMap
        Arena, obstacles, robot and clearances.
    robots : int
        E.
    scenarios : sequence of Scenario, optional
        Taken one after the other, again from the first when they are used up. None draws a new one from the
        map's generator at every reset.
    noise : float, optional
        Standard deviation of the LiDAR's rays in metres; None is the map's.
    horizon : int, optional
        Steps after which an episode is truncated; None is the task's.
    seed : int
        Same seed, same actions, same machine: the same numbers bit for bit.
    task : NavigationTask
        Rewards, goal radius and horizon.
    channels : sequence of ObservationChannel, optional
        Columns of the observations; None is `navigation_channels`.

    Attributes
    ----------
    poses, goals, previous : ndarray
        (E, 3), (E, 2) and (E, 2): x, y, theta; x, y; the last command as carried out, in m/s and rad/s.
    steps : ndarray
        (E,) since the last reset.
    scenes, scene : Scenes, ndarray
        The geometry, and which of its situations each robot is in, (E,).

    Notes
    -----
    Collision and danger are decided by the exact clearance of the footprint after each step, not by the noisy
    rays (the paper compares the smallest range): a state that is proved safe can then not collide in
    simulation. The reward's proximity term uses the smallest reading. Robots do not meet each other.
    """

    def __init__(
        self,
        world_map: WorldMap,
        robots: int,
        *,
        scenarios: Sequence[Scenario] | None = None,
        noise: float | None = None,
        horizon: int | None = None,
        seed: int = 0,
        task: NavigationTask | None = None,
        channels: Sequence[ObservationChannel] | None = None,
    ) -> None:
        self.world_map = world_map
        self.robot = world_map.robot
        self.task = _task(task, horizon)
        self.observer = Observer(channels or navigation_channels(self.robot.lidar), self.robot, noise)
        noise_seed, scenario_seed = np.random.SeedSequence(seed).spawn(2)
        self._noise = np.random.Generator(np.random.SFC64(noise_seed))
        self._source: FixedScenarios | RandomScenarios = (
            RandomScenarios(world_map, robots, scenario_seed)
            if scenarios is None
            else FixedScenarios(world_map, scenarios)
        )
        self.scenes = self._source.scenes
        self._slots = np.arange(robots)
        self.scene = np.zeros(robots, np.int64)
        self.poses = np.zeros((robots, 3))
        self.goals = np.zeros((robots, 2))
        self.previous = np.zeros((robots, 2))
        self.steps = np.zeros(robots, np.int64)
        self._observation = np.zeros((robots, self.observer.size))

    def __len__(self) -> int:
        """Return E, the number of robots."""
        return len(self.poses)

    @property
    def generator(self) -> ScenarioGenerator | None:
        """What draws the scenarios of later resets, None where they are fixed; a curriculum sets it."""
        return self._source.generator

    @generator.setter
    def generator(self, generator: ScenarioGenerator) -> None:
        if not isinstance(self._source, RandomScenarios):
            raise ConfigurationError(
                "a simulator of fixed scenarios draws none", "create it with scenarios=None"
            )
        self._source.generator = generator

    def reset(self, which: Booleans | None = None) -> Floats:
        """Put robots at the start of their next scenario.

        Parameters
        ----------
        which : ndarray, optional
            (E,) bool; None is all.

        Returns
        -------
        ndarray
            (E, n) observations of all robots; those of the others are as they were.
        """
        index = np.arange(len(self)) if which is None else np.flatnonzero(which)
        if len(index):
            self.scene[index], self.poses[index], self.goals[index] = self._source.take(self._slots[index])
            self.previous[index] = 0.0
            self.steps[index] = 0
            self._observation[index] = self.observer.observe(self.scenes, self._situation(index), self._noise)
        return self._observation.copy()

    def step(self, actions: Floats) -> Step:
        """Let every robot hold a command for one control interval.

        Parameters
        ----------
        actions : ndarray
            (E, 2) v in m/s and omega in rad/s; clipped to the robot's limits.

        Returns
        -------
        Step
            What happened. Nothing is reset: call `reset` with `Step.done`.
        """
        self.previous = self.robot.clip(np.asarray(actions, dtype=np.float64))
        self.poses = advance(self.poses, self.previous, self.robot.control_interval)
        self.steps += 1
        clearance = self.scenes.footprint_clearance(self.poses, self.robot.footprint, self.scene)
        away = self.goals - self.poses[:, :2]
        distance = np.sqrt(np.square(away).sum(axis=1))
        collision = clearance < self.world_map.clearance.collision
        success = (distance < self.task.goal_radius) & ~collision
        terminated = success | collision
        measured = self.observer.measure(self.scenes, self._situation(), self._noise)
        self._observation = self.observer.assemble(measured)
        nearest = measured["lidar"].min(axis=1)
        return Step(
            observation=self._observation.copy(),
            reward=self.task.reward(self.previous, nearest, success, collision),
            cost=(clearance < self.world_map.clearance.danger).astype(np.float64),
            terminated=terminated,
            truncated=(self.steps >= self.task.horizon) & ~terminated,
            success=success,
            collision=collision,
            clearance=clearance,
            goal_distance=distance,
        )

    def keep(self, which: Booleans) -> None:
        """Go on with some of the robots only, (E,) bool; the others leave the simulation."""
        for name in ("_slots", "scene", "poses", "goals", "previous", "steps", "_observation"):
            setattr(self, name, getattr(self, name)[which])

    def _situation(self, index: Indices | slice = slice(None)) -> Situation:
        """Return where some of the robots are."""
        return Situation(self.poses[index], self.scene[index], self.goals[index], self.previous[index])


def _task(task: NavigationTask | None, horizon: int | None) -> NavigationTask:
    """Return the task with another horizon."""
    task = task or NavigationTask()
    if horizon is None:
        return task
    if horizon < 1:
        raise ConfigurationError(f"horizon is {horizon} steps, expected at least 1", "give a larger horizon")
    return replace(task, horizon=horizon)
