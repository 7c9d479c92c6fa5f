"""A stored report that contradicts itself is not read, so that no gate passes on it."""

from __future__ import annotations

import copy
import json
from pathlib import Path

import pytest

import viatool
from tests.hall import MAP, write_policy
from viatool.errors import ConfigurationError
from viatool.report.kinds import load_document


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> dict:
    folder = tmp_path_factory.mktemp("hall")
    write_policy(folder / "policy.onnx")
    (folder / "map.yaml").write_text(MAP, encoding="utf-8")
    return viatool.verify(folder / "policy.onnx", folder / "map.yaml", eps=0.01).to_json()


def read(report: dict, folder: Path) -> None:
    path = folder / "report.json"
    path.write_text(json.dumps(report), encoding="utf-8")
    load_document(path)


def test_a_report_as_it_was_written_is_read(report: dict, tmp_path: Path) -> None:
    read(report, tmp_path)


@pytest.mark.parametrize("value", [1_000_000, True, "66", 1.5, -1, None])
@pytest.mark.parametrize(
    "place",
    [
        ("states",),
        ("verdicts", "safe"),
        ("verdicts", "unknown"),
        ("safety_rate", "overall", "safe"),
        ("safety_rate", "overall", "total"),
        ("safety_rate", "success", "total"),
        ("danger_rate", "overall", "total"),
    ],
    ids=".".join,
)
def test_counts_that_do_not_add_up_are_refused(
    report: dict, tmp_path: Path, place: tuple[str, ...], value: object
) -> None:
    changed = copy.deepcopy(report)
    part = changed
    for key in place[:-1]:
        part = part[key]
    part[place[-1]] = value
    with pytest.raises(ConfigurationError, match=r"report\.json"):
        read(changed, tmp_path)
