from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

import viatool
from tests.hall import MAP, write_policy
from viatool.report import Output, write_outputs
from viatool.report.states.run import StatesRun
from viatool.simulate import Places


def write_evidence(folder: Path, policy: Path, world_map: Path, **asked: object) -> Path:
    """Verify, and write the evidence of it."""
    result = viatool.verify(policy, world_map, **asked)
    write_outputs(StatesRun(result), [Output("evidence", folder)])
    return folder


@pytest.fixture(scope="session")
def hall(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a policy and a map in which some states are unsafe."""
    folder = tmp_path_factory.mktemp("hall")
    write_policy(folder / "policy.onnx")
    (folder / "map.yaml").write_text(MAP, encoding="utf-8")
    return folder


@pytest.fixture(scope="session")
def whole(hall: Path) -> Path:
    """Return evidence of random places in the hall, which nobody changes."""
    return write_evidence(
        hall / "evidence", hall / "policy.onnx", hall / "map.yaml", eps=0.01, places=Places(count=1500)
    )


@pytest.fixture
def driven(hall: Path, tmp_path: Path) -> Path:
    """Return evidence of a drive past the obstacle, to be changed."""
    return write_evidence(tmp_path / "driven", hall / "policy.onnx", hall / "map.yaml", eps=0.01)


@pytest.fixture
def folder(whole: Path, tmp_path: Path) -> Path:
    """Return a copy to be changed."""
    return Path(shutil.copytree(whole, tmp_path / "evidence"))


def hashed_again(folder: Path) -> None:
    """Make the manifest say what is there now, as somebody would who covers a change."""
    path = folder / "manifest.json"
    manifest = json.loads(path.read_text())
    there = sorted(file for file in folder.rglob("*") if file.is_file() and file != path)
    manifest["files"] = {
        file.relative_to(folder).as_posix(): {
            "sha256": hashlib.sha256(file.read_bytes()).hexdigest(),
            "bytes": file.stat().st_size,
        }
        for file in there
    }
    path.write_text(json.dumps(manifest))


def edited(path: Path, change: Callable[[dict], None]) -> None:
    """Change a JSON file."""
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))
