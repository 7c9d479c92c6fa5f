"""A robot with its deployed policy among obstacles, by school formulas: shares no code with the proofs.

Ranges ray by ray, observations written down in the order of the specification, commands from onnxruntime, motion by
Gauss quadrature of the speed along the heading, distances of points from segments and circles.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np
import shapely

from tests.sight.ray_oracle import outlines, scan
from viatool.policy import Policy
from viatool.world import Footprint, Obstacles, Scenario, WorldMap

GAUSS = np.array([0.5 - np.sqrt(0.15), 0.5, 0.5 + np.sqrt(0.15)]), np.array([5.0, 8.0, 5.0]) / 18.0


@dataclass
class Plant:
    """What is simulated: braking after the interval as hard as the robot can, after `delay` of the command before."""

    policy: Policy
    world: WorldMap
    scenario: Scenario
    eps: float
    footprint: Footprint = field(default_factory=Footprint)
    delay: float = 0.0
    steps: int = 10

    @cached_property
    def shapes(self) -> tuple[np.ndarray, np.ndarray]:
        """Circles (K, 3) and segments (M, 4)."""
        return outlines(self.world, self.scenario)

    @cached_property
    def solid(self) -> shapely.Geometry:
        """Everything solid that has corners, and the outside of the arena."""
        obstacles = self.world.obstacles + (self.scenario.obstacles if self.scenario else Obstacles())
        x0, y0, x1, y1 = self.world.bounds
        outside = shapely.box(x0 - 5, y0 - 5, x1 + 5, y1 + 5).difference(shapely.Polygon(self.world.arena))
        solid = shapely.union_all([outside, *(shapely.Polygon(ring) for ring in obstacles.polygons)])
        shapely.prepare(solid)
        return solid

    @property
    def distance(self) -> float:
        return self.world.clearance.collision

    def readings(self, states: np.ndarray) -> np.ndarray:
        """What perfect sensors read at states (x, y, theta, v, omega before), (B, n)."""
        poses = states[:, :3]
        dx, dy = np.asarray(self.scenario.goal)[:, None] - poses[:, :2].T
        bearing = np.arctan2(dy, dx) - poses[:, 2]
        values = {
            "lidar": scan(poses, self.world.robot.lidar, self.shapes), "goal_distance": np.hypot(dx, dy),
            "goal_cosine": np.cos(bearing), "goal_sine": np.sin(bearing),
            "previous_linear": states[:, 3], "previous_angular": states[:, 4],
        }  # fmt: skip
        columns = [
            values[channel.kind] if channel.value is None else np.full(len(states), channel.value)
            for channel in self.policy.spec.observation
        ]
        return np.hstack([column.reshape(len(states), -1) for column in columns])

    def radii(self) -> np.ndarray:
        """How far the sensors may err, (n,)."""
        return np.concatenate(
            [np.full(c.size, self.eps if c.value is None else 0.0) for c in self.policy.spec.observation]
        )

    def command(self, observations: np.ndarray) -> np.ndarray:
        """What the deployed program commands, as the robot carries it out, (B, 2)."""
        raw = self.policy.run(observations.astype(np.float32))
        kinds = [channel.kind for channel in self.policy.spec.action]
        robot = self.world.robot
        linear = np.clip(raw[:, kinds.index("linear")], robot.min_linear, robot.max_linear)
        angular = np.clip(raw[:, kinds.index("angular")], -robot.max_angular, robot.max_angular)
        return np.column_stack([linear, angular]).astype(float)

    def noisy_command(self, states: np.ndarray, generator: np.random.Generator) -> np.ndarray:
        """The command for random sensor errors, half of them at the ends of what is allowed."""
        readings = self.readings(states)
        error = generator.uniform(-1, 1, readings.shape)
        corner = generator.random(len(states)) < 0.5
        error[corner] = np.sign(error[corner])
        return self.command(readings + error * self.radii())

    def drive(self, poses: np.ndarray, commands: np.ndarray, seconds: float, stop: np.ndarray) -> np.ndarray:
        """Poses (B, 2 steps + 1, 3) while commands are held for some seconds, and then fall to 0 in `stop` (B,)."""
        v, w = commands.T
        shares = np.arange(1, self.steps + 1)[:, None] / self.steps
        held, braking = np.broadcast_to(seconds * shares, (self.steps, len(v))), seconds + stop * shares
        edges = np.concatenate([np.zeros((1, len(v))), held, braking])
        x, y, theta = poses.T.copy()
        way = [np.stack([x, y, theta], axis=1)]
        for begin, end in pairwise(edges):
            for share, weight in zip(*GAUSS, strict=True):
                time = begin + share * (end - begin)
                at = theta + w * self._held(time, seconds, stop)
                speed = v * np.clip(1.0 - (time - seconds) / np.maximum(stop, 1e-12), 0.0, 1.0)
                x = x + weight * (end - begin) * speed * np.cos(at)
                y = y + weight * (end - begin) * speed * np.sin(at)
            way.append(np.stack([x, y, theta + w * self._held(end, seconds, stop)], axis=1))
        return np.stack(way, axis=1)

    def _held(self, time: np.ndarray, seconds: float, stop: np.ndarray) -> np.ndarray:
        """For how long the full command would have to be held to get as far as at a time."""
        late = np.clip(time - seconds, 0.0, stop)
        return np.minimum(time, seconds) + late - 0.5 * late**2 / np.maximum(stop, 1e-12)

    def paths(self, states: np.ndarray, commands: np.ndarray) -> np.ndarray:
        """Poses over the dead time, the interval and the braking, (B, T, 3)."""
        still = np.zeros(len(states))
        waiting = self.drive(states[:, :3], states[:, 3:], self.delay, still)
        rim = self.footprint.reach if self.footprint.kind == "polygon" else 0.0
        stop = (np.abs(commands[:, 0]) + rim * np.abs(commands[:, 1])) / self.world.robot.deceleration
        acting = self.drive(waiting[:, -1], commands, self.world.robot.control_interval, stop)
        return acting if self.delay == 0.0 else np.concatenate([waiting, acting], axis=1)

    def away(self, poses: np.ndarray) -> np.ndarray:
        """How far the footprint at poses (..., 3) is from everything solid; from its boundary, within it."""
        flat = poses.reshape(-1, 3)
        if self.footprint.kind == "polygon":
            return self._polygon_away(flat).reshape(poses.shape[:-1])
        x, y, circles, segments = *flat[:, :2].T, *self.shapes
        least = np.full(len(flat), np.inf)
        for cx, cy, radius in circles:
            least = np.minimum(least, np.hypot(x - cx, y - cy) - radius)
        for x1, y1, x2, y2 in segments:
            ex, ey = x2 - x1, y2 - y1
            share = np.clip(((x - x1) * ex + (y - y1) * ey) / (ex**2 + ey**2), 0.0, 1.0)
            least = np.minimum(least, np.hypot(x - x1 - share * ex, y - y1 - share * ey))
        return (least - self.footprint.radius).reshape(poses.shape[:-1])

    def _polygon_away(self, poses: np.ndarray) -> np.ndarray:
        cosine, sine = np.cos(poses[:, 2, None]), np.sin(poses[:, 2, None])
        a, b = self.footprint.polygon.T
        corners = np.stack(
            [poses[:, 0, None] + cosine * a - sine * b, poses[:, 1, None] + sine * a + cosine * b], axis=-1
        )
        outlines = shapely.polygons(corners)
        least = shapely.distance(outlines, self.solid)
        for cx, cy, radius in self.shapes[0]:
            least = np.minimum(least, shapely.distance(outlines, shapely.Point(cx, cy)) - radius)
        return least

    def free(self, poses: np.ndarray) -> np.ndarray:
        """Tell which poses (B, 3) keep the collision distance, (B,)."""
        clear = self.away(poses) > self.distance
        if self.footprint.kind != "polygon":
            clear[clear] &= ~shapely.intersects_xy(self.solid, *poses[clear, :2].T)
        return clear

    def margins(
        self, lower: np.ndarray, upper: np.ndarray, generator: np.random.Generator, count: int
    ) -> np.ndarray:
        """How much more than the collision distance is left on the paths of random free states of random cells."""
        rows = generator.integers(len(lower), size=count)
        shares = generator.random((count, 5))
        shares = np.where(generator.random((count, 5)) < 0.3, np.round(shares), shares)
        states = lower[rows] + shares * (upper[rows] - lower[rows])
        states = states[self.free(states[:, :3])]
        paths = self.paths(states, self.noisy_command(states, generator))
        return self.away(paths).min(axis=1) - self.distance
