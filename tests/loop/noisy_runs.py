"""The closed loop by school formulas: rays of the oracle, onnxruntime, arcs by their radius; no code of the tubes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tests.sight.ray_oracle import outlines, scan
from viatool.policy import Policy
from viatool.world import Scenario, WorldMap

Floats = np.ndarray


def runs(
    policy: Policy,
    world: WorldMap,
    scenario: Scenario,
    start: tuple[Floats, Floats],
    errors: Floats,
    look: Callable[[Floats], Floats] | None = None,
    *,
    shares: Floats | float = 0.0,
    astray: Floats | float = 0.0,
) -> tuple[Floats, Floats]:
    """Drive R runs for K intervals from poses (R, 3) after commands (R, 2), with sensor errors (R, K, n).

    Readings are off by shares (R, K, n) of themselves as well, and the goal is seen from poses that are astray
    (R, K, 3). Returns poses (R, K, 3) and commands (R, K, 2) of the policies of the lab: 20 bins, goal, previous
    command, budget.
    """
    shapes, seconds = outlines(world, scenario), world.robot.control_interval
    poses, command = (np.array(part, dtype=float) for part in start)
    low = np.array([world.robot.min_linear, -world.robot.max_angular])
    high = np.array([world.robot.max_linear, world.robot.max_angular])
    places, commands = [], []
    shares = np.broadcast_to(shares, errors.shape)
    astray = np.broadcast_to(astray, (*errors.shape[:2], 3))
    for error, share, off in zip(
        *(np.moveaxis(part, 1, 0) for part in (errors, shares, astray)), strict=True
    ):
        readings = scan(poses, world.robot.lidar, shapes) if look is None else look(poses)
        believed = poses + off
        dx, dy = np.array(scenario.goal)[:, None] - believed[:, :2].T
        bearing = np.arctan2(dy, dx) - believed[:, 2]
        rest = [np.hypot(dx, dy), np.cos(bearing), np.sin(bearing), *command.T, np.zeros(len(poses))]
        seen = np.hstack([readings, np.stack(rest, axis=1)])
        command = np.clip(policy.run(seen * (1.0 + share) + error), low, high).astype(float)
        poses = arc(poses, command, seconds)
        places.append(poses)
        commands.append(command)
    return np.stack(places, axis=1), np.stack(commands, axis=1)


def arc(poses: Floats, commands: Floats, seconds: float) -> Floats:
    """Drive along circles of radius v / omega; headings are not wrapped."""
    x, y, theta = poses.T
    speed, turn = commands.T
    after = theta + turn * seconds
    straight = np.abs(turn) < 1e-9
    radius = speed / np.where(straight, 1.0, turn)
    dx = np.where(straight, speed * seconds * np.cos(theta), radius * (np.sin(after) - np.sin(theta)))
    dy = np.where(straight, speed * seconds * np.sin(theta), radius * (np.cos(theta) - np.cos(after)))
    return np.stack([x + dx, y + dy, after], axis=1)


def sensor_errors(generator: np.random.Generator, radii: Floats, runs_: int, steps: int) -> Floats:
    """Errors (R, K, n): a third uniform, a third at corners, a third at corners that persist over the run."""
    z = generator.uniform(-1.0, 1.0, (runs_, steps, len(radii)))
    third = runs_ // 3
    z[third:] = np.sign(z[third:])
    z[2 * third :] = z[2 * third :, :1]
    return z * radii
