"""The map and the obstacles of each episode, read anew, and how far probes are from all of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import shapely
import yaml
from numpy.typing import NDArray

from viatool.recheck.evidence import StoredEvidence

Floats = NDArray[np.float64]
GRID = "grid.npz"


def read_map(evidence: StoredEvidence) -> dict[str, Any]:
    """Return the copy of the map as it stands; of a map_server map alone nothing but its grid counts."""
    content = yaml.safe_load(evidence.copies("map")[0].read_text(encoding="utf-8"))
    return content if isinstance(content, dict) else {}


def solids(shapes: Sequence[Mapping[str, Any]]) -> tuple[Floats, list[shapely.Polygon]]:
    """Return obstacles of a map file as circles (K, 3) and polygons."""
    circles, polygons = [], []
    for shape in shapes:
        if shape["shape"] == "circle":
            circles.append([*map(float, shape["center"]), float(shape["radius"])])
        elif shape["shape"] == "wall":
            polygons += _wall(
                [np.array(point, dtype=float) for point in shape["points"]], shape.get("thickness", 0.1)
            )
        else:
            polygons.append(outline(shape))
    return np.array(circles, dtype=float).reshape(-1, 3), polygons


def outline(shape: Mapping[str, Any]) -> shapely.Polygon:
    """Return a box or a polygon of a map file."""
    if shape["shape"] == "polygon":
        return shapely.Polygon([[float(x), float(y)] for x, y in shape["points"]])
    if shape["shape"] != "box":
        raise ValueError(f"shape '{shape['shape']}' is not known")
    return _box(np.array(shape["center"], dtype=float), shape["size"], float(shape.get("yaw", 0.0)))


def _box(center: Floats, size: Sequence[Any], yaw: float) -> shapely.Polygon:
    corners = 0.5 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * np.array(size, dtype=float)
    turn = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    return shapely.Polygon(center + corners @ turn.T)


def _wall(points: list[Floats], thickness: Any) -> list[shapely.Polygon]:
    """Return a box for each segment, longer by half of the thickness at both ends."""
    boxes, thick = [], float(thickness)
    for first, second in pairwise(points):
        along = second - first
        length = float(np.hypot(*along))
        if length > 0.0:
            boxes.append(
                _box(0.5 * (first + second), (length + thick, thick), float(np.arctan2(along[1], along[0])))
            )
    return boxes


class Scene:
    """What surrounds one robot: an arena, polygons and circles.

    Parameters
    ----------
    arenas : sequence of Polygon
        It has to be inside of all of them.
    tree : STRtree
        Their rims, the polygons of the map, and those of the episode.
    circles : ndarray
        (K, 3) x, y and radius.
    """

    def __init__(
        self, arenas: Sequence[shapely.Polygon], trees: Sequence[shapely.STRtree], circles: Floats
    ) -> None:
        self._arenas, self._trees, self._circles = arenas, trees, circles
        bounds = np.abs([arena.bounds for arena in arenas])
        self.scale = 1.0 + float(bounds.max())

    def distances(self, probes: NDArray[Any], inside: Floats) -> Floats:
        """Return how far probes (C,) are from what is nearest; -inf where `inside` (C, 2), a point of each, is not."""
        found = np.full(len(probes), np.inf)
        for tree in self._trees:
            (rows, _), apart = tree.query_nearest(probes, return_distance=True, all_matches=False)
            nearest = np.full(len(probes), -np.inf)  # where nothing is told
            nearest[rows] = apart
            found = np.minimum(found, nearest)
        for x, y, radius in self._circles:
            found = np.minimum(found, shapely.distance(probes, shapely.Point(x, y)) - radius)
        for arena in self._arenas:
            found[~shapely.contains_xy(arena, inside[:, 0], inside[:, 1])] = -np.inf
        return found


class EpisodeScenes:
    """The scenes of all episodes."""

    def __init__(self, evidence: StoredEvidence) -> None:
        content = read_map(evidence)
        self._circles, polygons = solids(content.get("obstacles") or [])
        self._arenas: list[shapely.Polygon] = []
        blocked: list[shapely.Polygon] = []
        if (evidence.folder / GRID).is_file():
            rim, blocked = _grid(evidence)
            self._arenas.append(rim)
        if content.get("arena") is not None:
            self._arenas.append(outline(content["arena"]))
        shared = [*(arena.exterior for arena in self._arenas), *polygons, *blocked]
        self._tree, self._scenarios = shapely.STRtree(shared), evidence.scenarios
        self._known: dict[int, Scene] = {}

    def of(self, episode: int) -> Scene:
        """Return the scene of an episode."""
        if episode not in self._known:
            scenario = self._scenarios[episode] or {"circles": [], "polygons": []}
            own = [shapely.Polygon(ring) for ring in scenario["polygons"]]
            trees = [self._tree, shapely.STRtree(own)] if own else [self._tree]
            circles = np.concatenate(
                [self._circles, np.array(scenario["circles"], dtype=float).reshape(-1, 3)]
            )
            self._known[episode] = Scene(self._arenas, trees, circles)
        return self._known[episode]


def _grid(evidence: StoredEvidence) -> tuple[shapely.Polygon, list[shapely.Polygon]]:
    """Return the rim of an occupancy grid, and what is blocked: a rectangle for each run of cells in a row."""
    with np.load(evidence.folder / GRID, allow_pickle=False) as stored:
        blocked, side, (x, y, yaw) = stored["blocked"], float(stored["resolution"]), stored["origin"]
    turn = side * np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    rows, columns = blocked.shape
    edges = np.diff(np.pad(blocked.astype(np.int8), ((0, 0), (1, 1))), axis=1)
    (row, first), (_, last) = np.nonzero(edges == 1), np.nonzero(edges == -1)
    spans = np.concatenate([[[0, columns, 0, rows]], np.column_stack([first, last, row, row + 1])]).astype(
        float
    )
    corners = np.stack([spans[:, [0, 1, 1, 0]], spans[:, [2, 2, 3, 3]]], axis=-1)
    rim, *others = shapely.polygons(np.array([x, y]) + corners @ turn.T)
    return rim, others
