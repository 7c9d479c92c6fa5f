"""A scenario as one line of JSON, so that a recorded episode carries the obstacles it was driven among."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

import numpy as np

from viatool.errors import MapError, TrajectoryError

if TYPE_CHECKING:
    from viatool.world import Scenario


def write_scenario(scenario: Scenario | None) -> str:
    """Return the JSON of a scenario, or an empty text for None; every float is written exactly."""
    if scenario is None:
        return ""
    obstacles = scenario.obstacles
    return json.dumps(
        {
            "name": scenario.name,
            "start": [float(value) for value in scenario.start],
            "goal": [float(value) for value in scenario.goal],
            "circles": np.asarray(obstacles.circles, dtype=np.float64).reshape(-1, 3).tolist(),
            "polygons": [np.asarray(polygon, dtype=np.float64).tolist() for polygon in obstacles.polygons],
        }
    )


def read_scenario(text: str) -> Scenario | None:
    """Return the scenario that `write_scenario` wrote.

    Raises
    ------
    TrajectoryError
        If the text is not such a JSON object, or holds an obstacle that is not valid.
    """
    if not text:
        return None
    from viatool.world import Obstacles, Scenario

    try:
        fields = json.loads(text)
        polygons = tuple(np.array(polygon, dtype=np.float64).reshape(-1, 2) for polygon in fields["polygons"])
        circles = np.array(fields["circles"], dtype=np.float64).reshape(-1, 3)
        x, y, theta = (float(value) for value in fields["start"])
        goal_x, goal_y = (float(value) for value in fields["goal"])
        return Scenario(str(fields["name"]), (x, y, theta), (goal_x, goal_y), Obstacles(circles, polygons))
    except MapError as error:
        raise TrajectoryError(
            f"trajectory has the scenario '{text[:80]}': {error.message}", error.hint
        ) from error
    except (ValueError, TypeError, KeyError, OverflowError) as error:
        raise TrajectoryError(
            f"trajectory has the scenario '{text[:80]}', which cannot be read: {error}",
            "leave the scenario empty, or copy it from a trajectory that viatool wrote",
        ) from error
