"""Many physics worlds, one for each robot: in this process, or shared out among several."""

from __future__ import annotations

import multiprocessing
import signal
from collections.abc import Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any, Protocol

import numpy as np

from viatool.arrays import Floats
from viatool.errors import ConfigurationError, ViatoolError
from viatool.simulate.bullet.world import BulletWorld, Segments
from viatool.simulate.models import RobotModel
from viatool.world import Obstacles, WorldMap

Pose = tuple[float, float, float]
Task = tuple[int, Any]  # slot, and what its world is to do


@dataclass(frozen=True, eq=False)
class Blueprint:
    """What every world is built from.

    Parameters
    ----------
    world_map : WorldMap
        Arena and obstacles.
    model : RobotModel
        The robot's body.
    acceleration, step : float
        As for `BulletWorld`.
    directions : ndarray or None
        (2, R) directions of the rays that are cast in the engine, None to cast none.
    limit : float
        Length of the rays, in metres.
    """

    world_map: WorldMap
    model: RobotModel
    acceleration: float
    step: float
    directions: Floats | None
    limit: float

    def build(self) -> BulletWorld:
        """Return a new world."""
        return BulletWorld(self.world_map, self.model, self.acceleration, self.step)


@dataclass(frozen=True, eq=False)
class Sight:
    """What one world shows after it was asked for something.

    Parameters
    ----------
    pose : tuple
        x, y, theta of the robot, in metres and radians.
    touching : bool
        Whether its body touches an obstacle.
    ranges : ndarray or None
        (R,) of the rays, in metres.
    """

    pose: Pose
    touching: bool
    ranges: Floats | None


class Worlds(Protocol):
    """Worlds by the slot of their robot."""

    def place(self, tasks: Sequence[tuple[int, tuple[Pose, Obstacles]]]) -> list[Sight]:
        """Put robots down; a world is built when it is first asked for."""

    def drive(self, tasks: Sequence[tuple[int, Segments]]) -> list[Sight]:
        """Let robots drive."""

    def close(self) -> None:
        """Give everything back."""


class LocalWorlds:
    """Worlds in this process."""

    def __init__(self, blueprint: Blueprint) -> None:
        self._blueprint = blueprint
        self._worlds: dict[int, BulletWorld] = {}

    def place(self, tasks: Sequence[tuple[int, tuple[Pose, Obstacles]]]) -> list[Sight]:
        """Put robots down; a world is built when it is first asked for."""
        for slot, (pose, own) in tasks:
            if slot not in self._worlds:
                self._worlds[slot] = self._blueprint.build()
            self._worlds[slot].place(np.asarray(pose), own)
        return [self._look(slot) for slot, _ in tasks]

    def drive(self, tasks: Sequence[tuple[int, Segments]]) -> list[Sight]:
        """Let robots drive."""
        for slot, segments in tasks:
            self._worlds[slot].drive(segments)
        return [self._look(slot) for slot, _ in tasks]

    def close(self) -> None:
        """Give everything back."""
        while self._worlds:
            self._worlds.popitem()[1].close()

    def _look(self, slot: int) -> Sight:
        world, plan = self._worlds[slot], self._blueprint
        ranges = None if plan.directions is None else world.cast(plan.directions, plan.limit)
        return Sight(world.pose(), world.touches(), ranges)


class ProcessWorlds:
    """Worlds in several processes, shared out by slot; what they compute does not depend on how many there are.

    Parameters
    ----------
    blueprint : Blueprint
        Of all worlds.
    processes : int
        At least 1.
    """

    def __init__(self, blueprint: Blueprint, processes: int) -> None:
        context = multiprocessing.get_context("spawn")
        self._connections: list[Connection] = []
        self._processes = []
        for _ in range(processes):
            here, there = context.Pipe()
            process = context.Process(target=_serve, args=(there, blueprint), daemon=True)
            process.start()
            there.close()
            self._connections.append(here)
            self._processes.append(process)

    def place(self, tasks: Sequence[tuple[int, tuple[Pose, Obstacles]]]) -> list[Sight]:
        """Put robots down; a world is built when it is first asked for."""
        return self._ask("place", tasks)

    def drive(self, tasks: Sequence[tuple[int, Segments]]) -> list[Sight]:
        """Let robots drive."""
        return self._ask("drive", tasks)

    def close(self) -> None:
        """Give everything back."""
        for connection in self._connections:
            connection.close()  # the other side ends when nobody is left to ask it
        for process in self._processes:
            process.join(timeout=5.0)
            if process.is_alive():
                process.terminate()
        self._connections, self._processes = [], []

    def _ask(self, method: str, tasks: Sequence[Task]) -> list[Sight]:
        count = len(self._connections)
        shares: list[list[Task]] = [[] for _ in range(count)]
        for slot, content in tasks:
            shares[slot % count].append((slot, content))
        busy = [index for index, share in enumerate(shares) if share]
        found: dict[int, Sight] = {}
        try:
            for index in busy:
                self._connections[index].send((method, shares[index]))
            answers = [self._connections[index].recv() for index in busy]
        except (EOFError, OSError) as error:
            raise ViatoolError(
                "a process of the physics engine ended unexpectedly", "run again with --workers 1"
            ) from error
        for index, answer in zip(busy, answers, strict=True):
            if isinstance(answer, BaseException):
                raise answer
            found |= dict(zip((slot for slot, _ in shares[index]), answer, strict=True))
        return [found[slot] for slot, _ in tasks]


def _serve(connection: Connection, blueprint: Blueprint) -> None:
    """Answer questions about worlds until nobody asks any more."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # who asks is interrupted, and hangs up
    worlds = LocalWorlds(blueprint)
    while True:
        try:
            method, tasks = connection.recv()
        except (EOFError, OSError):
            break
        try:
            connection.send(getattr(worlds, method)(tasks))
        except Exception as error:  # it is raised again on the other side
            connection.send(error)
    worlds.close()


def open_worlds(blueprint: Blueprint, workers: int) -> Worlds:
    """Return worlds in this process for one worker, else in as many processes as there are workers.

    Raises
    ------
    ConfigurationError
        If there is no worker.
    """
    if workers < 1:
        raise ConfigurationError(f"{workers} workers", "ask for at least one")
    return LocalWorlds(blueprint) if workers == 1 else ProcessWorlds(blueprint, workers)
