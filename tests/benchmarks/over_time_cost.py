"""What it costs to look ahead: CPU time for each cell that is followed, and what that makes for a whole map.

    python tests/benchmarks/over_time_cost.py policies/via.onnx maps/lab.yaml

Follows a random part of the free cells of scenario 0 for 1, 2 and 4 control intervals, in cells of three sizes, and
prints how wide the successors of a cell are, in cells. The whole map is extrapolated; the previous command is not cut.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from viatool import load_map, load_policy
from viatool.loop.closed_loop import ClosedLoop
from viatool.places.mesh import CellSet, Mesh
from viatool.places.passages import follow
from viatool.places.tree import Lattice
from viatool.setting.setting import Setting


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("policy", type=Path)
    options.add_argument("map", type=Path)
    options.add_argument("--eps", type=float, default=0.01)
    options.add_argument("--cells", type=int, default=1500)
    given = options.parse_args()
    policy, world = load_policy(given.policy), load_map(given.map)
    loop = ClosedLoop.of(policy, Setting.of(policy, world, given.eps), world.scenarios[0])
    generator = np.random.default_rng(0)
    print(
        "side m   free cells   ms a cell for 1, 2, 4 intervals   whole map, CPU min   cells led to   sums MB"
    )
    for side in (0.125, 0.0625, 0.03125):
        lattice = Lattice.over(world.bounds, (loop.rules.lower, loop.rules.upper), (side, side, 0))
        mesh = Mesh.of(lattice)
        drawn = generator.integers(0, len(mesh), 4 * given.cells)
        free = ~loop.blocked(mesh.boxes(*mesh.bounds(drawn)).poses)
        cells, share = drawn[free][: given.cells], float(free.mean())
        spent = []
        for intervals in (1, 2, 4):
            start = time.process_time()
            found = follow(loop, mesh, cells, intervals=intervals)
            spent.append((time.process_time() - start) / len(cells))
            if intervals == 1:
                ranges = found.ranges[0]
                led = np.prod(ranges.last.astype(int) - ranges.first + 1, axis=1)
        start = time.process_time()
        sums = CellSet(mesh, np.ones(len(mesh), bool))
        count = share * len(mesh)
        print(
            f"{side:<8} {count:12,.0f}   {spent[0] * 1e3:8.3f} {spent[1] * 1e3:8.3f} {spent[2] * 1e3:8.3f}   "
            f"{count * spent[0] / 60:18.1f}   {np.median(led):5.0f} {np.percentile(led, 90):6.0f}   "
            f"{sums.bytes / 1e6:7.0f}, {time.process_time() - start:.2f} s"
        )


if __name__ == "__main__":
    main()
