"""Robots under the monitor, driven as badly as the error model allows, and measured by an oracle.

The oracle shares nothing with the proof: arcs by the difference of sines, brakes in small steps, distances by shapely.
The adversary may look at everything: in each interval it tries the commands that a policy could be made to give, with
poses at the ends of localisation's error, and takes the pair that passes and leads nearest to an obstacle.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import product

import numpy as np

from tests.safety.brute_force import clearance, drive_all, rim_of
from viatool.channels import View
from viatool.monitoring.guard import BRAKE, POLICY, Guard, Watch
from viatool.setting.setting import Setting
from viatool.world import Scenes

ROUNDING = 1e-9
INSTANTS = 12
STUCK = 20
LIES = np.concatenate([np.zeros((1, 3)), np.array(list(product((-1.0, 1.0), repeat=3)))])


@dataclass
class Robots:
    """E true robots: where they are, what acts on them, and how they brake.

    Half of them follow the commands that they are told; the others have brakes of their own, which let all speeds fall
    linearly and in proportion from the last command that passed.
    """

    poses: np.ndarray
    interval: float
    deceleration: float
    rim: float
    delay: float = 0.0
    queue: list = field(default_factory=list)
    given_up: np.ndarray = field(init=False)
    braked: np.ndarray = field(init=False)

    def __post_init__(self):
        count = len(self.poses)
        self.given_up, self.braked = np.zeros((count, 2)), np.full(count, np.inf)
        self.own_brakes = np.arange(count) % 2 == 1
        whole, rest = divmod(self.delay / self.interval + 1e-9, 1.0)
        self.late = round(rest * INSTANTS)  # of the instants of an interval, in which the command before acts
        waiting = int(whole) + (self.late > 0)
        self.queue = [(np.zeros((count, 2)), np.ones(count, bool)) for _ in range(waiting)]

    def put(self, rows, poses):
        """Put some robots down at rest, with nothing on its way to them."""
        self.poses[rows], self.given_up[rows], self.braked[rows] = poses, 0.0, np.inf
        for commands, brake in self.queue:
            commands[rows], brake[rows] = 0.0, True

    def follow(self, commands, brake):
        """Drive one interval; return poses (E, T, 3) on the way."""
        self.queue.append((commands.copy(), brake.copy()))
        places, fine, poses = [], self.interval / INSTANTS, self.poses
        for instant in range(INSTANTS):
            commands, brake = self.queue[0 if instant < self.late or not self.late else 1]
            self.given_up = np.where(brake[:, None], self.given_up, commands)
            self.braked = np.where(brake, self.braked, 0.0)
            stop = (np.abs(self.given_up[:, 0]) + self.rim * np.abs(self.given_up[:, 1])) / self.deceleration
            begin, end = (np.minimum(self.braked + more, stop) for more in (0.0, fine))
            covered = (end - begin) - (end**2 - begin**2) / (2.0 * np.maximum(stop, 1e-12))
            ramp = self.given_up * np.where(stop > 0.0, covered / fine, 0.0)[:, None]
            held = np.where((brake & self.own_brakes)[:, None], ramp, commands)
            poses = drive_all(poses, *held.T, np.full((len(poses), 1), fine))[:, 0]
            self.braked = np.where(brake, self.braked + fine, self.braked)
            places.append(poses)
        self.queue.pop(0)
        self.poses = poses
        return np.stack(places, axis=1)


@dataclass
class Sources:
    """What commands a policy could be made to give: by readings at the ends of their errors, or whatever it likes."""

    setting: Setting
    run: object
    goals: np.ndarray
    eps: float
    candidates: int
    generator: np.random.Generator

    def offers(self, scenes, scene, poses, previous):
        """Return commands (K, E, 2)."""
        quantities, robots = self.setting.quantities, np.arange(len(poses))
        readings = quantities.read(View(scenes, poses, scene, self.goals[robots], previous))
        signs = self.generator.choice(
            [-1.0, 0.0, 1.0], size=(self.candidates, *readings.shape), p=[0.45, 0.1, 0.45]
        )
        seen = quantities.observe((readings + self.eps * signs).reshape(-1, readings.shape[1]))
        fixed = self.setting.spec.fixed_values()
        seen = np.where(np.isnan(fixed), seen, fixed)
        return np.asarray(self.run(seen), float).reshape(self.candidates, len(poses), 2)


@dataclass
class Anything:
    """A policy that may command whatever it likes: the ends and middles of the robot's commands."""

    lower: np.ndarray
    upper: np.ndarray

    def offers(self, scenes, scene, poses, previous):
        """Return commands (K, E, 2)."""
        shares = np.array(list(product((1.0, 0.4, 0.05), (0.5, 0.0, 1.0))))
        commands = self.lower + shares * (self.upper - self.lower)
        return np.repeat(commands[:, None], len(poses), axis=1)


@dataclass
class Ram:
    """A policy that turns to the nearest obstacle and drives straight at it, as fast as it can."""

    lower: np.ndarray
    upper: np.ndarray
    distance: object

    def offers(self, scenes, scene, poses, previous):
        """Return commands (1, E, 2)."""
        away = np.linspace(-np.pi, np.pi, 33)[:-1]
        ahead = poses[:, None] + 0.2 * np.stack(
            [np.cos(away + poses[:, 2:]), np.sin(away + poses[:, 2:]), 0.0 * away + 0.0 * poses[:, 2:]],
            axis=2,
        )
        towards = away[
            self.distance(ahead.reshape(-1, 3), np.repeat(scene, 32)).reshape(-1, 32).argmin(axis=1)
        ]
        turn = np.clip(3.0 * towards, self.lower[1], self.upper[1])
        speed = np.where(np.abs(towards) < 0.5, self.upper[0], 0.0)
        return np.stack([speed, turn], axis=1)[None]


