"""A map_server map of 4000 x 4000 cells: loading, geometry, and 10,000 states verified end to end.

python tests/benchmarks/large_map.py
"""

from __future__ import annotations

import argparse
import dataclasses
import resource
import tempfile
import time
from pathlib import Path

import numpy as np
from PIL import Image

import viatool
from viatool.trajectory import Trajectory
from viatool.world import Footprint, Scenes, WorldMap

SIDE = 4000


def write_site(folder: Path) -> Path:
    """Write a site of 200 m x 200 m: 400 rooms, thousands of openings, furniture, specks and unknown patches."""
    rng = np.random.default_rng(1)
    greys = np.full((SIDE, SIDE), 254, np.uint8)
    for wall in range(0, SIDE, 200):
        greys[wall : wall + 3] = greys[:, wall : wall + 3] = 0
    for _ in range(20_000):
        (x, y), (width, height) = rng.integers(0, SIDE - 60, 2), rng.integers(3, 40, 2)
        kind = rng.random()
        greys[y : y + height, x : x + width] = 0 if kind < 0.35 else 254 if kind < 0.93 else 205
    greys[rng.random((SIDE, SIDE)) < 0.0005] = 0
    Image.fromarray(greys).save(folder / "site.png")
    path = folder / "site.yaml"
    path.write_text(
        "image: site.png\nresolution: 0.05\norigin: [-100.0, -100.0, 0.0]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.196\n",
        encoding="utf-8",
    )
    return path


def timed(what: str, start: float) -> None:
    """Print how long something took, and the most memory ever used."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    print(f"{what:<42} {time.perf_counter() - start:8.2f} s   peak {peak:6.0f} MB")


def measure(world: WorldMap, poses: np.ndarray) -> None:
    """Time every query of `Scenes`."""
    scenes, index = Scenes.of(world, [None]), np.zeros(len(poses), np.int64)
    ahead = poses[:, :2] + 0.05 * np.stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])], axis=1)
    start = time.perf_counter()
    scenes.clearance(poses[:, :2], index)
    timed(f"clearance of {len(poses)} points", start)
    start = time.perf_counter()
    scenes.segment_clearance(poses[:, :2], ahead, index)
    timed(f"clearance of {len(poses)} segments", start)
    start = time.perf_counter()
    scenes.footprint_clearance(poses, Footprint.rectangle(0.508, 0.43), index)
    timed(f"clearance of {len(poses)} footprints", start)
    start = time.perf_counter()
    scenes.cast(poses, index, world.robot.lidar)
    timed(f"{len(poses)} scans of {world.robot.lidar.rays} rays", start)


def states_at(policy: viatool.Policy, world: WorldMap, poses: np.ndarray, goals: np.ndarray) -> Trajectory:
    """Return what the policy would observe and do at poses, as a recorded trajectory."""
    lidar, count = world.robot.lidar, len(poses)
    scans = Scenes.of(world, [None]).cast(poses, np.zeros(count, np.int64), lidar)
    bins = np.maximum(scans.reshape(count, lidar.bins, -1).min(axis=2), lidar.minimum_range)
    away = goals - poses[:, :2]
    bearing = np.arctan2(away[:, 1], away[:, 0]) - poses[:, 2]
    rng = np.random.default_rng(2)
    previous = rng.uniform([0.0, -1.0], [0.5, 1.0], (count, 2))
    budget = policy.spec.fixed_values()[-1:] * np.ones((count, 1))
    columns = [
        bins,
        np.hypot(*away.T)[:, None],
        np.cos(bearing)[:, None],
        np.sin(bearing)[:, None],
        previous,
        budget,
    ]
    observations = np.hstack(columns)[:, : policy.input_size]
    return Trajectory(
        poses=poses,
        observations=observations,
        actions=policy.run(observations),
        episode=np.zeros(count, np.int64),
        time=0.1 * np.arange(count),
        outcomes=np.array(["unknown"]),
        costs=np.zeros(1),
        scenarios=(None,),
    )


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--states", type=int, default=10_000)
    parser.add_argument("--policy", default="policies/via.onnx")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        path = write_site(Path(folder))
        start = time.perf_counter()
        world = viatool.load_map(path)
        timed(f"load {SIDE} x {SIDE} cells", start)
    assert world.generator is not None
    start = time.perf_counter()
    near = dataclasses.replace(world.generator, start_clearance=0.401)  # so that many states are contested
    batch = near.draw_arrays(given.states, np.random.default_rng(0))
    timed(f"draw {given.states} starts and goals", start)
    measure(world, batch.starts)
    policy = viatool.load_policy(given.policy)
    start = time.perf_counter()
    trajectory = states_at(policy, world, batch.starts, batch.goals)
    result = viatool.verify(policy, world, eps=0.01, trajectory=trajectory)
    timed(f"{given.states} states observed and verified", start)
    print({stage: round(seconds, 2) for stage, seconds in result.seconds.items()})
    print({verdict: int((result.verdict == verdict).sum()) for verdict in ("safe", "unsafe", "unknown")})
    print(f"{int(result.contested.either.sum())} states contested")


if __name__ == "__main__":
    main()
