"""A kind of node that some pass over a network forgot fails type checking, in that pass."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
NETWORK = ROOT / "viatool/policy/network.py"
PASSES = {
    "policy/assembly.py": {"renumbered"},
    "policy/inspection.py": {"_kind", "_parameters"},
    "policy/maps.py": {"_step"},
    "policy/network.py": {"_evaluate", "_problem_of_sizes"},
    "policy/self_check.py": {"_error"},
    "policy/told_apart.py": {"_copies", "_taken"},
    "taylor/derivatives.py": {"_bounds_pulled_back", "_pulled_back"},
    "taylor/deviation.py": {"_exact_on_program", "_image", "_passed_on"},
    "taylor/head.py": {"_increasing"},
    "taylor/outputs.py": {"_image"},
    "taylor/packed.py": {"_node_is_covered"},
    "taylor/propagation.py": {"_enclose"},
    "taylor/rounding.py": {"own_error"},
}
UNION = "Node = Input | Affine"
NEW_KIND = '''
@dataclass(frozen=True, eq=False)
class Remainder:
    """A kind that no pass knows."""

    source: int
    size: int
    precision: Precision = "float32"

    @property
    def sources(self) -> tuple[int, ...]:
        """Return the indices of the nodes that this node reads."""
        return (self.source,)


Node = Remainder | Input | Affine'''


def functions(path: Path) -> dict[str, ast.FunctionDef]:
    tree = ast.parse(path.read_text())
    return {node.name: node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)}


def test_no_dispatch_over_nodes_has_a_default() -> None:
    for path in sorted(ROOT.glob("viatool/*/*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Match) and ast.unparse(node.subject) == "node":
                patterns = [case.pattern for case in node.cases]
                assert not any(isinstance(p, ast.MatchAs) and p.pattern is None for p in patterns), path


@pytest.mark.slow
def test_a_new_kind_of_node_fails_type_checking_in_every_pass(
    tmp_path: Path, pytestconfig: pytest.Config
) -> None:
    text = NETWORK.read_text()
    assert text.count(UNION) == 1
    extended = tmp_path / "network.py"
    extended.write_text(text.replace(UNION, NEW_KIND))
    checked = pytestconfig.cache.mkdir("types") if pytestconfig.cache else tmp_path / "types"
    command = [sys.executable, "-m", "mypy", "--cache-dir", str(checked), "--no-error-summary"]
    command += ["--shadow-file", str(NETWORK), str(extended), "-p", "viatool.policy", "-p", "viatool.taylor"]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    found: dict[str, set[int]] = {}
    for file, line in re.findall(
        r"^viatool/(\S+?):(\d+): error: Missing return statement", run.stdout, re.MULTILINE
    ):
        found.setdefault(file, set()).add(int(line))
    assert sorted(found) == sorted(PASSES), run.stdout + run.stderr
    for file, names in PASSES.items():
        source = extended if file == "policy/network.py" else ROOT / "viatool" / file
        assert {functions(source)[name].lineno for name in names} == found[file], file
