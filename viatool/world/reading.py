"""`load_map`: a map file to a checked world."""

from __future__ import annotations

import hashlib
import logging
import os
import warnings
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from viatool.arrays import Floats
from viatool.errors import MapError, MapWarning
from viatool.samples import MAPS
from viatool.world import map_file as file
from viatool.world.complaints import located, shortened, validated, wrong
from viatool.world.generator import ScenarioGenerator
from viatool.world.map_file import Unknown
from viatool.world.map_server import ServedMap, is_map_server_file, read_map_server
from viatool.world.obstacle_shapes import Arena, ObstacleShape
from viatool.world.rings import LARGEST, simple_polygon
from viatool.world.robot import ROBOTS, Footprint, Robot
from viatool.world.scenario import Scenario, StateRange
from viatool.world.scenes import Scenes
from viatool.world.shapes import Obstacles
from viatool.world.world_map import Clearance, WorldMap
from viatool.world.yaml_text import YamlDocument, read_yaml

_log = logging.getLogger(__name__)

# Of a map_server map alone: starts and goals apart, wherever there is room.
_DEFAULT_GENERATOR = file.GeneratorFile(area=None, goal_clearance=0.4, goal_distance=(1.0, 1e6))


def as_map(given: WorldMap | str | os.PathLike[str]) -> WorldMap:
    """Return a map as it was given, or read it with `load_map`."""
    return given if isinstance(given, WorldMap) else load_map(Path(given))


def load_map(path: str | Path, *, unknown: Unknown | None = None) -> WorldMap:
    """Read a map (YAML), check it and return the world it describes.

    Parameters
    ----------
    path : str or Path
        The file, or the name of a map that comes with viatool, such as "lab". A native map, of which
        `docs/` holds the JSON Schema, or a ROS 2 map_server map, which is told by its keys. The latter knows
        no robot and no scenarios: it gets the default robot and clearances and a generator of random starts
        and goals. A native map gives it others by naming it as its `occupancy`.
    unknown : str, optional
        What unknown cells of a map_server map are, "obstacle" or "free"; by default what the native map
        says, else obstacles.

    Returns
    -------
    WorldMap
        Arena, obstacles, robot, clearances, fixed scenarios and generator.

    Raises
    ------
    MapError
        If the file cannot be read, has an unknown, missing or impossible value (the message names file, line
        and field), or puts a start or a goal into an obstacle.

    Warns
    -----
    MapWarning
        If the map may not mean what its author thinks; also in `WorldMap.warnings`.
    """
    document, text = _read_document(MAPS.find(path))
    if is_map_server_file(document):
        world = _served_world(document, text, unknown or "obstacle")
    else:
        world = _native_world(document, text, unknown)
    for warning in world.warnings:
        warnings.warn(warning, MapWarning, stacklevel=2)
    _log.info(
        "map %s read: sha256 %s, %d circles and %d polygons, %d scenarios, robot %s",
        path,
        world.sha256[:12],
        len(world.obstacles.circles),
        len(world.obstacles.polygons),
        len(world.scenarios),
        world.robot.name,
    )
    return replace(world, path=Path(path))


def _read_document(path: Path) -> tuple[YamlDocument, bytes]:
    """Return a YAML file, parsed and as it is."""
    try:
        text = path.read_bytes()
    except OSError as error:
        raise MapError(f"map '{path}' cannot be read: {error.strerror or error}", MAPS.hint()) from error
    return read_yaml(path, text), text


def _served_world(document: YamlDocument, text: bytes, unknown: Unknown) -> WorldMap:
    """Return the world of a map_server map alone."""
    served = read_map_server(document, unknown)
    obstacles = Obstacles(grid=served.grid)
    world = WorldMap(
        document.path.stem,
        document.path,
        _digest(text, served.content),
        served.grid.outline,
        obstacles,
        warnings=served.warnings,
        stated=frozenset(),
    )
    if served.grid.free_area is None:
        return world
    return replace(world, generator=_generator(document, _DEFAULT_GENERATOR, world, np.zeros((0, 2))))


def _native_world(document: YamlDocument, text: bytes, unknown: Unknown | None) -> WorldMap:
    """Return the world of a native map."""
    if not isinstance(document.content, dict):
        raise MapError(
            f"{document.path}: is not a map: expected a mapping with 'arena', got {shortened(document.content)}",
            "give a native map such as maps/lab.yaml, or the YAML file of a map_server map",
        )
    content = validated(document, file.MapFile)
    served, parts = None, [text]
    if content.occupancy is not None:
        served, parts = _occupancy(document, content, unknown or content.unknown, text)
    elif content.arena is None:
        raise wrong(document, ("arena",), "field required", "give the arena, or an occupancy map")
    world = _build(document, content, _digest(*parts), served)
    _check_free_space(document, world)
    return world


