"""Safety by brute force: other formulas, shapely distances, dense commands. Shares no code with safety/."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import shapely

from viatool.world import Clearance, Footprint, Obstacles, Robot, WorldMap

SQUARE = Footprint.rectangle(0.5, 0.4)
WEDGE = Footprint("polygon", polygon=np.array([[-0.2, -0.1], [0.35, 0.0], [0.1, 0.2], [-0.05, 0.05]]))
FOOTPRINTS = {
    "point": Footprint(),
    "circle": Footprint("circle", radius=0.15),
    "square": SQUARE,
    "wedge": WEDGE,
}


def random_world(seed, footprint=None, **robot):
    """A crowded 6 m arena with circles, boxes and a triangle."""
    generator = np.random.default_rng(seed)
    circles = np.column_stack([generator.uniform(-2.5, 2.5, (5, 2)), generator.uniform(0.05, 0.4, 5)])
    polygons = []
    for _ in range(4):
        x, y = generator.uniform(-2.5, 2.5, 2)
        width, height = generator.uniform(0.02, 0.8, 2)
        box = shapely.affinity.rotate(shapely.box(x, y, x + width, y + height), generator.uniform(0, 90))
        polygons.append(np.array(shapely.geometry.polygon.orient(box).exterior.coords)[:-1])
    polygons.append(np.array([[1.0, 1.0], [1.6, 1.2], [1.1, 1.7]]))
    limits = {"min_linear": -0.3, "max_linear": 1.0, "max_angular": 2.0, "deceleration": 0.8}
    return WorldMap(
        name="random",
        path=Path("random.yaml"),
        sha256="",
        arena=np.array([[-3.0, -3.0], [3.0, -3.0], [3.0, 3.0], [-3.0, 3.0]]),
        obstacles=Obstacles(circles, tuple(polygons)),
        robot=Robot(**{**limits, **robot}, footprint=footprint or Footprint()),
        clearance=Clearance(0.1, 0.2),
    )


def drive(pose, linear, angular, seconds):
    """Poses (T, 3) of one pose's arcs; commands and seconds are broadcast."""
    linear, angular, seconds = np.broadcast_arrays(linear, angular, seconds)
    shape = seconds.shape
    places = drive_all(
        np.tile(pose, (seconds.size, 1)), linear.ravel(), angular.ravel(), seconds.reshape(-1, 1)
    )
    return places.reshape(*shape, 3)


def drive_all(poses, linear, angular, seconds, precision=np.longdouble):
    """Poses (S, T, 3) of S arcs at (T,) or (S, 1) seconds, by the difference of sines, not the chord."""
    x, y, theta = (column[:, None] for column in np.asarray(poses, precision).T)
    linear, angular = np.asarray(linear, precision)[:, None], np.asarray(angular, precision)[:, None]
    seconds = np.asarray(seconds, precision)
    turn = angular * seconds
    curved = np.abs(turn) > 1e-9
    rate = np.where(curved, angular, 1.0)
    forward = np.where(
        curved, linear * (np.sin(theta + turn) - np.sin(theta)) / rate, linear * seconds * np.cos(theta)
    )
    left = np.where(
        curved, linear * (np.cos(theta) - np.cos(theta + turn)) / rate, linear * seconds * np.sin(theta)
    )
    return np.stack([x + forward, y + left, theta + turn], axis=-1).astype(float)


def drive_and_stop(poses, linear, angular, interval, deceleration, rim, steps=60):
    """Poses (S, T, 3) of S commands held for the interval, and of a stop in small steps of falling rates."""
    held = drive_all(poses, linear, angular, np.linspace(0.0, interval, steps)[None])
    stop = (np.abs(linear) + rim * np.abs(angular)) / deceleration
    places = [held[:, -1]]
    for step in range(steps):
        share = 1.0 - (step + 0.5) / steps  # of the commanded rates, in the middle of the step
        places.append(drive_all(places[-1], share * linear, share * angular, stop[:, None] / steps)[:, 0])
    return np.concatenate([held, np.stack(places, axis=1)], axis=1)


def clearance(world, poses, footprint, scenario=None):
    """Distance of the whole footprint from obstacles and walls, 0 where they meet; poses (N, 3)."""
    poses = np.asarray(poses).reshape(-1, 3)
    shapes = place(poses, footprint)
    x_min, y_min, x_max, y_max = world.bounds
    outside = shapely.box(x_min - 9, y_min - 9, x_max + 9, y_max + 9).difference(shapely.Polygon(world.arena))
    own = Obstacles() if scenario is None else scenario.obstacles
    polygons = [*world.obstacles.polygons, *own.polygons]
    solid = shapely.union_all([outside, *(shapely.Polygon(polygon) for polygon in polygons)])
    shapely.prepare(solid)
    found = shapely.distance(shapes, solid)
    for x, y, radius in [*world.obstacles.circles, *own.circles]:
        found = np.minimum(found, shapely.distance(shapes, shapely.Point(x, y)) - radius)
    return np.maximum(found - (footprint.radius if footprint.kind == "circle" else 0.0), 0.0)


def place(poses, footprint):
    """The footprint at each pose, as shapely geometries; a circle as its centre."""
    if footprint.kind != "polygon":
        return shapely.points(poses[:, :2])
    turned = np.exp(1j * poses[:, 2])[:, None] * (footprint.polygon @ [1, 1j])
    corners = turned + (poses[:, 0] + 1j * poses[:, 1])[:, None]
    return shapely.polygons(np.stack([corners.real, corners.imag], axis=-1))


def rim_of(footprint):
    return float(np.hypot(*footprint.polygon.T).max()) if footprint.kind == "polygon" else 0.0
