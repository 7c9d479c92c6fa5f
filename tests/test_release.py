"""What is released works in an empty environment, away from the checkout."""

from __future__ import annotations

import subprocess
import sys
import tarfile
import venv
import zipfile
from pathlib import Path

import numpy as np
import pytest

from viatool import engine
from viatool.samples import ERRORS, MAPS, POLICIES

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the source archive, and the wheel that was built from it."""
    folder = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "-m", "build", "--no-isolation", "--outdir", folder, ROOT]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout + run.stderr
    return folder


def test_the_wheel_verifies_a_sample_away_from_the_checkout(built: Path, tmp_path: Path) -> None:
    (wheel,) = built.glob("*.whl")
    venv.create(tmp_path / "env")
    (packages,) = tmp_path.glob("env/lib/python*/site-packages")
    zipfile.ZipFile(wheel).extractall(packages)
    (packages / "dependencies.pth").write_text(str(Path(np.__file__).parents[1]), encoding="utf-8")

    def python(*arguments: str) -> str:
        command = [tmp_path / "env" / "bin" / "python", *arguments]
        run = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert run.returncode == 0, run.stderr
        return run.stdout

    program = (
        "from viatool.samples import ERRORS, MAPS, POLICIES; "
        "print(MAPS.folder, *MAPS.names(), *POLICIES.names(), *ERRORS.names())"
    )
    folder, *names = python("-c", program).split()
    assert Path(folder) == packages / "viatool" / "samples" / "maps"
    assert names == [*MAPS.names(), *POLICIES.names(), *ERRORS.names()]
    page = ("--output", "html:report.html")  # the page's script and style are in the wheel
    report = python("-m", "viatool", "verify", "via", "--map", "lab-grid", "--eps", "0.01", *page)
    assert report.splitlines()[1].startswith("via on lab-grid, eps 0.01")
    assert f"engine {engine.chosen_engine()}" in python("-m", "viatool", "--version").splitlines()


def test_the_source_archive_holds_what_the_checks_need(built: Path) -> None:
    (archive,) = built.glob("*.tar.gz")
    with tarfile.open(archive) as content:
        names = {name.partition("/")[2] for name in content.getnames()}
    needed = ("README.md", "CHANGELOG.md", "CITATION.cff", "docs/conf.py", "tests/test_release.py", ".ci/run")
    assert set(needed) <= names
    assert not any(name.startswith(("docs/_build", ".venv", "runs/")) for name in names)
