from __future__ import annotations

import json
from pathlib import Path
from xml.etree import ElementTree

import jsonschema
import numpy as np
import pytest
import shapely
from click.testing import CliRunner

from tests.places.test_arriving import CHAMBER, constant
from viatool.cli import main
from viatool.world import load_map

ARGUMENTS = ["certify", "via", "--map", "room", "--eps", "0.01", "--smallest", "0.06", "--halvings", "0"]
SCHEMA = Path(__file__).resolve().parents[2] / "docs" / "certificate.schema.json"


def run(*arguments):
    return CliRunner().invoke(main, [*ARGUMENTS, *arguments])


def read_npz(path):
    with np.load(path) as archive:
        return dict(archive)


@pytest.fixture(scope="module")
def outputs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("certify")
    names = {
        "json": "c.json", "figure": "c.svg", "cells": "c.npz", "witnesses": "w.json", "markdown": "c.md",
        "junit": "c.xml", "github": "c.txt",
    }  # fmt: skip
    asked = [part for name, file in names.items() for part in ("-o", f"{name}:{folder / file}")]
    done = run("--sample", "0.03", "--fail-under", "contested=0.1", *asked)
    return done, {name: folder / file for name, file in names.items()}


def test_it_prints_shares_and_refuses_to_gate_on_a_part_of_the_map(outputs):
    done, _ = outputs
    assert done.exit_code == 1
    assert "of the contested volume is certified" in done.stdout
    assert "but only" in " ".join(done.stdout.split())


def test_the_json_keeps_to_its_schema(outputs):
    document = json.loads(outputs[1]["json"].read_text())
    jsonschema.validate(document, json.loads(SCHEMA.read_text()))
    assert document["contested_rate"]["part"] <= document["decided_rate"]["part"]


def test_the_counterexamples_replay(outputs):
    done = CliRunner().invoke(main, ["replay", str(outputs[1]["witnesses"])])
    assert done.exit_code == 0, done.output
    assert "violate the clearance" in done.output


def test_cells_figure_and_markdown_are_written(outputs):
    table = read_npz(outputs[1]["cells"])
    assert set(table["status"]) <= {"uncontested", "certified", "refuted", "unknown"}
    assert outputs[1]["figure"].read_text().startswith("<?xml")
    assert "## viatool:" in outputs[1]["markdown"].read_text()


def test_ci_sees_the_gate_the_slices_and_the_worst_places(outputs):
    suite = ElementTree.parse(outputs[1]["junit"]).getroot()[0]
    names = [case.get("name") for case in suite.iter("testcase")]
    assert len(names) == len(set(names)) == 9
    assert int(suite.get("failures")) >= 1
    lines = outputs[1]["github"].read_text().splitlines()
    assert lines[0].startswith("::error")
    assert any(line.startswith("::error") and "comes within" in line for line in lines)


def test_what_holds_over_time_is_printed_drawn_and_written(tmp_path):
    files = {
        name: tmp_path / file
        for name, file in {"json": "c.json", "figure": "c.svg", "cells": "c.npz"}.items()
    }
    outputs = [part for name, file in files.items() for part in ("-o", f"{name}:{file}")]
    arguments = [
        "certify",
        "via",
        "--map",
        "room",
        "--criterion",
        "swept",
        "--eps",
        "0.01",
        "--smallest",
        "0.25",
    ]
    over_time = ["--halvings", "0", "--steps", "2", "--forever", "--lookahead", "1", "--coarser", "1"]
    done = CliRunner().invoke(main, [*arguments, *over_time, *outputs])
    assert done.exit_code == 0, done.output
    assert "certified for 2 steps" in done.stdout
    assert "for ever, or until the goal is reached" in done.stdout
    document = json.loads(files["json"].read_text())
    jsonschema.validate(document, json.loads(SCHEMA.read_text()))
    later = document["over_time"]
    assert [step["steps"] for step in later["steps"]] == [1, 2]
    assert later["steps"][0]["part"] >= later["steps"][1]["part"] >= later["forever"]["part"]
    assert later["cell"]["x"] == 2 * document["smallest_cell"]["x"]
    certified = later["steps"][0]["part"]
    table = read_npz(files["cells"])
    assert table["steps_lower"].shape == table["steps_upper"].shape == (certified, 5)
    assert "left only towards the goal" in files["figure"].read_text()


