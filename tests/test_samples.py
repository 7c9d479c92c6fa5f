"""Policies and maps by name: an existing path wins, and a wrong name is answered with the right ones."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

import viatool
from viatool.errors import MapError, PolicyError
from viatool.samples import MAPS, POLICIES

ROOT = Path(__file__).resolve().parents[1]


def test_the_samples_are_those_of_the_checkout() -> None:
    assert {"via", "via-64", "via-tanh", "td3"} <= set(POLICIES.names())
    assert {"lab", "office", "corridor", "warehouse", "lab.ros", "lab-grid"} <= set(MAPS.names())


def test_a_name_means_the_same_as_its_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert viatool.load_policy("via").sha256 == viatool.load_policy(ROOT / "policies" / "via.onnx").sha256
    assert viatool.load_map("lab").sha256 == viatool.load_map(ROOT / "maps" / "lab.yaml").sha256


def test_a_report_names_what_was_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert str(viatool.load_policy("via").path) == "via"
    assert str(viatool.load_map("lab").path) == "lab"
    assert viatool.load_map("lab").name == "lab"


def test_an_existing_path_wins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copy(ROOT / "policies" / "td3.onnx", "via")
    shutil.copy(ROOT / "maps" / "office.yaml", "lab")
    assert viatool.load_policy("via").sha256 == viatool.load_policy("td3").sha256
    assert viatool.load_map("lab").sha256 == viatool.load_map("office").sha256


@pytest.mark.parametrize("name", ["vai", "via.onnx", "./via", "../policies/via", ""])
def test_neither_a_path_nor_a_name(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(PolicyError) as error:
        viatool.load_policy(name)
    assert str(Path(name)) in error.value.message
    with pytest.raises(MapError) as mistake:
        viatool.load_map(name)
    assert str(Path(name)) in mistake.value.message


def test_the_hint_of_a_missing_file_lists_the_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(PolicyError) as error:
        viatool.load_policy("vai")
    assert "td3, td7, via, via-256, via-64, via-tanh" in error.value.hint
    with pytest.raises(MapError) as mistake:
        viatool.load_map("lub")
    assert "corridor, " in mistake.value.hint
