"""Small runs of the command line in a folder with a map and policies."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from tests.hall import MAP, write_policy
from viatool.cli import main


@pytest.fixture(scope="session")
def hall(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with ``policy.onnx`` and ``map.yaml``."""
    folder = tmp_path_factory.mktemp("hall")
    write_policy(folder / "policy.onnx")
    write_policy(folder / "foreign.onnx", specification=False)
    write_policy(folder / "wide.onnx", inputs=30)
    (folder / "map.yaml").write_text(MAP, encoding="utf-8")
    return folder


@pytest.fixture
def run(hall: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Result]:
    """Run viatool in the folder of `hall`."""
    monkeypatch.chdir(hall)
    return lambda *arguments: CliRunner().invoke(main, [str(argument) for argument in arguments])
