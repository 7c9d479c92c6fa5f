"""The maps of the repository: what the scripts write, and what holds of it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import shapely
from PIL import Image

from viatool.world import Scenes, load_map

MAPS = Path("maps")
NAMES = ("corridor", "lab", "office", "warehouse")
HAND_WRITTEN = {"clutter.yaml", "room.yaml"}


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("maps")
    for name in ("make_lab.py", "make_maps.py", "lab.yaml"):
        shutil.copy(MAPS / name, folder)
    environment = os.environ | {"PYTHONPATH": str(Path.cwd())}
    subprocess.run([sys.executable, folder / "make_maps.py"], check=True, env=environment)
    return folder


def test_the_script_writes_the_maps_as_they_are(written: Path) -> None:
    names = {path.name for path in written.iterdir()} - {"__pycache__"}
    assert names | HAND_WRITTEN == {path.name for path in MAPS.iterdir()} - {"__pycache__"}
    for path in sorted(written.glob("*.yaml")):
        assert path.read_text(encoding="utf-8") == (MAPS / path.name).read_text(encoding="utf-8")
    for path in [*written.glob("*.pgm"), *written.glob("*.png")]:
        with Image.open(path) as new, Image.open(MAPS / path.name) as old:
            assert np.array_equal(np.asarray(new), np.asarray(old))
        assert (MAPS / path.name).stat().st_size < 200_000


@pytest.mark.parametrize("name", NAMES)
def test_every_map_has_ten_scenarios_and_a_generator(name: str) -> None:
    for path in (MAPS / f"{name}.yaml", MAPS / f"{name}-grid.yaml"):
        world = load_map(path)
        assert len({scenario.name for scenario in world.scenarios}) == 10
        assert world.generator is not None
        assert len(world.generator.draw(3, 0)) == 3
    assert not load_map(MAPS / f"{name}.ros.yaml").scenarios


@pytest.mark.parametrize("name", NAMES)
def test_the_occupancy_map_covers_the_native_one_by_less_than_a_cell(name: str) -> None:
    native = Scenes.of(load_map(MAPS / f"{name}.yaml"), [None]).shapely(0, margin=0.2)
    grid = load_map(MAPS / f"{name}-grid.yaml").obstacles.grid
    assert grid is not None
    cells = grid.polygons()
    assert native.difference(cells.buffer(1e-9)).area < 1e-6
    assert cells.difference(native.buffer(2.0**0.5 * grid.resolution + 1e-9)).difference(
        shapely.box(*native.bounds).boundary.buffer(0.2)
    ).area < 1e-6  # fmt: skip
    points = np.array([scenario.start[:2] for scenario in load_map(MAPS / f"{name}.yaml").scenarios])
    index = np.zeros(len(points), int)
    exact = Scenes.of(load_map(MAPS / f"{name}.yaml"), [None]).clearance(points, index)
    rough = Scenes.of(load_map(MAPS / f"{name}-grid.yaml"), [None]).clearance(points, index)
    assert (rough <= exact + 1e-9).all()
    assert (rough >= exact - 2.0**0.5 * grid.resolution - 1e-9).all()
