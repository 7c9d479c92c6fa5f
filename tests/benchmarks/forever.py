"""Try to leave a set that is left only towards the goal: simulated runs under sensor errors chosen to do harm.

    python tests/benchmarks/forever.py policies/room.onnx maps/room.yaml cells.npz --steps 100000

Takes the cells of ``viatool certify ... --forever --output cells:cells.npz``, starts robots at random states of those
that hold for ever, and in every step picks, among random errors of the sensors at their limits, the one after which the
robot comes nearest to an obstacle (half of the robots) or is least surrounded by cells of the set (the others). A
robot that reaches the goal is replaced. With ``--arrive RUNS`` and the cells of ``viatool certify ... --arrive`` it
drives so many runs from cells that arrive, half of the errors at their limits and some held, and counts those that come
too near or are later than the cell says. Shares no code with the enclosures: rays by school formulas, motion by
quadrature, distances from points to segments and circles, commands from onnxruntime. Prints the violations.
"""

from __future__ import annotations

import argparse
import itertools
import time
from pathlib import Path

import numpy as np

from tests.loop.plant import Plant
from viatool import load_map, load_policy


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("policy", type=Path)
    options.add_argument("map", type=Path)
    options.add_argument("cells", type=Path)
    options.add_argument("--scenario", type=int, default=0)
    options.add_argument("--eps", type=float, default=0.01)
    options.add_argument("--steps", type=int, default=100_000)
    options.add_argument("--robots", type=int, default=500)
    options.add_argument("--tries", type=int, default=32)
    options.add_argument("--lookahead", type=int, default=4)
    options.add_argument("--goal-radius", type=float, default=0.5)
    options.add_argument("--seed", type=int, default=0)
    options.add_argument(
        "--arrive", type=int, metavar="RUNS", help="drive so many runs from the cells that arrive"
    )
    given = options.parse_args()
    policy, world = load_policy(given.policy), load_map(given.map)
    start = time.process_time()
    plant = Robots(policy, world, world.scenarios[given.scenario], given.eps, steps=5)
    generator = np.random.default_rng(given.seed)
    if given.arrive:
        cells = Arriving(np.load(given.cells))
        told = drive_to_goal(plant, cells, given.arrive, given.goal_radius, generator)
        print(f"{len(cells):,} cells that arrive within {cells.within.max()} intervals at most")
        print(
            f"{told['runs']:,} runs, {told['intervals']:,} intervals under errors of up to {given.eps:g}: "
            f"{told['violations']} violations of the clearance, {told['late']} runs that are late"
        )
        print(f"least distance beyond the collision distance: {told['least']:.2e} m")
        print(f"{time.process_time() - start:.0f} s CPU")
        return
    cells = CellList(np.load(given.cells))
    told = attack(
        plant, cells, given.steps, given.robots, given.tries, given.lookahead, given.goal_radius, generator
    )
    print(f"{len(cells):,} cells of the set, {cells.volume:.4g} m2 rad")
    print(
        f"{told['steps']:,} steps of {given.robots} robots, worst of {given.tries} errors of up to {given.eps:g}: "
        f"{told['violations']} violations of the clearance, {told['escapes']} escapes, {told['goals']} goals"
    )
    print(f"least distance beyond the collision distance: {told['least']:.2e} m")
    print(f"{time.process_time() - start:.0f} s CPU")


class CellList:
    """The cells that hold for ever, looked up by arithmetic of their own."""

    def __init__(self, table) -> None:
        chosen = table["steps"] == -1
        self.lower, self.upper = table["steps_lower"][chosen], table["steps_upper"][chosen]
        if not len(self.lower):
            raise SystemExit("no cell holds for ever")
        self.size = (self.upper - self.lower).mean(axis=0)
        self.corner = self.lower.min(axis=0)
        self.turn = round(2 * np.pi / self.size[2])
        index = np.round((self.lower - self.corner) / self.size).astype(int)
        self.count = index.max(axis=0) + 1
        self.count[2] = self.turn
        index[:, 2] %= self.turn
        self.mask = np.zeros(self.count, bool)
        self.mask[tuple(index.T)] = True

    def __len__(self) -> int:
        return len(self.lower)

    @property
    def volume(self) -> float:
        commands = np.prod(self.size[3:] * self.count[3:]) if len(self) else 1.0
        return float(len(self) * np.prod(self.size) / commands)

    def draw(self, count, generator):
        rows = generator.integers(len(self), size=count)
        share = generator.random((count, 5))
        share = np.where(generator.random((count, 5)) < 0.3, np.round(share), share)
        return self.lower[rows] + share * (self.upper - self.lower)[rows]

    def holds(self, states, slack=1e-9):
        """Whether states lie in the set; on a border, in any of the cells that meet there."""
        place = (states - self.corner) / self.size
        held = np.zeros(len(states), bool)
        for nudges in itertools.product((-slack, slack), repeat=5):
            index = np.floor(place + nudges).astype(int)
            index[:, 2] %= self.turn
            beyond = ((index < 0) | (index >= self.count)).any(axis=1)
            index = np.clip(index, 0, self.count - 1)
            held |= self.mask[tuple(index.T)] & ~beyond
        return held


