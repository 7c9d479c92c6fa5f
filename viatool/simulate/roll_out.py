"""Roll-outs: drive the deployed program through scenarios and record every state."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from viatool.arrays import Booleans, Floats, Indices
from viatool.policy.memory import CarriedMemory
from viatool.policy.specified import Specified, name_of, specification_of
from viatool.schedule import Progress
from viatool.setting.setting import Setting
from viatool.simulate.adversary import choose_observations
from viatool.simulate.conditions import Conditions
from viatool.simulate.engines import largest_batch, make_simulator
from viatool.simulate.simulator import Simulator, Step
from viatool.simulate.task import NavigationTask
from viatool.trajectory import Trajectory
from viatool.uncertainty import ErrorModel
from viatool.world import Scenario, WorldMap


class RunnablePolicy(Specified, Protocol):
    """What a roll-out needs of a policy."""

    def run(self, observations: ArrayLike, /) -> Floats:
        """Return the actions (B, A) of observations (B, n), as the deployed program computes them."""

    def outputs(self, observations: ArrayLike, /) -> Floats:
        """Return what the network gives, before the action map; asked where the policy observes it."""

    def remember(self, observations: ArrayLike, /) -> Floats:
        """Return what the program keeps for the next step, (B, M); asked where the policy has a memory."""


class Supervisor(Protocol):
    """What may stand between policies and their robots: it is told what they command, and says what is sent."""

    def __call__(self, simulator: Simulator, observations: Floats, commands: Floats) -> Floats:
        """Return the commands (E, A) that are sent in the place of those that the policies give, (E, A)."""

    def begin(self, which: Booleans) -> None:
        """Begin anew with some robots, (E,) bool, that were put at the start of another scenario."""

    def keep(self, which: Booleans) -> None:
        """Go on with some of the robots only, (E,) bool."""


@dataclass(frozen=True, eq=False)
class Drive:
    """What driving N scenarios gave.

    Parameters
    ----------
    trajectory : Trajectory
        Every state in which the policy decided.
    ends : ndarray
        (N, 3) pose at the end of each episode, after the last decision; metres and radians.
    clearances : ndarray
        Clearance after every step of every episode, in metres.
    least_clearance : ndarray
        (N,) the smallest of each episode, in metres.
    """

    trajectory: Trajectory
    ends: Floats
    clearances: Floats
    least_clearance: Floats


def roll_out(
    policy: RunnablePolicy,
    world_map: WorldMap,
    scenarios: Sequence[Scenario] | None = None,
    **settings: Any,
) -> Trajectory:
    """Drive a policy through scenarios of a map and return the states alone; everything else is as for `drive`."""
    asked = Setting.of_specification(
        specification_of(policy), world_map, 0.0, scenarios=scenarios, name=name_of(policy)
    )
    return drive(policy, asked, **settings).trajectory


def drive(
    policy: RunnablePolicy,
    setting: Setting,
    *,
    engine: str = "kinematic",
    conditions: Conditions | None = None,
    noise: float | None = None,
    horizon: int | None = None,
    seed: int = 0,
    task: NavigationTask | None = None,
    workers: int = 1,
    lidar: str | None = None,
    errors: ErrorModel | None = None,
    adversary: bool = False,
    supervisor: Supervisor | None = None,
    progress: Progress | None = None,
) -> Drive:
    """Drive a policy through scenarios, many at once, until each ends.

    Parameters
    ----------
    policy : Policy
        Its `run` (onnxruntime) decides.
    setting : Setting
        Where it drives, the columns of its observation, and its scenarios: one episode each.
    engine : str
        "kinematic" or "bullet".
    conditions : Conditions, optional
        What makes the robot less than ideal.
    noise : float, optional
        Standard deviation of the LiDAR's rays in metres; None is that of the conditions, else the map's.
    horizon : int, optional
        Steps after which an episode is a timeout; None is the task's 300.
    seed : int
        Of the sensor noise.
    task : NavigationTask, optional
        Goal radius and horizon.
    workers : int
        Processes of the physics engine; they do not change what comes out.
    lidar : str, optional
        How the physics engine casts rays, "rays" or "analytic".
    errors : ErrorModel, optional
        Errors within bounds, beside those of the conditions.
    adversary : bool
        Whether an adversary chooses the errors, not chance.
    supervisor : Supervisor, optional
        What may send robots other commands than their policies give.
    progress : Progress, optional
        Told the episodes that have ended and all of them.

    Returns
    -------
    Drive
        The states of all episodes, one after the other, in the order of the scenarios. Observations are the
        float32 numbers that the policy received, its memory behind them; actions are what it asked for, before the
        robot's limits.

    Raises
    ------
    PolicyError
        If the policy observes what cannot be simulated.
    ConfigurationError
        If there is no scenario, one starts or ends in an obstacle, or the engine or its robot is not known.
    """
    chosen = setting.scenarios
    simulator = make_simulator(
        engine,
        setting.world_map,
        min(len(chosen), largest_batch(engine)),
        workers=workers,
        lidar=lidar,
        scenarios=chosen,
        noise=noise,
        horizon=horizon,
        seed=seed,
        task=task,
        channels=setting.spec.sensed,
        frames=setting.spec.frames,
        conditions=conditions,
        errors=errors,
        adversary=adversary,
    )
    try:
        return _record(policy, simulator, chosen, setting, supervisor, progress)
    finally:
        simulator.close()


def _record(
    policy: RunnablePolicy,
    simulator: Simulator,
    scenarios: tuple[Scenario, ...],
    setting: Setting,
    supervisor: Supervisor | None,
    progress: Progress | None,
) -> Drive:
    """Drive all scenarios; a robot that is done takes the next one, or leaves."""
    count, ended = len(scenarios), 0
    recording = _Recording(count, repeats=not simulator.adversary)
    begun = len(simulator)
    memory, sensed = CarriedMemory(setting.spec, begun, setting.number), simulator.reset()
    while len(simulator):
        if simulator.adversary:
            sensed = choose_observations(policy, simulator, setting, memory.beside)
        observations = memory.beside(sensed)
        actions = np.asarray(policy.run(observations), dtype=np.float64)
        recording.add_states(simulator, observations, actions)
        memory.carry(policy, observations)
        raw = policy.outputs(observations) if simulator.observes_raw else None
        commands = setting.sent(observations, actions)
        if supervisor is not None:
            commands = supervisor(simulator, observations, commands)
        step = simulator.step(commands, raw)
        recording.add_step(simulator, step)
        sensed = step.observation
        done = np.flatnonzero(step.done)
        if not len(done):
            continue
        ended += len(done)
        if progress is not None:
            progress("drive", ended, count)
        going = np.ones(len(simulator), dtype=bool)
        going[done[count - begun :]] = False
        renewed = step.done & going
        if renewed.any():
            begun += int(renewed.sum())
            sensed = simulator.reset(renewed)
            memory.begin(renewed)
            if supervisor is not None:
                supervisor.begin(renewed)
        if not going.all():
            simulator.keep(going)
            memory.keep(going)
            if supervisor is not None:
                supervisor.keep(going)
            sensed = sensed[going]
    return recording.drive(scenarios)


class _Recording:
    """Collects the states of episodes that run side by side; the scene of a robot is its episode.

    Parameters
    ----------
    episodes : int
        How many.
    repeats : bool
        Whether frames from before an episode repeat its first reading; an adversary takes another one than filled them.
    """

    def __init__(self, episodes: int, *, repeats: bool) -> None:
        self.repeats = repeats
        self.states: list[tuple[Indices, Indices, Floats, Floats, Floats, Floats, Floats, Floats]] = []
        self.motion: tuple[str, ...] = ()
        self.clearances: list[Floats] = []
        self.outcomes = np.full(episodes, "timeout", dtype="U9")
        self.costs = np.zeros(episodes)
        self.ends = np.zeros((episodes, 3))
        self.least = np.full(episodes, np.inf)

    def add_states(self, simulator: Simulator, observations: Floats, actions: Floats) -> None:
        """Record the states of one instant."""
        self.motion = tuple(axis.name for axis in simulator.kinematics.state)
        self.states.append(
            (
                *(
                    simulator.scene.copy(),
                    simulator.steps.copy(),
                    simulator.time.copy(),
                    simulator.poses.copy(),
                ),
                *(observations, actions, simulator.motion.copy(), simulator.people()),
            )
        )

    def add_step(self, simulator: Simulator, step: Step) -> None:
        """Record what followed."""
        episode = simulator.scene
        self.costs[episode] += step.cost
        self.outcomes[episode[step.success]] = "success"
        self.outcomes[episode[step.collision]] = "collision"
        self.ends[episode] = simulator.poses
        self.least[episode] = np.minimum(self.least[episode], step.clearance)
        self.clearances.append(step.clearance)

    def drive(self, scenarios: tuple[Scenario, ...]) -> Drive:
        """Return everything, sorted by episode."""
        episode, steps, time, poses, observations, actions, motion, people = (
            np.concatenate(arrays) for arrays in zip(*self.states, strict=True)
        )
        order = np.argsort(episode, kind="stable")
        trajectory = Trajectory(
            poses=poses[order],
            observations=observations[order],
            actions=actions[order],
            episode=episode[order],
            time=time[order],
            outcomes=self.outcomes,
            costs=self.costs,
            scenarios=scenarios,
            from_rest=True,
            steps=steps[order] if self.repeats else None,
            people=people[order],
            motion=dict(zip(self.motion, motion[order].T, strict=True)),
        )
        return Drive(trajectory, self.ends, np.concatenate(self.clearances)[order], self.least)
