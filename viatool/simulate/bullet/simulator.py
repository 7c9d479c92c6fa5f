"""The physics engine: every robot drives in a physics world of its own."""

from __future__ import annotations

import math
import weakref
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np

from viatool.arrays import Booleans, Floats, Indices, Reals
from viatool.channels import Fan, View
from viatool.errors import ConfigurationError
from viatool.simulate.bullet.worlds import Blueprint, Sight, open_worlds
from viatool.simulate.models import model_of
from viatool.simulate.simulator import Simulator
from viatool.world import Footprint, WorldMap

_RATE = 120.0  # least number of steps of the engine in a second


class BulletSimulator(Simulator):
    """Robots with mass, on wheels with motors and friction, or on a base that is pushed as the command says.

    Parameters
    ----------
    world_map : WorldMap
        Arena, obstacles, robot and clearances; the robot has to be one whose body is known
        (`viatool.simulate.models`).
    robots : int
        E; each has a physics world of its own, which takes about 40 MB.
    lidar : str
        "rays": ray tests of the engine, from the LiDAR as it stands and tilts; "analytic": exact geometry at the
        robot's pose, as in the kinematic engine, which is faster.
    workers : int
        Processes among which the worlds are shared out. What comes out does not depend on it.
    **settings
        As for `Simulator`. Without an acceleration among the conditions, that of the robot's motors holds.

    Notes
    -----
    Call `close` when the simulator is no longer needed, or use it in a ``with`` block. A body that touches an
    obstacle has collided, whatever clearance the map asks for.
    """

    largest = 8
    moves_obstacles = False

    def __init__(
        self,
        world_map: WorldMap,
        robots: int,
        *,
        lidar: Literal["rays", "analytic"] = "rays",
        workers: int = 1,
        **settings: Any,
    ) -> None:
        self._finalizer = None
        super().__init__(world_map, robots, **settings)
        if lidar not in ("rays", "analytic"):
            raise ConfigurationError(f"unknown LiDAR '{lidar}'", "choose rays or analytic")
        self.model = model_of(self.robot)
        self._body = Footprint("polygon", polygon=self.model.outline)
        acceleration = self.conditions.acceleration
        interval = self.robot.control_interval
        self._steps_per_interval = math.ceil(interval * _RATE - 1e-9)
        self._analytic = lidar == "analytic"
        fans = self.observer.fans
        blueprint = Blueprint(
            world_map,
            self.model,
            self.model.acceleration if acceleration is None else acceleration,
            interval / self._steps_per_interval,
            None if self._analytic else np.hstack([fan.quick_directions for fan in fans]).astype(np.float64),
            max(fan.lidar.maximum_range for fan in fans),
        )
        self._worlds = open_worlds(blueprint, min(workers, robots) if workers > 1 else workers)
        self._finalizer = weakref.finalize(self, self._worlds.close)
        ends = np.cumsum([0, *(len(fan) for fan in fans)]).tolist()
        self._rays = {fan: slice(*ends[place : place + 2]) for place, fan in enumerate(fans)}
        self._seen = np.zeros((robots, 0 if self._analytic else ends[-1]), np.float32)

    def __enter__(self) -> BulletSimulator:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close it."""
        self.close()

    def close(self) -> None:
        """Give the memory and the processes of the worlds back."""
        if self._finalizer is not None:
            self._finalizer()

    def keep(self, which: Booleans) -> None:
        """Go on with some of the robots only, (E,) bool; the others leave the simulation."""
        super().keep(which)
        self._seen = self._seen[which]

    def _place(self, index: Indices) -> None:
        self._check_room(index)
        tasks = [
            (int(self._slots[row]), (tuple(self.poses[row].tolist()), self.own_obstacles(row)))
            for row in index
        ]
        for row, sight in zip(index, self._worlds.place(tasks), strict=True):
            self._take(int(row), sight)

    def _move(self, commands: Sequence[tuple[float, Floats]]) -> tuple[Floats, Booleans]:
        step = self.robot.control_interval / self._steps_per_interval
        ends = np.rint(np.cumsum([seconds for seconds, _ in commands]) / step).astype(int).tolist()
        lengths = np.diff([0, *ends]).tolist()
        tasks = [
            (
                slot,
                [
                    (length, command[row].tolist())
                    for length, (_, command) in zip(lengths, commands, strict=True)
                ],
            )
            for row, slot in enumerate(self._slots.tolist())
        ]
        sights = self._worlds.drive(tasks)
        for row, sight in enumerate(sights):
            self._take(row, sight)
        poses = np.array([sight.pose for sight in sights]).reshape(-1, 3)
        return poses, np.array([sight.touching for sight in sights], dtype=bool)

    def _take(self, row: int, sight: Sight) -> None:
        if sight.ranges is not None:
            self._seen[row] = sight.ranges

    def _moving(self, before: Floats, commands: Floats) -> Floats:
        """Return what wheels and walls made of the commands: the average velocity."""
        return self._average(before)

    def _ranges(self, fan: Fan, index: Indices | slice, view: View) -> Reals:
        if self._analytic:
            return super()._ranges(fan, index, view)
        return np.minimum(self._seen[index][:, self._rays[fan]], np.float32(fan.lidar.maximum_range))

    def _check_room(self, index: Indices) -> None:
        """Refuse to put a body down into an obstacle."""
        room = self.scenes.footprint_clearance(self.poses[index], self._body, self.scene[index])
        for row in index[room <= 0.0][:1]:
            x, y, _ = self.poses[row]
            raise ConfigurationError(
                f"the body of {self.robot.name} does not fit at the start ({x:g}, {y:g}): it would stand in an "
                "obstacle",
                "move the start into free space, or choose a smaller robot",
            )
