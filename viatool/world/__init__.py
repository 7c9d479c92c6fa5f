"""Worlds: maps, obstacles, robots, LiDAR and scenarios, with exact geometry in batches."""

from __future__ import annotations

from viatool.world.capsules import Capsules, Nearest
from viatool.world.generator import ScenarioBatch, ScenarioGenerator
from viatool.world.lidar import Lidar, bin_ranges
from viatool.world.map_file import MapFile
from viatool.world.map_server import MapServerFile
from viatool.world.occupancy import Cell, OccupancyGrid
from viatool.world.reachability import unreachable_scenarios
from viatool.world.reading import as_map, load_map
from viatool.world.rings import simple_polygon
from viatool.world.robot import ROBOTS, Footprint, Robot
from viatool.world.scenario import Scenario
from viatool.world.scenes import Scenes
from viatool.world.shapes import Obstacles, box_polygon, wall_polygons
from viatool.world.world_map import Clearance, WorldMap

__all__ = [
    "ROBOTS",
    "Capsules",
    "Cell",
    "Clearance",
    "Footprint",
    "Lidar",
    "MapFile",
    "MapServerFile",
    "Nearest",
    "Obstacles",
    "OccupancyGrid",
    "Robot",
    "Scenario",
    "ScenarioBatch",
    "ScenarioGenerator",
    "Scenes",
    "WorldMap",
    "as_map",
    "bin_ranges",
    "box_polygon",
    "load_map",
    "simple_polygon",
    "unreachable_scenarios",
    "wall_polygons",
]
