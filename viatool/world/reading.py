"""`load_map`: a map file to a checked world."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from viatool.errors import MapError, ViatoolError
from viatool.world import map_file as file
from viatool.world.generator import ScenarioGenerator
from viatool.world.robot import ROBOTS, Footprint, Lidar, Robot
from viatool.world.scenario import Scenario
from viatool.world.scenes import Scenes
from viatool.world.shapes import Floats, Obstacles, box_polygon, simple_polygon, wall_polygons
from viatool.world.world_map import Clearance, WorldMap
from viatool.world.yaml_text import YamlDocument, read_yaml

_SHOWN = 8  # errors that are listed; the rest is counted


def load_map(path: str | Path) -> WorldMap:
    """Read a native map (YAML), check it and return the world it describes.

    Parameters
    ----------
    path : str or Path
        The file; `docs/` holds the JSON Schema of its content.

    Returns
    -------
    WorldMap
        Arena, obstacles, robot, clearances, fixed scenarios and generator.

    Raises
    ------
    MapError
        If the file cannot be read, has an unknown, missing or impossible value (the message names file, line
        and field), or puts a start or a goal into an obstacle.
    """
    place = Path(path)
    try:
        text = place.read_bytes()
    except OSError as error:
        raise MapError(
            f"map '{place}' cannot be read: {error.strerror or error}", "give the path of a map file"
        ) from error
    document = read_yaml(place, text)
    content = _validate(document)
    world = _build(document, content, hashlib.sha256(text).hexdigest())
    _check_free_space(document, world)
    return world


def _validate(document: YamlDocument) -> file.MapFile:
    """Return the file as a typed model."""
    if not isinstance(document.content, dict):
        raise MapError(
            f"{document.path}: is not a map: expected a mapping with 'arena', got {_show(document.content)}",
            "give a native map such as maps/lab.yaml",
        )
    if "image" in document.content and "arena" not in document.content:
        raise MapError(
            f"{document.path}: is a ROS map_server file, which this version does not read",
            "describe the map natively, as maps/lab.yaml does",
        )
    try:
        return file.MapFile.model_validate(document.content)
    except ValidationError as error:
        problems = error.errors(include_url=False)
        lines = [_explain(document, problem) for problem in problems[:_SHOWN]]
        if len(problems) > _SHOWN:
            lines.append(f"and {len(problems) - _SHOWN} more")
        raise MapError(
            "\n".join(lines), "correct the named fields; lengths are metres, angles radians"
        ) from error


def _explain(document: YamlDocument, problem: Any) -> str:
    """Return one line for one problem that pydantic found."""
    location = [step for step in problem["loc"] if step not in _VARIANTS]
    message = problem["msg"]
    what = _PLAINER.get(problem["type"], message[0].lower() + message[1:])
    given = problem["input"]
    if problem["type"] not in ("missing", "extra_forbidden") and not isinstance(given, dict | list):
        what += f", got {_show(given)}"
    return f"{document.place(location)}: {_field(location)}: {what}"


# Steps in pydantic's locations that name a variant of a union instead of a key of the file.
_VARIANTS = ("circle", "box", "polygon", "wall", "point", "str", "RobotFile")


# What pydantic says in terms of Python, in terms of the file.
_PLAINER = {
    "union_tag_not_found": "has no 'shape'",
    "model_type": "expected a mapping",
    "model_attributes_type": "expected a mapping",
    "list_type": "expected a list",
    "tuple_type": "expected a list",
    "extra_forbidden": "is not a known field",
}


def _show(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _field(location: Iterable[str | int]) -> str:
    """Return "obstacles[2].radius" for ("obstacles", 2, "radius")."""
    text = ""
    for step in location:
        text += f"[{step}]" if isinstance(step, int) else f".{step}" if text else step
    return text or "map"


def _build(document: YamlDocument, content: file.MapFile, digest: str) -> WorldMap:
    """Return the world; errors of its parts are told with their place in the file."""
    arena = _polygon(document, content.arena, ("arena",))
    obstacles, centres = _obstacles(document, content.obstacles, ("obstacles",))
    robot = _located(document, ("robot",), lambda: _robot(content.robot))
    clearance = _located(
        document,
        ("clearance",),
        lambda: Clearance(content.clearance.collision, content.clearance.danger),
    )
    scenarios = _scenarios(document, content.scenarios)
    world = WorldMap(
        content.name or document.path.stem,
        document.path,
        digest,
        arena,
        obstacles,
        robot,
        clearance,
        scenarios,
    )
    if content.generator is None:
        return world
    generator = _generator(document, content.generator, world, centres)
    _located(document, ("generator",), lambda: generator.draw(1, seed=0))
    return replace(world, generator=generator)


def _wrong(document: YamlDocument, location: Sequence[str | int], what: str, hint: str) -> MapError:
    """Return an error that names file, line and field."""
    return MapError(f"{document.place(location)}: {_field(location)}: {what}", hint)


def _located(document: YamlDocument, location: Sequence[str | int], build: Any) -> Any:
    """Return what `build` builds; its errors become map errors with a place."""
    try:
        return build()
    except ViatoolError as error:
        raise _wrong(document, location, error.message, error.hint) from error


def _polygon(document: YamlDocument, shape: file.Box | file.Polygon, location: Sequence[str | int]) -> Floats:
    """Return the corners of a box or a checked polygon."""
    if isinstance(shape, file.Box):
        return box_polygon(shape.center, shape.size, shape.yaw)
    points = np.array(shape.points)
    ring: Floats = _located(document, location, lambda: simple_polygon(points, shape.name or "polygon"))
    return ring


def _obstacles(
    document: YamlDocument, shapes: Sequence[file.Obstacle], location: Sequence[str | int]
) -> tuple[Obstacles, Floats]:
    """Return the obstacles, and the centres of all but the walls."""
    circles: list[tuple[float, float, float]] = []
    polygons: list[Floats] = []
    walls: list[Floats] = []
    for index, shape in enumerate(shapes):
        if isinstance(shape, file.Circle):
            circles.append((*shape.center, shape.radius))
        elif isinstance(shape, file.Wall):
            walls.extend(wall_polygons(shape.points, shape.thickness))
        else:
            polygons.append(_polygon(document, shape, (*location, index)))
    compact = Obstacles(np.array(circles).reshape(-1, 3), tuple(polygons))
    return compact + Obstacles(polygons=tuple(walls)), compact.centres()


def _scenarios(document: YamlDocument, given: Sequence[file.ScenarioFile]) -> tuple[Scenario, ...]:
    """Return the fixed scenarios; their names are unique."""
    scenarios: list[Scenario] = []
    for index, scenario in enumerate(given):
        name = scenario.name or f"scenario-{index}"
        if any(name == other.name for other in scenarios):
            raise _wrong(
                document,
                ("scenarios", index, "name"),
                f"'{name}' is taken",
                "give every scenario its own name",
            )
        obstacles, _ = _obstacles(document, scenario.obstacles, ("scenarios", index, "obstacles"))
        scenarios.append(Scenario(name, scenario.start, scenario.goal, obstacles))
    return tuple(scenarios)


def _robot(content: str | file.RobotFile) -> Robot:
    """Return a known robot, with the file's changes."""
    given = file.RobotFile(name=content) if isinstance(content, str) else content
    if given.name not in ROBOTS:
        raise MapError(f"robot '{given.name}' is unknown", f"use one of {', '.join(ROBOTS)}")
    robot = ROBOTS[given.name]
    plain = given.model_dump(exclude_none=True, exclude={"name", "footprint", "lidar"})
    if given.lidar is not None:
        plain["lidar"] = Lidar(**(vars(robot.lidar) | given.lidar.model_dump(exclude_none=True)))
    if given.footprint is not None:
        plain["footprint"] = _footprint(given.footprint)
    robot = replace(robot, **plain)
    if robot.max_linear < max(robot.min_linear, 0.0):
        raise MapError(
            f"max_linear {robot.max_linear} m/s is below min_linear {robot.min_linear} m/s or below 0",
            "correct the speed limits",
        )
    return robot


