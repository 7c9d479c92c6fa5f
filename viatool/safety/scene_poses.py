"""Where states stand: their poses, each within the obstacles of its own episode, and among what moves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Booleans, Floats, Indices, Plane
from viatool.world import Capsules, Footprint, Nearest, Obstacles, Scenario, Scenes, WorldMap
from viatool.world.measurement import as_plane


@dataclass(frozen=True, eq=False)
class Movers:
    """Things that move around B states.

    Parameters
    ----------
    capsules : Capsules
        Around each of S places.
    index : ndarray
        (B,) the place of each state.
    """

    capsules: Capsules
    index: Indices

    def select(self, which: NDArray[Any]) -> Movers:
        """Return those of some of the states."""
        return Movers(self.capsules, self.index[which])


@dataclass(frozen=True, eq=False)
class ScenePoses:
    """B poses, each in a scene of its own episode, or boxes of poses.

    Distances are taken after some time since the observation, (B,) seconds, for which what moves has moved as the robot
    likes it least; of several times there are several answers. Without movers they all are the same.

    Parameters
    ----------
    poses : ndarray
        (B, 3) x, y, theta in the map frame; metres and radians.
    scene : ndarray
        (B,) index of each pose's scene in `still`.
    still : Scenes
        Obstacles and arena of every scene; what moves as well, where it was when it was observed.
    scale : float
        A bound of every coordinate and radius of the geometry, in metres, at least 1.
    radii : ndarray, optional
        (B, 3) half-widths of boxes of poses around the given ones; None for the poses alone.
    movers : tuple of Movers
        What may be elsewhere.
    """

    poses: Floats
    scene: Indices
    still: Scenes
    scale: float
    radii: Floats | None = None
    movers: tuple[Movers, ...] = ()

    @classmethod
    def of(
        cls,
        world_map: WorldMap,
        scenarios: Sequence[Scenario | None],
        poses: Floats,
        scene: Indices,
    ) -> ScenePoses:
        """Return poses within the map and the obstacles of their scenarios."""
        own = [scenario.obstacles for scenario in scenarios if scenario is not None]
        extents = [np.abs(world_map.arena).max(), *map(_extent, [world_map.obstacles, *own])]
        return cls(poses, scene, Scenes.of(world_map, scenarios), 1.0 + float(max(extents)))

    def __len__(self) -> int:
        """Return the number of poses."""
        return len(self.poses)

    @property
    def extent(self) -> Floats | float:
        """Return how far any place of a box is from its middle at most, (B,) metres; 0 for poses alone."""
        return 0.0 if self.radii is None else np.hypot(self.radii[:, 0], self.radii[:, 1])

    def among(self, movers: Sequence[Movers]) -> ScenePoses:
        """Return the same states among things that move as well."""
        scale = max([self.scale, *(1.0 + some.capsules.extent for some in movers)])
        return replace(self, movers=(*self.movers, *movers), scale=scale)

    def among_near(self, limit: Floats, seconds: Floats) -> ScenePoses:
        """Return the same states among what may come within distances (B,) of them until some times (B,) alone."""
        each, points = np.arange(len(self)), as_plane(self.poses)
        near = (some.capsules.within(points, some.index, seconds, limit) for some in self.movers)
        return replace(self, movers=tuple(Movers(few, each) for few in near if len(few)))

    @property
    def met(self) -> Booleans:
        """Tell which states anything moves around, (B,)."""
        there = [some.capsules.there(some.index) for some in self.movers]
        return np.asarray(np.any([np.zeros(len(self), dtype=bool), *there], axis=0))

    def select(self, which: NDArray[Any]) -> ScenePoses:
        """Return some of the states, by index (repeated at will) or mask."""
        radii = None if self.radii is None else self.radii[which]
        movers = tuple(some.select(which) for some in self.movers)
        return replace(self, poses=self.poses[which], scene=self.scene[which], radii=radii, movers=movers)

    def throughout(self, poses: Floats, radii: Floats | None = None) -> ScenePoses:
        """Return other poses (B, 3), or boxes around them, all of them in the first scene, among what moves there."""
        first = np.zeros(len(poses), np.int64)
        movers = tuple(Movers(some.capsules, first) for some in self.movers)
        return replace(self, poses=poses, scene=first, radii=radii, movers=movers)

    def moved(self, poses: Floats) -> ScenePoses:
        """Return the same states at other poses (B, 3)."""
        return replace(self, poses=poses)

    @property
    def fastest(self) -> Floats:
        """Return the largest speed of what moves around each state, (B,) m/s."""
        speeds = [some.capsules.fastest(some.index) for some in self.movers]
        return np.asarray(np.max([np.zeros(len(self)), *speeds], axis=0))

    def clearance(self, *seconds: Floats) -> list[Floats]:
        """Return the distance from the robot's origin to the nearest obstacle, after some times; (B,) metres each."""
        points = self.poses[:, :2]
        found = [some.capsules.clearance(as_plane(points), some.index, *seconds) for some in self.movers]
        return _least(self.still.clearance(points, self.scene), found, len(seconds))

    def segment_clearance(self, starts: Floats, ends: Floats, *seconds: Floats) -> list[Floats]:
        """Return the same of segments between points (B, 2)."""
        found = [
            some.capsules.segment_clearance(as_plane(starts), as_plane(ends), some.index, *seconds)
            for some in self.movers
        ]
        return _least(self.still.segment_clearance(starts, ends, self.scene), found, len(seconds))

    def footprint_clearance(self, footprint: Footprint, *seconds: Floats) -> list[Floats]:
        """Return the same of the whole footprint at the poses; at most 0 where it touches something."""
        still = self.still.footprint_clearance(self.poses, footprint, self.scene)
        if footprint.kind != "polygon":
            points = as_plane(self.poses)
            found = [
                [away - footprint.radius for away in some.capsules.clearance(points, some.index, *seconds)]
                for some in self.movers
            ]
        else:
            corners = outline(self.poses, footprint)
            found = [some.capsules.outline_clearance(corners, some.index, *seconds) for some in self.movers]
        return _least(still, found, len(seconds))

    def nearest_mover(self, footprint: Footprint, seconds: Floats) -> Nearest:
        """Return what moves that may be nearest after some time (B,); without a name where nothing that moves is."""
        count, corners = len(self), outline(self.poses, footprint)
        still = self.still.footprint_clearance(self.poses, footprint, self.scene)
        nowhere = np.full(count, complex(np.nan, np.nan))
        best = Nearest(still + footprint.radius, np.full(count, ""), nowhere, nowhere)
        for some in self.movers:
            best = best.or_nearer(some.capsules.nearest(corners, some.index, seconds))
        return best


def outline(poses: Floats, footprint: Footprint) -> Plane:
    """Return the corners of a footprint at poses (B, 3), (n, B); of one without corners its centre."""
    corners = as_plane(footprint.polygon) if footprint.kind == "polygon" else np.zeros(1, complex)
    return np.asarray(as_plane(poses) + np.exp(1j * poses[:, 2]) * corners[:, None])


def _least(still: Floats, moving: Sequence[Sequence[Floats]], times: int) -> list[Floats]:
    """Return the least of what stands and, for each of several times, of what moves; NaN where one of them is."""
    found = [still] * times
    for each in moving:
        found = [np.minimum(nearest, away) for nearest, away in zip(found, each, strict=True)]
    return found


def _extent(obstacles: Obstacles) -> float:
    """Return a bound of the coordinates and radii of obstacles, in metres."""
    shapes = [obstacles.circles, *obstacles.polygons]
    if obstacles.grid is not None:
        shapes.append(obstacles.grid.outline)
    return max((float(np.abs(shape).max()) for shape in shapes if shape.size), default=0.0)
