"""A speed governor around a trained policy: it stands still, exactly, where it must not go on.

    python examples/govern.py policies/via.onnx room.onnx
    viatool certify room.onnx --map maps/room.yaml --eps 0.01 --criterion swept --smallest 0.041667 --halvings 0 \
        --coarser 1 --forever --lookahead 1

The speed that the policy commands is lowered by ``sum_i slope_i relu(far_i - bin_i)`` of the LiDAR's bins. A bin reads
less than ``near_i`` if something in its sector comes closer than `CLEARANCE` to a robot that drives ahead by `STOP`;
then nothing is left of the largest speed, and the robot, whose least speed is 0, stands. From ``far_i``, where that
is so for a robot that drives ahead by `STOP + RAMP`, it slows down. What it turns by stays the policy's own.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import onnx
from onnx import helper, numpy_helper

from viatool import load_policy

CLEARANCE, STOP, RAMP = 0.62, 0.2, 0.3  # metres
STEEPEST = 5.0  # 1/s, of how fast the speed falls with a bin


def ranges(ahead: float, sectors: np.ndarray) -> np.ndarray:
    """How far a ray gets that comes closer than CLEARANCE to a robot on its way ahead; the most of each sector."""
    cosine, sine = np.cos(sectors), np.abs(np.sin(sectors))
    beside = CLEARANCE / np.maximum(sine, 1e-9)
    before = ahead * cosine + np.sqrt(np.maximum(CLEARANCE**2 - (ahead * sine) ** 2, 0.0))
    return np.where(beside * cosine <= ahead, beside, before).max(axis=1)


def main() -> None:
    """Write the policy with its governor."""
    source, target = map(Path, sys.argv[1:3])
    spec = load_policy(source).spec
    scan = next(channel.lidar for channel in spec.observation if channel.kind == "lidar")
    speed = next(channel for channel in spec.action if channel.kind == "linear")
    bins = spec.columns(next(channel.name for channel in spec.observation if channel.kind == "lidar"))
    half = 0.5 * scan.field_of_view
    rays = np.linspace(-half, half, scan.rays).reshape(scan.bins, -1)
    sectors = np.linspace(rays[:, 0], rays[:, -1], 41, axis=1)
    near = ranges(STOP, sectors)
    far = np.maximum(ranges(STOP + RAMP, sectors), near + speed.upper / STEEPEST)
    nearness = np.zeros((scan.bins, spec.observation_size), np.float32)
    nearness[np.arange(scan.bins), np.arange(bins.start, bins.stop)] = -1.0
    slower = np.zeros((len(spec.action), scan.bins), np.float32)
    slower[spec.action.index(speed)] = -speed.upper / (far - near)

    model = onnx.load(source)
    graph = model.graph
    seen, done = graph.input[0].name, graph.output[0].name
    for node in graph.node:
        node.output[:] = ["driven" if name == done else name for name in node.output]
    numbers = {
        "nearness": nearness, "far": far.astype(np.float32), "slower": slower,
        "as_asked": np.zeros(len(spec.action), np.float32),
    }  # fmt: skip
    graph.initializer.extend(numpy_helper.from_array(array, name) for name, array in numbers.items())
    graph.node.extend(
        [
            helper.make_node("Gemm", [seen, "nearness", "far"], ["within"], transB=1),
            helper.make_node("Relu", ["within"], ["how_near"]),
            helper.make_node("Gemm", ["how_near", "slower", "as_asked"], ["change"], transB=1),
            helper.make_node("Add", ["driven", "change"], [done]),
        ]
    )
    onnx.checker.check_model(model)
    onnx.save(model, target)


if __name__ == "__main__":
    main()
