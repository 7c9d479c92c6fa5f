"""Ellipses in native maps, which the geometry knows as polygons around them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.hall import MAP, write_policy
from viatool import load_map, verify
from viatool.errors import MapError
from viatool.world import MapFile, Scenes

UNION = "Obstacle = Annotated[Circle | Rectangle | Polygon | Wall, "
FILES = {
    "viatool/world/obstacle_shapes.py": {
        UNION: '''\
class Ellipse(Outlined):
    """An ellipse: half-axes along its own x and y, turned by yaw."""

    shape: Literal["ellipse"]
    center: Point
    radii: Size
    yaw: Number = 0.0

    def ring(self) -> Floats:
        """See `Outlined.ring`; the 48 sides are tangents."""
        angle = np.arange(48) * (np.pi / 24.0)
        x, y = np.array(self.radii)[:, None] * np.stack([np.cos(angle), np.sin(angle)]) / np.cos(np.pi / 48.0)
        cosine, sine = np.cos(self.yaw), np.sin(self.yaw)
        corners = np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=1)
        return simple_polygon(np.array(self.center) + corners, self.name or "ellipse")


Obstacle = Annotated[Circle | Rectangle | Polygon | Wall | Ellipse, '''
    }
}
CENTRE, RADII, YAW = (0.0, 0.75), (0.6, 0.3), 0.4
GIVEN = "{shape: ellipse, center: [0.0, 0.75], radii: [0.6, 0.3], yaw: 0.4}"


def outline(count: int) -> np.ndarray:
    angle = np.linspace(0.0, 2.0 * np.pi, count)
    x, y = RADII[0] * np.cos(angle), RADII[1] * np.sin(angle)
    turned = np.cos(YAW) * x - np.sin(YAW) * y, np.sin(YAW) * x + np.cos(YAW) * y
    return np.stack(turned, axis=1) + CENTRE


def check(folder: Path) -> None:
    path = folder / "map.yaml"
    path.write_text(MAP.replace("{shape: circle, center: [0.0, 0.55], radius: 0.3}", GIVEN), encoding="utf-8")
    world = load_map(path)
    points = np.random.default_rng(0).uniform(-2.0, 2.0, (200, 2))
    true = np.linalg.norm(points[:, None] - outline(20_000), axis=2).min(axis=1)
    found = Scenes.of(world, [None]).clearance(points, np.zeros(200, np.int64))
    walls = 3.0 - np.abs(points).max(axis=1)
    outside = found > 0.0
    assert outside.sum() > 150
    assert (found <= np.minimum(true, walls) + 1e-6)[outside].all()
    assert (found >= np.minimum(true, walls) - 0.01)[outside].all()
    assert (
        Scenes.of(world, [None])
        .blocked(outline(200) * 0.9 + 0.1 * np.array(CENTRE), np.zeros(200, np.int64))
        .all()
    )

    result = verify(write_policy(folder / "policy.onnx"), world, eps=0.01)
    near = np.linalg.norm(result.poses[:, None, :2] - outline(2000), axis=2).min(axis=1)
    assert 0 < (result.verdict == "safe").sum() < len(near)
    assert (near[result.verdict == "safe"] > world.clearance.collision).all()

    path.write_text(path.read_text("utf-8").replace("[0.6, 0.3]", "[0.6, -0.3]"), encoding="utf-8")
    with pytest.raises(
        MapError, match=r"map.yaml:5: obstacles\[0\].radii\[1\]: input should be greater than 0"
    ):
        load_map(path)
    assert MapFile.model_json_schema()["$defs"]["Ellipse"]["required"] == ["shape", "center", "radii"]
