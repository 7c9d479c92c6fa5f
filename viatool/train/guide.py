"""The way around the obstacles, for the shaping of the reward: a map of the distance to go for every robot."""

from __future__ import annotations

import math

import numpy as np

from viatool.arrays import Floats, Indices, Singles
from viatool.world import Scenes, WorldMap

FINEST = 0.25  # metres between the points of the lattice
MOST_POINTS = 4096  # of the lattice: a larger map gets a coarser one
MARGIN = 0.15  # metres beyond the danger clearance within which the way gets longer
DETOUR = 6.0  # so many times longer is a metre at the collision clearance
FAR = np.float32(1e4)  # metres, to where no way is known yet
SETTLED = 1e-3  # metres; smaller changes end the iteration
CHECKED_EVERY = 8  # iterations


class Guide:
    """Distances to go of E robots, along ways that keep clear of the obstacles.

    Parameters
    ----------
    world_map : WorldMap
        Arena, clearances, footprint.
    robots : int
        E.
    narrow : float
        So many times longer, besides what `DETOUR` says, is a metre where obstacles are nearer than the danger
        clearance: a way through a gap that just keeps it is then longer than one around it.

    Notes
    -----
    Sound: no, and it need not be: the policy does not see the distance. With ``shaping_form: potential`` it leaves the
    best policy as it is, whatever it is (Ng, Harada and Russell, 1999); with ``progress``, and more so where that is
    capped, the metres gained are part of the task. The distance U solves the eikonal equation ``|grad U| = n`` on a
    lattice by upwind differences, n being 1 in the open and up to 1 + `DETOUR` + `narrow` near obstacles. n is
    finite everywhere: a start or a goal in a narrow place has its way as well. The lattice may miss the middle
    of a gap by half its spacing, over which `narrow` fades out.
    """

    def __init__(self, world_map: WorldMap, robots: int, narrow: float = 0.0) -> None:
        x_min, y_min, x_max, y_max = world_map.bounds
        self.spacing = max(FINEST, math.sqrt((x_max - x_min) * (y_max - y_min) / MOST_POINTS))
        x = np.arange(x_min, x_max + self.spacing, self.spacing)
        y = np.arange(y_min, y_max + self.spacing, self.spacing)
        self.origin = np.array([x_min, y_min])
        self.points = np.stack(np.meshgrid(x, y), axis=-1)  # (R, C, 2)
        self.fields: Singles = np.zeros((robots, len(y), len(x)), dtype=np.float32)
        reach = world_map.robot.footprint.reach
        self._blocked = world_map.clearance.collision + reach
        self._danger = world_map.clearance.danger + reach
        self._open = self._danger + MARGIN
        self.narrow = narrow

    def aim(self, which: Indices, scenes: Scenes, scene: Indices, goals: Floats) -> None:
        """Find the ways of some robots to their new goals.

        Parameters
        ----------
        which, scene : ndarray
            (W,) robots, and the geometry around each.
        scenes : Scenes
            The geometry.
        goals : ndarray
            (W, 2).
        """
        if not len(which):
            return
        shape = self.fields.shape[1:]
        flat = self.points.reshape(-1, 2)
        clearance = scenes.clearance(np.tile(flat, (len(which), 1)), np.repeat(scene, len(flat)))
        step = (self.spacing * self._slowness(clearance)).astype(np.float32).reshape(-1, *shape)
        away = np.hypot(*(self.points - goals[:, None, None]).transpose(3, 0, 1, 2)).astype(np.float32)
        self.fields[which] = solve_eikonal(np.where(away < 1.5 * self.spacing, away, FAR), step)

    def _slowness(self, clearance: Floats) -> Floats:
        """Return n, how many times longer a metre is at places with these clearances."""
        near = np.clip((self._open - clearance) / (self._open - self._blocked), 0.0, 1.0)
        narrow = np.clip(1.0 - (clearance - self._danger) / (0.5 * self.spacing), 0.0, 1.0)
        return np.asarray(1.0 + DETOUR * near + self.narrow * narrow)

    def distance(self, points: Floats) -> Floats:
        """Return the distance to go from points (E, 2), one for each robot, interpolated; metres."""
        rows, columns = self.fields.shape[1:]
        place = (points - self.origin) / self.spacing
        place = np.clip(place, 0.0, np.array([columns, rows]) - 1.001)
        cell = place.astype(np.int64)
        (right, up), (column, row), robot = (place - cell).T, cell.T, np.arange(len(points))
        low = self.fields[robot, row, column] * (1 - right) + self.fields[robot, row, column + 1] * right
        high = (
            self.fields[robot, row + 1, column] * (1 - right)
            + self.fields[robot, row + 1, column + 1] * right
        )
        return np.asarray(low * (1 - up) + high * up)


def solve_eikonal(start: Singles, step: Singles) -> Singles:
    """Extend distances over a lattice: ``|grad U| = step / spacing``.

    Parameters
    ----------
    start : ndarray
        (W, R, C) known distances near the goal, `FAR` elsewhere.
    step : ndarray
        (W, R, C) length of a step from each point to its neighbour.

    Returns
    -------
    ndarray
        (W, R, C); Godunov's upwind scheme, iterated for all points at once until nothing changes.
    """
    padded = np.full((len(start), start.shape[1] + 2, start.shape[2] + 2), FAR, dtype=np.float32)
    distance = padded[:, 1:-1, 1:-1]
    distance[...] = start
    before = start.copy()
    for iteration in range(1, 4 * sum(start.shape[1:])):
        across = np.minimum(padded[:, 1:-1, :-2], padded[:, 1:-1, 2:])
        along = np.minimum(padded[:, :-2, 1:-1], padded[:, 2:, 1:-1])
        apart = np.minimum(np.abs(across - along), step)
        oblique = np.sqrt(2.0 * step * step - apart * apart)
        # where the two differ by a step or more, the nearer neighbour alone decides
        nearer = np.minimum(across, along)
        np.minimum(distance, nearer + 0.5 * (apart + oblique), out=distance)
        if iteration % CHECKED_EVERY == 0:
            if np.abs(distance - before).max() < SETTLED:
                break
            before[...] = distance
    return np.ascontiguousarray(distance)
