"""What ``viatool explain`` says of missions, cells and margins: what to refine, and what only another policy mends."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from tests.hall import MAP, write_policy
from viatool import load_map, load_policy
from viatool.cli import main
from viatool.missions import MissionLimits, mission
from viatool.places import Resolution, SearchBudget, certify
from viatool.report import Output, load_document
from viatool.report.margins.document import MarginsDocument
from viatool.report.missions.document import MissionsDocument
from viatool.report.outputs import content_of
from viatool.report.places.run import PlacesRun


@pytest.fixture(scope="module")
def hall(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("hall")
    write_policy(folder / "policy.onnx")
    (folder / "map.yaml").write_text(MAP, encoding="utf-8")
    return folder


def explained(*words: Any, code: int = 0) -> str:
    done = CliRunner().invoke(main, ["explain", *map(str, words)])
    assert done.exit_code == code, done.output
    return " ".join(done.output.split())


def missions(hall: Path, eps: dict[str, float], parts: int, start: float = -2.0) -> dict[str, Any]:
    world_map = load_map(hall / "map.yaml")
    there = replace(world_map.scenarios[1], start=(-1.5, start, 0.0), goal=(-0.6, start))
    limits = MissionLimits(0, parts, 0.06, 0.04, 0)
    return mission(
        hall / "policy.onnx",
        world_map,
        eps=eps,
        time_limit=5.0,
        scenarios=[there],
        limits=limits,
        explain_errors=True,
    ).to_json()


def test_a_mission_names_the_error_without_which_it_is_proved(hall: Path, tmp_path: Path) -> None:
    found = missions(hall, {"": 0.0, "goal_sine": 0.2, "goal_cosine": 0.01}, parts=2)
    (one,) = found["missions"]
    assert one["verdict"] == "unknown"
    assert one["needs"] == {
        "without_errors": "proved",
        "alone": ["eps of goal_sine"],
        "others": ["eps of goal_cosine"],
    }
    (proved,) = missions(hall, {"": 0.0, "goal_cosine": 0.01}, parts=2)["missions"]  # as it says
    assert proved["verdict"] == "proved"
    assert proved["needs"] is None
    path = tmp_path / "missions.json"
    path.write_text(json.dumps(found))
    assert "It is proved without eps of goal_sine, each alone, and all other errors" in explained(
        path, "--scenario", "clear"
    )


@pytest.mark.parametrize(
    ("needs", "words"),
    [
        (None, "was not asked: --explain-errors"),
        (("refuted", [], []), "fails without any error as well: the policy has to act otherwise"),
        (("unknown", [], []), "not proved without any error either, so that the bounds are what is too wide"),
        (("proved", [], ["a", "b"]), "not without one alone of a, b"),
        (("proved", [], []), "there was no time to ask"),
        (("proved", ["a", "b"], []), "proved without a or without b"),
    ],
)
def test_what_a_mission_takes_tells_the_policy_from_the_bounds(hall: Path, needs: Any, words: str) -> None:
    found = missions(hall, {"": 0.0}, parts=4000)
    found["missions"][0] |= {
        "verdict": "unknown",
        "reason": "too many parts",
        "needs": needs and dict(zip(("without_errors", "alone", "others"), needs, strict=True)),
    }
    assert words in MissionsDocument(found).explain("scenario", "clear")


@pytest.fixture(scope="module")
def cells(hall: Path) -> Path:
    room = load_map(Path("maps/room.yaml"))
    certificate = certify(
        load_policy(hall / "policy.onnx"), room, room.scenarios[0], eps=0.05, resolution=Resolution(0.3, 0),
        budget=SearchBudget(share=0.2), explain_errors=True,
    )  # fmt: skip
    path = hall / "cells.npz"
    path.write_bytes(b"".join(content_of(Output("cells", path), PlacesRun(certificate))))
    return path


@pytest.mark.parametrize(
    ("status", "words"),
    [
        ("refuted", "makes the program fail"),
        ("unknown", "finer ones (--smallest, --halvings) may prove it"),
        ("certified", "Nothing to explain"),
    ],
)
def test_every_cell_of_an_archive_says_why_it_is_not_certified(cells: Path, status: str, words: str) -> None:
    with np.load(cells) as archive:
        table = dict(archive)
    only = [row for row in np.flatnonzero(table["status"] == status).tolist() if alone(table, row)]
    row = only[0]
    middle = 0.5 * (table["lower"][row, :3] + table["upper"][row, :3])
    told = explained(cells, "--place", ",".join(map(str, middle)))
    assert words in told
    saved = table["fails_by"][row]
    if status != "certified":
        assert (
            f"certified without {saved.split(',')[0]}" if saved else "not certified without any single"
        ) in told


def alone(table: dict[str, Any], row: int) -> bool:
    """Tell whether all cells at the middle of one have its status."""
    middle = 0.5 * (table["lower"][row, :3] + table["upper"][row, :3])
    there = ((table["lower"][:, :3] <= middle) & (middle <= table["upper"][:, :3])).all(axis=1)
    return bool((table["status"][there] == table["status"][row]).all())


def test_a_place_without_a_cell_is_refused(cells: Path) -> None:
    assert "no cell holds" in explained(cells, "--place", "500,0,0", code=2)
    assert isinstance(load_document(cells), PlacesRun.__mro__[1])


@pytest.mark.parametrize(
    ("proved", "failing", "words"),
    [
        (None, 0.0, "the policy has to act otherwise here"),
        (None, None, "tighter bounds may prove it: try --refine split"),
        (0.1, 0.101, "a finer proof cannot help"),
        (0.1, 0.3, "tighter bounds (--refine split, --order 2) may raise what is proved"),
        (0.1, None, "the policy need not be at fault"),
        (0.5, None, "--most tries more"),
    ],
)
def test_margins_tell_what_to_refine_from_what_only_another_policy_mends(
    margins: dict[str, Any], tmp_path: Path, proved: float | None, failing: float | None, words: str
) -> None:
    (part,) = margins["margins"]
    part["contested_states"][0] |= {"certified": proved, "refuted": failing}
    number, close = (part["contested_states"][0][name] for name in ("state", "close"))
    path = tmp_path / "margins.json"
    path.write_text(json.dumps(margins))
    option = "--close" if close else "--state"
    assert words in explained(path, option, number)
    assert "no verdict depends on the policy" in explained(path, option, 10**6, code=2)
    listed = len(MarginsDocument(margins).failing.rows)
    assert listed == sum(one["certified"] is None for one in part["contested_states"])


@pytest.fixture
def margins(hall: Path) -> dict[str, Any]:
    from copy import deepcopy

    if not _made:
        from viatool.margins import margin
        from viatool.margins.result import document_of

        found = margin(hall / "policy.onnx", hall / "map.yaml", close=20, resolution=0.01)
        _made.append(document_of([found]))
    return deepcopy(_made[0])


_made: list[dict[str, Any]] = []
