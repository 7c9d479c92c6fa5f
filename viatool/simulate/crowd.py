"""Obstacles that move around simulated robots, within an error model: wherever they like, or straight at the robot.

Each robot has obstacles of its own, which begin where the map shows them. What moves by a speed goes on from where it
is; what roams is anywhere within its radius, whenever the robot observes anew. By chance things wander about, and stop
before they run into a robot. For an adversary they go straight at where the robot is when the interval ends, as near as
half of the collision distance, from where a robot that drives on is at fault.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from viatool.arrays import Booleans, Floats, Indices, Plane
from viatool.simulate.conditions import PERSON
from viatool.uncertainty.error_model import ObstacleTerms
from viatool.world import Obstacles, Scenario, Scenes, WorldMap
from viatool.world.capsules import NOWHERE
from viatool.world.measurement import as_plane, point_edge_squared

_DRAWN = 64
"""Places among which one is chosen where a person begins."""
_APART = 1.5
"""Metres from the robot at which people begin at least."""
_TURNS = 1.0
"""How often in a second what wanders takes another way, on average."""


@dataclass(frozen=True, eq=False)
class Things:
    """Up to O things in each of S scenarios, made of up to K circles and M edges; what is missing is nowhere.

    Parameters
    ----------
    circles, edges : ndarray
        (S, K, 3) x, y, radius, and (S, M, 4) both ends.
    of_circle, of_edge : ndarray
        (S, K) and (S, M) which thing each belongs to.
    middle, around : ndarray
        (S, O) a disc around each thing, middle x + iy and radius.
    roams, speeds : ndarray
        (S, O) metres within which it is always, and m/s.
    """

    circles: Floats
    edges: Floats
    of_circle: Indices
    of_edge: Indices
    middle: Plane
    around: Floats
    roams: Floats
    speeds: Floats

    @classmethod
    def of(
        cls, world_map: WorldMap, scenarios: Sequence[Scenario], terms: ObstacleTerms, people: int
    ) -> Things:
        """Return what moves on the map, everything that scenarios add to it, and behind them people, at the origin."""
        moving = world_map.obstacles.select(_move(world_map, terms))
        alike = ObstacleTerms(speed=terms.speed)
        parts = [_listed([(moving, terms), (scenario.obstacles, alike)]) for scenario in scenarios]
        circles, edges, things = (_stacked(rows) for rows in zip(*parts, strict=True))
        discs = [(0.0, 0.0, PERSON, things.shape[1] + number) for number in range(people)]
        persons = np.tile((0.0, 0.0, PERSON, 0.0, terms.people or 0.0), (len(parts), people, 1))
        circles = np.concatenate(
            [circles, np.tile(np.reshape(discs, (people, 4)), (len(parts), 1, 1))], axis=1
        )
        things = np.concatenate([things, persons], axis=1)
        return cls(
            circles[:, :, :3], edges[:, :, :4], circles[:, :, 3].astype(int), edges[:, :, 4].astype(int),
            things[:, :, 0] + 1j * things[:, :, 1], *np.moveaxis(things[:, :, 2:], 2, 0),
        )  # fmt: skip


class Crowd:
    """What moves around E robots.

    Parameters
    ----------
    world_map : WorldMap
        Whose obstacles move.
    scenarios : sequence of Scenario
        S of them, among which robots are.
    terms : ObstacleTerms
        How they move.
    robots : int
        E.
    people : int
        How many people walk about besides, from free places that are not near the robot.
    adversary : bool
        Whether they go straight at the robots.

    Attributes
    ----------
    scenes : Scenes
        E scenes: what is around each robot at present.
    """

    def __init__(
        self,
        world_map: WorldMap,
        scenarios: Sequence[Scenario],
        terms: ObstacleTerms,
        robots: int,
        *,
        people: int = 0,
        adversary: bool,
    ) -> None:
        self._things, self._adversary = Things.of(world_map, scenarios, terms, people), adversary
        self._people, self._standing = people, Scenes.of(world_map, scenarios)
        count = self._things.middle.shape[1]
        self._scene = np.zeros(robots, np.int64)
        self._gone = np.zeros((robots, count), complex)
        self._velocity = np.zeros((robots, count), complex)
        self._stop = _inner(world_map) + 0.5 * world_map.clearance.collision
        x_min, y_min, x_max, y_max = world_map.bounds
        self._bounds = (complex(x_min, y_min), complex(x_max, y_max))
        stays = world_map.obstacles.select(~_move(world_map, terms))
        self.scenes = Scenes(world_map.arena, stays, self._circles(slice(None)), self._edges(slice(None)))

    @staticmethod
    def is_asked(world_map: WorldMap, terms: ObstacleTerms, people: int) -> bool:
        """Tell whether anything moves."""
        return people > 0 or bool(terms.speed) or bool(_move(world_map, terms).any())

    def begin(self, robots: Indices, scene: Indices, poses: Floats, rng: np.random.Generator) -> None:
        """Put everything around some robots (W,) at poses (W, 3) where the map and their scenarios (W,) show it."""
        self._scene[robots], self._gone[robots] = scene, 0.0
        for person in range(self._gone.shape[1] - self._people, self._gone.shape[1]):
            self._gone[robots, person] = self._free_places(scene, as_plane(poses), rng)
        self._velocity[robots] = self._speeds(robots) * _anywhere(rng, (len(robots), self._gone.shape[1]))
        self._rebuild(robots)

    def move(self, robots: Indices, poses: Floats, seconds: Floats, rng: np.random.Generator) -> None:
        """Let everything around robots (W,) move for some time (W,), at the end of which they are at poses (W, 3)."""
        here = as_plane(poses)[:, None]
        begin: Plane = self._gone[robots]
        roams, speeds, lasting = (
            self._things.roams[self._scene[robots]],
            self._speeds(robots),
            seconds[:, None],
        )
        nearest = self._nearest(robots, here)
        apart = np.abs(here - nearest)
        towards = (here - nearest) / np.where(apart > 0.0, apart, 1.0)
        gone: Plane
        if self._adversary:
            free = np.clip(apart - self._stop, 0.0, None)
            gone = begin + np.minimum(speeds * lasting, free) * towards
        else:
            turns = rng.random(begin.shape) < _TURNS * lasting
            way = np.where(turns, speeds * _anywhere(rng, begin.shape), self._velocity[robots])
            gone = begin + way * lasting
            at = self._things.middle[self._scene[robots]] + gone
            low, high = self._bounds
            out = (at.real < low.real) | (at.real > high.real) | (at.imag < low.imag) | (at.imag > high.imag)
            self._velocity[robots] = np.where(out, -way, way)
            gone = np.where(out, begin, gone)
        gone = np.where(roams > 0.0, roams * self._roaming(robots, here, rng), gone)
        after = np.abs(here - (nearest + gone - begin))
        if not self._adversary:  # what comes nearer than that waits
            gone = np.asarray(np.where((after < self._stop) & (after < apart), begin, gone))
        self._gone[robots] = gone
        if self._adversary:
            self._velocity[robots] = (gone - begin) / lasting
        self._rebuild(robots)

    def people(self, robots: Indices) -> Floats:
        """Return what is not where the map shows it around robots (W,) as discs: x, y, vx, vy and radius, (W, P, 5).

        NaN for what stays. What roams has no velocity: it is said to be within its radius, however fast it gets there.
        """
        scene = self._scene[robots]
        at = self._things.middle[scene] + self._gone[robots]
        velocity = np.where(self._things.roams[scene] > 0.0, 0.0, self._velocity[robots])
        around = self._things.around[scene]
        table = np.stack([at.real, at.imag, velocity.real, velocity.imag, around], axis=2)
        walks = (self._things.speeds > 0.0) | (self._things.roams > 0.0)
        walks[:, walks.shape[1] - self._people :] = True
        table = np.where(walks[scene][:, :, None], table, np.nan)
        return np.asarray(table[:, walks.any(axis=0)])

    def _free_places(self, scene: Indices, here: Plane, rng: np.random.Generator) -> Plane:
        """Return a place for a person around each of W robots; the least bad of some where none is free."""
        low, high = self._bounds
        span = high - low
        drawn = rng.random((2, _DRAWN, len(here)))
        places = low + span.real * drawn[0] + 1j * span.imag * drawn[1]
        flat = np.column_stack([places.real.ravel(), places.imag.ravel()])
        room = self._standing.clearance(flat, np.tile(scene, _DRAWN)).reshape(places.shape) - PERSON
        good = np.minimum(room, 0.0) + np.minimum(np.abs(places - here) - _APART, 0.0)
        return np.asarray(places[good.argmax(axis=0), np.arange(len(here))])

    def _speeds(self, robots: Indices) -> Floats:
        return np.asarray(self._things.speeds[self._scene[robots]])

    def _roaming(self, robots: Indices, here: Plane, rng: np.random.Generator) -> Plane:
        """Return where within a disc of radius 1 what roams is next, (W, O)."""
        if not self._adversary:
            return _anywhere(rng, (len(robots), self._gone.shape[1]))
        home = self._nearest(robots, here) - self._gone[robots]
        away = here - home
        far, roams = np.abs(away), self._things.roams[self._scene[robots]]
        share = np.clip(far - self._stop, 0.0, roams) / np.where(roams > 0.0, roams, 1.0)
        return np.asarray(share * away / np.where(far > 0.0, far, 1.0))

    def _nearest(self, robots: Indices, here: Plane) -> Plane:
        """Return the point of each thing (W, O) that is nearest to robots (W, 1)."""
        found = np.full(self._gone[robots].shape, NOWHERE)
        rows = np.arange(len(robots))[:, None]
        circles, edges = self._circles(robots), self._edges(robots)
        middle, radius = circles[:, :, 0] + 1j * circles[:, :, 1], circles[:, :, 2]
        far = np.abs(here - middle)
        on_rim = middle + np.minimum(radius, far) * (here - middle) / np.where(far > 0.0, far, 1.0)
        first, second = edges[:, :, 0] + 1j * edges[:, :, 1], edges[:, :, 2] + 1j * edges[:, :, 3]
        along = second - first
        square = np.square(np.abs(along))
        share = ((here - first) * along.conj()).real / np.where(square > 0.0, square, 1.0)
        on_edge = first + np.clip(share, 0.0, 1.0) * along
        scene = self._scene[robots]
        for points, owner in (
            (on_rim, self._things.of_circle[scene]),
            (on_edge, self._things.of_edge[scene]),
        ):
            for column in range(points.shape[1]):
                which = owner[:, column]
                nearer = np.abs(here[:, 0] - points[:, column]) < np.abs(
                    here[:, 0] - found[rows[:, 0], which]
                )
                found[rows[:, 0][nearer], which[nearer]] = points[nearer, column]
        return found

    def _rebuild(self, robots: Indices) -> None:
        self.scenes.replace(robots, self._circles(robots), self._edges(robots))

    def _circles(self, robots: Indices | slice) -> Floats:
        scene = self._scene[robots]
        gone = np.take_along_axis(self._gone[robots], self._things.of_circle[scene], axis=1)
        return np.asarray(
            self._things.circles[scene] + np.stack([gone.real, gone.imag, 0.0 * gone.real], axis=2)
        )

    def _edges(self, robots: Indices | slice) -> Floats:
        scene = self._scene[robots]
        gone = np.take_along_axis(self._gone[robots], self._things.of_edge[scene], axis=1)
        moved = np.stack([gone.real, gone.imag, gone.real, gone.imag], axis=2)
        return np.asarray(self._things.edges[scene] + moved)


def _move(world_map: WorldMap, terms: ObstacleTerms) -> Booleans:
    """Tell which obstacles of a map move or roam."""
    free = [any(terms.freedom(name)) for name in world_map.obstacles.names]
    return np.array(free, dtype=bool)


def _listed(parts: Sequence[tuple[Obstacles, ObstacleTerms]]) -> tuple[Floats, Floats, Floats]:
    """Return circles (K, 4) and edges (M, 5) with the thing that each belongs to, and things (O, 5)."""
    circles: list[Floats] = [np.zeros((0, 4))]
    edges: list[Floats] = [np.zeros((0, 5))]
    things: list[tuple[float, ...]] = [
        (NOWHERE.real, NOWHERE.imag, 0.0, 0.0, 0.0)
    ]  # which nothing belongs to
    for obstacles, terms in parts:
        rounds = len(obstacles.circles)
        for number, name in enumerate(obstacles.names):
            if number < rounds:
                x, y, around = obstacles.circles[number].tolist()
                circles.append(np.array([[x, y, around, len(things)]]))
            else:
                ring = obstacles.polygons[number - rounds]
                x, y = ring.mean(axis=0).tolist()
                around = float(np.hypot(*(ring - (x, y)).T).max())
                sides = np.hstack([ring, np.roll(ring, -1, axis=0), np.full((len(ring), 1), len(things))])
                edges.append(sides)
            things.append((x, y, around, *terms.freedom(name)))
    return np.concatenate(circles), np.concatenate(edges), np.array(things)


def _stacked(rows: Sequence[Floats]) -> Floats:
    """Stack tables (n, k) of different lengths, (S, longest, k); what is missing is nowhere, and of thing 0."""
    longest, width = max(map(len, rows)), rows[0].shape[1]
    filler = {4: (1e9, 1e9, 0.0, 0.0), 5: (1e9, 1e9, 1e9, 1e9, 0.0)}[width]
    found = np.tile(np.array(filler), (len(rows), longest, 1))
    for table, row in zip(found, rows, strict=True):
        table[: len(row)] = row
    return found


def _inner(world_map: WorldMap) -> float:
    """Return how far the outline of the robot is from its origin at least, in metres."""
    footprint = world_map.robot.footprint
    if footprint.kind != "polygon":
        return footprint.radius
    corners = as_plane(footprint.polygon)[:, None]
    away = point_edge_squared(np.zeros(1, complex), corners, np.roll(corners, -1, axis=0))
    return float(np.sqrt(away.min()))


def _anywhere(rng: np.random.Generator, shape: tuple[int, ...]) -> Plane:
    """Return points of the disc of radius 1, evenly."""
    return np.asarray(np.sqrt(rng.random(shape)) * np.exp(2j * np.pi * rng.random(shape)))
