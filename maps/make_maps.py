"""Write the maps office, corridor and warehouse, and those and the lab once more as map_server files.

    python maps/make_maps.py

NAME.yaml is the native map; NAME.ros.yaml with its image is what a mapping robot would have saved of it; and
NAME-grid.yaml is that occupancy map with the robot and the scenarios of the native one.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import shapely
import yaml
from make_lab import is_passable, lines_of, rounded
from PIL import Image

from viatool.world import Scenes, WorldMap, load_map

FOLDER = Path(__file__).parent
RESOLUTION = 0.05
MARGIN = 0.3  # metres of the image around the arena
OCCUPIED, UNKNOWN, FREE = 0, 205, 254  # greys that map_saver writes
SHELL = 0.1  # metres into an obstacle that a LiDAR sees of it
SCENARIOS = 10

ROBOT = """\
robot:
  name: turtlebot3
  min_linear: 0.0
  max_linear: 0.5
  max_angular: 1.0
  deceleration: 1.0
  control_interval: 0.1
  footprint: {shape: point}
  lidar:
    field_of_view: 3.141592653589793
    rays: 180
    bins: 20
    minimum_range: 0.2
    maximum_range: 7.0
    noise: 0.01

clearance: {collision: 0.4, danger: 0.5}
"""


@dataclass(frozen=True)
class Place:
    """What a map is made of.

    Parameters
    ----------
    name, description : str
        Of the map.
    size : tuple of float
        Of the arena around the origin, in metres.
    obstacles : tuple of str
        One YAML flow mapping each.
    suffix : str
        Of the image of its map_server files.
    seed : int
        Of its scenarios.
    goal_distance : tuple of float
        Least and largest distance between start and goal, in metres.
    """

    name: str
    description: str
    size: tuple[float, float]
    obstacles: tuple[str, ...]
    suffix: str
    seed: int
    goal_distance: tuple[float, float] = (3.0, 8.0)


def box(name: str, x: float, y: float, length: float, width: float, yaw: float = 0.0) -> str:
    """Return a rectangle around (x, y)."""
    turn = f", yaw: {yaw:.3f}" if yaw else ""
    return f"{{name: {name}, shape: box, center: [{x:.3f}, {y:.3f}], size: [{length:g}, {width:g}]{turn}}}"


def circle(name: str, x: float, y: float, radius: float) -> str:
    """Return a disc."""
    return f"{{name: {name}, shape: circle, center: [{x:.3f}, {y:.3f}], radius: {radius:g}}}"


def wall(name: str, *points: tuple[float, float]) -> str:
    """Return a wall 0.12 m thick."""
    corners = ", ".join(f"[{x:g}, {y:g}]" for x, y in points)
    return f"{{name: {name}, shape: wall, thickness: 0.12, points: [{corners}]}}"


def office() -> Place:
    """Return an open-plan office with a meeting room, a kitchen, desks, and chairs where people left them."""
    rng = np.random.default_rng(1)
    shapes = [
        wall("meeting-south", (-8.0, 1.6), (-5.2, 1.6)),
        wall("meeting-door", (-3.7, 1.6), (-2.4, 1.6), (-2.4, 6.0)),
        wall("kitchen-west", (4.0, 6.0), (4.0, 4.4)),
        wall("kitchen-door", (4.0, 2.9), (4.0, 2.0), (8.0, 2.0)),
        box("meeting-table", -5.3, 4.0, 2.4, 1.1),
        box("counter", 6.9, 5.6, 2.0, 0.7),
        box("fridge", 7.6, 2.5, 0.7, 0.7),
        box("printer", 0.8, 5.6, 1.2, 0.6),
        box("sofa", -7.4, -3.4, 0.9, 2.0),
        circle("coffee-table", -5.9, -3.6, 0.35),
        circle("pillar-1", -2.2, -0.4, 0.25),
        circle("pillar-2", 3.0, -0.4, 0.25),
        circle("plant-1", -7.5, 0.9, 0.25),
        circle("plant-2", 7.5, -5.5, 0.3),
    ]
    for number, (x, y) in enumerate([(-2.8, -3.9), (0.6, -3.9), (4.0, -3.9), (6.6, -1.0), (0.6, 2.4)]):
        yaw = float(rng.normal(0.0, 0.04))
        shapes.append(box(f"desk-{number}", x, y, 1.6, 0.8, yaw))
        for side, dy in (("a", 0.8), ("b", -0.8)):
            if rng.random() < 0.75:
                dx, away = rng.uniform(-0.4, 0.4), dy + rng.uniform(-0.1, 0.15)
                shapes.append(circle(f"chair-{number}{side}", x + dx, y + away, 0.27))
    shapes.append(box("box-1", -4.6, -0.9, 0.4, 0.6, 0.5))
    shapes.append(
        "{name: bent-screen, shape: polygon, points: [[1.2, -1.5], [2.1, -1.9], [2.2, -1.8], [1.3, -1.35]]}"
    )
    about = "A cluttered office: two rooms with doors of 1.5 m, desks, chairs, pillars and plants"
    return Place("office", about, (16.0, 12.0), tuple(shapes), "png", 31)


def corridor() -> Place:
    """Return a corridor between six rooms, whose doors are 1.4 m wide."""
    shapes = []
    for side, y in (("north", 1.3), ("south", -1.3)):
        edges = [-10.0]
        for door in (-6.9, 0.3, 6.6) if y > 0.0 else (-6.3, -0.6, 7.2):
            shapes.append(wall(f"{side}-{len(edges)}", (edges[-1], y), (door - 0.7, y)))
            edges.append(door + 0.7)
        shapes.append(wall(f"{side}-{len(edges)}", (edges[-1], y), (10.0, y)))
        far = 4.5 if y > 0.0 else -4.5
        for number, x in enumerate((-3.4, 3.5)):
            shapes.append(wall(f"{side}-rooms-{number}", (x, y), (x, far)))
    shapes += [
        box("cupboard", -9.65, 3.4, 0.7, 1.8),
        box("bed", -5.0, 3.6, 1.0, 1.8),
        box("desk-1", 1.6, 4.0, 1.6, 0.8),
        box("desk-2", -2.2, 3.9, 1.6, 0.8),
        circle("chair", 1.5, 3.2, 0.25),
        box("shelf", 9.7, 3.2, 0.5, 2.0),
        box("table", 4.9, 3.5, 1.2, 0.8, 0.3),
        box("bench", -8.8, -4.1, 1.8, 0.5),
        circle("bin", -4.0, -4.0, 0.2),
        box("rack", 0.1, -4.2, 2.4, 0.5),
        circle("round-table", 5.2, -3.4, 0.45),
        box("trolley", 2.9, -0.85, 0.8, 0.5, 0.1),
        circle("extinguisher", -3.6, 1.1, 0.1),
    ]
    about = "A corridor of 2.5 m between six rooms, with doors of 1.4 m"
    return Place("corridor", about, (20.0, 9.0), tuple(shapes), "pgm", 32)


def warehouse() -> Place:
    """Return aisles between racks, pallets that stand askew, and pillars."""
    rng = np.random.default_rng(3)
    shapes = []
    for number, y in enumerate((5.0, 2.0, -1.0, -4.0)):
        for part, x in enumerate((-6.2, 1.8)):
            shapes.append(box(f"rack-{number}{part}", x, y, 6.0, 1.0))
    for number, x in enumerate((-2.2, 5.6)):
        shapes += [circle(f"pillar-{number}a", x, 3.5, 0.3), circle(f"pillar-{number}b", x, -2.5, 0.3)]
    for number in range(6):
        x, y = 8.0 + 2.0 * (number % 2), 5.6 - 2.6 * (number // 2)
        shapes.append(box(f"pallet-{number}", x, y, 1.2, 0.8, float(rng.uniform(-0.5, 0.5))))
    shapes += [
        box("fork-lift", 9.4, -3.6, 2.2, 1.1, 0.7),
        box("desk", -11.4, -6.6, 0.8, 1.6),
        box("loose-pallet", -4.4, -6.0, 1.2, 0.8, 0.35),
        wall("dock", (6.4, -8.0), (6.4, -6.2)),
        wall("office", (-12.0, -4.9), (-10.6, -4.9)),
    ]
    about = "A warehouse: racks with aisles of 2 m, pallets askew, pillars and a parked fork-lift"
    return Place("warehouse", about, (24.0, 16.0), tuple(shapes), "png", 33, (4.0, 10.0))


def generator_of(place: Place) -> str:
    """Return the YAML of a generator with two people who stand about."""
    half_x, half_y = 0.5 * place.size[0] - 0.5, 0.5 * place.size[1] - 0.5
    return "\n".join(
        [
            "# Random scenarios: two people stand about.",
            "generator:",
            f"  area: [{-half_x}, {-half_y}, {half_x}, {half_y}]",
            "  obstacles:",
            "    - {shape: circle, radius: 0.25}",
            "    - {shape: circle, radius: 0.25}",
            "  start_clearance: 0.6",
            "  goal_clearance: 0.6",
            f"  goal_distance: {list(place.goal_distance)}",
            "",
        ]
    )


def write_native(place: Place) -> None:
    """Write the native map of a place, with scenarios in which the goal can be reached."""
    path = FOLDER / f"{place.name}.yaml"
    head = "\n".join(
        [
            f"# {place.description}.",
            "# Written by maps/make_maps.py.",
            "# Lengths in metres, angles in radians; positions in the map frame, poses are x, y, theta.",
            "schema_version: 1",
            f"name: {place.name}",
            f"description: '{place.description}'",
            "",
            f"arena: {{shape: box, center: [0.0, 0.0], size: {list(place.size)}}}",
            "",
            "obstacles:",
            *(f"  - {shape}" for shape in place.obstacles),
            "",
            ROBOT,
            generator_of(place),
        ]
    )
    write(path, head)
    world = load_map(path)
    assert world.generator is not None
    drawn = (rounded(scenario, scenario.name) for scenario in world.generator.draw(4 * SCENARIOS, place.seed))
    lines = [
        f"# Drawn with seed {place.seed}; the goal can be reached at the danger clearance.",
        "scenarios:",
    ]
    number = 0
    for scenario in drawn:
        if number < SCENARIOS and is_passable(world, scenario):
            lines += lines_of(rounded(scenario, f"{place.name}-{number}"))
            number += 1
    write(path, head + "\n" + "\n".join(lines) + "\n")


def occupancy_image(world: WorldMap) -> tuple[np.ndarray, tuple[float, float]]:
    """Return greys as a mapping robot would save them, (H, W) with the top row first, and the lower left corner.

    A cell that touches an obstacle or the outside is occupied; what no LiDAR sees behind it is unknown.
    """
    blocked = Scenes.of(world, [None]).shapely(0, margin=MARGIN + 1.0)
    x_min, y_min, x_max, y_max = world.bounds
    left, low = round(x_min - MARGIN, 3), round(y_min - MARGIN, 3)
    columns = int(np.ceil((x_max + MARGIN - left) / RESOLUTION))
    rows = int(np.ceil((y_max + MARGIN - low) / RESOLUTION))
    x, y = left + RESOLUTION * np.arange(columns), low + RESOLUTION * np.arange(rows)[::-1, None]
    x, y = np.broadcast_arrays(x, y)
    cells = shapely.box(x, y, x + RESOLUTION, y + RESOLUTION)
    shapely.prepare(blocked)
    hidden = blocked.buffer(-SHELL, join_style="mitre")
    shapely.prepare(hidden)
    greys = np.full((rows, columns), FREE, np.uint8)
    greys[shapely.intersects(blocked, cells)] = OCCUPIED
    greys[shapely.contains_properly(hidden, cells)] = UNKNOWN
    return greys, (left, low)


def write_occupancy(name: str, suffix: str) -> None:
    """Write the map_server files of a native map, and a native map around them."""
    world, text = load_map(FOLDER / f"{name}.yaml"), (FOLDER / f"{name}.yaml").read_text(encoding="utf-8")
    greys, (left, low) = occupancy_image(world)
    Image.fromarray(greys).save(FOLDER / f"{name}.{suffix}")
    served = {
        "image": f"{name}.{suffix}",
        "mode": "trinary",
        "resolution": RESOLUTION,
        "origin": [left, low, 0.0],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
    }
    lines = ["# Written by maps/make_maps.py.", *(f"{key}: {value}" for key, value in served.items())]
    write(FOLDER / f"{name}.ros.yaml", "\n".join(lines) + "\n")
    head = [
        f"# The occupancy map of {name}.ros.yaml with the robot and the scenarios of {name}.yaml.",
        "# Written by maps/make_maps.py.",
        "schema_version: 1",
        f"name: {name}-grid",
        f"description: '{yaml.safe_load(text)['description']}, as an occupancy map'",
        f"occupancy: {name}.ros.yaml",
        "",
        "",
    ]
    write(FOLDER / f"{name}-grid.yaml", "\n".join(head) + text[text.index("robot:\n") :])
    load_map(FOLDER / f"{name}-grid.yaml")


def write(path: Path, text: str) -> None:
    """Write a text file that is the same on every system."""
    path.write_text(text, encoding="utf-8", newline="\n")


def main() -> None:
    """Write all maps; maps/lab.yaml has to be there."""
    for place in (office(), corridor(), warehouse()):
        write_native(place)
        write_occupancy(place.name, place.suffix)
    write_occupancy("lab", "pgm")


if __name__ == "__main__":
    main()
