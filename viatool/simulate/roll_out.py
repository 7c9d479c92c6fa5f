"""Roll-outs: drive the deployed program through scenarios and record every state."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from viatool.errors import ConfigurationError, PolicyError
from viatool.simulate.simulator import NavigationSimulator, Step
from viatool.simulate.task import NavigationTask
from viatool.trajectory import Trajectory
from viatool.world import Scenario, WorldMap

if TYPE_CHECKING:
    from viatool.policy.specification import PolicySpecification

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]


class RunnablePolicy(Protocol):
    """What a roll-out needs of a policy."""

    @property
    def spec(self) -> PolicySpecification | None:
        """Meaning of the observation and the action."""

    def run(self, observations: ArrayLike, /) -> Floats:
        """Return the actions (B, A) of observations (B, n), as the deployed program computes them."""


def roll_out(
    policy: RunnablePolicy,
    world_map: WorldMap,
    scenarios: Sequence[Scenario] | None = None,
    *,
    noise: float | None = None,
    horizon: int | None = None,
    seed: int = 0,
    task: NavigationTask | None = None,
) -> Trajectory:
    """Drive a policy through scenarios, all at once, until each ends.

    Parameters
    ----------
    policy : Policy
        Its `run` (onnxruntime) decides; its specification names the columns of the observation.
    world_map : WorldMap
        Where it drives.
    scenarios : sequence of Scenario, optional
        One episode each; None is the map's fixed scenarios.
    noise : float, optional
        Standard deviation of the LiDAR's rays in metres; None is the map's.
    horizon : int, optional
        Steps after which an episode is a timeout; None is the task's 300.
    seed : int
        Of the sensor noise.
    task : NavigationTask, optional
        Goal radius and horizon.

    Returns
    -------
    Trajectory
        The states of all episodes, one after the other, in the order of the scenarios. Observations are the
        float32 numbers that the policy received; actions are what it asked for, before the robot's limits.

    Raises
    ------
    PolicyError
        If the policy has no specification, or one that cannot be simulated.
    ConfigurationError
        If there is no scenario, or the policy expects another control interval than the map's robot has.
    """
    spec = _fitting_specification(policy, world_map)
    chosen = tuple(world_map.scenarios if scenarios is None else scenarios)
    simulator = NavigationSimulator(
        world_map,
        len(chosen),
        scenarios=chosen,
        noise=noise,
        horizon=horizon,
        seed=seed,
        task=task,
        channels=spec.observation,
    )
    columns = command_columns(spec)
    recording = _Recording(len(chosen), world_map.robot.control_interval)
    active = np.arange(len(chosen))
    observations = simulator.reset()
    while len(active):
        actions = np.asarray(policy.run(observations), dtype=np.float64)
        recording.add_states(active, simulator.poses, observations, actions)
        step = simulator.step(actions[:, columns])
        recording.add_step(active, step)
        simulator.keep(~step.done)
        active, observations = active[~step.done], step.observation[~step.done]
    return recording.trajectory(chosen)


class _Recording:
    """Collects the states of episodes that run side by side."""

    def __init__(self, episodes: int, interval: float) -> None:
        self.interval = interval
        self.states: list[tuple[Indices, Floats, Floats, Floats, Floats]] = []
        self.outcomes = np.full(episodes, "timeout", dtype="U9")
        self.costs = np.zeros(episodes)

    def add_states(self, active: Indices, poses: Floats, observations: Floats, actions: Floats) -> None:
        """Record the states of one instant."""
        time = np.full(len(active), len(self.states) * self.interval)
        self.states.append((active, time, poses, observations, actions))

    def add_step(self, active: Indices, step: Step) -> None:
        """Record what followed."""
        self.costs[active] += step.cost
        self.outcomes[active[step.success]] = "success"
        self.outcomes[active[step.collision]] = "collision"

    def trajectory(self, scenarios: tuple[Scenario, ...]) -> Trajectory:
        """Return everything, sorted by episode."""
        episode, time, poses, observations, actions = (
            np.concatenate(arrays) for arrays in zip(*self.states, strict=True)
        )
        order = np.argsort(episode, kind="stable")
        return Trajectory(
            poses=poses[order],
            observations=observations[order],
            actions=actions[order],
            episode=episode[order],
            time=time[order],
            outcomes=self.outcomes,
            costs=self.costs,
            scenarios=scenarios,
        )


def specification_of(policy: RunnablePolicy) -> PolicySpecification:
    """Return the policy's specification, refusing a policy without one."""
    spec = policy.spec
    if spec is None:
        raise PolicyError(
            "the policy has no specification, so its observation cannot be simulated",
            "give one with --spec robot.yaml",
        )
    return spec


def _fitting_specification(policy: RunnablePolicy, world_map: WorldMap) -> PolicySpecification:
    """Return the policy's specification if it fits the map's robot."""
    spec = specification_of(policy)
    interval = world_map.robot.control_interval
    if abs(spec.control_interval - interval) > 1e-9:
        raise ConfigurationError(
            f"the policy acts every {spec.control_interval} s, but the robot of map '{world_map.name}' "
            f"every {interval} s",
            "set robot.control_interval in the map to the policy's",
        )
    return spec


def command_columns(spec: PolicySpecification) -> list[int]:
    """Return which actions are v and omega."""
    kinds = [channel.kind for channel in spec.action]
    missing = [kind for kind in ("linear", "angular") if kind not in kinds]
    if missing:
        raise PolicyError(
            f"no action of the policy is of kind {' or '.join(missing)}",
            "name the kinds of the actions in the specification",
        )
    return [kinds.index("linear"), kinds.index("angular")]
