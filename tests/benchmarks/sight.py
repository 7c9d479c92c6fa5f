"""Cast rays against the LiDAR's enclosures: how many leave them, and how tight they are beside dense sampling.

    python tests/benchmarks/sight.py --rays 100000000

Boxes of several sizes over the lab, the office and random worlds with every kind of shape; of each box, poses at its
corners and within. The rays are cast by the oracle of the tests, which shares no code with the enclosures.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from tests.sight.ray_oracle import outlines, scan
from tests.sight.test_scan import boxes_in
from tests.world.random_worlds import ARENAS, random_world
from viatool.sight.scan import enclose_scan
from viatool.sight.shapes import Shapes
from viatool.world import Lidar, Scenes, load_map

SIDES = (0.004, 0.01, 0.02, 0.04, 0.08)  # whole widths in metres and radians
POSES = 50
ROUNDING = 1e-8  # of the oracle, where a ray grazes


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--rays", type=int, default=2_000_000)
    options.add_argument("--seed", type=int, default=0)
    given = options.parse_args()
    generator = np.random.default_rng(given.seed)
    found = {side: [] for side in SIDES}
    seconds, cast, outside, cells = {"enclose": 0.0, "cast": 0.0}, 0, 0, 0
    while cast < given.rays:
        world, scenario, lidar = random_scene(generator)
        shapes, scenes = outlines(world, scenario), Scenes.of(world, [scenario])
        for side in SIDES:
            boxes = boxes_in(world, scenario, generator, 100, sizes=(0.5 * side,))
            boxes.radius[:] = 0.5 * side
            left = scenes.clearance(boxes.centre[:, :2], np.zeros(len(boxes), np.int64))
            boxes = boxes.select(left > side)  # a LiDAR within an obstacle sees nothing that is promised
            start = time.process_time()
            forms = enclose_scan(boxes, Shapes.of(world, scenario), lidar)
            seconds["enclose"] += time.process_time() - start
            z = generator.uniform(-1, 1, (len(boxes), POSES, 3))
            z[:, : POSES // 3] = np.sign(z[:, : POSES // 3])
            poses = (boxes.centre[:, None] + z * boxes.radius[:, None]).reshape(-1, 3)
            start = time.process_time()
            readings = scan(poses, lidar, shapes).reshape(len(boxes), POSES, -1)
            seconds["cast"] += time.process_time() - start
            left = readings - np.einsum("cjk,csj->csk", forms.slope, z)
            over = np.abs(left - forms.centre[:, None]) - forms.rest[:, None]
            outside += int((over > ROUNDING).sum())
            cast, cells = cast + len(poses) * lidar.rays, cells + len(boxes)
            found[side].append(
                (2.0 * forms.rest.ravel(), np.ptp(left, axis=1).ravel(), np.ptp(readings, axis=1).ravel())
            )
    print(f"{cast:,} rays, {outside} readings outside their enclosure")
    print(
        f"{1e3 * seconds['enclose'] / cells:.3f} ms CPU for each box; casting took {seconds['cast']:.0f} s CPU"
    )
    print("side      enclosed rest   sampled rest   reading varies   ratio of medians   > 0.1 m   sampled")
    for side, parts in found.items():
        rest, sampled, whole = (np.concatenate(part) for part in zip(*parts, strict=True))
        medians = [float(np.median(part)) for part in (rest, sampled, whole)]
        print(
            f"{side:5.3f} {medians[0]:15.5f} {medians[1]:14.5f} {medians[2]:16.5f} {medians[0] / medians[1]:18.2f}"
            f" {100 * (rest > 0.1).mean():8.1f} % {100 * (sampled > 0.1).mean():7.1f} %"
        )


def random_scene(generator):
    """A map, a scenario and a LiDAR."""
    kind = generator.integers(3)
    if kind == 2:
        arena = ARENAS[generator.choice(list(ARENAS))]
        world, scenarios = random_world(generator, arena, 2)
        return world, scenarios[0], Lidar()
    world = load_map(Path("maps") / ("lab.yaml", "office.yaml")[kind])
    return world, world.scenarios[generator.integers(len(world.scenarios))], world.robot.lidar


if __name__ == "__main__":
    main()
