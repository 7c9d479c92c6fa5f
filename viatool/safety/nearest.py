"""Which obstacle is nearest, in words."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Floats
from viatool.world import Footprint, Obstacles, Scenario, Scenes, WorldMap


def describe_nearest(
    world_map: WorldMap, scenario: Scenario | None, pose: Floats, footprint: Footprint
) -> str:
    """Name the obstacle that is nearest to the footprint at one pose (3,); as `describe_each_nearest`."""
    return describe_each_nearest(world_map, scenario, pose[None], footprint)[0]


def describe_each_nearest(
    world_map: WorldMap, scenario: Scenario | None, poses: Floats, footprint: Footprint
) -> tuple[str, ...]:
    """Name for each of some poses the obstacle that is nearest to the footprint.

    Parameters
    ----------
    world_map : WorldMap
        The map.
    scenario : Scenario or None
        What else stands there.
    poses : ndarray
        (B, 3) x, y, theta of the robot.
    footprint : Footprint
        Outline in the robot's frame.

    Returns
    -------
    tuple of str
        B of them, such as "circle of radius 0.75 m at (1.76, 0.68)".
    """
    import shapely

    own = Obstacles() if scenario is None else scenario.obstacles
    obstacles = world_map.obstacles + own
    outlines = _placed(poses, footprint)[:, None]
    arena = shapely.Polygon(world_map.arena)
    shapes = [shapely.Polygon(polygon) for polygon in obstacles.polygons]
    away = [
        shapely.distance(outlines, arena.exterior),
        shapely.distance(outlines, shapely.points(obstacles.circles[:, :2])) - obstacles.circles[:, 2],
        shapely.distance(outlines, np.array(shapes, dtype=object)),
    ]
    names = [
        "wall of the arena",
        *(f"circle of radius {radius:.3g} m at ({x:.2f}, {y:.2f})" for x, y, radius in obstacles.circles),
        *(_polygon(shape) for shape in shapes),
    ]
    if obstacles.grid is not None:
        only = replace(world_map, obstacles=Obstacles(grid=obstacles.grid))
        disc = footprint if footprint.kind == "polygon" else Footprint()
        scenes = Scenes.of(only, [None])
        away.append(scenes.footprint_clearance(poses, disc, np.zeros(len(poses), np.int64))[:, None])
        names.append("cell of the occupancy map")
    nearest = np.concatenate(away, axis=1).argmin(axis=1)
    inside = shapely.contains_xy(arena, poses[:, :2])
    return tuple(
        names[number] if within else "outside of the arena"
        for number, within in zip(nearest.tolist(), inside.tolist(), strict=True)
    )


def describe_mover(what: str, origin: Floats, velocity: Floats) -> str:
    """Say what has come near: what it is, from where (2,), and how (2,)."""
    speed = float(np.hypot(*velocity))
    if not speed:
        return f"{what}, within its bounds at ({origin[0]:.2f}, {origin[1]:.2f})"
    return f"{what}, from ({origin[0]:.2f}, {origin[1]:.2f}) at {speed:.2f} m/s"


def _polygon(shape: Any) -> str:
    x, y = shape.centroid.coords[0]
    return f"polygon of {len(shape.exterior.coords) - 1} corners around ({x:.2f}, {y:.2f})"


def _placed(poses: Floats, footprint: Footprint) -> NDArray[np.object_]:
    """Return the footprint at poses (B, 3) as shapely geometries (B,); a disc as its centre."""
    import shapely

    if footprint.kind != "polygon":
        return np.asarray(shapely.points(poses[:, :2]))
    cosine, sine = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    turns = np.stack([np.stack([cosine, sine], axis=1), np.stack([-sine, cosine], axis=1)], axis=1)
    return np.asarray(shapely.polygons(footprint.polygon @ turns + poses[:, None, :2]))
