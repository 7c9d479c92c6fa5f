"""What all simulators share: scenarios, observations, rewards, costs and the ends of episodes.

An engine adds how robots move, and may add how rays are cast: `NavigationSimulator` moves them along arcs,
`viatool.simulate.bullet` on wheels.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from viatool.arrays import Booleans, Floats, Indices, Reals
from viatool.channels import Fan, Frames, View, see
from viatool.errors import ConfigurationError
from viatool.motion.actuated import STANDING
from viatool.motion.arcs import wrap_angle
from viatool.motion.changing import ChangingTwist
from viatool.motion.kinematics import motion_of
from viatool.motion.twists import HeldTwist
from viatool.policy.specification import ObservationChannel
from viatool.simulate.conditions import Conditions
from viatool.simulate.crowd import Crowd
from viatool.simulate.models import track_of
from viatool.simulate.observation import Observer, navigation_channels
from viatool.simulate.odometry import DelayLine, Odometry
from viatool.simulate.scenarios import FixedScenarios, RandomScenarios, Repeats
from viatool.simulate.sensor_flaws import SensorFlaws
from viatool.simulate.task import NavigationTask
from viatool.uncertainty import ErrorModel
from viatool.world import Obstacles, Scenario, ScenarioGenerator, Scenes, WorldMap

_STILL = 1e-12
"""Metres by which poses of robots that stand may be rounded."""


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


class Simulator(ABC):
    """E robots that drive to goals among obstacles, in lockstep.

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
        Standard deviation of the LiDAR's rays in metres, instead of that of `conditions`.
    horizon : int, optional
        Steps after which an episode is truncated; None is the task's.
    seed : int
        Same seed, same actions, same machine: the same numbers bit for bit.
    task : NavigationTask
        Rewards, goal radius and horizon.
    channels : sequence of ObservationChannel, optional
        Columns of the observations; None is `navigation_channels`.
    conditions : Conditions, optional
        What makes the robot less than ideal.
    frames : Frames, optional
        How many whole observations are stacked.
    errors : ErrorModel, optional
        Errors that are drawn within bounds, beside those of the conditions.
    adversary : bool
        Whether they are as large as they may be, and the motors' of some those that lead nearest to an obstacle.

    Attributes
    ----------
    poses, goals, previous : ndarray
        (E, 3), (E, 2) and (E, A): x, y, theta; x, y; the last command as sent to the motors.
    believed : ndarray
        (E, 3) where localisation says that the robots are, as they observe it.
    steps : ndarray
        (E,) since the last reset.
    time : ndarray
        (E,) seconds since the last reset.
    motion : ndarray
        (E, S) the state of the motion: the speeds or the steering that robots have.
    scenes, scene : Scenes, ndarray
        The geometry, and which of its scenes each robot is in, (E,).

    Notes
    -----
    Among obstacles that move a robot is at fault while it moves alone (passive safety): one that stood still during a
    step has not collided in it. Collision and danger are decided by the exact clearance of the footprint after each
    step, not by the noisy rays (the paper compares the smallest range): a state that is proved safe can then not
    collide in simulation. The reward's proximity term uses the smallest reading. Robots do not meet each other.
    """

    largest = 2**31
    """Most robots that one simulator of the kind should have at once."""
    moves_obstacles = True
    """Whether obstacles may move."""

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
        conditions: Conditions | None = None,
        frames: Frames | None = None,
        errors: ErrorModel | None = None,
        adversary: bool = False,
    ) -> None:
        self.world_map = world_map
        self.robot = world_map.robot
        self.kinematics = motion_of(self.robot)
        axes = len(self.kinematics.axes)
        self.task = _task(task, horizon)
        self.conditions = (conditions or Conditions()).with_noise(noise)
        self.observer = Observer(
            channels or navigation_channels(self.robot.lidar),
            self.robot,
            self.conditions.noise,
            self.conditions.dropout,
            frames,
        )
        noise_seed, scenario_seed, drift_seed, flaw_seed = np.random.SeedSequence(seed).spawn(4)
        self._noise = _noise(noise_seed)
        self.errors, self.adversary = errors or ErrorModel(), adversary
        self._chance = np.random.default_rng(flaw_seed)
        self._flaws = SensorFlaws(self.errors, self.observer.quantities, adversary) if self.errors else None
        self._source: FixedScenarios | RandomScenarios = (
            RandomScenarios(world_map, robots, scenario_seed)
            if scenarios is None
            else FixedScenarios(world_map, scenarios)
        )
        self.scenes = self._source.scenes
        self._bare: dict[float, Scenes] = {}  # by the width of what rays pass
        self._slots = np.arange(robots)
        self.scene = np.zeros(robots, np.int64)
        self.poses = np.zeros((robots, 3))
        self.goals = np.zeros((robots, 2))
        self.believed = np.zeros((robots, 3))
        self.previous = np.zeros((robots, axes))
        self.steps = np.zeros(robots, np.int64)
        self.time: Floats = np.zeros(robots)
        self._offered, self._offered_poses = np.zeros((0, robots, 0)), np.zeros((0, robots, 3))
        self._velocity = np.zeros((robots, 3))
        self.motion = np.zeros((robots, len(self.kinematics.state)))
        self._raw = np.zeros((robots, self.observer.quantities.outputs))
        slow = self.conditions.lidar_rate is not None  # then a scan is held until the next one
        fans = self.observer.fans if slow else ()
        self._held = {fan: np.zeros((robots, len(fan)), np.float32) for fan in fans}
        self._observation = np.zeros((robots, self.observer.size))
        inputs = self.observer.quantities.inputs
        self._past = np.zeros((robots, inputs.memory, inputs.places[-1].stop))  # readings, the newest first
        self._earlier = self._past.copy()  # of the present ones
        drift = self.conditions.drift
        track = track_of(self.robot) if drift > 0.0 else 1.0
        self._odometry = Odometry(robots, drift, track, drift_seed)
        self._sent = DelayLine(robots, self.conditions.delay, self.robot.control_interval, axes)
        self._crowd = self._gathered()

    def _gathered(self) -> Crowd | None:
        """Return what moves around the robots, None where all stands."""
        terms, people = self.errors.obstacles, self.conditions.people
        if (terms.people is not None) != (people > 0):
            raise ConfigurationError(
                f"{self.errors.source}: obstacles.people and the number of people to simulate (--people) belong "
                "together",
                "give both: how fast people walk, and how many there are",
            )
        if not Crowd.is_asked(self.world_map, terms, people):
            return None
        if not (self.moves_obstacles and isinstance(self._source, FixedScenarios)):
            raise ConfigurationError(
                f"{self.errors.source}: obstacles: they move in the kinematic engine and in fixed scenarios alone",
                "leave the section obstacles out",
            )
        return Crowd(
            self.world_map, self._source.scenarios, terms, len(self), people=people, adversary=self.adversary
        )

    def around(self, index: Indices | slice = slice(None)) -> tuple[Scenes, Indices]:
        """Return the geometry at present, and which of its scenes some robots are in, (W,)."""
        if self._crowd is None:
            return self.scenes, self.scene[index]
        return self._crowd.scenes, self._slots[index]

    def clearance(self, poses: Floats) -> Floats:
        """Return the clearance of the footprint at poses of all robots, or of them several times over, (C E, 3)."""
        scenes, scene = self.around()
        return scenes.footprint_clearance(
            poses, self.robot.footprint, np.tile(scene, len(poses) // len(self))
        )

    def people(self) -> Floats:
        """Return what walks around the robots, (E, P, 5), as in `Trajectory`; nobody where nothing moves."""
        return np.zeros((len(self), 0, 5)) if self._crowd is None else self._crowd.people(self._slots)

    def __len__(self) -> int:
        """Return E, the number of robots."""
        return len(self.poses)

    @abstractmethod
    def _place(self, index: Indices) -> None:
        """Put W robots down at rest at their poses in their scenes."""

    @abstractmethod
    def _move(self, commands: Sequence[tuple[float, Floats]]) -> tuple[Floats, Booleans]:
        """Let all robots follow commands for one control interval.

        Parameters
        ----------
        commands : sequence of (float, ndarray)
            Seconds, and the commands (E, A) that reach the motors during them.

        Returns
        -------
        tuple of ndarray
            Poses (E, 3) after it, and which bodies touch an obstacle, (E,) bool.
        """

    def _moving(self, before: Floats, commands: Floats) -> Floats:
        """Return the velocity that robots have after a step, (E, 3), which began at poses and ended with commands."""
        if isinstance(self.kinematics, ChangingTwist):
            return self.kinematics.velocity(np.concatenate([commands, self.motion], axis=1))
        if not isinstance(self.kinematics, HeldTwist):
            return self._average(before)
        return np.stack(self.kinematics.parts(commands), axis=1)

    @property
    def _driven(self) -> Floats:
        """Return the speed ahead and the turning speed that rewards speak of, first of all, (E, >= 2)."""
        return self._velocity[:, [0, 2]] if self.kinematics.state else self.previous

    def _set_down(self, index: Indices) -> Floats:
        """Return the velocity of robots that were set down, (W, 3): none, unless their limits allow no other."""
        _, velocity = self.kinematics.recalled(self.motion[index]) if self.kinematics.state else (None, None)
        return np.zeros((len(index), 3)) if velocity is None else velocity

    def _average(self, before: Floats) -> Floats:
        """Return the average velocity of robots in the last interval, (E, 3)."""
        turned = wrap_angle(self.poses[:, 2] - before[:, 2])
        moved = (self.poses[:, 0] - before[:, 0]) + 1j * (self.poses[:, 1] - before[:, 1])
        moved = moved * np.exp(-1j * (before[:, 2] + 0.5 * turned)) / np.sinc(0.5 * turned / np.pi)
        return np.stack([moved.real, moved.imag, turned], axis=1) / self.robot.control_interval

    def _ranges(self, fan: Fan, index: Indices | slice, view: View) -> Reals:
        """Return the true ranges of the rays of some robots, (W, R) m; by exact geometry unless overridden."""
        return see(fan, view)

    def close(self) -> None:  # noqa: B027  # most engines hold nothing
        """Give back what the engine holds; nothing may be asked of it afterwards."""

    def reseed(self, seed: int) -> None:
        """Begin anew with a seed, as a new simulator would; `reset` has to follow."""
        noise_seed, scenario_seed, drift_seed, flaw_seed = np.random.SeedSequence(seed).spawn(4)
        self._chance = np.random.default_rng(flaw_seed)
        self._noise = _noise(noise_seed)
        self._source.reseed(scenario_seed)
        self._odometry.reseed(drift_seed)

    @property
    def observes_raw(self) -> bool:
        """Tell whether the policy observes its own last outputs."""
        return self._raw.shape[1] > 0

    @property
    def generator(self) -> ScenarioGenerator | None:
        """What draws the scenarios of later resets, None where they are fixed; a curriculum sets it."""
        return self._source.generator

    @generator.setter
    def generator(self, generator: ScenarioGenerator) -> None:
        self._drawing.generator = generator

    def repeat(self, repeats: Repeats) -> None:
        """Let robots drive some scenarios again in later resets, instead of new ones."""
        self._drawing.repeats = repeats

    @property
    def repeated(self) -> Booleans:
        """Return which robots drive a scenario again, (E,)."""
        return self._drawing.repeated.copy()

    @property
    def _drawing(self) -> RandomScenarios:
        if not isinstance(self._source, RandomScenarios):
            raise ConfigurationError(
                "a simulator of fixed scenarios draws none", "create it with scenarios=None"
            )
        return self._source

    def own_obstacles(self, robot: int) -> Obstacles:
        """Return the obstacles around one robot that only its scenario has."""
        return self._source.own(int(self.scene[robot]))

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
            self._bare.clear()
            self.previous[index] = 0.0
            self.motion[index] = np.clip(0.0, *self.kinematics.state_range)
            self._velocity[index] = self._set_down(index)
            self._raw[index] = 0.0
            self.steps[index] = 0
            self.time[index] = 0.0
            if self._flaws is not None:
                self.poses[index] = self._flaws.started(self.poses[index], self._chance)
            if self._crowd is not None:
                self._crowd.begin(self._slots[index], self.scene[index], self.poses[index], self._chance)
            self._place(index)
            self._odometry.reset(index, self.poses[index])
            self._sent.reset(index)
            readings = self._read(self._view(index))
            self._past[index] = self._earlier[index] = readings[:, None]
            self._observation[index] = self.observer.quantities.observe(readings)
        return self._observation.copy()

    def step(self, actions: Floats, raw: Floats | None = None) -> Step:
        """Let every robot hold a command for one control interval.

        Parameters
        ----------
        actions : ndarray
            (E, A) commands, see `Kinematics.axes`; clipped to the robot's limits.
        raw : ndarray, optional
            (E, K) what the network gave, for policies that observe it; their commands, if left out.

        Returns
        -------
        Step
            What happened. Nothing is reset: call `reset` with `Step.done`.
        """
        self.previous = self.kinematics.clip(np.asarray(actions, dtype=np.float64), self.robot)
        before, begun = self.poses, self.time
        if self.observes_raw:
            self._raw = np.asarray(self.previous if raw is None else raw, dtype=np.float64)
        touching = self._drive(before)
        self._odometry.follow(before, self.poses)
        self.steps += 1
        at_fault = np.ones(len(self), dtype=bool)
        if self._crowd is not None:
            self._crowd.move(self._slots, self.poses, self.time - begun, self._chance)
            at_fault = self._moved(before, self.time - begun)
        clearance = self.clearance(self.poses)
        away = self.goals - self.poses[:, :2]
        distance = np.sqrt(np.square(away).sum(axis=1))
        collision = (at_fault & (clearance < self.world_map.clearance.collision)) | touching
        success = (distance < self.task.goal_radius) & ~collision
        terminated = success | collision
        view = self._view(slice(None))
        readings = self._read(view)
        self._earlier = self._past
        self._observation = self.observer.quantities.observe(readings, self._past)
        nearest = self.observer.nearest(view, readings)
        self._past = _with(readings, self._past)
        return Step(
            observation=self._observation.copy(),
            reward=self.task.reward(self._driven, nearest, success, collision),
            cost=((at_fault & (clearance < self.world_map.clearance.danger)) | touching).astype(np.float64),
            terminated=terminated,
            truncated=(self.steps >= self.task.horizon) & ~terminated,
            success=success,
            collision=collision,
            clearance=clearance,
            goal_distance=distance,
        )

    def _moved(self, before: Floats, seconds: Floats) -> Booleans:
        """Tell which footprints have moved since poses (E, 3); motors that lag never quite rest, see `STANDING`."""
        lags = any(any(one.lag or ()) for one in self.errors.actuation.each)
        way, turn = np.hypot(*(self.poses - before)[:, :2].T), np.abs(self.poses - before)[:, 2]
        rim = self.robot.footprint.reach if self.robot.footprint.kind == "polygon" else 0.0
        return np.asarray(way + rim * turn > (STANDING * seconds if lags else _STILL))

    def _drive(self, before: Floats) -> Booleans:
        """Let all robots follow their commands until the next observation; return which bodies touch, (E,) bool."""
        sent = self._sent.send(self.previous)
        self.poses, touching = self._move(sent)
        self._velocity = self._moving(before, sent[-1][1])
        self.time = np.asarray((self.steps + 1) * self.robot.control_interval, dtype=np.float64)
        return touching

    def _read(self, view: View) -> Floats:
        """Return what the sensors of some robots read, (W, m), with all errors."""
        readings = self.observer.quantities.read(view)
        return readings if self._flaws is None else self._flaws.readings(readings, self._chance)

    def offer(self, count: int) -> Floats:
        """Return observations (C, E, n) of the present, each with other errors, of which `take` takes one."""
        offered, believed = [], []
        for _ in range(count):
            offered.append(self._read(self._view(slice(None))))
            believed.append(self.believed.copy())
        self._offered, self._offered_poses = np.stack(offered), np.stack(believed)
        return np.stack([self.observer.quantities.observe(seen, self._earlier) for seen in self._offered])

    def take(self, which: Indices) -> Floats:
        """Take one of the offered observations, (E,), as what the robots observe, and return it, (E, n)."""
        robots = np.arange(len(self))
        readings, self.believed = self._offered[which, robots], self._offered_poses[which, robots]
        self._observation = self.observer.quantities.observe(readings, self._earlier)
        self._past = _with(readings, self._earlier)
        return self._observation.copy()

    def keep(self, which: Booleans) -> None:
        """Go on with some of the robots only, (E,) bool; the others leave the simulation."""
        names = (
            "_slots",
            "scene",
            "poses",
            "goals",
            "believed",
            "previous",
            "steps",
            "time",
            "_earlier",
            "_observation",
            "_past",
            "_velocity",
            "motion",
            "_raw",
        )
        for name in names:
            setattr(self, name, getattr(self, name)[which])
        self._held = {fan: ranges[which] for fan, ranges in self._held.items()}
        self._odometry.keep(which)
        self._sent.keep(which)

    def _view(self, index: Indices | slice) -> View:
        """Return some robots and what is around them, as their sensors see it."""
        scenes, scene = self.around(index)
        self.believed[index] = self._believed(index)
        return View(
            scenes,
            self.poses[index],
            scene,
            self.goals[index],
            self.previous[index],
            self.believed[index],
            self.steps[index],
            self.task.horizon,
            self._velocity[index],
            self._raw[index],
            eyes=lambda fan, view: self._see(fan, index, view),
        )

    def _believed(self, index: Indices | slice) -> Floats:
        """Return where some robots think they are, (W, 3)."""
        poses = self._odometry.poses[index]
        return poses if self._flaws is None else self._flaws.believed(poses, self._chance)

    def _see(self, fan: Fan, index: Indices | slice, view: View) -> Reals:
        """Return what the rays of some robots read, (W, R) m: of the last scan, with its errors."""
        turn = None if self._flaws is None else self._flaws.turn(fan, len(view), self._chance)
        if turn is not None:
            view = replace(view, poses=view.poses + turn[:, None] * np.array([0.0, 0.0, 1.0]))
        ranges = self.observer.disturb(self._passing(fan, index, view), fan, self._noise)
        if self._flaws is not None:
            ranges = self._flaws.rays(ranges, fan, self._chance)
        rate = self.conditions.lidar_rate
        if rate is None:
            return ranges
        held = self._held[fan]
        held[index] = np.where(self._scanned(index, rate)[:, None], ranges, held[index])
        return held[index].copy()

    def _passing(self, fan: Fan, index: Indices | slice, view: View) -> Reals:
        """Return how far the rays of some robots get, (W, R) m: to what is nearest, or past what is thin."""
        ranges = self._ranges(fan, index, view)
        thin = 0.0 if self._flaws is None else self._flaws.thin(fan)
        if self._flaws is None or not thin:
            return ranges
        if thin not in self._bare:
            own = [self._source.own(scene) for scene in range(len(self.scenes))]
            self._bare[thin] = Scenes.around(self.world_map, own, thin)
        past = see(fan, replace(view, scenes=self._bare[thin]))
        return self._flaws.passing(ranges, past, fan, self._chance)

    def _scanned(self, index: Indices | slice, rate: float) -> Booleans:
        """Tell which robots' LiDAR has completed a scan in the last interval."""
        turns = rate * self.robot.control_interval * np.stack([self.steps[index] - 1, self.steps[index]])
        earlier, now = np.floor(turns + 1e-9)
        return np.asarray(now > earlier)


def _with(readings: Floats, past: Floats) -> Floats:
    """Return what was read in the steps before, (E, T, m), with readings (E, m) as the newest."""
    return np.concatenate([readings[:, None], past[:, :-1]], axis=1)[:, : past.shape[1]]


def _noise(seed: np.random.SeedSequence) -> np.random.Generator:
    """Return the source of the sensor's errors: a fast one."""
    return np.random.Generator(np.random.SFC64(seed))


def _task(task: NavigationTask | None, horizon: int | None) -> NavigationTask:
    """Return the task with another horizon."""
    task = task or NavigationTask()
    if horizon is None:
        return task
    if horizon < 1:
        raise ConfigurationError(f"horizon is {horizon} steps, expected at least 1", "give a larger horizon")
    return replace(task, horizon=horizon)
