"""A square room of 4 m with a LiDAR policy written by hand, and what is seen there by school formulas."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from viatool import load_map, load_policy
from viatool.policy import (
    ActionChannel,
    Affine,
    Input,
    LidarSpecification,
    Network,
    ObservationChannel,
    Policy,
    PolicySpecification,
    write_onnx,
)
from viatool.world import WorldMap

HALF = 2.0
COLLISION = 0.22
FAR = 7.0

_MAP = """\
schema_version: 1
arena: {{shape: box, center: [0, 0], size: [4, 4]}}
obstacles: {obstacles}
robot: turtlebot3
clearance: {{collision: {collision}, danger: 0.3}}
scenarios: [{{name: corner, start: [-1, -1, 0.4], goal: [1.5, 1.5]}}]
"""


def square(folder: Path, obstacles: str = "[]", collision: float = COLLISION) -> WorldMap:
    path = folder / "square.yaml"
    path.write_text(_MAP.format(obstacles=obstacles, collision=collision))
    return load_map(path)


def lidar(name: str, view: float, bins: int, rays: int | None = None) -> ObservationChannel:
    described = LidarSpecification(
        field_of_view=view, rays=rays or bins, bins=bins, minimum_range=0.0, maximum_range=FAR
    )
    return ObservationChannel(name=name, size=bins, kind="lidar", lidar=described)


def linear_policy(
    path: Path,
    channels: list[ObservationChannel],
    rows: dict[tuple[str, int], tuple[float, float]],
    bias=(0.0, 0.0),
) -> Policy:
    """Commands v and omega that add so much for each number, by channel and place in it."""
    spec = PolicySpecification(
        observation=channels,
        action=[
            ActionChannel(name="v", unit="m/s", lower=0.0, upper=0.5, kind="linear"),
            ActionChannel(name="w", unit="rad/s", lower=-1.0, upper=1.0, kind="angular"),
        ],
    )
    weight = np.zeros((2, spec.observation_size))
    for (name, index), gains in rows.items():
        weight[:, spec.columns(name)[0] + index] = gains
    weight, offset = (np.float32(part).astype(np.float64) for part in (weight, bias))
    write_onnx(Network((Input(spec.observation_size), Affine((0,), (weight,), offset))), spec, path)
    return load_policy(path)


def readings(poses: np.ndarray, view: float, bins: int, rays: int | None = None) -> np.ndarray:
    """What a LiDAR reads at poses (B, 3) in the empty square, (B, bins)."""
    rays = rays or bins
    angle = poses[:, 2, None] + np.linspace(-view / 2, view / 2, rays)
    x, y = poses[:, 0, None], poses[:, 1, None]
    with np.errstate(divide="ignore"):
        along_x = (HALF - np.sign(np.cos(angle)) * x) / np.abs(np.cos(angle))
        along_y = (HALF - np.sign(np.sin(angle)) * y) / np.abs(np.sin(angle))
    nearest = np.minimum(np.minimum(along_x, along_y), FAR)
    return nearest.reshape(len(poses), bins, -1).min(axis=2)
