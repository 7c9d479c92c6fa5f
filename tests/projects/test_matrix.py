"""The cells of a project: what the file says, what wins, and what is refused with its line."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from viatool.cli.run import commands_of_checks
from viatool.errors import ConfigurationError
from viatool.projects import ProjectCell, expand, find_project, load_project

Expand = Callable[..., tuple[ProjectCell, ...]]

HEAD = 'policies = ["via", "td3"]\nmaps = ["lab", "maps/hall.yaml"]\n'


@pytest.fixture
def cells(tmp_path: Path) -> Expand:
    """Return what makes the cells of a project file with that text."""

    def of(
        text: str, overrides: Mapping[str, Any] | None = None, name: str = "viatool.toml"
    ) -> tuple[ProjectCell, ...]:
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return expand(load_project(path), commands_of_checks(), overrides)

    return of


def words(cell: ProjectCell) -> list[str]:
    return cell.arguments(commands_of_checks())


def test_a_check_is_asked_of_every_policy_on_every_map(cells: Expand) -> None:
    found = cells(HEAD + '[[check]]\nname = "drive"\neps = 0.01\n')
    assert [cell.name for cell in found] == [
        "drive/via/lab", "drive/via/hall", "drive/td3/lab", "drive/td3/hall",
    ]  # fmt: skip
    assert words(found[1]) == ["via", "--map=maps/hall.yaml", "--eps=0.01"]


def test_axes_multiply_and_exclusions_take_away(cells: Expand) -> None:
    found = cells(
        HEAD
        + """
[[check]]
eps = 0.01
matrix = { criterion = ["swept", "braking"], errors = ["husky", "errors/mine.yaml"] }
exclude = [{ policy = "td3" }, { map = "hall", criterion = "braking" }]
include = [{ policy = "td3", map = "lab", eps = 0.02, gate = { max-unsafe = 3 } }]
"""
    )
    assert [cell.name for cell in found] == [
        "verify/via/lab/criterion=swept/errors=husky",
        "verify/via/lab/criterion=swept/errors=mine",
        "verify/via/lab/criterion=braking/errors=husky",
        "verify/via/lab/criterion=braking/errors=mine",
        "verify/via/hall/criterion=swept/errors=husky",
        "verify/via/hall/criterion=swept/errors=mine",
        "verify/td3/lab/eps=0.02",
    ]
    assert words(found[-1]) == ["td3", "--map=lab", "--eps=0.02", "--max-unsafe=3"]


def test_the_nearer_word_wins_and_the_command_line_wins_over_all(cells: Expand) -> None:
    text = """
