"""Driving the robots of all seeds: exploration, budget, reward, and the finished episodes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from viatool.arrays import Booleans, Floats, Indices
from viatool.simulate import NavigationTask, Step, make_simulator
from viatool.simulate.scenarios import Repeats
from viatool.train.configuration import TrainingConfiguration
from viatool.train.constraint import next_budget
from viatool.train.feedback import Feedback
from viatool.train.guide import Guide
from viatool.train.methods import Method
from viatool.train.networks import Weights
from viatool.train.observation import UnitScaling
from viatool.train.returns import Transition
from viatool.train.updates import act
from viatool.world import WorldMap

STANDING_SPEED = 0.1  # m/s, below which a robot about stands


@dataclass(frozen=True, eq=False)
class Episodes:
    """Finished episodes, one entry each."""

    seed: Indices
    cost: Floats  # undiscounted
    reward: Floats  # undiscounted and unscaled, with shaping
    length: Indices
    success: Booleans
    collision: Booleans
    steady: Booleans  # with little exploration noise, from a start of the task: u and lambda are updated from these

    @staticmethod
    def joined(parts: list[Episodes]) -> Episodes:
        """Return the episodes of all parts."""
        names = Episodes.__dataclass_fields__
        return Episodes(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})

    def where(self, which: Booleans) -> Episodes:
        """Return some of the episodes."""
        names = Episodes.__dataclass_fields__
        return Episodes(**{name: getattr(self, name)[which] for name in names})

    def __len__(self) -> int:
        """Return the number of episodes."""
        return len(self.seed)


def exploration_noise(configuration: TrainingConfiguration) -> Floats:
    """Return ``(S * E,)`` the noise of every robot, geometrically spaced over the robots of each seed."""
    lowest, highest = configuration.noise_lowest, configuration.noise_highest
    if lowest > 0:
        spread = np.geomspace(lowest, highest, configuration.robots)
    else:
        spread = np.linspace(lowest, highest, configuration.robots)
    return np.tile(spread, configuration.seeds)


def make_task(configuration: TrainingConfiguration) -> NavigationTask:
    """Return the task with the rewards of the configuration; where episodes end is the task's own."""
    return NavigationTask(
        horizon=configuration.horizon,
        goal_reward=configuration.success_reward,
        collision_reward=-configuration.collision_penalty,
        turn_penalty=configuration.turn_penalty,
        proximity_penalty=configuration.proximity_penalty,
        proximity_range=configuration.proximity_range,
    )


def shaping_reward(
    weight: float, discount: float, before: Floats, after: Floats, terminated: Booleans
) -> Floats:
    """Return the potential-based shaping ``gamma Phi(s') - Phi(s)`` with ``Phi = -weight * goal distance``.

    The potential of a terminal state is 0 and that of a truncated one is its own, so that the discounted sum
    over an episode depends on its first state alone and the best policy stays the best (Ng, Harada and
    Russell, 1999).
    """
    return weight * (before - discount * after * ~terminated)