def _occupancy(
    document: YamlDocument, content: file.MapFile, unknown: Unknown, text: bytes
) -> tuple[ServedMap, list[bytes]]:
    """Return the map_server map that a native map names, and everything that was read."""
    path = document.path.parent / str(content.occupancy)
    try:
        inner, inner_text = _read_document(path)
    except MapError as error:
        raise wrong(document, ("occupancy",), error.message, "give the path of a map_server file") from error
    if not is_map_server_file(inner):
        raise wrong(
            document,
            ("occupancy",),
            f"'{path}' is not a map_server file: it names no image",
            "give the YAML file that map_saver writes",
        )
    served = read_map_server(inner, unknown)
    return served, [text, inner_text, served.content]


def _digest(*parts: bytes) -> str:
    """Return the digest of a file, or of the digests of several."""
    digests = [hashlib.sha256(part) for part in parts]
    if len(digests) == 1:
        return digests[0].hexdigest()
    return hashlib.sha256(b"".join(digest.digest() for digest in digests)).hexdigest()


def _build(document: YamlDocument, content: file.MapFile, digest: str, served: ServedMap | None) -> WorldMap:
    """Return the world; errors of its parts are told with their place in the file."""
    obstacles, centres = _obstacles(document, content.obstacles, ("obstacles",))
    obstacles = obstacles + Obstacles(grid=served.grid if served else None)
    robot = located(document, ("robot",), lambda: _robot(content.robot))
    clearance = located(
        document,
        ("clearance",),
        lambda: Clearance(content.clearance.collision, content.clearance.danger),
    )
    world = WorldMap(
        content.name or document.path.stem,
        document.path,
        digest,
        _arena(document, content.arena, served),
        obstacles,
        robot,
        clearance,
        _scenarios(document, content.scenarios),
        warnings=served.warnings if served else (),
        stated=_stated(content),
    )
    if content.generator is None:
        return world
    generator = _generator(document, content.generator, world, centres)
    located(document, ("generator",), lambda: generator.draw(1, seed=0))
    return replace(world, generator=generator)


def _arena(document: YamlDocument, arena: Arena | None, served: ServedMap | None) -> Floats:
    """Return the arena that is given, or else the outline of the occupancy map."""
    if arena is None:
        assert served is not None  # one of them is required
        return served.grid.outline
    return located(document, ("arena",), arena.ring)


def _obstacles(
    document: YamlDocument, shapes: Sequence[ObstacleShape], location: Sequence[str | int]
) -> tuple[Obstacles, Floats]:
    """Return the obstacles, and the centres of those that are compact."""
    solids = [
        _named(located(document, (*location, index), shape.solid), shape.name)
        for index, shape in enumerate(shapes)
    ]
    empty = [shape for shape, solid in zip(shapes, solids, strict=True) if not len(solid)]
    if empty:
        raise TypeError(
            f"an obstacle of shape '{empty[0].shape}' has no solid, so nothing would keep away from it"
        )
    compact, others = (
        Obstacles.together(
            [solid for shape, solid in zip(shapes, solids, strict=True) if shape.compact == kind]
        )
        for kind in (True, False)
    )
    return compact + others, compact.centres()


def _named(solid: Obstacles, name: str) -> Obstacles:
    return replace(solid, names=(name,) * len(solid))


def _scenarios(document: YamlDocument, given: Sequence[file.ScenarioFile]) -> tuple[Scenario, ...]:
    """Return the fixed scenarios; their names are unique."""
    scenarios: list[Scenario] = []
    for index, scenario in enumerate(given):
        name = scenario.name or f"scenario-{index}"
        if any(name == other.name for other in scenarios):
            raise wrong(
                document,
                ("scenarios", index, "name"),
                f"'{name}' is taken",
                "give every scenario its own name",
            )
        obstacles, _ = _obstacles(document, scenario.obstacles, ("scenarios", index, "obstacles"))
        place = ("scenarios", index, "goal")
        starts = _states(scenario.start)
        region = located(document, place, partial(_region, scenario.goal))
        x, y, theta = scenario.start if isinstance(scenario.start, tuple) else _middle(starts, 3)
        goal_x, goal_y = scenario.goal if isinstance(scenario.goal, tuple) else _middle(region, 2)
        when = scenario.deadline, scenario.arrive
        scenarios.append(Scenario(name, (x, y, theta), (goal_x, goal_y), obstacles, starts, region, *when))
    return tuple(scenarios)


def _middle(states: StateRange | None, count: int) -> tuple[float, ...]:
    """Return the first numbers of the middle of a box of states."""
    assert states is not None
    return states.middle[:count]


def _states(given: file.StatesFile | file.PolygonGoalFile | tuple[float, ...]) -> StateRange | None:
    """Return a box of states; None for a place."""
    if isinstance(given, tuple):
        return None
    lower = tuple(-np.inf if end is None else end for end in given.lower)
    upper = tuple(np.inf if end is None else end for end in given.upper)
    return StateRange(lower, upper)


def _region(given: file.GoalFile) -> StateRange | None:
    """Return the states of a goal; None for a place."""
    if isinstance(given, list):
        given = file.PolygonGoalFile(points=given)
    states = _states(given)
    if states is None or isinstance(given, file.StatesFile):
        return states
    assert isinstance(given, file.PolygonGoalFile)
    ring = simple_polygon(given.points, "the polygon")
    region = replace(states, outline=tuple((float(x), float(y)) for x, y in ring))
    if region.places((-LARGEST, -LARGEST, LARGEST, LARGEST)).is_empty:
        raise MapError(
            "holds no place: `lower` and `upper` keep x and y out of the polygon", "leave them null"
        )
    return region


