"""CONTRIBUTING's table of doors is true: every file is there, and a toy needs no other file than those it names."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest

from viatool.channels import kinds
from viatool.motion.kinematics import KINEMATICS
from viatool.report import FORMATS
from viatool.setting.criteria import CRITERIA

ROOT = Path(__file__).resolve().parents[1]
CHANGES = {
    "an activation": 2,
    "an operator": 1,
    "an observation kind": 3,
    "a kinematics": 4,
    "an obstacle shape": 1,
    "a criterion": 1,
    "a report format": 2,
    "a training method": 3,
}
"""How many files each may take at most."""
TOYS = {change: change.partition(" ")[2].replace(" ", "_") for change in CHANGES}
"""The module of `tests/doors/` that adds one."""


def doors() -> dict[str, list[str]]:
    """Return the cells of CONTRIBUTING's table by what is added: what to touch, what goes there, what else."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (an? [a-z ]+) \|(.*)\|$", text.partition("## Doors")[2], flags=re.MULTILINE)
    return {name: rest.split("|") for name, rest in rows}


def files(cell: str) -> list[str]:
    """Return the paths that a cell names."""
    return re.findall(r"`((?:viatool|tests|docs)/[^`]+)`", cell)


def test_there_is_a_door_for_each_of_eight_changes() -> None:
    assert list(doors()) == list(CHANGES)


@pytest.mark.parametrize("change", CHANGES)
def test_every_file_that_is_named_is_there_and_they_are_few(change: str) -> None:
    touched, _, others = doors()[change]
    assert 1 <= len(files(touched)) <= CHANGES[change]
    assert all(name.startswith("viatool/") for name in files(touched))
    for name in files(touched) + files(others):
        path = ROOT / name
        assert path.parent.is_dir() if path.stem == "NAME" else path.is_file(), name


def test_the_floors_are_those_that_are_checked() -> None:
    layers = re.search(
        r"^layers = \[(.*?)^\]", (ROOT / "pyproject.toml").read_text(encoding="utf-8"), re.S | re.M
    )
    assert layers is not None
    expected = [floor for floor in re.findall(r'"([^"]+)"', layers.group(1)) if floor != "__main__"]
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    shown = re.search(r"^    (cli >.*?)\n\n", text, re.S | re.M)
    assert shown is not None
    assert " ".join(shown.group(1).split()).split(" > ") == expected


@pytest.fixture
def copy(tmp_path: Path) -> Iterator[Path]:
    """Return a copy of the program, with the samples and the tests beside it."""
    half_written = shutil.ignore_patterns("*.pyc.*")  # by a process that compiles at this moment
    shutil.copytree(ROOT / "viatool", tmp_path / "viatool", ignore=half_written)
    for name in ("maps", "policies", "tests"):
        (tmp_path / name).symlink_to(ROOT / name, target_is_directory=True)
    yield tmp_path
    shutil.rmtree(tmp_path / "viatool")


def add(toy: ModuleType, copy: Path) -> None:
    """Write a toy's additions into a copy of the program."""
    for name, change in toy.FILES.items():
        path = copy / name.replace("NAME", getattr(toy, "NAME", ""))
        if isinstance(change, str):
            assert not path.exists()
            path.write_text(change, encoding="utf-8")
            continue
        text = path.read_text(encoding="utf-8")
        for before, after in change.items():
            assert text.count(before) == 1, f"{name} has no single {before!r}"
            text = text.replace(before, after)
        path.write_text(text, encoding="utf-8")


@pytest.mark.parametrize("change", TOYS)
def test_a_toy_works_that_touches_what_the_table_says_and_nothing_else(change: str, copy: Path) -> None:
    toy = import_module(f"tests.doors.{TOYS[change]}")
    assert list(toy.FILES) == files(doors()[change][0])
    add(toy, copy)
    work = copy / "work"
    work.mkdir()
    program = (
        "import sys, viatool, pathlib\n"
        f"assert pathlib.Path(viatool.__file__).is_relative_to({str(copy)!r})\n"
        f"from tests.doors.{TOYS[change]} import check\n"
        f"check(pathlib.Path({str(work)!r}))"
    )
    run = subprocess.run(
        [sys.executable, "-c", program],
        cwd=copy,
        env={**os.environ, "PYTHONPATH": str(copy)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stdout + run.stderr


def members() -> dict[str, list[str]]:
    """Return, for each registry of classes, the names of the classes in it."""
    return {
        "an observation kind": [kind.__name__ for kind in kinds().values()],
        "a kinematics": [type(known).__name__ for known in KINEMATICS.values()],
        "a criterion": [type(known).__name__ for known in CRITERIA.values()],
        "a report format": list(FORMATS.values()),
    }


@pytest.mark.parametrize("change", members())
def test_no_other_file_asks_for_a_member_by_its_class(change: str) -> None:
    """What only some members have is asked of the member; a ladder elsewhere would be one more file to touch."""
    homes = [Path(name) for name in files(doors()[change][0])]
    for path in sorted((ROOT / "viatool").rglob("*.py")):
        here = path.relative_to(ROOT)
        if here in homes or any(home.stem == "NAME" and home.parent == here.parent for home in homes):
            continue
        text = path.read_text(encoding="utf-8")
        for name in members()[change]:
            asked = r"isinstance\([^)]*\b{0}\b|type\([^)]*\) is {0}\b|case {0}\(".format(re.escape(name))
            assert not re.search(asked, text), f"{here} asks for {name}"


def test_no_file_compares_with_the_name_of_a_criterion_a_shape_or_a_method() -> None:
    from viatool.train.methods import METHODS
    from viatool.world.obstacle_shapes import SHAPES

    names = "|".join(
        map(re.escape, {*CRITERIA, *METHODS, *SHAPES} - {"circle", "polygon"})
    )  # also of footprints
    compared = re.compile(
        rf"""\b(criterion|method|shape)\b(\.name)? (==|!=|in|not in) \(?["']({names})["']"""
    )
    for path in sorted((ROOT / "viatool").rglob("*.py")):
        if path.parent.name == "studies":
            continue  # the paper's own experiments, which name the paper's methods
        found = compared.search(path.read_text(encoding="utf-8"))
        assert found is None, f"{path}: {found and found.group()}"
