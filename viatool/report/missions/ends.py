"""Where the runs of a mission begin and arrive, to be drawn."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from viatool.missions import Mission, Missions


def start_box(mission: Mission, missions: Missions) -> list[float]:
    """Return the least x, y and the largest x, y from which runs begin."""
    scenario = mission.scenario
    if scenario.starts is not None:
        return [*scenario.starts.lower[:2], *scenario.starts.upper[:2]]
    (x, y, _), (dx, dy, _) = scenario.start, missions.start_error
    return [x - dx, y - dy, x + dx, y + dy]


def goal_outlines(mission: Mission, missions: Missions) -> list[list[list[float]]]:
    """Return the outlines of where runs arrive, as lists of corners; what is free reaches to the edge of the map."""
    import shapely

    region = mission.scenario.region
    if region is None:
        angle = np.linspace(0.0, 2.0 * np.pi, 49)
        ring = np.array(mission.scenario.goal) + missions.goal_radius * np.stack(
            [np.cos(angle), np.sin(angle)], axis=1
        )
        return [ring.tolist()]
    places = shapely.get_parts(region.places(missions.world_map.bounds))
    return [np.array(place.exterior.coords).tolist() for place in places if place.geom_type == "Polygon"]
