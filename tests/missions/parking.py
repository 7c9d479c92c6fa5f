"""A policy that observes its pose and speed and commands an acceleration and a turn, fitted to a simple controller."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from viatool.policy import ActionChannel, Activation, Affine, Input, Network, PolicySpecification, write_onnx
from viatool.policy.activations import activation
from viatool.policy.specification import ObservationChannel

INTERVAL, NEURONS = 0.2, 48
LIMITS = {"linear_acceleration": 3.0, "angular": 2.0}
SPECIFICATION = PolicySpecification(
    schema_version=2,
    observation=[
        ObservationChannel(name=name, kind=kind)
        for name, kind in {"x": "pose_x", "y": "pose_y", "v": "linear_velocity", "phi": "heading"}.items()
    ],
    action=[ActionChannel(name=kind, kind=kind, lower=-limit, upper=limit) for kind, limit in LIMITS.items()],
    control_interval=INTERVAL,
)
MAP = """\
schema_version: 1
arena: {shape: box, center: [1, 1], size: [8, 8]}
obstacles: [{shape: box, center: [1.9, 0.6], size: [0.8, 0.8], yaw: 0.3}]
robot:
  {kinematics: second_order_linear, min_linear: -0.5, max_linear: MOST, max_angular: 2.0, min_acceleration: -3.0,
   max_acceleration: 3.0, footprint: {shape: point}, control_interval: 0.2, deceleration: 3.0}
clearance: {collision: 0.05, danger: 0.1}
scenarios:
  - name: park
    start: {lower: [2.9, 2.95, -2.4, 0.0], upper: [3.1, 3.05, -2.3, 0.1]}
    goal: {lower: [-0.4, -0.4, null, -0.5], upper: [0.4, 0.4, null, 0.5]}
    deadline: 6
    arrive: at
"""
LOWER, UPPER = np.array([2.9, 2.95, -2.4, 0.0]), np.array([3.1, 3.05, -2.3, 0.1])


def controller(states: np.ndarray) -> np.ndarray:
    """Accelerations and turns towards the origin, slower the nearer; states are x, y, v, heading."""
    x, y, v, heading = states.T
    ahead = 0.8 * np.hypot(x, y) - 0.2
    towards = np.arctan2(-y - 0.05, -x - 0.05)
    near = np.clip(np.hypot(x, y), 0.0, 1.0)
    return np.column_stack([2.0 * (ahead - v), 1.5 * near * (towards - heading)])


def write_parking_policy(path: Path, seed: int = 0) -> Path:
    """Fit a network of one layer of rectifiers by least squares, and write it."""
    generator = np.random.default_rng(seed)
    way = generator.uniform(0.02, 1.05, (20_000, 1))
    states = np.hstack([3.0 * way, 3.0 * way, 1.5 * way, -2.36 + 0.0 * way])
    states = states + generator.normal(0.0, [0.15, 0.15, 0.4, 0.3], states.shape)
    scale = np.array([1.0, 1.0, 1.0, 1.5])
    weights = generator.normal(0.0, 0.7, (NEURONS, 4)) / scale
    shift = -(weights * states[generator.integers(len(states), size=NEURONS)]).sum(axis=1)
    features = np.hstack([np.maximum(states @ weights.T + shift, 0.0), np.ones((len(states), 1))])
    square = features.T @ features + 1e-1 * np.eye(NEURONS + 1)
    fitted = np.linalg.solve(square, features.T @ controller(states)).T
    weights, shift, fitted = (part.astype(np.float32).astype(np.float64) for part in (weights, shift, fitted))
    network = Network(
        (
            Input(4),
            Affine((0,), (weights,), shift),
            Activation(1, activation("Relu"), NEURONS),
            Affine((2,), (fitted[:, :-1],), fitted[:, -1]),
        )
    )
    write_onnx(network, SPECIFICATION, path)
    return path


def drive(
    states: np.ndarray,
    commands: np.ndarray,
    most: float,
    pieces: int = 24,
    share: float = 1.0,
    least: float = -0.5,
) -> np.ndarray:
    """States (R, pieces + 1, 4), x, y, heading and v, while accelerations and turns (R, 2) are held, by Runge-Kutta.

    They are held for a share of an interval.
    """
    step = share * INTERVAL / pieces
    found = [states]
    acceleration, turn = commands.T
    for _ in range(pieces):
        begin = states[:, 3]

        def speed(time, begin=begin):
            return np.clip(begin + acceleration * time, np.minimum(least, begin), np.maximum(most, begin))

        x, y, heading, _ = states.T
        middle, end = heading + 0.5 * step * turn, heading + step * turn
        parts = [
            (speed(time) * share, angle)
            for time, share, angle in (
                (0.0, 1 / 6, heading), (0.5 * step, 4 / 6, middle), (step, 1 / 6, end)
            )
        ]  # fmt: skip
        x = x + step * sum(part * np.cos(angle) for part, angle in parts)
        y = y + step * sum(part * np.sin(angle) for part, angle in parts)
        states = np.column_stack([x, y, end, speed(step)])
        found.append(states)
    return np.stack(found, axis=1)