class Collector:
    """S * E robots that drive with the policies of S seeds, robots of one seed beside each other.

    Parameters
    ----------
    configuration : TrainingConfiguration
        Number of robots, noise, reward, curriculum.
    world_map : WorldMap
        With a generator, unless the map's own scenarios shall be driven.
    scaling : UnitScaling
        For the networks' inputs and outputs.
    method : Method
        Says whether the budget follows the cost.
    var : ndarray
        ``(S,)`` u, the budget at the start of an episode.
    epoch : int
        Finished epochs of the run; part of the seed, since robots are set down more than once.
    feedback : Feedback, optional
        Where a share of the episodes begins again.
    number : int
        Of the map among those of the training; part of the seed.
    """

    def __init__(
        self,
        configuration: TrainingConfiguration,
        world_map: WorldMap,
        scaling: UnitScaling,
        method: Method,
        var: Floats,
        epoch: int,
        feedback: Feedback | None = None,
        number: int = 0,
    ) -> None:
        self.configuration = configuration
        self.budgeted = method.budgeted and configuration.budget_rule == "recursive"
        self.world_map = world_map
        self.scaling = scaling
        count = configuration.seeds * configuration.robots
        scenarios = None if world_map.generator is not None else world_map.scenarios
        further = [number] if number else []
        self.simulator = make_simulator(
            configuration.engine,
            world_map,
            count,
            workers=configuration.engine_workers,
            scenarios=scenarios,
            seed=int(np.random.SeedSequence([configuration.seed, epoch, *further]).generate_state(1)[0]),
            task=make_task(configuration),
        )
        self.rng = np.random.default_rng([configuration.seed, epoch, 1, *further])
        self.noise = exploration_noise(configuration)
        self.steady = self.noise <= max(configuration.constraint_noise, configuration.noise_lowest)
        self.seed_of_robot = np.repeat(np.arange(configuration.seeds), configuration.robots)
        self.budget = var[self.seed_of_robot]
        self.distance = np.zeros(count)
        around = configuration.shaping_path == "around"
        self.guide = Guide(world_map, count, configuration.shaping_narrow) if around else None
        self.fed, self.repeated = False, np.zeros(count, dtype=bool)
        if feedback is not None:
            self.feed_back(feedback)
        self.cost, self.reward = np.zeros(count), np.zeros(count)
        self.length = np.zeros(count, dtype=np.int64)
        self._observe(self._reset(np.ones(count, dtype=bool)))
        self._aim(np.ones(count, dtype=bool))
        self.start_observation = self.observation.clone()  # (S, E, n), of every robot's latest episode

    def _observe(self, observation: NDArray[Any]) -> None:
        self.observation = self._normalised(observation, self.budget)

    def _normalised(self, observation: NDArray[Any], budget: Floats) -> Tensor:
        shape = (self.configuration.seeds, self.configuration.robots, -1)
        return self.scaling.normalise(observation, budget).view(shape)

    def explore(self, actor: Weights) -> Floats:
        """Return the policies' actions with exploration noise, ``(S * E, A)`` in [-1, 1]."""
        with torch.no_grad():
            action = act(actor, self.observation)
        flat = action.reshape(len(self.noise), -1).numpy().astype(np.float64)
        noise = self.rng.standard_normal(flat.shape) * self.noise[:, None]
        return np.clip(flat + noise, -1.0, 1.0)

    def step(self, actor: Weights, var: Floats) -> tuple[Transition, Episodes]:
        """Drive every robot for one control interval.

        Parameters
        ----------
        actor : Weights
            Of S seeds.
        var : ndarray
            ``(S,)`` u: the budget of the episodes that begin now.

        Returns
        -------
        tuple
            The ``(S, E)`` transitions, and the episodes that ended.
        """
        action = self.explore(actor)
        before = self.distance, self.simulator.previous[:, 1]
        step = self.simulator.step(self.scaling.physical_action(action))
        budget = self._next_budget(step.cost)
        self.distance = self._distance_to_go()
        reward = self._reward(step, *before)
        transition = self._transition(action, reward, step, self._normalised(step.observation, budget))
        self.cost += step.cost
        self.reward += reward
        self.length += 1
        done = step.done
        episodes = self._finished(done, step)
        self._begin(done, budget, var, step)
        return transition, episodes

    def _reward(self, step: Step, distance: Floats, turning: Floats) -> Floats:
        """Return the reward of a step, from how far the robots had to go and how they turned before it."""
        options = self.configuration
        if options.shaping_form == "progress":
            most = self._most_in_the_open() if options.shaping_capped else math.inf
            shaping = options.shaping * np.minimum(distance - self.distance, most)
        else:
            shaping = shaping_reward(
                options.shaping, options.discount, distance, self.distance, step.terminated
            )
        steering = options.steering_penalty * np.abs(self.simulator.previous[:, 1] - turning)
        standing = np.maximum(1.0 - self.simulator.previous[:, 0] / STANDING_SPEED, 0.0)
        return step.reward + shaping - steering - options.standing_penalty * standing

    def _distance_to_go(self) -> Floats:
        """Return the potential of every robot, in metres; see `Guide`."""
        poses, goals = self.simulator.poses, self.simulator.goals
        if self.guide is None:
            return np.asarray(np.hypot(*(goals - poses[:, :2]).T))
        heading = np.stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])], axis=1)
        return self.guide.distance(poses[:, :2] + self.configuration.shaping_lookahead * heading)

    def _most_in_the_open(self) -> float:
        """Return by how much the distance to go can fall in one step away from obstacles, in metres."""
        robot = self.world_map.robot
        turning = 0.0 if self.guide is None else self.configuration.shaping_lookahead * robot.max_angular
        return robot.control_interval * math.hypot(robot.max_linear, turning)

    def _aim(self, which: Booleans) -> None:
        """Measure the distance to go of robots that have a new goal."""
        if self.guide is not None:
            index = np.flatnonzero(which)
            simulator = self.simulator
            self.guide.aim(index, simulator.scenes, simulator.scene[index], simulator.goals[index])
        self.distance = self._distance_to_go()

    def _next_budget(self, cost: Floats) -> Floats:
        if not self.budgeted:
            return self.budget
        return next_budget(self.budget, cost, self.configuration.discount, self.configuration.budget_limit)

    def _transition(self, action: Floats, reward: Floats, step: Step, after: Tensor) -> Transition:
        shape = (self.configuration.seeds, self.configuration.robots)

        def numbers(values: Floats) -> Tensor:
            return torch.from_numpy(values.astype(np.float32)).view(*shape, *values.shape[1:])

        return Transition(
            observation=self.observation,
            next_observation=after,
            action=numbers(action),
            reward=numbers(reward * self.configuration.reward_scale),
            cost=numbers(step.cost),
            terminated=torch.from_numpy(step.terminated).view(shape),
            truncated=torch.from_numpy(step.truncated).view(shape),
        )

    def _finished(self, done: Booleans, step: Step) -> Episodes:
        return Episodes(
            seed=self.seed_of_robot,
            cost=self.cost,
            reward=self.reward,
            length=self.length,
            success=step.success,
            collision=step.collision,
            steady=self.steady & ~self.repeated,
        ).where(done)

    def _begin(self, done: Booleans, budget: Floats, var: Floats, step: Step) -> None:
        """Start the next episode of the robots that are done."""
        self.budget = np.where(done, var[self.seed_of_robot], budget)
        for total in (self.cost, self.reward, self.length):
            total[done] = 0
        self._observe(self._reset(done) if done.any() else step.observation)
        if done.any():
            self._aim(done)
        fresh = torch.from_numpy(done & ~self.repeated).view(self.observation.shape[:2])
        self.start_observation[fresh] = self.observation[fresh]

    def _reset(self, done: Booleans) -> Floats:
        """Put robots at the start of their next scenario; return the observations of all."""
        observation = self.simulator.reset(done)
        if self.fed:
            self.repeated = self.simulator.repeated
        return observation

    def feed_back(self, feedback: Feedback) -> None:
        """Let a share of the coming episodes begin again where missions of their seed were not proved."""
        first = np.cumsum(feedback.counts) - feedback.counts
        share, robots = self.configuration.mission_feedback, self.configuration.robots
        self.fed = True
        self.simulator.repeat(
            Repeats(share, feedback.batch, np.repeat(first, robots), np.repeat(feedback.counts, robots))
        )

    def limit_goal_distance(self, largest: float) -> None:
        """Draw goals of the coming episodes within this distance of their start (curriculum), in metres."""
        generator = self.world_map.generator
        if generator is not None:
            least, usual = generator.goal_distance
            self.simulator.generator = generator.with_goal_distance(min(least, largest), min(usual, largest))
