"""Counterexamples from verify to replay, and footprints as they are written."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import Result

from tests.hall import MAP

Run = Callable[..., Result]
VERIFY = ("verify", "policy.onnx", "--map", "map.yaml", "--eps", "0.01", "--quiet")


@pytest.fixture
def witnesses(run: Run, tmp_path: Path) -> Path:
    path = tmp_path / "witnesses.json"
    assert run(*VERIFY, "--only-contested", "--close", "0", "--output", f"witnesses:{path}").exit_code == 0
    assert len(json.loads(path.read_text())["witnesses"]) >= 1
    return path


def test_every_witness_violates_again_and_says_when_and_where(run: Run, witnesses: Path) -> None:
    result = run("replay", witnesses)
    assert result.exit_code == 0, result.output
    count = len(json.loads(witnesses.read_text())["witnesses"])
    assert f"{count} of {count} witnesses violate" in result.stdout
    assert result.stdout.count("circle of radius 0.3 m") == count
    assert "NO" not in result.stdout


def test_witnesses_of_close_places_are_run_again_and_told_apart(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "witnesses.json"
    assert run(*VERIFY, "--close", "20", "--output", f"witnesses:{path}").exit_code == 0
    close = [entry for entry in json.loads(path.read_text())["witnesses"] if entry.get("close")]
    result = run("replay", path)
    assert (result.exit_code, "NO" in result.stdout) == (0, False)
    assert result.stdout.count("close ") == len(close) > 0


@pytest.mark.parametrize(("suffix", "mark"), [("png", b"\x89PNG"), ("svg", b"<?xml"), ("pdf", b"%PDF")])
def test_witnesses_are_drawn(run: Run, witnesses: Path, tmp_path: Path, suffix: str, mark: bytes) -> None:
    picture = tmp_path / f"replay.{suffix}"
    assert run("replay", witnesses, "-q", "--output", picture).exit_code == 0
    assert picture.read_bytes().startswith(mark)


def test_a_witness_that_no_longer_violates_gives_exit_1(run: Run, witnesses: Path, tmp_path: Path) -> None:
    repaired = tmp_path / "repaired.yaml"
    repaired.write_text(MAP.replace("radius: 0.3", "radius: 0.1"))
    result = run("replay", witnesses, "--map", repaired)
    assert result.exit_code == 1
    assert "0 of" in result.stdout
    assert "the map is not the one" in result.stderr


@pytest.mark.parametrize("change", [lambda d: d.pop("rules"), lambda d: d["witnesses"][0].update(pose=[0])])
def test_what_cannot_be_replayed_gives_exit_2(
    run: Run, witnesses: Path, change: Callable[[dict], object]
) -> None:
    document = json.loads(witnesses.read_text())
    change(document)
    witnesses.write_text(json.dumps(document))
    result = run("replay", witnesses)
    assert result.exit_code == 2
    assert "is not a witness file" in result.stderr
    assert run("replay", "none.json").exit_code == 2
    assert run("replay", "map.yaml").exit_code == 2


def test_a_witness_of_another_policy_gives_exit_2(run: Run, witnesses: Path) -> None:
    result = run("replay", witnesses, "--policy", "wide.onnx")
    assert result.exit_code == 2
    assert "26" in result.stderr


def assumed_footprint(run: Run, tmp_path: Path, footprint: str) -> str:
    path = tmp_path / "report.json"
    result = run(*VERIFY, "--only-contested", "--footprint", footprint, "--output", f"json:{path}")
    assert result.exit_code == 0, result.output
    return str(json.loads(path.read_text())["assumptions"]["footprint"])


def test_a_footprint_is_a_point_a_radius_corners_or_a_file(run: Run, tmp_path: Path) -> None:
    corners = tmp_path / "corners.yaml"
    assert assumed_footprint(run, tmp_path, "0.105") == "disc of radius 0.105 m"
    assert assumed_footprint(run, tmp_path, "point") == "point (the LiDAR origin)"
    assert assumed_footprint(run, tmp_path, "-0.1,-0.1 0.1,-0.1 0.1,0.1") == "polygon of 3 corners"
    for text in ("[[-0.1, -0.1], [0.1, -0.1], [0, 0.2]]", 'footprint: "[[-0.1, -0.1], [0.1, -0.1], [0, 1]]"'):
        corners.write_text(text)
        assert assumed_footprint(run, tmp_path, str(corners)) == "polygon of 3 corners"


@pytest.mark.parametrize(
    "footprint", ["round", "-1", "0", "0,0 1,1", "0,0 1,0 x,1", "map.yaml", "0,0 1,0 2,0"]
)
def test_what_is_no_footprint_gives_exit_2(run: Run, footprint: str) -> None:
    result = run(*VERIFY, "--footprint", footprint)
    assert result.exit_code == 2
    assert "Traceback" not in result.output


def test_delay_and_interval_ask_for_more(run: Run, tmp_path: Path) -> None:
    """Of the same states, as an ideal robot drove them."""
    safe, recording = [], tmp_path / "run.npz"
    assert run("simulate", *VERIFY[1:4], "--output", str(recording), "--quiet").exit_code == 0
    for more in ((), ("--delay", "0.05"), ("--interval", "0.15"), ("--criterion", "braking")):
        path = tmp_path / "report.json"
        asked = (*VERIFY, "--trajectory", str(recording), "--only-contested", *more)
        assert run(*asked, "--output", f"json:{path}").exit_code == 0
        safe.append(json.loads(path.read_text())["verdicts"]["safe"])
    assert max(safe[1:]) < safe[0]
