"""Short console summaries of what is not a result: a map, reachable sets."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from viatool.report.foreign import shown
from viatool.report.numbers import count, counted, significant

if TYPE_CHECKING:
    from viatool.policy import Policy
    from viatool.taylor import ReachableSet, SymbolicAction
    from viatool.world import WorldMap

ROWS_SHOWN = 20
_KINDS = ("free", "occupied", "unknown")  # in the order of `viatool.world.Cell`


def print_facts(title: str, facts: Iterable[tuple[str, str]], console: Console) -> None:
    """Print a title and, below it, names with their values."""
    table = Table.grid(padding=(0, 2))
    for name, value in facts:
        table.add_row(Text(f"  {shown(name)}", style="dim"), Text(shown(value)))
    console.print(Text(shown(title), style="bold"))
    console.print(table)


def print_map(world_map: WorldMap, console: Console) -> None:
    """Summarise a map: arena, obstacles, robot, clearances and scenarios."""
    x_min, y_min, x_max, y_max = world_map.bounds
    obstacles, robot, lidar = world_map.obstacles, world_map.robot, world_map.robot.lidar
    footprint = robot.footprint
    outline = {
        "point": "point (the LiDAR origin)",
        "circle": f"disc of radius {significant(footprint.radius)} m",
        "polygon": f"polygon of {len(footprint.polygon)} corners within {significant(footprint.reach)} m",
    }[footprint.kind]
    generator = "none" if world_map.generator is None else "draws any number of further scenarios"
    facts = [
        ("arena", f"x {x_min:g} to {x_max:g} m, y {y_min:g} to {y_max:g} m, {len(world_map.arena)} corners"),
        (
            "obstacles",
            f"{counted(len(obstacles.circles), 'circle')}, {counted(len(obstacles.polygons), 'polygon')}",
        ),
        *_occupancy_facts(world_map),
        (
            "clearance",
            f"collision {world_map.clearance.collision:g} m, danger {world_map.clearance.danger:g} m",
        ),
        ("robot", f"{robot.name}, footprint {outline}"),
        (
            "commands",
            f"{robot.speeds}, every {robot.control_interval:g} s",
        ),
        (
            "LiDAR",
            f"{lidar.rays} rays in {lidar.bins} bins over {np.degrees(np.ptp(lidar.angles())):g} degrees, "
            f"{lidar.minimum_range:g} to {lidar.maximum_range:g} m, noise {lidar.noise:g} m",
        ),
        ("scenarios", f"{count(len(world_map.scenarios))} fixed{_freedom(world_map)}"),
        ("generator", generator),
        ("sha256", world_map.sha256),
    ]
    print_facts(f"{world_map.name} ({world_map.path})", facts, console)


def _occupancy_facts(world_map: WorldMap) -> list[tuple[str, str]]:
    """Return what the cells of an occupancy map hold; nothing for a map without one."""
    grid = world_map.obstacles.grid
    if grid is None:
        return []
    rows, columns = grid.cells.shape
    x, y, yaw = grid.origin
    numbers = np.bincount(grid.cells.ravel(), minlength=3).tolist()
    shares = [
        f"{100.0 * number / grid.cells.size:.1f} % {kind}"
        for kind, number in zip(_KINDS, numbers, strict=True)
    ]
    taken = "free" if grid.unknown_is_free else "obstacles"
    return [
        (
            "cells",
            f"{count(columns)} x {count(rows)} of {grid.resolution:g} m, lower left at {x:g}, {y:g}, {yaw:g} rad",
        ),
        ("", f"{', '.join(shares)}; unknown cells count as {taken}"),
    ]


def _freedom(world_map: WorldMap) -> str:
    """Say how near starts and goals are to what is not free."""
    from viatool.world import Scenes

    if not world_map.scenarios:
        return ""
    scenes, index = Scenes.of(world_map, world_map.scenarios), np.arange(len(world_map.scenarios))
    starts = np.array([scenario.start for scenario in world_map.scenarios])
    goals = np.array([scenario.goal for scenario in world_map.scenarios])
    start = scenes.footprint_clearance(starts, world_map.robot.footprint, index).min()
    goal = scenes.clearance(goals, index).min()
    return f"; starts at least {start:.2f} m and goals at least {goal:.2f} m from obstacles"


ROUNDING_WORTH_A_WORD = 0.25
"""Share of the widths from which on a person is told that it is the rounding of the program."""


def print_bounds(policy: Policy, reachable: ReachableSet, console: Console) -> None:
    """Print the reachable set of each observation, or of the first ones, and the widths over all."""
    names = _output_names(policy)
    table = Table(box=box.SIMPLE_HEAD, show_edge=False)
    table.add_column("observation", justify="right")
    for name in names:
        table.add_column(Text(shown(name)), justify="right")
    for row, (lower, upper) in enumerate(
        zip(reachable.lower[:ROWS_SHOWN], reachable.upper[:ROWS_SHOWN], strict=True)
    ):
        ends = [f"{low:.6f} to {high:.6f}" for low, high in zip(lower, upper, strict=True)]
        if reachable.possible is not None:
            ends = [_said(end, can) for end, can in zip(ends, reachable.possible[row].tolist(), strict=True)]
        table.add_row(str(row), *ends)
    console.print(table)
    if len(reachable.lower) > ROWS_SHOWN:
        console.print(
            f"and {count(len(reachable.lower) - ROWS_SHOWN)} more; --output FILE writes all of them"
        )
    width, attained = reachable.width, reachable.attained_width
    for name, mean, largest, found in zip(
        names, width.mean(axis=0), width.max(axis=0), attained.mean(axis=0), strict=True
    ):
        console.print(
            Text(
                f"width of {shown(name)}: mean {significant(mean)}, max {significant(largest)}; "
                f"attained inside the boxes: mean {significant(found)}"
            )
        )
    share = 2 * reachable.deviation.sum() / width.sum() if width.any() else 0.0
    if share > ROUNDING_WORTH_A_WORD:
        narrow = any(node.precision in ("bfloat16", "float16") for node in policy.network.nodes)
        remedy = "; exported in float32 it would round less" if narrow else ""
        console.print(
            f"{share:.0%} of these widths is what the program may round{remedy} (--arithmetic real leaves it out)"
        )


def _output_names(policy: Policy) -> list[str]:
    """Return what the outputs are called: actions, or the values of a choice's commands."""
    if policy.spec is None:
        return [f"action {i}" for i in range(policy.output_size)]
    if policy.spec.choice is not None:
        return [f"{policy.spec.choice.name} {i}" for i in range(policy.output_size)]
    return [f"{action.name} [{action.unit}]" for action in policy.spec.action]


def _said(ends: str, possible: bool) -> str:
    return f"{ends}, {'possible' if possible else 'excluded'}"


def print_symbolic(actions: Sequence[SymbolicAction], console: Console) -> None:
    """Print actions as polynomials of the sensor errors, and which error moves each action most."""
    import sympy

    for action in actions:
        terms = sympy.Add.make_args(sympy.expand(action.polynomial))
        ordered = sorted(
            terms, key=lambda term: (sympy.Poly(term).total_degree() if term.free_symbols else 0, str(term))
        )
        text = " + ".join(f"{term.evalf(6)}" for term in ordered).replace("+ -", "- ")
        console.print(Text(f"\n{shown(action.name)} [{shown(action.unit)}] ="), highlight=False)
        console.print(Text(f"  {text} +- {action.remainder:.3g}"), highlight=False)
        for entry, effect in list(action.effect.items())[:ROWS_SHOWN]:
            console.print(Text(f"    {shown(entry)} moves it by up to {effect:.3g}"), highlight=False)