def test_what_arrives_is_printed_drawn_written_and_gated(tmp_path):
    files = {
        name: tmp_path / file
        for name, file in {"json": "c.json", "figure": "c.svg", "cells": "c.npz", "markdown": "c.md"}.items()
    }
    outputs = [part for name, file in files.items() for part in ("-o", f"{name}:{file}")]
    straight = str(constant(tmp_path / "straight.onnx", 0.5, 0.0).path)
    (tmp_path / "chamber.yaml").write_text(CHAMBER)
    asked = [
        "certify",
        straight,
        "--map",
        str(tmp_path / "chamber.yaml"),
        "--criterion",
        "swept",
        "--eps",
        "0.01",
    ]
    asked += ["--smallest", "0.2", "--arrive", "--goal-radius", "0.45"]
    done = CliRunner().invoke(main, [*asked, *outputs, "--fail-under", "arrive=0.9"])
    assert done.exit_code == 1, done.output
    for printed in (done.stdout, files["markdown"].read_text()):
        assert "reaches the goal for certain, within" in printed
        assert "safe for ever, but may come to stand" in printed
    document = json.loads(files["json"].read_text())
    jsonschema.validate(document, json.loads(SCHEMA.read_text()))
    later = document["over_time"]
    parts = [later[name]["part"] for name in ("arrive", "moving", "standing")]
    assert parts[0] > 0
    assert sum(parts) == later["forever"]["part"]
    table = read_npz(files["cells"])
    assert table["steps_lower"].shape[1] == 5
    assert (table["steps_upper"] - table["steps_lower"])[0, 3:].tolist() == [0.5, 2.0]  # any command before
    assert (table["steps_arrive"] > 0).sum() == parts[0]
    assert table["steps_arrive"].max() == later["arrive_within"]
    assert table["steps_moving"].sum() == parts[1]
    for title in ("reaches the goal for certain", "left only towards the goal"):
        assert title in files["figure"].read_text()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--fail-under", "arrive=0.5"), "add --arrive"),
        (("--fail-under", "forever=0.5", "--steps", "2"), "add --forever"),
        (("--arrive", "--delay", "0.05"), "leave out --delay, or --steps, --forever and --arrive"),
        (("--scenario", "7"), "has 1 scenarios"),
        (("--fail-under", "danger=0.5"), "no rate 'danger'"),
        (("--output", "states:x.npz"), "formats are json"),
    ],
)
def test_wrong_usage_is_exit_2(arguments, words):
    done = run(*arguments)
    assert done.exit_code == 2
    assert words in done.output


def test_a_place_says_what_its_counterexample_comes_near_to(outputs):
    report = outputs[1]["json"]
    worst = json.loads(report.read_text())["worst"]
    assert worst
    room = load_map("room")
    standing = room.obstacles + room.scenarios[0].obstacles
    shapes = {"wall of the arena": shapely.Polygon(room.arena).exterior}
    for x, y, radius in standing.circles:
        shapes[f"circle of radius {radius:.3g} m at ({x:.2f}, {y:.2f})"] = shapely.Point(x, y).buffer(radius)
    for shape in map(shapely.Polygon, standing.polygons):
        corners, middle = len(shape.exterior.coords) - 1, shape.centroid
        shapes[f"polygon of {corners} corners around ({middle.x:.2f}, {middle.y:.2f})"] = shape
    for one in worst[:5]:
        x, y, theta = one["pose"]
        away = {name: shape.distance(shapely.Point(x, y)) for name, shape in shapes.items()}
        assert away[one["obstacle"]] <= min(away.values()) + 0.1  # it drives some centimetres until it stands
        said = CliRunner().invoke(main, ["explain", str(report), f"--place={x + 0.01},{y},{theta}"])
        words = " ".join(said.output.split())
        assert said.exit_code == 0
        assert "is 0.01 m and 0 rad away" in words
        assert f"m of {one['obstacle']} after" in words
        assert "was not asked" in words
    assert "worst place" in CliRunner().invoke(main, ["explain", str(report)]).output
