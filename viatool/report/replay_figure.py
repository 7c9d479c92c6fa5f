"""Counterexamples that were run again, as a picture: one panel for each of the closest."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from viatool.arrays import Floats
from viatool.errors import ConfigurationError
from viatool.report.drawing import FLOOR, INK, WALL, draw_region
from viatool.report.files import replacing
from viatool.report.foreign import one_line
from viatool.report.palette import COLOUR
from viatool.report.replay_summary import state_of

if TYPE_CHECKING:
    from shapely.geometry.base import BaseGeometry

    from viatool.verification.witness_file import Replay, WitnessFile
    from viatool.world import WorldMap

SUFFIXES = (".png", ".svg", ".pdf")
PANELS, COLUMNS = 12, 4
_ARC = 64  # segments of a quarter of a circle


def check_replay_figure(path: Path) -> None:
    """Refuse a path that does not end in the suffix of a picture."""
    if path.suffix.lower() not in SUFFIXES:
        raise ConfigurationError(f"'{path}' ends in '{path.suffix}'", f"end it in {' or '.join(SUFFIXES)}")


def write_replay_figure(path: Path, world_map: WorldMap, file: WitnessFile, found: Replay) -> None:
    """Write the picture of a replay as png, svg or pdf."""
    check_replay_figure(path)
    with replacing(path) as draft:
        draw_replay(world_map, file, found).savefig(draft, dpi=160)


def draw_replay(world_map: WorldMap, file: WitnessFile, found: Replay) -> Figure:
    """Draw the counterexamples with the smallest clearance, at most `PANELS`."""
    chosen = np.argsort(found.clearance, kind="stable")[:PANELS]
    columns = min(max(len(chosen), 2), COLUMNS)
    rows = max(-(-len(chosen) // columns), 1)
    figure = Figure(figsize=(3.4 * columns, 3.8 * rows + 0.8), layout="constrained")
    grid = figure.add_gridspec(rows, columns)
    judged = file.judged(world_map)
    paths = judged.paths(found.actions[:, None], np.linspace(0.0, 1.0, 17))[:, 0]
    tracks = paths.reshape(len(paths), -1, 17, 3) if judged.motion is not None else paths[:, None]
    for place, row in enumerate(chosen.tolist()):
        axes = figure.add_subplot(grid[divmod(place, columns)])
        _draw_one(axes, _blocked(world_map, file, found.poses[row], row), tracks[row], file, found, row)
    figure.legend(handles=_legend(), loc="outside lower center", ncols=2, fontsize=9, frameon=False)
    return figure


def _draw_one(
    axes: Axes, blocked: BaseGeometry, tracks: Floats, file: WitnessFile, found: Replay, row: int
) -> None:
    """Draw the paths (R, T, 3) of one, and what has to be free where it comes nearest."""
    collision, pose = file.rules.clearance.collision, found.poses[row]
    verdict = "unsafe" if found.violates[row] else "safe"
    needed = _outline(file, pose).buffer(collision / np.cos(np.pi / (4 * _ARC)), quad_segs=_ARC)
    draw_region(axes, blocked, facecolor=WALL, edgecolor=INK, alpha=1.0, zorder=1)
    draw_region(axes, needed, facecolor=COLOUR[verdict], edgecolor=COLOUR[verdict], alpha=0.3, zorder=2)
    draw_region(axes, needed.intersection(blocked), facecolor=INK, alpha=0.6, zorder=3)
    for track in tracks:
        axes.plot(*track[:, :2].T, color=INK, lw=1.2, zorder=4)
    x, y, heading = file.poses[row]
    marker = (3, 0, float(np.degrees(heading)) - 90.0)
    axes.plot(x, y, marker=marker, ms=8, mfc="white", mec=INK, mew=1.0, ls="", zorder=6)
    axes.plot(*pose[:2], marker="x", ms=6, color=COLOUR[verdict], ls="", zorder=7)
    half = 1.6 * (collision + file.rules.footprint.reach) + float(np.abs(tracks[..., :2] - pose[:2]).max())
    axes.set(xlim=(pose[0] - half, pose[0] + half), ylim=(pose[1] - half, pose[1] + half), aspect="equal")
    axes.set(facecolor=FLOOR, xticks=[], yticks=[])
    state = one_line(state_of(file.entries[row], row))
    title = f"state {state}: {found.clearance[row]:.4f} m left after {found.seconds[row]:.3f} s"
    axes.set_title(f"{title}\n{found.nearest[row]}".replace("$", r"\$"), fontsize=7, color=INK)


def _blocked(world_map: WorldMap, file: WitnessFile, pose: Floats, row: int) -> BaseGeometry:
    """Return what is not free around a pose; of a grid only the cells nearby, for it may have millions."""
    from viatool.world import Scenes

    grid = world_map.obstacles.grid
    if grid is not None:
        reach = 3.0 * (file.rules.clearance.collision + file.rules.footprint.reach + 1.0)
        (x, y, yaw), (rows, columns) = grid.origin, grid.cells.shape
        middle = complex(pose[0] - x, pose[1] - y) * np.exp(-1j * yaw) / grid.resolution
        size = int(np.ceil(reach / grid.resolution))
        left, low = (
            int(np.clip(at, 0, most - 1))
            for at, most in ((middle.real - size, columns), (middle.imag - size, rows))
        )
        corner = grid.to_map(np.array([left, low], dtype=np.float64))
        near = replace(
            grid,
            cells=grid.cells[low : low + 2 * size + 1, left : left + 2 * size + 1],
            origin=(float(corner[0]), float(corner[1]), yaw),
        )
        world_map = replace(world_map, obstacles=replace(world_map.obstacles, grid=near))
    return Scenes.of(world_map, [file.scenarios[row]]).shapely(0)


def _outline(file: WitnessFile, pose: Floats) -> BaseGeometry:
    """Return the footprint at a pose; a disc circumscribed."""
    import shapely

    footprint = file.rules.footprint
    if footprint.kind != "polygon":
        centre = shapely.Point(pose[0], pose[1])
        if footprint.radius == 0.0:
            return centre
        return centre.buffer(footprint.radius / np.cos(np.pi / (4 * _ARC)), quad_segs=_ARC)
    cosine, sine = np.cos(pose[2]), np.sin(pose[2])
    return shapely.Polygon(footprint.polygon @ np.array([[cosine, sine], [-sine, cosine]]) + pose[:2])


def _legend() -> list[Line2D | Patch]:
    return [
        Line2D([], [], marker="^", mfc="white", mec=INK, color=INK, label="pose of the state and path"),
        Line2D([], [], marker="x", color=COLOUR["unsafe"], ls="", label="closest approach"),
        Patch(facecolor=COLOUR["unsafe"], alpha=0.3, label="must be free there"),
        Patch(facecolor=INK, alpha=0.6, label="is not"),
    ]