policies.via = { file = "via", seed = 2 }
maps = ["lab"]
[defaults]
eps = 0.01
seed = 1
horizon = 5
gate = { fail-under = 0.5 }
[[check]]
eps = { lidar = 0.03, goal_distance = 0.1 }
gate = { fail-under = [0.9, "danger=0.8"], min-contested = 2 }
[[check]]
kind = "certify"
[[check]]
kind = "mission"
start-error = [0.02, 0.01]
"""
    verify, certify, mission = cells(text)
    assert words(verify)[2:] == [
        "--eps=lidar=0.03", "--eps=goal_distance=0.1", "--seed=2", "--horizon=5", "--fail-under=0.9",
        "--fail-under=danger=0.8", "--min-contested=2",
    ]  # fmt: skip
    assert words(certify)[2:] == ["--eps=0.01", "--seed=2", "--fail-under=0.5"]  # which knows no horizon
    assert "--start-error=0.02,0.01" in words(mission)
    verify, certify, _ = cells(text, {"eps": ["0.05"], "fail-under": ["1"], "horizon": "9"})
    assert words(verify)[2:] == [
        "--eps=0.05",
        "--seed=2",
        "--horizon=9",
        "--fail-under=1",
        "--min-contested=2",
    ]
    assert words(certify)[2:] == ["--eps=0.05", "--seed=2", "--fail-under=1"]


def test_an_option_of_the_command_line_leaves_one_value_of_an_axis(cells: Expand) -> None:
    text = HEAD + '[[check]]\neps = 0.01\nmatrix.criterion = ["swept", "braking"]\n'
    found = cells(text, {"criterion": "sampled"})
    assert len(found) == 4
    assert all("--criterion=sampled" in words(cell) for cell in found)


def test_pyproject_holds_the_same_below_its_table(cells: Expand, tmp_path: Path) -> None:
    text = '[tool.viatool]\npolicies = ["via"]\nmaps = ["lab"]\n[[tool.viatool.check]]\neps = 0.01\n'
    assert [cell.name for cell in cells(text, name="pyproject.toml")] == ["verify/via/lab"]
    below = tmp_path / "src" / "deep"
    below.mkdir(parents=True)
    assert find_project(below) == tmp_path / "pyproject.toml"
    (tmp_path / "viatool.toml").write_text("", encoding="utf-8")
    assert find_project(below) == tmp_path / "viatool.toml"
    with pytest.raises(ConfigurationError, match=r"pyproject.toml:5: .*'epss' is not a known key"):
        cells(text.replace("eps =", "epss ="), name="pyproject.toml")


@pytest.mark.parametrize(
    ("text", "line", "what"),
    [
        ("polices = ['via']\n" + HEAD + "[[check]]\neps = 1.0\n", 1, "polices: is not a known key"),
        (HEAD + "[[check]]\nepss = 0.01\n", 4, "'epss' is not a known key"),
        (HEAD + "[defaults]\nhorizn = 3\n[[check]]\n", 4, "'horizn' is not a known key"),
        (HEAD + "[[check]]\n[check.gate]\neps = 0.01\n", 3, "'eps' is not a known key of a gate"),
        (HEAD + "[[check]]\noutput = 'json:a'\n", 4, "'output' is not given to a cell"),
        (HEAD + "[[check]]\nkind = 'verfy'\n", 3, "'verfy' is no kind of check"),
        (HEAD + "[[check]]\neps = -1\n", 3, "not a finite radius of at least 0"),
        (HEAD + "[[check]]\ncriterion = 'swpt'\n", 3, "is not one of"),
        (HEAD + "[[check]]\nonly-contested = 'yes'\n", 4, "'only-contested' is 'yes'"),
        (HEAD + "[[check]]\nexclude = [{ policy = 'tdd' }]\n", 3, "no cell has policy = 'tdd'"),
        (HEAD + "[[check]]\nexclude = [{ polcy = 'td3' }]\n", 3, "'polcy' is no axis"),
        (HEAD + "[[check]]\ninclude = [{ policy = 'td3' }]\n", 3, "lacks its 'map'"),
        (HEAD + "[[check]]\nmatrix.criterionn = ['swept']\n", 3, "'criterionn' is not a known key"),
        (HEAD + "reports = ['pfd']\n[[check]]\n", None, "'pfd' is no format"),
        (HEAD + "[[check]]\n[[check]]\n", None, "two checks are called 'verify'"),
        (HEAD, None, "check: field required"),
        ("[[check]]\n", 1, "has no cells"),
    ],
)
def test_what_is_wrong_is_named_with_its_line(cells: Expand, text: str, line: int | None, what: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        cells(text)
    place = "viatool.toml" if line is None else f"viatool.toml:{line}:"
    assert place in caught.value.message
    assert what in caught.value.message
    assert caught.value.hint


def test_two_files_of_one_name_need_names_of_their_own(cells: Expand) -> None:
    with pytest.raises(ConfigurationError, match=r"a/x.onnx.*b/x.onnx"):
        cells("policies = ['a/x.onnx', 'b/x.onnx']\nmaps = ['lab']\n[[check]]\n")
    named = "policies = { old = 'a/x.onnx', new = 'b/x.onnx' }\nmaps = ['lab']\n[[check]]\n"
    assert [cell.policy_file for cell in cells(named)] == ["a/x.onnx", "b/x.onnx"]


ACCEPTED = """
[[accepted]]
cell = "verify/via"
verdict = "unsafe"
state = 3
reason = "why"
expires = 2027-01-31
"""


def test_accepted_findings_reach_the_cells_that_they_name(cells: Expand) -> None:
    found = cells(HEAD + "[[check]]\n" + ACCEPTED)
    assert [(cell.name, len(cell.accepted)) for cell in found] == [
        ("verify/via/lab", 1), ("verify/via/hall", 1), ("verify/td3/lab", 0), ("verify/td3/hall", 0),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("before", "after", "what"),
    [
        ('"verify/via"', '"verify/vi"', "no cell is 'verify/vi'"),
        ('cell = "verify/via"\n', "", "names no cell"),
        ("expires = 2027-01-31", 'expires = "2027-01-31"', "expires"),
        ("expires = 2027-01-31\n", "", "expires: field required"),
        ('reason = "why"\n', "", "reason: field required"),
        ('reason = "why"', 'reason = " "', "says no reason"),
        ("state = 3\n", "", "by one of 'state', 'scenario' and 'place'"),
        ("state = 3\n", 'state = 3\nscenario = "a"\n', "by one of 'state', 'scenario' and 'place'"),
        ('verdict = "unsafe"\n', "", "verdict: field required"),
        ("state = 3\n", "stat = 3\n", "is not a known key"),
    ],
)
def test_an_accepted_finding_says_which_why_and_until_when(
    cells: Expand, before: str, after: str, what: str
) -> None:
    assert before in ACCEPTED
    with pytest.raises(ConfigurationError) as caught:
        cells(HEAD + "[[check]]\n" + ACCEPTED.replace(before, after))
    assert what in caught.value.message
    assert "viatool.toml:" in caught.value.message
