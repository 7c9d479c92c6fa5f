"""Scenarios at random: obstacles, a start and a goal that keep the asked distances from each other."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from viatool.arrays import Booleans, Floats, Indices
from viatool.errors import MapError
from viatool.world.scenario import Scenario
from viatool.world.scenes import NO_CIRCLES, NO_EDGES, Scenes
from viatool.world.shapes import Obstacles, box_polygon

_BATCH = 256  # scenarios that are drawn together; part of what a seed means
_CANDIDATES = 16  # places tried at once for every scenario
_ROUNDS = 8  # times that is done before a scenario is given up and drawn anew
_BARREN = 5  # batches without a single scenario after which the generator is called infeasible


@dataclass(frozen=True, eq=False)
class ScenarioBatch:
    """N drawn scenarios as arrays.

    Parameters
    ----------
    starts : ndarray
        (N, 3) x, y, theta; metres and radians.
    goals : ndarray
        (N, 2) metres.
    circles : ndarray
        (N, K, 3) x, y, radius of random circles, in metres.
    boxes : ndarray
        (N, L, 4, 2) corners of random boxes, counter-clockwise, in metres.
    """

    starts: Floats
    goals: Floats
    circles: Floats
    boxes: Floats

    def __len__(self) -> int:
        """Return the number of scenarios."""
        return len(self.starts)

    def __getitem__(self, which: slice | Booleans | Indices) -> ScenarioBatch:
        """Return some of the scenarios."""
        return ScenarioBatch(self.starts[which], self.goals[which], self.circles[which], self.boxes[which])

    def __add__(self, other: ScenarioBatch) -> ScenarioBatch:
        """Return both batches, one after the other."""
        pairs = zip(self._arrays(), other._arrays(), strict=True)
        return ScenarioBatch(*(np.concatenate(pair) for pair in pairs))

    def with_rows(self, rows: Booleans, other: ScenarioBatch) -> ScenarioBatch:
        """Return the batch, in which some of the scenarios (N,) are those of another one, in their order."""
        arrays = [own.copy() for own in self._arrays()]
        for own, new in zip(arrays, other._arrays(), strict=True):
            own[rows] = new
        return ScenarioBatch(*arrays)

    def edges(self) -> Floats:
        """Return the edges of the boxes, (N, 4 L, 4), their inside to the left."""
        following = self.boxes[:, :, [1, 2, 3, 0]]
        return np.concatenate([self.boxes, following], axis=-1).reshape(len(self), -1, 4)

    def scenario(self, index: int, name: str) -> Scenario:
        """Return one of the scenarios."""
        x, y, theta = self.starts[index].tolist()
        goal_x, goal_y = self.goals[index].tolist()
        obstacles = Obstacles(self.circles[index].copy(), tuple(box.copy() for box in self.boxes[index]))
        return Scenario(name, (x, y, theta), (goal_x, goal_y), obstacles)

    def _arrays(self) -> tuple[Floats, Floats, Floats, Floats]:
        return self.starts, self.goals, self.circles, self.boxes


@dataclass(frozen=True, eq=False)
class ScenarioGenerator:
    """Draws scenarios by rejection: places are uniform among those that keep all distances.

    Parameters
    ----------
    arena : ndarray
        (n, 2) corners of the map's arena, in metres.
    obstacles : Obstacles
        The map's own.
    centres : ndarray
        (F, 2) centres of the map's obstacles from which the separations count (not of walls), in metres.
    area : tuple of float
        Smallest x, y and largest x, y of every random centre, in metres.
    radii : tuple of float
        One random circle for each, in metres.
    boxes : tuple of (float, float)
        One randomly yawed random box for each: length and width in metres.
    obstacle_separation, start_separation, goal_separation : float
        Least distance of a new random obstacle's centre, of the start, and of the goal, from the centres of
        all obstacles placed before; the goal keeps it from the start as well. In metres.
    start_clearance, goal_clearance : float
        Least distance of the start and of the goal from the obstacles themselves and the arena's walls, in
        metres.
    goal_distance : tuple of float
        Least and largest distance between start and goal, in metres.
    """

    arena: Floats
    obstacles: Obstacles
    area: tuple[float, float, float, float]
    centres: Floats = field(default_factory=lambda: np.zeros((0, 2)))
    radii: tuple[float, ...] = ()
    boxes: tuple[tuple[float, float], ...] = ()
    obstacle_separation: float = 1.8
    start_separation: float = 1.8
    goal_separation: float = 1.2
    start_clearance: float = 0.5
    goal_clearance: float = 0.0
    goal_distance: tuple[float, float] = (0.0, math.inf)

    def draw(self, count: int, seed: int) -> tuple[Scenario, ...]:
        """Return scenarios; the first ones of a seed are the same however many are drawn.

        Parameters
        ----------
        count : int
            How many.
        seed : int
            Same seed, same scenarios.

        Raises
        ------
        MapError
            If the distances leave no room.
        """
        batch = self.draw_arrays(count, np.random.default_rng(seed))
        return tuple(batch.scenario(index, f"random-{seed}-{index}") for index in range(count))

    def draw_arrays(self, count: int, rng: np.random.Generator) -> ScenarioBatch:
        """Return `count` scenarios as arrays, tens of thousands of them in a second.

        Raises
        ------
        MapError
            If the distances leave no room.
        """
        drawn = self._draw_batch(rng)
        barren = 0
        while len(drawn) < count or not len(drawn):
            fresh = self._draw_batch(rng)
            barren = 0 if len(fresh) or len(drawn) else barren + 1
            if barren >= _BARREN:
                raise MapError(
                    "the scenario generator finds no room for its "
                    f"{len(self.radii) + len(self.boxes)} obstacles, a start and a goal",
                    "lower the separations and clearances, or enlarge the generator's area",
                )
            drawn = drawn + fresh
        return drawn[:count]

    def with_goal_distance(self, least: float, largest: float) -> ScenarioGenerator:
        """Return the generator with other distances between start and goal, in metres (for a curriculum)."""
        return replace(self, goal_distance=(least, largest))

    def _draw_batch(self, rng: np.random.Generator) -> ScenarioBatch:
        """Return at most `_BATCH` scenarios."""
        count = len(self.radii) + len(self.boxes)
        placed = np.empty((_BATCH, len(self.centres) + count, 2))
        placed[:, : len(self.centres)] = self.centres
        alive = np.ones(_BATCH, bool)
        bare = Scenes(self.arena, self.obstacles, NO_CIRCLES, NO_EDGES)
        extents = [*self.radii, *(0.5 * math.hypot(*size) for size in self.boxes)]
        for number, extent in enumerate(extents, start=len(self.centres)):
            others = placed[:, :number]
            room = self._keeps(others, self.obstacle_separation, bare, extent)
            placed[:, number] = self._place(rng, alive, self._anywhere, room)
        circles, boxes = self._shapes(placed[:, len(self.centres) :], rng)
        batch = ScenarioBatch(np.empty((_BATCH, 3)), np.empty((_BATCH, 2)), circles, boxes)
        scenes = Scenes(self.arena, self.obstacles, circles, batch.edges())
        room = self._keeps(placed, self.start_separation, scenes, self.start_clearance)
        batch.starts[:, :2] = self._place(rng, alive, self._anywhere, room)
        batch.starts[:, 2] = rng.uniform(-math.pi, math.pi, _BATCH)
        batch.goals[:] = self._place_goals(rng, alive, placed, batch.starts[:, :2], scenes)
        return batch[alive]

    def _place_goals(
        self, rng: np.random.Generator, alive: Booleans, placed: Floats, starts: Floats, scenes: Scenes
    ) -> Floats:
        """Return goals, (N, 2), at the asked distances from obstacles and starts."""
        least, largest = self.goal_distance
        lower = np.maximum(starts - largest, self.area[:2])
        upper = np.minimum(starts + largest, self.area[2:])
        others = np.concatenate([placed, starts[:, None]], axis=1)
        free = self._keeps(others, self.goal_separation, scenes, self.goal_clearance)

        def near(rng: np.random.Generator, which: Indices) -> Floats:
            spread = rng.random((len(which), _CANDIDATES, 2))
            return np.asarray(lower[which, None] + spread * (upper - lower)[which, None])

        def room(points: Floats, which: Indices) -> Booleans:
            away = np.hypot(*(points - starts[which, None]).transpose(2, 0, 1))
            return np.asarray(free(points, which) & (away >= least) & (away <= largest))

        return self._place(rng, alive, near, room)

    def _anywhere(self, rng: np.random.Generator, which: Indices) -> Floats:
        """Return candidates, (W, C, 2), spread evenly over the area."""
        return rng.uniform(self.area[:2], self.area[2:], (len(which), _CANDIDATES, 2))

    @staticmethod
    def _keeps(
        others: Floats, separation: float, scenes: Scenes, clearance: float
    ) -> Callable[[Floats, Indices], Booleans]:
        """Return the test whether candidates keep away from centres (N, n, 2) and from obstacles."""

        def room(points: Floats, which: Indices) -> Booleans:
            free = np.ones(points.shape[:2], bool)  # (W, C)
            for centre in others.transpose(1, 2, 0):  # (2, N): a loop over places, not over scenarios
                x, y = points[..., 0] - centre[0, which, None], points[..., 1] - centre[1, which, None]
                free &= x * x + y * y >= separation * separation
            row, column = np.nonzero(free)
            scene = which[row] if len(scenes) > 1 else np.zeros(len(row), np.int64)
            measured = scenes.clearance(points[row, column], scene)
            free[row, column] = (measured >= clearance) & (measured > 0.0)
            return np.asarray(free)

        return room

    @staticmethod
    def _place(
        rng: np.random.Generator,
        alive: Booleans,
        propose: Callable[[np.random.Generator, Indices], Floats],
        room: Callable[[Floats, Indices], Booleans],
    ) -> Floats:
        """Return the first candidate with room, (N, 2); scenarios that found none are no longer alive."""
        points = np.full((len(alive), 2), np.nan)
        pending = np.flatnonzero(alive)
        for _ in range(_ROUNDS):
            if not len(pending):
                break
            candidates = propose(rng, pending)
            free = room(candidates, pending)
            first = free.argmax(axis=1)
            found = free.any(axis=1)
            points[pending[found]] = candidates[found, first[found]]
            pending = pending[~found]
        alive[pending] = False
        return points

    def _shapes(self, centres: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
        """Return circles (N, K, 3) and corners of boxes (N, L, 4, 2) around centres (N, K + L, 2)."""
        split = len(self.radii)
        radii = np.broadcast_to(np.asarray(self.radii), (len(centres), split))
        circles = np.concatenate([centres[:, :split], radii[..., None]], axis=-1)
        yaw = rng.uniform(-math.pi, math.pi, (len(centres), len(self.boxes)))
        return circles, box_polygon(centres[:, split:], np.reshape(self.boxes, (-1, 2)), yaw)
