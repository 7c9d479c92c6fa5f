"""Robots of every kind with policies written by hand in the square, and where they go by school formulas."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.channels.square import HALF, lidar, readings
from viatool import load_map, load_policy
from viatool.policy import ActionChannel, Affine, Input, Network, Policy, PolicySpecification, write_onnx
from viatool.world import WorldMap

VIEW, BINS, COLLISION = 4.0, 6, 0.25
STEPS = 40

MAP = """\
schema_version: 1
arena: {{shape: box, center: [0, 0], size: [4, 4]}}
robot: {{{robot}, footprint: {{shape: point}}, control_interval: 0.4, deceleration: 1.0}}
clearance: {{collision: {collision}, danger: 0.3}}
scenarios: [{{name: corner, start: [-1.2, -1.2, 0.4], goal: [1.5, 1.5]}}]
"""


@dataclass(frozen=True)
class Drive:
    """A robot and a policy that is linear in what its LiDAR reads.

    Parameters
    ----------
    robot : str
        As a map says it.
    actions : tuple
        Name, kind, lower and upper end of each.
    gains : tuple
        What each bin adds to each action, and the constant of each action.
    velocity : callable
        Speed ahead, to the left, and turning speed of actions (B, A), clipped to their ends before.
    """

    robot: str
    actions: tuple[tuple[str, float, float], ...]
    gains: tuple[tuple[float, ...], ...]
    velocity: object

    def world(self, folder: Path, collision: float = COLLISION) -> WorldMap:
        path = folder / "square.yaml"
        path.write_text(MAP.format(robot=self.robot, collision=collision))
        return load_map(path)

    def policy(self, folder: Path) -> Policy:
        actions = [
            ActionChannel(name=f"my_{kind}", kind=kind, lower=lower, upper=upper)
            for kind, lower, upper in self.actions
        ]
        spec = PolicySpecification(
            schema_version=2, observation=[lidar("lidar", VIEW, BINS)], action=actions, control_interval=0.4
        )
        rows = np.array(self.gains, np.float32).astype(np.float64)
        path = folder / "policy.onnx"
        write_onnx(Network((Input(BINS), Affine((0,), (rows[:, :BINS],), rows[:, BINS]))), spec, path)
        return load_policy(path)

    def clipped(self, raw: np.ndarray) -> np.ndarray:
        return np.clip(raw, [low for _, low, _ in self.actions], [high for *_, high in self.actions])

    def path(self, poses: np.ndarray, raw: np.ndarray, seconds: float = 0.4) -> np.ndarray:
        """Poses (B, STEPS + 1, 3) while what the program gave, (B, A), is held: midpoint steps of the velocity."""
        ahead, left, turn = self.velocity(self.clipped(raw))
        fine, way = seconds / STEPS, [poses.astype(float)]
        for _ in range(STEPS):
            x, y, theta = way[-1].T
            middle = theta + 0.5 * fine * turn
            x = x + fine * (ahead * np.cos(middle) - left * np.sin(middle))
            y = y + fine * (ahead * np.sin(middle) + left * np.cos(middle))
            way.append(np.column_stack([x, y, theta + fine * turn]))
        return np.stack(way, axis=1)


def read(poses: np.ndarray) -> np.ndarray:
    return readings(poses, VIEW, BINS)


def left_over(poses: np.ndarray) -> np.ndarray:
    """What is left between a point robot and the walls, (...)."""
    return HALF - np.abs(poses[..., :2]).max(axis=-1)


HOLONOMIC = Drive(
    "kinematics: holonomic, min_linear: -0.5, max_linear: 1.0, max_lateral: 0.6, max_angular: 1.0",
    (("lateral", -0.6, 0.6), ("linear", -0.5, 1.0), ("angular", -1.0, 1.0)),
    (
        (-0.2, -0.2, 0.0, 0.0, 0.2, 0.2, 0.0),
        (0.0, 0.0, 0.3, 0.3, 0.0, 0.0, -0.1),
        (-0.3, 0.1, 0.0, 0.0, -0.1, 0.3, 0.1),
    ),
    lambda held: (held[:, 1], held[:, 0], held[:, 2]),
)

TRACK = 0.4
WHEELS = Drive(
    f"min_linear: -0.6, max_linear: 0.9, max_angular: 6.0, track: {TRACK}",
    (("right_wheel", -0.6, 0.9), ("left_wheel", -0.6, 0.8)),
    ((0.1, 0.0, 0.2, 0.2, 0.0, 0.2, -0.5), (0.2, 0.0, 0.2, 0.2, 0.0, 0.1, -0.5)),
    lambda held: ((held[:, 0] + held[:, 1]) / 2, 0.0 * held[:, 0], (held[:, 0] - held[:, 1]) / TRACK),
)

WHEELBASE = 0.33
CAR = Drive(
    f"kinematics: ackermann, min_linear: -0.3, max_linear: 1.0, max_steering: 0.5, wheelbase: {WHEELBASE}",
    (("steering", -0.5, 0.4), ("linear", -0.3, 1.0)),
    ((-0.2, -0.1, 0.0, 0.0, 0.1, 0.2, 0.1), (0.0, 0.0, 0.3, 0.3, 0.0, 0.0, -0.2)),
    lambda held: (held[:, 1], 0.0 * held[:, 1], held[:, 1] * np.tan(held[:, 0]) / WHEELBASE),
)

DRIVES = {"holonomic": HOLONOMIC, "wheels": WHEELS, "car": CAR}