def _stated(content: file.MapFile) -> frozenset[str]:
    """Return what a file says of the robot, see `WorldMap`."""
    if "robot" not in content.model_fields_set:
        return frozenset()
    robot = content.robot
    lidar = None if isinstance(robot, str) else robot.lidar
    said = set() if lidar is None else lidar.model_dump(exclude_none=True).keys()
    body = set() if isinstance(robot, str) or robot.footprint is None else {"footprint"}
    return frozenset({"robot", *body, *(f"lidar.{name}" for name in said)})


def _robot(content: str | file.RobotFile) -> Robot:
    """Return a known robot, with the file's changes."""
    given = file.RobotFile(name=content) if isinstance(content, str) else content
    if given.name not in ROBOTS:
        raise MapError(
            f"robot '{given.name}' is unknown",
            f"leave `name` out to describe a robot of your own, or use one of {', '.join(ROBOTS)}",
        )
    robot = ROBOTS[given.name]
    plain = given.model_dump(exclude_none=True, exclude={"name", "footprint", "lidar"})
    if given.lidar is not None:
        plain["lidar"] = replace(robot.lidar, **given.lidar.model_dump(exclude_none=True))
    if given.footprint is not None:
        plain["footprint"] = _footprint(given.footprint)
    return replace(robot, **plain)


def _footprint(content: file.FootprintFile) -> Footprint:
    if isinstance(content, file.FootprintPolygon):
        return Footprint("polygon", polygon=np.array(content.points))
    if isinstance(content, file.FootprintCircle):
        return Footprint("circle", radius=content.radius)
    return Footprint()


def _generator(
    document: YamlDocument, content: file.GeneratorFile, world: WorldMap, centres: Floats
) -> ScenarioGenerator:
    """Return the generator of a world, with the world's values where the file is silent."""
    grid = world.obstacles.grid
    room = world.bounds if grid is None else grid.free_area or world.bounds
    x_min, y_min, x_max, y_max = content.area or room
    if not (x_min < x_max and y_min < y_max):
        raise wrong(
            document,
            ("generator", "area"),
            f"has no inside, got {list(content.area or ())}",
            "give smallest x, smallest y, largest x, largest y",
        )
    least, largest = content.goal_distance or (0.0, float("inf"))
    if least > largest:
        raise wrong(
            document,
            ("generator", "goal_distance"),
            f"{least} m is more than {largest} m",
            "give the least distance first",
        )
    start = content.start_clearance
    circles = tuple(shape.radius for shape in content.obstacles if isinstance(shape, file.RandomCircle))
    boxes = tuple(shape.size for shape in content.obstacles if isinstance(shape, file.RandomBox))
    return ScenarioGenerator(
        arena=world.arena,
        obstacles=world.obstacles,
        area=(x_min, y_min, x_max, y_max),
        centres=centres,
        radii=circles,
        boxes=boxes,
        obstacle_separation=content.obstacle_separation,
        start_separation=content.start_separation,
        goal_separation=content.goal_separation,
        start_clearance=(world.clearance.danger + world.robot.footprint.reach if start is None else start),
        goal_clearance=content.goal_clearance,
        goal_distance=(least, largest),
    )


def _check_free_space(document: YamlDocument, world: WorldMap) -> None:
    """Refuse scenarios that begin in collision, or whose goal lies in an obstacle."""
    if not world.scenarios:
        return
    scenes = Scenes.of(world, world.scenarios)
    index = np.arange(len(scenes))
    starts = np.array([scenario.start for scenario in world.scenarios])
    free = scenes.footprint_clearance(starts, world.robot.footprint, index)
    blocked = scenes.blocked(np.array([scenario.goal for scenario in world.scenarios]), index)
    least = world.clearance.collision
    for number, scenario in enumerate(world.scenarios):
        if not (free[number] >= least and free[number] > 0.0):
            raise wrong(
                document,
                ("scenarios", number, "start"),
                f"the robot is {free[number]:.3f} m from the nearest obstacle, expected at least {least} m "
                f"(scenario '{scenario.name}')",
                "move the start into free space",
            )
        region = scenario.region
        if blocked[number] if region is None else _is_covered(region, world, scenes, number):
            raise wrong(
                document,
                ("scenarios", number, "goal"),
                f"lies in an obstacle or outside the arena (scenario '{scenario.name}')",
                "move the goal into free space",
            )


def _is_covered(region: StateRange, world: WorldMap, scenes: Scenes, number: int) -> bool:
    """Tell whether every place of a goal lies in an obstacle or outside the arena."""
    left, right = np.array(world.bounds[:2]), np.array(world.bounds[2:])
    margin = 1.0 + float((right - left).max())
    bounds = (*(left - margin).tolist(), *(right + margin).tolist())
    places = region.places(bounds)
    return bool(places.is_empty or scenes.shapely(number, margin=margin).covers(places))