@dataclass(frozen=True)
class Outcome:
    """What became of an attack, in intervals of single robots."""

    intervals: int
    passed: int
    braked: int
    proved: int
    violations: int
    least: float


class Attack:
    """E robots in one world, for which everything goes wrong that may.

    Parameters
    ----------
    world : WorldMap
        With what really counts: footprint, clearance, braking.
    scenarios : sequence
        Of the robots.
    believed : Setting
        What the monitor believes; that of the truth, or of a mutant.
    radii : ndarray
        (3,) how far localisation really may be off.
    delay : float
        Seconds until a command really acts.
    """

    def __init__(self, world, scenarios, believed, radii, seed, robots, delay=0.0):
        self.world, self.scenarios, self.radii = world, scenarios, np.asarray(radii)
        self.generator = np.random.default_rng(seed)
        self.scene = np.arange(robots) % len(scenarios)
        self.scenes = Scenes.of(world, scenarios)
        self.watch = Watch(Guard(believed, tuple(scenarios)), robots)
        robot = world.robot
        self.braking = np.zeros(robots, int)
        self.robots = Robots(
            self._starts(self.scene),
            robot.control_interval,
            robot.deceleration,
            rim_of(robot.footprint),
            delay,
        )

    def distance(self, poses, scene):
        """The footprint's distance from everything, by the oracle, (N,)."""
        found = np.empty(len(poses))
        for number in np.unique(scene):
            rows = scene == number
            found[rows] = clearance(
                self.world, poses[rows], self.world.robot.footprint, self.scenarios[number]
            )
        return found

    def _starts(self, scene):
        x_min, y_min, x_max, y_max = self.world.bounds
        starts, limit = np.zeros((len(scene), 3)), self.world.clearance.collision + 0.25
        missing = np.arange(len(scene))
        while len(missing):
            starts[missing] = self.generator.uniform(
                (x_min, y_min, -np.pi), (x_max, y_max, np.pi), (len(missing), 3)
            )
            missing = missing[self.distance(starts[missing], scene[missing]) <= limit]
        return starts

    def run(self, source, intervals, *, until_violation=False):
        """Attack for some intervals, or until one violates what was proved; every one under a guarantee counts."""
        passed = braked = proved = violations = 0
        least = np.inf
        previous = np.zeros((len(self.scene), 2))
        for _ in range(intervals):
            asked, pose = self._worst(source.offers(self.scenes, self.scene, self.robots.poses, previous))
            told = self.watch.decide(pose, self.scene, asked)
            way = self.robots.follow(told.commands, told.source == BRAKE)
            previous = told.commands
            away = (
                self.distance(way.reshape(-1, 3), np.repeat(self.scene, INSTANTS))
                .reshape(-1, INSTANTS)
                .min(axis=1)
            )
            passed += int((told.source == POLICY).sum())
            braked += int((told.source == BRAKE).sum())
            proved += int(told.proved.sum())
            violations += int((told.proved & (away <= self.world.clearance.collision - ROUNDING)).sum())
            least = min(least, float(away[told.proved].min(initial=np.inf)))
            if until_violation and violations:
                break
            self._replace(told.source == BRAKE, previous)
        count = passed + braked
        return Outcome(count, passed, braked, proved, violations, least)

    def _replace(self, brake, previous):
        """Put robots that have braked for long somewhere else, as nothing more happens to them."""
        self.braking = np.where(brake, self.braking + 1, 0)
        rows = np.flatnonzero(self.braking >= STUCK)
        if len(rows):
            self.robots.put(rows, self._starts(self.scene[rows]))
            self.watch.begin(rows)
            self.braking[rows], previous[rows] = 0, 0.0

    def _worst(self, offers):
        """Return for each robot the offered command, of (K, E, 2), and the pose that pass and lead nearest."""
        kinds, count = len(offers), len(self.scene)
        lies = LIES if self.radii.any() else LIES[:1]
        true, far = self.robots.poses, np.tile(self.scene, kinds)
        ends = drive_all(
            np.tile(true, (kinds, 1)), *offers.reshape(-1, 2).T, np.full((kinds * count, 1), 0.4)
        )[:, 0]
        danger = self.distance(ends, far).reshape(kinds, count)
        stubborn = self.generator.random(count) < 0.2  # so that the robot has to brake
        near = np.flatnonzero(~stubborn & (danger.min(axis=0) < self.world.clearance.collision + 0.4))
        order = danger.argsort(axis=0)
        lied = self.generator.integers(len(lies), size=count)
        choice = order[0].copy()
        undecided = near
        for rank in range(kinds):
            if not len(undecided):
                break
            kind = order[rank, undecided]
            poses = true[undecided] + self.radii * 0.999999 * lies[:, None]  # (L, U, 3)
            each = len(lies)
            passes = self.watch.guard.proves(
                poses.reshape(-1, 3),
                np.tile(self.scene[undecided], each),
                np.tile(self.watch.guard.setting.rules.clip(offers[kind, undecided]), (each, 1)),
                np.tile(self.watch.under_way[undecided], (each, 1, 1)),
            ).reshape(each, -1)
            some = passes.any(axis=0)
            choice[undecided[some]] = kind[some]
            lied[undecided[some]] = passes[:, some].argmax(axis=0)
            undecided = undecided[~some]
        robots = np.arange(count)
        return offers[choice, robots], true + self.radii * 0.999999 * lies[lied]
