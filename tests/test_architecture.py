"""The floors of the house, the public names, and a top level that stays light."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

import pytest

import viatool

ROOT = Path(__file__).resolve().parents[1]
HEAVY = (
    "torch",
    "pybullet",
    "sympy",
    "matplotlib",
    "shapely",
    "scipy",
    "onnx",
    "onnxruntime",
    "numpy",
    "pydantic",
    "rich",
)
PUBLIC = [
    "Decision",
    "ErrorModel",
    "Monitor",
    "Policy",
    "ReachableSet",
    "Result",
    "StateVerdict",
    "Trajectory",
    "Verifier",
    "WorldMap",
    "__version__",
    "certify",
    "draw_map",
    "draw_result",
    "load_errors",
    "load_map",
    "load_policy",
    "load_trajectory",
    "margin",
    "mission",
    "reach",
    "roll_out",
    "verify",
]


def test_every_room_imports_from_lower_floors_only() -> None:
    script = Path(sys.executable).with_name("lint-imports")
    run = subprocess.run([script, "--no-cache"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout + run.stderr


def test_the_public_names_are_these() -> None:
    assert sorted(viatool.__all__) == PUBLIC
    assert dir(viatool) == PUBLIC
    assert all(getattr(viatool, name) is not None for name in PUBLIC)


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="verfy"):
        viatool.verfy  # noqa: B018  # reading the attribute is the test


@pytest.mark.parametrize(
    "program",
    [
        "import viatool",
        "from viatool.cli import main\ntry:\n    main(['--help'])\nexcept SystemExit:\n    pass",
    ],
    ids=["import viatool", "viatool --help"],
)
def test_the_top_level_imports_nothing_heavy(program: str) -> None:
    probe = f"{program}\nimport sys\nprint('LOADED', *sorted({HEAVY!r} & sys.modules.keys()))"
    probe = probe.replace(repr(HEAVY), repr(set(HEAVY)))
    run = subprocess.run([sys.executable, "-c", probe], cwd=ROOT, capture_output=True, text=True, check=True)
    assert run.stdout.splitlines()[-1].split() == ["LOADED"]


def test_bounds_load_what_they_need(tmp_path: Path) -> None:
    """Nobody waits for sympy, for geometry or for reports to learn what a policy may command."""
    table = tmp_path / "observation.csv"
    table.write_text(",".join(["1.0"] * viatool.load_policy("via").input_size) + "\n")
    program = (
        f"from viatool.cli import main\ntry:\n    main(['bounds', 'via', {str(table)!r}, '--eps', '0.01'])\n"
    )
    program += "except SystemExit as end:\n    assert not end.code\n"
    needless = {
        "sympy",
        "scipy",
        "shapely",
        "matplotlib",
        "torch",
        "viatool.simulate",
        "viatool.report.kinds",
    }
    probe = f"{program}import sys\nprint('LOADED', *sorted({needless!r} & sys.modules.keys()))"
    run = subprocess.run([sys.executable, "-c", probe], cwd=ROOT, capture_output=True, text=True, check=True)
    assert run.stdout.splitlines()[-1].split() == ["LOADED"]


def test_torch_and_pybullet_stay_in_their_rooms() -> None:
    allowed = {"torch": ("train", "importing"), "pybullet": ("simulate",)}
    for path in sorted((ROOT / "viatool").rglob("*.py")):
        room = path.relative_to(ROOT / "viatool").parts[0]
        for line in path.read_text(encoding="utf-8").splitlines():
            for package, homes in allowed.items():
                if line.strip().startswith((f"import {package}", f"from {package}")):
                    assert room in homes, f"{path}: {line.strip()}"


def test_ci_runs_the_tests_of_the_readme_and_those_that_are_slow() -> None:
    steps = [line for line in (ROOT / ".ci" / "run").read_text().splitlines() if line.startswith("step ")]
    assert steps[-2:] == ['step bash -c "$tests"', 'step bash -c "$tests -m slow"']
    marked = [path for path in (ROOT / "tests").rglob("test_*.py") if "@pytest.mark.slow" in path.read_text()]
    assert len(marked) > 1  # pytest fails where it finds nothing to run


def test_the_changelog_and_the_citation_name_the_version() -> None:
    assert f"## {viatool.__version__} " in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert f"version: {viatool.__version__}" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")


def test_every_public_class_has_a_name_of_its_own() -> None:
    places = defaultdict(list)
    for path in sorted((ROOT / "viatool").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(path.relative_to(ROOT).as_posix())
    assert {name: files for name, files in places.items() if len(files) > 1} == {}
