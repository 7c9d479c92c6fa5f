"""Policies and maps by name: an existing path wins, and a wrong name is answered with the right ones."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

import viatool
from viatool.errors import ConfigurationError, MapError, PolicyError
from viatool.samples import ERRORS, MAPS, POLICIES
from viatool.world import ROBOTS

ROOT = Path(__file__).resolve().parents[1]


def test_the_samples_are_those_of_the_checkout() -> None:
    assert {"via", "via-64", "via-tanh", "td3"} <= set(POLICIES.names())
    assert {"lab", "office", "corridor", "warehouse", "lab.ros", "lab-grid"} <= set(MAPS.names())


@pytest.mark.parametrize("name", ERRORS.names())
def test_an_error_model_of_a_robot_states_its_source_and_nothing_without_one(name: str) -> None:
    model, text = viatool.load_errors(name), ERRORS.find(name).read_text(encoding="utf-8")
    assert name in ROBOTS
    assert model.source == name
    assert any(model.stated())
    assert "# Source: " in text


def test_the_lidar_of_a_turtlebot3_is_within_its_data_sheet() -> None:
    lidar = viatool.load_errors("turtlebot3_burger").sensor["lidar"]
    sheets = (  # from, to, metres, share: LDS-01 with accuracy and precision, LDS-02
        (0.12, 0.499, 0.025, 0.0), (0.5, 3.5, 0.0, 0.085), (0.16, 0.3, 0.01, 0.0), (0.3, 6.0, 0.0, 0.03),
        (6.0, 8.0, 0.0, 0.05),
    )  # fmt: skip
    for first, last, metres, share in sheets:
        for distance in (first, last):
            assert metres + share * distance <= lidar.absolute + lidar.relative * distance


def test_an_error_model_that_nobody_has_is_answered_with_those_that_there_are() -> None:
    with pytest.raises(ConfigurationError, match="husky"):
        viatool.load_errors("roomba")


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
    assert "td3, td7, via, via-256, via-64, via-mission, via-tanh" in error.value.hint
    with pytest.raises(MapError) as mistake:
        viatool.load_map("lub")
    assert "corridor, " in mistake.value.hint
