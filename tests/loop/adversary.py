"""Bunches of runs against one mission of the lab, thousands at once, by school formulas; no code of what proves.

Rays come from `bunch_oracle`, commands from onnxruntime in batches, arcs from their radius.
"""

from __future__ import annotations

import numpy as np

from tests.loop.noisy_runs import arc
from tests.sight.bunch_oracle import scan_bunch
from tests.sight.ray_oracle import outlines

Floats = np.ndarray
KINDS = ("uniform", "corners anew", "corners held", "greedy", "branching", "exploring")
_STEPS = np.array([0.02, 0.02, 0.04])
"""Metres and radians by which extents count alike where runs branch."""
_CELL = np.array([0.01, 0.01, 0.02])
"""Sides of the cells over which exploring runs are spread, in metres, metres and radians."""


class Course:
    """The closed loop of a policy of the lab in one scenario, for R runs at once."""

    def __init__(self, policy, world, scenario):
        self.policy, self.world, self.scenario = policy, world, scenario
        self.shapes, self.robot = outlines(world, scenario), world.robot
        self.kinds = [channel.kind for channel in policy.spec.observation]

    def observe(self, poses, before):
        """What perfect sensors read (R, n) from poses (R, 3) after commands (R, 2)."""
        dx, dy = np.array(self.scenario.goal)[:, None] - poses[:, :2].T
        bearing = np.arctan2(dy, dx) - poses[:, 2]
        columns = {
            "goal_distance": np.hypot(dx, dy), "goal_cosine": np.cos(bearing), "goal_sine": np.sin(bearing),
            "previous_linear": before[:, 0], "previous_angular": before[:, 1], "budget": np.zeros(len(poses)),
        }  # fmt: skip
        read = [
            scan_bunch(poses, self.robot.lidar, self.shapes) if kind == "lidar" else columns[kind][:, None]
            for kind in self.kinds
        ]
        return np.hstack(read)

    def radii(self, eps):
        """By how much readings may be off, (n,)."""
        sizes = [self.robot.lidar.bins if kind == "lidar" else 1 for kind in self.kinds]
        return np.repeat([0.0 if kind == "budget" else eps for kind in self.kinds], sizes)

    def command(self, seen):
        """What the robot carries out (R, 2) of what is observed (R, n)."""
        low = np.array([self.robot.min_linear, -self.robot.max_angular])
        high = np.array([self.robot.max_linear, self.robot.max_angular])
        return np.clip(self.policy.run(seen), low, high).astype(float)

    def move(self, poses, command, share=1.0):
        """Where the robot is after a share of the interval."""
        return arc(poses, command, share * self.robot.control_interval)

    def slopes(self, seen, command, radii, weights):
        """Signs (R, n) of what each reading adds to the sum of a command's numbers by weights (R, 2)."""
        signs = np.ones_like(seen)
        places = np.flatnonzero(radii)
        shifted = np.repeat(seen[:, None], len(places), axis=1)
        shifted[:, np.arange(len(places)), places] += radii[places]
        found = self.policy.run(shifted.reshape(-1, seen.shape[1])).reshape(len(seen), len(places), 2)
        signs[:, places] = np.sign(np.einsum("rna,ra->rn", found - command[:, None], weights))
        return np.where(signs == 0.0, 1.0, signs)

    def clearance(self, poses):
        """Metres from places (R, 3) to the nearest outline: of circles and of segments."""
        circles, segments = self.shapes
        x, y = poses[:, 0], poses[:, 1]
        best = np.full(len(poses), np.inf)
        for cx, cy, radius in circles:
            best = np.minimum(best, np.hypot(x - cx, y - cy) - radius)
        for x1, y1, x2, y2 in segments:
            ex, ey = x2 - x1, y2 - y1
            share = np.clip(((x - x1) * ex + (y - y1) * ey) / (ex**2 + ey**2), 0.0, 1.0)
            best = np.minimum(best, np.hypot(x - x1 - share * ex, y - y1 - share * ey))
        return best


