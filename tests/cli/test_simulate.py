"""``viatool simulate``: engines, robots, conditions, reports, films."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from click.testing import Result
from PIL import Image

from tests.needs import needs_pybullet
from viatool.policy import load_policy
from viatool.trajectory import load_trajectory

ROOT = Path(__file__).resolve().parents[2]
Run = Callable[..., Result]
DRIVE = ("simulate", "policy.onnx", "--map", "map.yaml")


def test_the_report_counts_the_episodes(run: Run, tmp_path: Path) -> None:
    target = tmp_path / "run.json"
    result = run(*DRIVE, "--episodes", "8", "--seed", "4", "-o", f"json:{target}")
    assert result.exit_code == 0, result.output
    document = json.loads(target.read_text(encoding="utf-8"))
    counts = [document[name]["count"] for name in ("success", "collision", "timeout")]
    outcomes = [episode["outcome"] for episode in document["episodes"]]
    assert counts == [outcomes.count(name) for name in ("success", "collision", "timeout")]
    assert sum(counts) == 8
    for name, number in zip(("success", "collision", "timeout"), counts, strict=True):
        low, high = document[name]["interval"]
        assert low <= number / 8 <= high
        assert f"{name} {number} (" in " ".join(result.stdout.split())
    assert sum(document["clearance"]["histogram"]["counts"]) == sum(
        round(episode["seconds"] / 0.1) for episode in document["episodes"]
    )
    assert document["engine"] == "kinematic"
    assert min(episode["path_length_ratio"] for episode in document["episodes"]) >= 1.0


@needs_pybullet
def test_a_trajectory_of_the_physics_engine_is_verified(run: Run, tmp_path: Path) -> None:
    states, report, document = tmp_path / "run.npz", tmp_path / "report.json", tmp_path / "run.json"
    result = run(
        *DRIVE, "--engine", "bullet", "--robot", "jackal", "--noise", "0.02", "--delay", "0.1", "--drift", "0.01",
        "-o", states, "-o", f"json:{document}",
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    text = " ".join(result.stdout.split())
    assert "bullet, jackal, LiDAR by ray tests, LiDAR noise 0.02 m, delay 0.1 s, odometry drift 0.01" in text
    trajectory = load_trajectory(states)
    previous = trajectory.observations[:, 23:25]
    same = trajectory.episode[1:] == trajectory.episode[:-1]
    asked = np.clip(trajectory.actions[:-1], (0.0, -4.0), (2.0, 4.0))
    assert previous[1:][same] == pytest.approx(
        asked[same], abs=1e-6
    )  # what was sent is what is observed next
    verified = run(
        "verify", "policy.onnx", "--map", "map.yaml", "--eps", "0.01", "--trajectory", states, "-o", f"json:{report}"
    )  # fmt: skip
    assert verified.exit_code == 0, verified.output
    counts = json.loads(report.read_text(encoding="utf-8"))
    assert counts["states"] == len(trajectory) > 50
    assert counts["verdicts"]["safe"] > 0
    driven = json.loads(document.read_text(encoding="utf-8"))
    assert driven["conditions"]["delay"] == 0.1
    assert counts["task"]["success_rate"] == driven["success"]["rate"]


def test_the_figure_and_the_table_are_written(run: Run, tmp_path: Path) -> None:
    picture, table = tmp_path / "run.png", tmp_path / "run.csv"
    result = run(*DRIVE, "-o", f"figure:{picture}", "-o", f"trajectory:{table}", "-q")
    assert (result.exit_code, result.stdout) == (0, "")
    with Image.open(picture) as drawn:
        assert drawn.size[0] > 1000
    assert len(load_trajectory(table, load_policy("policy.onnx").spec).outcomes) == 2


def test_a_slower_robot_is_told_of(run: Run) -> None:
    result = run(*DRIVE, "--robot", "turtlebot3_burger", "--time-limit", "2")
    text = " ".join(result.stdout.split())
    assert "the policy asks for linear 0 to 0.5 m/s, turtlebot3_burger does 0 to 0.22" in text
    assert "clipped 100.00 % of its commands" in text


def test_clearances_and_footprint_can_be_asked_for(run: Run) -> None:
    free = run(*DRIVE, "--clearance", "0.1")
    wide = run(*DRIVE, "--clearance", "0.1", "--footprint", "0.4")
    assert "success 2 (100.00 %" in " ".join(free.stdout.split())
    assert "collision 1 (50.00 %" in " ".join(wide.stdout.split())


@pytest.mark.parametrize("name", ["run.gif", "run.mp4"])
def test_a_film_shows_the_robot_move(run: Run, tmp_path: Path, name: str) -> None:
    film = tmp_path / name
    result = run(*DRIVE, "--record", film, "--shown", "1", "--time-limit", "0.9")
    assert result.exit_code == 0, result.output
    if film.suffix == ".mp4":
        assert b"ftyp" in film.read_bytes()[:16]
        return
    with Image.open(film) as picture:
        assert getattr(picture, "n_frames", 1) == 5
        first = np.asarray(picture.convert("RGB"), dtype=int)
        picture.seek(4)
        last = np.asarray(picture.convert("RGB"), dtype=int)
    changed = (np.abs(first - last).sum(axis=2) > 60)[40:].mean()  # below the caption
    assert 1e-4 < changed < 0.1


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("--engine", "gazebo"), "unknown engine 'gazebo'"),
        (("--robot", "pepper"), "unknown robot 'pepper'"),
        (("--lidar", "rays"), "no ray tests"),
        (("--record", "film.avi"), "film.avi"),
        (("--render",), "no display"),
        (("-o", "pdf:run.pdf"), "FORMAT:PATH"),
        (("-o", "figure:run.json"), "run.json"),
        (("-o", "json:run.json", "-o", "json:run.json"), "two outputs"),
        (("--dropout", "1.5"), "dropout"),
        (("--acceleration", "0"), "acceleration"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_what_is_wrong_is_said_before_anything_is_driven(
    run: Run, monkeypatch: pytest.MonkeyPatch, arguments: tuple[str, ...], told: str
) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    result = run(*DRIVE, *arguments)
    assert result.exit_code == 2
    assert told in result.stderr
    assert result.stderr.startswith(("error: ", "Usage"))


def test_scenarios_that_cannot_be_drawn_are_refused_with_a_way_on(run):
    done = run("simulate", "via", "--map", "room", "--episodes", "3", "--quiet")
    assert done.exit_code == 2
    assert "to draw 3 scenarios" in done.output
    assert "leave the number of scenarios out" in done.output
    assert run("simulate", "via", "--map", "room", "--quiet").exit_code == 0


def test_the_monitor_is_compared_on_the_same_scenarios(run: Run, tmp_path: Path) -> None:
    target, plain = tmp_path / "run.json", tmp_path / "plain.json"
    asked = (*DRIVE, "--episodes", "12", "--seed", "4", "--clearance", "0.55", "--danger", "0.8")
    result = run(*asked, "--monitor", "-o", f"json:{target}")
    assert result.exit_code == 0, result.output
    assert run(*asked, "-o", f"json:{plain}").exit_code == 0
    document, without = (json.loads(path.read_text(encoding="utf-8")) for path in (target, plain))
    schema = json.loads((ROOT / "docs" / "simulation.schema.json").read_text(encoding="utf-8"))
    jsonschema.validate(document, schema)
    monitor = document.pop("monitor")
    for changing in ("seconds", "versions"):
        del document[changing], without[changing]
    assert document == without  # the usual figures are those without the monitor
    assert document["collision"]["count"] > 0
    assert monitor["collision"]["count"] == 0
    assert monitor["least_clearance"] > 0.55
    assert monitor["prevented_collisions"] == document["collision"]["count"]
    assert 0 < monitor["interventions"] < monitor["intervals"]
    assert sum(monitor[name]["count"] for name in ("success", "collision", "timeout")) == 12
    gained = monitor["success"]["count"] - document["success"]["count"]
    assert monitor["gained_success"] - monitor["lost_success"] == gained
    words = " ".join(result.stdout.split())
    assert (
        f"interventions {monitor['interventions']:,} of {monitor['intervals']:,} commands did not pass"
        in words
    )


def test_what_the_monitor_does_not_count_with_is_a_wrong_usage(run: Run, tmp_path: Path) -> None:
    assert run(*DRIVE, "--monitor", "--drift", "0.01").exit_code == 2
    errors = tmp_path / "errors.yaml"
    errors.write_text("version: 1\nactuation: {linear: {lag: [0.1, 0.2]}}\n", encoding="utf-8")
    result = run(*DRIVE, "--monitor", "--errors", errors)
    assert result.exit_code == 2
    assert "monitor" in result.output + getattr(result, "stderr", "")
