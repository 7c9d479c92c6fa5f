"""Write maps/lab.yaml, the paper's arena with its ten fixed evaluation scenarios, and the harder clutter.yaml.

    python maps/make_lab.py

The scenarios are drawn with a fixed seed, rounded to millimetres, and kept only if a robot can get from the
start to the goal with the danger clearance all the way: a timeout or a collision is then the policy's fault.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import shapely

from viatool.world import Obstacles, Scenario, Scenes, WorldMap, load_map

SEED = 20
SCENARIOS = 10
GOAL_SEPARATION = 1.8
GOAL_DISTANCE = (4.0, 8.0)


@dataclasses.dataclass(frozen=True)
class Arena:
    """A walled arena, and what is drawn at random in it."""

    name: str
    title: str
    description: str
    radii: tuple[float, ...]  # of the random obstacles
    obstacle_separation: float
    start_separation: float
    goal_separation: float
    scenario_goal_separation: float  # in the fixed scenarios


ARENAS = (
    Arena(
        name="lab",
        title="The paper's lab: a 10 m x 10 m walled arena with four fixed and four random cylinders.",
        description="The arena of the paper, with the ten fixed scenarios on which policies are evaluated",
        radii=(0.5, 0.25, 0.21, 0.75),
        obstacle_separation=1.8,
        start_separation=1.8,
        goal_separation=1.2,
        scenario_goal_separation=1.8,
    ),
    Arena(
        name="clutter",
        title="The lab with ten small random cylinders instead of four: short ways lead close past them.",
        description="A harder arena, in which a limit on the cost is felt: the short ways lead close past obstacles",
        radii=(0.3, 0.3, 0.25, 0.25, 0.2, 0.2, 0.2, 0.15, 0.15, 0.15),
        obstacle_separation=1.4,
        start_separation=1.2,
        goal_separation=1.1,
        scenario_goal_separation=1.2,
    ),
)

HEAD = """\
# {title}
# Written by maps/make_lab.py.
# Lengths in metres, angles in radians; positions in the map frame, poses are x, y, theta.
schema_version: 1
name: {name}
description: {quoted}

# Inner faces of the walls.
arena: {{shape: box, center: [0.0, 0.0], size: [9.7, 9.7]}}

obstacles:
  - {{name: fixed-1, shape: circle, center: [-2.93, 3.17], radius: 0.26}}
  - {{name: fixed-2, shape: circle, center: [2.86, -3.0], radius: 0.56}}
  - {{name: fixed-3, shape: circle, center: [-2.77, -0.96], radius: 0.14}}
  - {{name: fixed-4, shape: circle, center: [2.83, 2.93], radius: 0.98}}

robot:
  name: turtlebot3
  min_linear: 0.0
  max_linear: 0.5
  max_angular: 1.0
  deceleration: 1.0
  control_interval: 0.1
  footprint: {{shape: point}}
  lidar:
    field_of_view: 3.141592653589793
    rays: 180
    bins: 20
    minimum_range: 0.2
    maximum_range: 7.0
    noise: 0.01

clearance: {{collision: 0.4, danger: 0.5}}

# Random scenarios, as the paper trains on them; separations are between centres.
generator:
  area: [-4.0, -4.0, 4.0, 4.0]
  obstacles:
{obstacles}
  obstacle_separation: {obstacle_separation}
  start_separation: {start_separation}
  goal_separation: {goal_separation}
"""


def head_of(arena: Arena) -> str:
    """Return everything but the scenarios."""
    obstacles = "\n".join(f"    - {{shape: circle, radius: {radius}}}" for radius in arena.radii)
    quoted = f"'{arena.description}'" if ":" in arena.description else arena.description
    return HEAD.format(**dataclasses.asdict(arena), obstacles=obstacles, quoted=quoted)


def is_passable(world: WorldMap, scenario: Scenario) -> bool:
    """Tell whether start and goal lie in one piece of the space that keeps the danger clearance."""
    blocked = Scenes.of(world, [scenario]).shapely(0)
    x_min, y_min, x_max, y_max = world.bounds
    free = shapely.box(x_min, y_min, x_max, y_max).difference(blocked.buffer(world.clearance.danger))
    ends = shapely.MultiPoint([scenario.start[:2], scenario.goal])
    return any(piece.covers(ends) for piece in shapely.get_parts(free))


def rounded(scenario: Scenario, name: str) -> Scenario:
    """Return the scenario in millimetres and milliradians."""
    x, y, theta = (round(value, 3) for value in scenario.start)
    goal_x, goal_y = (round(value, 3) for value in scenario.goal)
    circles = np.round(scenario.obstacles.circles, 3)
    return Scenario(name, (x, y, theta), (goal_x, goal_y), Obstacles(circles))


def lines_of(scenario: Scenario) -> list[str]:
    """Return the YAML of one scenario."""
    lines = [
        f"  - name: {scenario.name}",
        f"    start: {list(scenario.start)}",
        f"    goal: {list(scenario.goal)}",
        "    obstacles:",
    ]
    for x, y, radius in scenario.obstacles.circles.tolist():
        lines.append(f"      - {{shape: circle, center: [{x}, {y}], radius: {radius}}}")
    return lines


def write(arena: Arena) -> None:
    """Write the map of an arena."""
    place = Path(__file__).with_name(f"{arena.name}.yaml")
    head = head_of(arena)
    place.write_text(head, encoding="utf-8", newline="\n")
    world = load_map(place)
    assert world.generator is not None
    strict = dataclasses.replace(
        world.generator, goal_separation=arena.scenario_goal_separation, goal_distance=GOAL_DISTANCE
    )
    drawn = (
        rounded(scenario, f"{arena.name}-{index}")
        for index, scenario in enumerate(strict.draw(10 * SCENARIOS, SEED))
    )
    kept = [scenario for scenario in drawn if is_passable(world, scenario)][:SCENARIOS]
    named = [
        dataclasses.replace(scenario, name=f"{arena.name}-{index}") for index, scenario in enumerate(kept)
    ]
    lines = [
        "",
        f"# Drawn with seed {SEED}; goals at least {arena.scenario_goal_separation} m from every obstacle's "
        "centre, 4 to 8 m from the start.",
        "scenarios:",
    ]
    for scenario in named:
        lines += lines_of(scenario)
    place.write_text(head + "\n".join(lines) + "\n", encoding="utf-8", newline="\n")
    load_map(place)


def main() -> None:
    """Write all arenas."""
    for arena in ARENAS:
        write(arena)


if __name__ == "__main__":
    main()