class Adversary:
    """Errors (R, n) of each interval in turn, of runs of six kinds (R,).

    A greedy run has each reading off to the side on which the policy turns further left, or right, or drives faster,
    or slower, for some intervals on end; a branching one keeps to its side, and goes on as one at the rim of its bunch
    where it is in the midst of it. An exploring one errs now in this way, now in that, and goes on as any of them,
    sooner as one that is alone in its cell.
    """

    def __init__(self, course, kinds, radii, generator):
        self.course, self.kinds, self.radii, self.generator = course, kinds, radii, generator
        runs = len(kinds)
        self.held = generator.choice([-1.0, 1.0], (runs, len(radii)))
        self.side = generator.choice([-1.0, 1.0], runs)
        self.weights = np.array([[0.0, 1.0], [0.0, 1.0], [1.0, 0.0], [1.0, 1.0]])[
            generator.integers(0, 4, runs)
        ]
        self.signs = self.held.copy()
        self.round = 0

    def errors(self, seen, going):
        generator, kinds = self.generator, self.kinds
        z = self.held.copy()
        some = kinds == 0
        z[some] = generator.uniform(-1.0, 1.0, (some.sum(), seen.shape[1]))
        way = generator.integers(0, 4, len(kinds))
        some = (kinds == 1) | ((kinds == 5) & (way == 0))
        z[some] = generator.choice([-1.0, 1.0], (some.sum(), seen.shape[1]))
        turned = generator.random(len(seen)) < np.array([0.1, 0.1, 0.1, 0.1, 0.01, 0.5])[kinds]
        self.side = np.where(turned, -self.side, self.side)
        led = (kinds == 3) | (kinds == 4) | ((kinds == 5) & (way >= 2))
        again = np.flatnonzero(led & going & ((np.arange(len(kinds)) // 8 + self.round) % 2 == 0))
        if len(again):
            command = self.course.policy.run(seen[again])
            self.signs[again] = self.course.slopes(seen[again], command, self.radii, self.weights[again])
        z[led] = self.side[led, None] * self.signs[led]
        self.held = np.where((kinds == 5)[:, None], z, self.held)
        self.round += 1
        return z * self.radii

    def branched(self, poses, going):
        """Which run (R,) each one goes on as."""
        source = np.arange(len(poses))
        self._at_the_rim(source, poses, np.flatnonzero((self.kinds == 4) & going))
        self._over_cells(source, poses, np.flatnonzero((self.kinds == 5) & going))
        for own in (self.held, self.side, self.weights, self.signs):
            own[:] = own[source]
        flipped = (source != np.arange(len(poses))) & (self.generator.random(len(poses)) < 0.25)
        self.side = np.where(flipped, -self.side, self.side)
        return source

    def _over_cells(self, source, poses, rows):
        """Let exploring runs go on, sooner those that are alone in their cell."""
        if not len(rows):
            return
        cells = np.floor(poses[rows] / _CELL).astype(np.int64)
        _, cell, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
        weight = 1.0 / count[cell.ravel()]
        source[rows] = self.generator.choice(rows, len(rows), p=weight / weight.sum())

    def _at_the_rim(self, source, poses, rows):
        """Let a quarter of the branching runs, those in the midst, go on as some at the rim."""
        if len(rows) < 8:
            return
        directions = self.generator.normal(size=(16, 3))
        directions[:3], directions[3:6] = np.eye(3), -np.eye(3)
        along = ((poses[rows] - poses[rows].mean(axis=0)) / _STEPS) @ directions.T
        order = np.argsort(-along, axis=0)  # (rows, 16)
        rank = np.empty_like(order)
        np.put_along_axis(rank, order, np.arange(len(rows))[:, None].repeat(16, axis=1), axis=0)
        inner = np.argsort(-rank.min(axis=1), kind="stable")[: len(rows) // 4]
        rim = order[: max(len(rows) // 64, 1)].ravel()
        source[rows[inner]] = rows[self.generator.choice(rim, len(inner))]
