"""Pictures of driving: the paths of all seeds of a variant in one scenario, with the tubes of what was reachable."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from viatool.report.drawing import FLOOR, INK, WALL, draw_region, swept_regions
from viatool.studies.curves import COLOUR, to_png
from viatool.studies.variants import EVERY, VARIANTS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from viatool.world import Scenario, WorldMap

Episode = Mapping[str, Any]

LOOKAHEAD = 1.0  # seconds for which every reachable command is followed in the picture
_COLUMNS = 3
_MARK = {"success": "", "collision": "X", "timeout": "s"}


def hardest_scenario(evaluations: Sequence[Mapping[str, Any]]) -> int:
    """Return the fixed scenario that the fewest policies master; among equals the one with the longest detours."""
    failed = np.array([[one["outcome"] != "success" for one in found["paths"]] for found in evaluations])
    detour = np.array([[_detour(one["states"]) for one in found["paths"]] for found in evaluations])
    return int(np.lexsort((detour.mean(axis=0), failed.sum(axis=0)))[-1])


def thinned(episode: Episode) -> dict[str, Any]:
    """Return an episode with every second state and the last one, which is enough to draw it."""
    states = episode["states"]
    kept = sorted({*range(0, len(states), 2), len(states) - 1})
    return {"outcome": episode["outcome"], "states": [states[index] for index in kept]}


def _detour(states: Sequence[Sequence[float]]) -> float:
    points = np.array(states, dtype=np.float64)[:, :2]
    driven = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    return driven / max(float(np.linalg.norm(points[-1] - points[0])), 0.5)


def scene_of(world_map: WorldMap, scenario: Scenario) -> dict[str, Any]:
    """Return what a picture shows besides paths, as JSON values."""
    obstacles = [world_map.obstacles, scenario.obstacles]
    return {
        "name": scenario.name,
        "start": list(scenario.start),
        "goal": list(scenario.goal),
        "arena": np.asarray(world_map.arena).tolist(),
        "circles": [list(map(float, circle)) for part in obstacles for circle in part.circles],
        "polygons": [np.asarray(polygon).tolist() for part in obstacles for polygon in part.polygons],
        "danger": world_map.clearance.danger,
    }


def draw_paths(scene: Mapping[str, Any], paths: Mapping[str, Sequence[Episode]]) -> bytes:
    """Draw a panel for each variant."""
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    variants = [variant for variant in EVERY if variant.name in paths]
    rows = -(-len(variants) // _COLUMNS)
    figure = Figure(figsize=(4.0 * _COLUMNS, 4.25 * rows + 0.3), layout="constrained", facecolor="white")
    for place, variant in enumerate(variants):
        axes = figure.add_subplot(rows, _COLUMNS, place + 1)
        _draw_scene(axes, scene)
        for episode in paths[variant.name]:
            _draw_episode(axes, episode, COLOUR[variant.name])
        reached = sum(episode["outcome"] == "success" for episode in paths[variant.name])
        title = f"{VARIANTS[variant.name].title}: {reached} of {len(paths[variant.name])} reach the goal"
        axes.set_title(title, fontsize=9, color=INK, loc="left", pad=3)
    legend = [
        Line2D([], [], color=INK, lw=1.0, label="driven path of a seed"),
        Patch(facecolor=INK, alpha=0.3, label=f"where all reachable commands lead within {LOOKAHEAD:g} s"),
        Line2D([], [], color=WALL, lw=0.9, ls=(0, (2, 2)), label="danger distance"),
        Line2D([], [], marker="X", color="#C00000", ls="", label="collision"),
        Line2D([], [], marker="s", color="#C00000", ls="", label="timeout"),
    ]
    figure.legend(handles=legend, loc="outside lower center", ncols=5, fontsize=8, frameon=False)
    return to_png(figure)


def _draw_scene(axes: Axes, scene: Mapping[str, Any]) -> None:
    from matplotlib.patches import Circle, Polygon

    arena = np.array(scene["arena"])
    axes.set_facecolor(WALL)
    axes.add_patch(Polygon(arena, closed=True, facecolor=FLOOR, edgecolor=INK, lw=0.8))
    for x, y, radius in scene["circles"]:
        axes.add_patch(Circle((x, y), radius, facecolor=WALL, edgecolor=INK, lw=0.6, zorder=2))
        ring = Circle(
            (x, y), radius + scene["danger"], facecolor="none", edgecolor=WALL, lw=0.8, ls=(0, (2, 2))
        )
        axes.add_patch(ring)
    for polygon in scene["polygons"]:
        axes.add_patch(Polygon(polygon, closed=True, facecolor=WALL, edgecolor=INK, lw=0.6, zorder=2))
    x, y, heading = scene["start"]
    axes.plot(x, y, marker=(3, 0, np.degrees(heading) - 90.0), ms=8, mfc="white", mec=INK, ls="", zorder=6)
    axes.plot(*scene["goal"], marker="*", ms=11, mfc="#F0E442", mec=INK, mew=0.7, ls="", zorder=6)
    low, high = arena.min(axis=0) - 0.15, arena.max(axis=0) + 0.15
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", xticks=[], yticks=[])
    for spine in axes.spines.values():
        spine.set_visible(False)


def _draw_episode(axes: Axes, episode: Episode, colour: str) -> None:
    import shapely

    states = np.array(episode["states"], dtype=np.float64)
    tube = shapely.union_all(swept_regions(states[:, :3], states[:, 3:5], states[:, 5:7], LOOKAHEAD))
    draw_region(axes, tube, facecolor=colour, alpha=0.3, zorder=3.0)
    axes.plot(*states[:, :2].T, color=INK, lw=0.9, zorder=4)
    mark = _MARK[episode["outcome"]]
    if mark:
        axes.plot(*states[-1, :2], marker=mark, color="#C00000", ms=7, ls="", zorder=7)
