"""Robots whose motion has a state, with policies written by hand, in the square."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.channels.square import HALF, lidar, readings
from tests.motion import changing_plant as plant
from viatool import load_map, load_policy
from viatool.policy import ActionChannel, Affine, Input, Network, Policy, PolicySpecification, write_onnx
from viatool.policy.specification import ObservationChannel
from viatool.world import WorldMap

VIEW, BINS, COLLISION, INTERVAL, DECELERATION, EPS = 4.0, 6, 0.25, 0.4, 1.5, 0.05
PIECES = 48

MAP = """\
schema_version: 1
arena: {{shape: box, center: [0, 0], size: [4, 4]}}
robot:
  {{kinematics: {kinematics}, min_linear: {low}, max_linear: {high}, max_angular: {turn}, wheelbase: {wheelbase},
   max_steering: {steering}, max_steering_rate: {rate}, min_acceleration: -3.0, max_acceleration: 2.0,
   max_angular_acceleration: 4.0, footprint: {{shape: point}}, control_interval: {interval},
   deceleration: {deceleration}}}
clearance: {{collision: {collision}, danger: 0.3}}
scenarios: [{{name: corner, start: [-1.2, -1.2, 0.4], goal: [1.5, 1.5]}}]
"""
RANGES = {
    "linear": (-0.4, 1.0),
    "angular": (-1.5, 1.5),
    "steering": (-0.6, 0.6),
    "linear_acceleration": (-3.0, 2.0),
    "angular_acceleration": (-4.0, 4.0),
}


@dataclass(frozen=True)
class Changing:
    """A robot and a policy that is linear in what its LiDAR reads and in the speeds that it measures.

    Parameters
    ----------
    name : str
        Of the kinematics.
    actions : tuple of str
        Kinds of its actions, in the order of the command.
    measured : tuple of str
        Kinds of the velocities that the policy measures: the numbers of the state in their order, or none.
    motion : tuple of str
        What these are called.
    """

    name: str
    actions: tuple[str, ...]
    measured: tuple[str, ...]
    motion: tuple[str, ...]

    def world(self, folder: Path, collision: float = COLLISION) -> WorldMap:
        path = folder / "square.yaml"
        robot = plant.robot_of(self.name)
        path.write_text(
            MAP.format(
                kinematics=self.name, low=plant.LOW, high=plant.HIGH, turn=plant.TURN, wheelbase=plant.WHEELBASE,
                steering=plant.STEERING, rate=robot.max_steering_rate, interval=INTERVAL, deceleration=DECELERATION,
                collision=collision,
            )
        )  # fmt: skip
        return load_map(path)

    def policy(self, folder: Path, seed: int = 3) -> Policy:
        actions = [
            ActionChannel(name=f"my_{kind}", kind=kind, lower=RANGES[kind][0], upper=RANGES[kind][1])
            for kind in self.actions
        ]
        seen = [lidar("lidar", VIEW, BINS)]
        seen += [ObservationChannel(name=kind, kind=kind) for kind in self.measured]
        spec = PolicySpecification(
            schema_version=2, observation=seen, action=actions, control_interval=INTERVAL
        )
        generator = np.random.default_rng(seed)
        size = BINS + len(self.measured)
        gains = generator.normal(0.0, 0.5, (2, size)).astype(np.float32).astype(np.float64)
        shift = (-0.5 * gains[:, :BINS].sum(axis=1) + 0.3).astype(np.float32).astype(np.float64)
        path = folder / "policy.onnx"
        write_onnx(Network((Input(size), Affine((0,), (gains,), shift))), spec, path)
        return load_policy(path)

    def clipped(self, raw: np.ndarray) -> np.ndarray:
        return np.clip(raw, *np.transpose([RANGES[kind] for kind in self.actions]))

    def observed(self, poses: np.ndarray, motion: np.ndarray) -> np.ndarray:
        return np.hstack([readings(poses, VIEW, BINS), motion[:, : len(self.measured)]])

    def path(
        self, poses: np.ndarray, raw: np.ndarray, motion: np.ndarray, brakes: bool = False
    ) -> np.ndarray:
        """Poses (B, PIECES + 1, 3) while what the program gave, (B, 2), is held, and while the robot brakes after."""
        held = np.hstack([self.clipped(raw), motion])
        seconds = plant.whole(self.name, held, INTERVAL, DECELERATION if brakes else None, 0.0)
        return plant.path(self.name, poses, held, seconds, INTERVAL, PIECES)


def left_over(poses: np.ndarray) -> np.ndarray:
    """What is left between a point robot and the walls, (...)."""
    return HALF - np.abs(poses[..., :2]).max(axis=-1)


ROBOTS = {
    one.name: one
    for one in (
        Changing("second_order_linear", ("linear_acceleration", "angular"), ("linear_velocity",), ("v",)),
        Changing("second_order_angular", ("linear", "angular_acceleration"), ("angular_velocity",), ("omega",)),
        Changing(
            "second_order", ("linear_acceleration", "angular_acceleration"),
            ("linear_velocity", "angular_velocity"), ("v", "omega"),
        ),
        Changing("second_order_ackermann", ("linear_acceleration", "steering"), ("linear_velocity",), ("v",)),
        Changing("ackermann", ("linear", "steering"), (), ("steering",)),
    )
}  # fmt: skip