class Arriving(CellList):
    """The cells from which every run reaches the goal, each with its number of intervals."""

    def __init__(self, table) -> None:
        chosen = table["steps_arrive"] > 0
        self.lower, self.upper = table["steps_lower"][chosen], table["steps_upper"][chosen]
        self.within = table["steps_arrive"][chosen]
        if not len(self.lower):
            raise SystemExit("no cell arrives for certain")

    def draw(self, count, generator):
        rows = generator.integers(len(self), size=count)
        share = generator.random((count, 5))
        share = np.where(generator.random((count, 1)) < 0.7, np.round(share), share)
        return self.lower[rows] + share * (self.upper - self.lower)[rows], self.within[rows]


class Robots(Plant):
    """Robots that hold each command for an interval and do not brake."""

    def ends(self, states, commands, intervals=1):
        """States afterwards, headings in [-pi, pi), and all poses on the way."""
        way = self.drive(
            states[:, :3], commands, intervals * self.world.robot.control_interval, np.zeros(len(states))
        )
        after = np.hstack([way[:, -1], commands])
        after[:, 2] = (after[:, 2] + np.pi) % (2 * np.pi) - np.pi
        return after, way

    def reached(self, states, radius):
        return np.hypot(*(states[:, :2] - np.array(self.scenario.goal)).T) < radius


def attack(plant, cells, steps, robots, tries, lookahead, goal_radius, generator):
    """Drive robots for so many steps in all, and count what must not happen."""
    told = {"steps": 0, "violations": 0, "escapes": 0, "goals": 0, "least": np.inf}
    states, outside = fresh(plant, cells, robots, goal_radius, generator), np.zeros(robots, int)
    while told["steps"] < steps:
        commands = harm(plant, cells, states, tries, generator)
        states, way = plant.ends(states, commands)
        left = plant.away(way).min(axis=1) - plant.distance
        broken = left < 0.0
        done = plant.reached(states, goal_radius)
        outside = np.where(cells.holds(states) | done, 0, outside + 1)
        escaped = outside >= lookahead
        told["steps"] += robots
        told["violations"] += int(broken.sum())
        told["escapes"] += int(escaped.sum())
        told["goals"] += int(done.sum())
        told["least"] = min(told["least"], float(left.min()))
        renewed = done | broken | escaped | (generator.random(robots) < 0.002)
        states[renewed] = fresh(plant, cells, int(renewed.sum()), goal_radius, generator)
        outside[renewed] = 0
    return told


def drive_to_goal(plant, cells, runs, goal_radius, generator):
    """Drive as many runs from cells that arrive, and count those that come too near, or are late.

    Errors of the sensors are at their limits, anew in every interval or held, or anywhere within them.
    """
    states, within = np.zeros((0, 5)), np.zeros(0, int)
    while len(states) < runs:
        drawn, intervals = cells.draw(2 * runs, generator)
        free = plant.free(drawn[:, :3])
        states, within = np.concatenate([states, drawn[free]]), np.concatenate([within, intervals[free]])
    states, within = states[:runs], within[:runs]
    kind = generator.integers(4, size=runs)[:, None]
    held = generator.choice([-1.0, 1.0], (runs, len(plant.radii())))
    going, told = np.arange(runs), {"runs": runs, "violations": 0, "late": 0, "intervals": 0, "least": np.inf}
    for number in range(1, int(within.max()) + 1):
        seen = plant.readings(states[going])
        corner = generator.choice([-1.0, 1.0], seen.shape)
        ways = [corner, generator.uniform(-1.0, 1.0, seen.shape), held[going], 0.0 * corner]
        error = np.select([kind[going] == each for each in range(4)], ways) * (1.0 - 1e-4)
        states[going], way = plant.ends(states[going], plant.command(seen + error * plant.radii()))
        left = plant.away(way).min(axis=1) - plant.distance
        done = plant.reached(states[going], goal_radius)
        late = ~done & (within[going] <= number)
        told["violations"] += int((left < 0.0).sum())
        told["late"] += int(late.sum())
        told["intervals"] += len(going)
        told["least"] = min(told["least"], float(left.min()))
        going = going[~done & ~late & (left >= 0.0)]
        if not len(going):
            break
    return told


def fresh(plant, cells, count, goal_radius, generator):
    """Free states of the set that have not reached the goal."""
    drawn = np.zeros((0, 5))
    while len(drawn) < count:
        more = cells.draw(2 * count + 10, generator)
        drawn = np.concatenate([drawn, more[plant.free(more[:, :3]) & ~plant.reached(more, goal_radius)]])
    return drawn[:count]


def harm(plant, cells, states, tries, generator):
    """The command, among those that some errors of the sensors cause, that does most harm."""
    count = len(states)
    seen = np.repeat(plant.readings(states), tries, axis=0)
    error = generator.choice([-1.0, 1.0], seen.shape) * (1.0 - 1e-4)  # room for the rounding to float32
    commands = plant.command(seen + error * plant.radii())
    before = np.repeat(states, tries, axis=0)
    ahead, _ = plant.ends(before, commands, 3)
    near = plant.away(ahead[:, :3]).reshape(count, tries)
    after, _ = plant.ends(before, commands)
    nudges = [generator.uniform(-1, 1, after.shape) * cells.size * [1, 1, 1, 0, 0] for _ in range(4)]
    inside = (
        sum(cells.holds(after + nudge).astype(int) for nudge in nudges).reshape(count, tries) + 1e-3 * near
    )
    worst = np.where(np.arange(count) % 2 == 0, near.argmin(axis=1), inside.argmin(axis=1))
    return commands.reshape(count, tries, 2)[np.arange(count), worst]


if __name__ == "__main__":
    main()
