"""Which obstacle is nearest, in words."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from viatool.arrays import Floats
from viatool.world import Footprint, Obstacles, Scenario, Scenes, WorldMap


def describe_nearest(
    world_map: WorldMap, scenario: Scenario | None, pose: Floats, footprint: Footprint
) -> str:
    """Name the obstacle that is nearest to the footprint.

    Parameters
    ----------
    world_map : WorldMap
        The map.
    scenario : Scenario or None
        What else stands there.
    pose : ndarray
        (3,) x, y, theta of the robot.
    footprint : Footprint
        Outline in the robot's frame.

    Returns
    -------
    str
        Such as "circle of radius 0.75 m at (1.76, 0.68)".
    """
    import shapely

    outline = _place(pose, footprint)
    own = Obstacles() if scenario is None else scenario.obstacles
    obstacles = world_map.obstacles + own
    x, y = pose[0], pose[1]
    wall = shapely.Polygon(world_map.arena).exterior
    candidates = [(shapely.distance(outline, wall), "wall of the arena")]
    for cx, cy, radius in obstacles.circles:
        away = shapely.distance(outline, shapely.Point(cx, cy)) - radius
        candidates.append((away, f"circle of radius {radius:.3g} m at ({cx:.2f}, {cy:.2f})"))
    for polygon in obstacles.polygons:
        shape = shapely.Polygon(polygon)
        middle = shapely.centroid(shape)
        name = f"polygon of {len(polygon)} corners around ({middle.x:.2f}, {middle.y:.2f})"
        candidates.append((shapely.distance(outline, shape), name))
    if obstacles.grid is not None:
        only = replace(world_map, obstacles=Obstacles(grid=obstacles.grid))
        disc = footprint if footprint.kind == "polygon" else Footprint()
        away = Scenes.of(only, [None]).footprint_clearance(pose[None], disc, np.zeros(1, np.int64))[0]
        candidates.append((away, "cell of the occupancy map"))
    if not shapely.Polygon(world_map.arena).contains(shapely.Point(x, y)):
        return "outside of the arena"
    return min(candidates, key=lambda candidate: float(candidate[0]))[1]


def describe_mover(what: str, origin: Floats, velocity: Floats) -> str:
    """Say what has come near: what it is, from where (2,), and how (2,)."""
    speed = float(np.hypot(*velocity))
    if not speed:
        return f"{what}, within its bounds at ({origin[0]:.2f}, {origin[1]:.2f})"
    return f"{what}, from ({origin[0]:.2f}, {origin[1]:.2f}) at {speed:.2f} m/s"


def _place(pose: Floats, footprint: Footprint) -> object:
    """Return the footprint at a pose as a shapely geometry; a disc as its centre."""
    import shapely

    if footprint.kind != "polygon":
        return shapely.Point(pose[0], pose[1])
    cosine, sine = np.cos(pose[2]), np.sin(pose[2])
    turned = footprint.polygon @ np.array([[cosine, sine], [-sine, cosine]])
    return shapely.Polygon(turned + pose[:2])
