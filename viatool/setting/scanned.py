"""What scans would be that are turned or pass thin obstacles: over boxes of poses, and exactly for counterexamples."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from viatool.arrays import Booleans, Floats, Indices
from viatool.channels.drift import ScanView
from viatool.channels.erring import Erring
from viatool.channels.views import View, see_precisely
from viatool.errors import ConfigurationError
from viatool.rounding import SIGHT_ROUNDING
from viatool.sets.forms import PoseBoxes
from viatool.sight.shapes import Shapes
from viatool.uncertainty import ErrorModel
from viatool.world import Scenario, Scenes, WorldMap
from viatool.world.scenes import own_of

if TYPE_CHECKING:
    from viatool.setting.setting import Setting

_PAIRS = 400_000
"""Poses times shapes that are seen together."""


def check_scans(model: ErrorModel, world_map: WorldMap, job: str) -> None:
    """Refuse scans of which it is not known what they would be.

    Raises
    ------
    ConfigurationError
        If obstacles may be thin that an occupancy map does not tell apart, or recorded scans are turned or pass thin
        obstacles where it is not known where something was.
    """
    thin = [name for name, terms in model.sensor.items() if terms.thin]
    whole = [
        (name, field)
        for name, terms in model.sensor.items()
        for field in ("angle", "thin")
        if getattr(terms, field)
    ]
    moving = [place for place, term, _, _ in model.stated() if term.startswith("obstacles.")]
    if thin and world_map.obstacles.grid is not None:
        raise ConfigurationError(
            f"{model.source}: sensor.{thin[0]}.thin: the cells of an occupancy map are not told apart as obstacles, so "
            "none is thin",
            "draw the thin obstacles as shapes of a native map, or leave the term out",
        )
    if whole and job.startswith("verify") and any(model.obstacles.roams.values()):
        raise ConfigurationError(
            f"{model.source}: sensor.{whole[0][0]}.{whole[0][1]} and obstacles.roams together are not taken into "
            "account for recorded states: what another scan would be depends on where things were",
            "leave one of them out, or certify",
        )
    if thin and moving and job.startswith("simulate"):
        raise ConfigurationError(
            f"{model.source}: sensor.{thin[0]}.thin and {moving[0]} together are not simulated",
            "leave one of them out",
        )


def scan_views(
    setting: Setting, scenario: Scenario | None, boxes: PoseBoxes
) -> Iterator[tuple[slice, ScanView]]:
    """Yield what LiDARs see around boxes of poses in a scenario, for some of the boxes after the others."""
    errors = setting.reading_errors
    shapes = Shapes.of(setting.world_map, scenario, measured=errors.passes)
    scenes = Scenes.of(setting.world_map, [scenario])
    erring = Erring.within(np.zeros(setting.quantities.columns[-1].stop), errors.scans)
    step = max(1, _PAIRS // len(shapes))
    for start in range(0, len(boxes), step):
        some = slice(start, min(start + step, len(boxes)))
        here = boxes.select(some)
        room = scenes.clearance(here.centre[:, :2], np.zeros(len(here), np.int64))
        slack = SIGHT_ROUNDING * (shapes.scale + np.abs(here.centre).sum(axis=1))
        yield some, ScanView(erring, shapes, ~(room > here.extent + slack))


def changed_scans(
    setting: Setting,
    scenarios: Sequence[Scenario | None],
    scene: Indices,
    poses: Floats,
    turn: Floats,
    passed: Booleans,
) -> Floats:
    """Return by how much the readings of LiDARs differ that err as a whole.

    Parameters
    ----------
    setting : Setting
        Of n inputs.
    scenarios : sequence of Scenario
        S of them.
    scene : ndarray
        (B,) in which of them a state is.
    poses : ndarray
        (B, 3) where the robot is.
    turn : ndarray
        (B, T) by how much each of T scans is turned, in radians.
    passed : ndarray
        (B, n) bool: bins whose rays pass all that is thin.

    Returns
    -------
    ndarray
        (B, n), by exact rays.
    """
    scans, world_map = setting.reading_errors.scans, setting.world_map
    found = np.zeros((len(poses), setting.quantities.columns[-1].stop))
    still = np.zeros((len(poses), len(setting.rules.kinematics.axes)))
    view = View(
        Scenes.of(world_map, scenarios), poses, scene, np.zeros((len(poses), 2)), still, eyes=see_precisely
    )
    lidars = {place.start: lidar for lidar, place in setting.quantities.lidars}
    for number, scan in enumerate(scans):
        lidar, columns = lidars[int(scan.columns[0])], scan.columns
        turned = replace(view, poses=poses + turn[:, number, None] * [0.0, 0.0, 1.0])
        seen = np.asarray(lidar.measure(turned), dtype=np.float64)
        if scan.thin > 0.0:
            bare = replace(turned, scenes=Scenes.around(world_map, own_of(scenarios), scan.thin))
            seen = np.where(passed[:, columns], lidar.measure(bare), seen)
        found[:, columns] = seen - lidar.measure(view)
    return found[:, setting.quantities.inputs.reading]