def _footprint(content: file.FootprintFile) -> Footprint:
    if isinstance(content, file.FootprintPolygon):
        return Footprint("polygon", polygon=simple_polygon(np.array(content.points), "footprint"))
    if isinstance(content, file.FootprintCircle):
        return Footprint("circle", radius=content.radius)
    return Footprint()


def _generator(
    document: YamlDocument, content: file.GeneratorFile, world: WorldMap, centres: Floats
) -> ScenarioGenerator:
    """Return the generator of a world, with the world's values where the file is silent."""
    x_min, y_min, x_max, y_max = content.area or world.bounds
    if not (x_min < x_max and y_min < y_max):
        raise _wrong(
            document,
            ("generator", "area"),
            f"has no inside, got {list(content.area or ())}",
            "give smallest x, smallest y, largest x, largest y",
        )
    least, largest = content.goal_distance or (0.0, float("inf"))
    if least > largest:
        raise _wrong(
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
        if free[number] < least or free[number] <= 0.0:
            raise _wrong(
                document,
                ("scenarios", number, "start"),
                f"the robot is {free[number]:.3f} m from the nearest obstacle, expected at least {least} m "
                f"(scenario '{scenario.name}')",
                "move the start into free space",
            )
        if blocked[number]:
            raise _wrong(
                document,
                ("scenarios", number, "goal"),
                f"lies in an obstacle or outside the arena (scenario '{scenario.name}')",
                "move the goal into free space",
            )
