"""Two oracles of a LiDAR read the same."""

from __future__ import annotations

import numpy as np
import pytest

from tests.sight.bunch_oracle import scan_bunch
from tests.sight.ray_oracle import outlines, scan
from viatool import load_map

LAB = load_map("maps/lab.yaml")


@pytest.mark.parametrize("spread", [0.05, 3.0])
def test_bunches_read_what_every_ray_against_every_shape_reads(spread):
    generator = np.random.default_rng(0)
    for scenario in LAB.scenarios[:4]:
        shapes = outlines(LAB, scenario)
        for turned in np.linspace(-9.0, 9.0, 5):
            middle = np.append(generator.uniform(-4.5, 4.5, 2), turned)
            poses = middle + spread * generator.uniform(-1.0, 1.0, (40, 3))
            poses[:, :2] = np.clip(poses[:, :2], -4.8, 4.8)
            expected = scan(poses, LAB.robot.lidar, shapes)
            assert np.abs(scan_bunch(poses, LAB.robot.lidar, shapes, 16) - expected).max() < 1e-9
