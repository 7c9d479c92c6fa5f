"""What stands around the robot: an occupancy grid, the outlines of obstacles, and the goal."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Floats
from viatool.report.drawing import FAINT
from viatool.report.occupancy import darkest
from viatool.report.playback.markers import circle, markers, outlined, single
from viatool.report.playback.messages import RosMessage, header, pose_of

if TYPE_CHECKING:
    from viatool.world import Scenario, WorldMap

_CELL = 0.05  # metres, of maps that have no cells of their own
_MOST = 400  # cells along the longer side of these
_MARGIN = 0.25  # metres around the arena
_HALF = 0.499  # of a cell's side, so that cells are not touched by what ends where they do
_FREE, _BLOCKED, _UNKNOWN = 0, 100, -1
_GOAL = "#F0E442"


class MapMessages:
    """What stands around the robot in the scenarios of a map."""

    def __init__(self, world_map: WorldMap) -> None:
        self.world_map = world_map
        self._cells, self._side, self._origin = _lattice(world_map)
        self._bare: NDArray[np.int8] | None = None

    def messages(
        self, stamp: int, scenario: Scenario | None, goal: Iterable[Floats]
    ) -> tuple[RosMessage, RosMessage, RosMessage]:
        """Return map, obstacles and goal, whose outlines are rings (n, 2), as they are from a stamp on."""
        outlines = outlined(self._rings(scenario), stamp, "obstacles", 0, FAINT)
        return (
            self._grid(stamp, scenario),
            markers(stamp, "/obstacles", [outlines], afresh=True, lasting=True),
            single(stamp, "/goal", outlined(goal, stamp, "goal", 0, _GOAL)),
        )

    def _grid(self, stamp: int, scenario: Scenario | None) -> RosMessage:
        rows, columns = self._cells.shape
        info = {
            "map_load_time": header(stamp)["stamp"],
            "resolution": self._side,
            "width": columns,
            "height": rows,
            "origin": pose_of(self._origin),
        }
        fields: dict[str, Any] = {
            "header": header(stamp),
            "info": info,
            "data": self._occupied(scenario).ravel(),
        }
        return RosMessage(stamp, "/map", "nav_msgs/msg/OccupancyGrid", fields, lasting=True)

    def _occupied(self, scenario: Scenario | None) -> NDArray[np.int8]:
        """Return what each cell holds; it is blocked where something comes nearer to its middle than to its sides."""
        if scenario is not None and len(scenario.obstacles):
            return self._touched(scenario)
        if self._bare is None:
            self._bare = self._touched(None)
        return self._bare

    def _touched(self, scenario: Scenario | None) -> NDArray[np.int8]:
        from viatool.world import Scenes

        rows, columns = self._cells.shape
        shapes = replace(self.world_map, obstacles=replace(self.world_map.obstacles, grid=None))
        scenes, found = Scenes.of(shapes, [scenario]), self._cells.copy()
        x, y, turn = self._origin
        for row in range(rows):
            at = (np.arange(columns) + 0.5 + 1j * (row + 0.5)) * self._side * np.exp(1j * turn)
            middles = np.stack([x + at.real, y + at.imag], axis=1)
            near = scenes.clearance(middles, np.zeros(columns, np.int64)) <= _HALF * self._side
            found[row, near] = _BLOCKED
        return found

    def _rings(self, scenario: Scenario | None) -> list[Floats]:
        own = [] if scenario is None else [scenario.obstacles]
        rings = [self.world_map.arena]
        for obstacles in (self.world_map.obstacles, *own):
            rings += [circle((x, y), radius) for x, y, radius in obstacles.circles]
            rings += obstacles.polygons
        return rings


def _lattice(world_map: WorldMap) -> tuple[NDArray[np.int8], float, Floats]:
    """Return cells (rows, columns) before shapes are drawn into them, the side of one, and their origin (3,)."""
    grid = world_map.obstacles.grid
    if grid is not None:
        kinds, block = darkest(grid.cells)
        holds = np.array([_FREE, _BLOCKED, _UNKNOWN], np.int8)
        return holds[kinds], grid.resolution * block, np.array(grid.origin)
    x_min, y_min, x_max, y_max = world_map.bounds
    width, height = x_max - x_min + 2.0 * _MARGIN, y_max - y_min + 2.0 * _MARGIN
    side = max(_CELL, max(width, height) / _MOST)
    shape = int(np.ceil(height / side)), int(np.ceil(width / side))
    return np.full(shape, _FREE, np.int8), side, np.array([x_min - _MARGIN, y_min - _MARGIN, 0.0])
