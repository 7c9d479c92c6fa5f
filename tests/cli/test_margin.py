"""``viatool margin``: its gate, its formats, several policies, and what it refuses."""

from __future__ import annotations

import csv
import io
import json
import re
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from click.testing import CliRunner
from click.testing import Result as Done

from viatool.cli import main
from viatool.report import Gate, evaluate, load_document, parse_threshold
from viatool.report.margins.document import MarginsDocument

ROOT = Path(__file__).resolve().parents[2]
PLACES = ("--map", "lab", "--poses", "random:600")


def command(*arguments: object) -> Done:
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Everything that a run writes of one policy, and the JSON and the picture of two."""
    folder = tmp_path_factory.mktemp("margins")
    kinds = {
        "json": "report.json", "csv": "states.csv", "markdown": "report.md", "states": "states.npz",
        "witnesses": "witnesses.json", "junit": "junit.xml", "sarif": "found.sarif", "html": "report.html",
    }  # fmt: skip
    outputs = [part for kind, name in kinds.items() for part in ("-o", f"{kind}:{folder / name}")]
    done = command("margin", "via", *PLACES, *outputs, "-q")
    assert done.exit_code == 0, done.output
    both = ("-o", f"json:{folder / 'both.json'}", "-o", f"figure:{folder / 'both.svg'}")
    done = command("margin", "via", "td3", *PLACES, *both)
    assert done.exit_code == 0, done.output
    (folder / "both.txt").write_text(done.stdout)
    return folder


def states(folder: Path) -> list[dict]:
    (part,) = json.loads((folder / "report.json").read_text())["margins"]
    return part["contested_states"]


def test_the_formats_say_the_same(folder: Path) -> None:
    told = states(folder)
    assert len(told) > 8
    key = [-1.0 if one["certified"] is None else one["certified"] for one in told]
    assert key == sorted(key)
    with np.load(folder / "states.npz") as table:
        order = np.argsort(table["state"])
        assert sorted(one["state"] for one in told) == table["state"][order].tolist()
        certified = dict(zip(table["state"].tolist(), table["certified"].tolist(), strict=True))
        assert (table["certified"] < table["refuted"]).all()
        assert table["weight"].shape == (len(told), len(table["entry"]))
    for one in told:
        assert certified[one["state"]] == (-np.inf if one["certified"] is None else one["certified"])
    rows = list(csv.DictReader(io.StringIO((folder / "states.csv").read_text())))
    assert [int(row["state"]) for row in rows] == [one["state"] for one in told]
    assert [row["certified"] for row in rows] == [
        "" if one["certified"] is None else f"{one['certified']:.17g}" for one in told
    ]
    curve = json.loads((folder / "report.json").read_text())["margins"][0]["curve"]
    for error, proved, refuted in zip(curve["error"], curve["proved"], curve["refuted"], strict=True):
        assert proved == sum(one["certified"] is not None and one["certified"] >= error for one in told)
        assert refuted == sum(one["refuted"] is not None and one["refuted"] <= error for one in told)


def test_counterexamples_are_replayed(folder: Path) -> None:
    done = command("replay", folder / "witnesses.json")
    assert done.exit_code == 0
    refuted = sum(one["refuted"] is not None for one in states(folder))
    assert f"{refuted} of {refuted} witnesses violate" in done.output


def test_the_first_line_is_what_was_at_stake(folder: Path) -> None:
    first = (folder / "both.txt").read_text().partition("\n")[0]
    assert first.startswith("the policy was put to the test in via: ")
    told = (folder / "report.md").read_text()
    assert f"put to the test in {len(states(folder))} of 600 states" in told


def test_several_policies_are_in_one_report_and_one_picture(folder: Path) -> None:
    parts = json.loads((folder / "both.json").read_text())["margins"]
    assert [part["policy"]["path"] for part in parts] == ["via", "td3"]
    assert parts[0]["contested_states"] == states(folder)
    assert parts[0]["contested_states"] != parts[1]["contested_states"]
    picture = (folder / "both.svg").read_text()
    assert picture.count("<!-- via: ") == picture.count("<!-- td3: ") == 1
    done = command("margin", "via", "td3", *PLACES, "-o", "states:table.npz")
    assert (done.exit_code, "give one policy" in done.output or "one policy" in done.output) == (2, True)


def test_the_gate_is_an_error_that_every_state_survives(folder: Path) -> None:
    report, told = folder / "report.json", states(folder)
    bare = [one["state"] for one in told if one["certified"] is None]
    assert bare
    failed = command("gate", report, "--fail-under", "margin=0.02")
    assert failed.exit_code == 1
    below = [one["state"] for one in told if one["certified"] is None or one["certified"] < 0.02]
    assert f"{len(below)} of {len(told)} do not" in failed.output
    assert all(re.search(rf"\b{state}\b", failed.output) for state in below)
    document = load_document(report)
    (check,) = evaluate(Gate((parse_threshold("margin=0.02", MarginsDocument),)), document)
    assert re.findall(r"State (\d+) is", " ".join(check.evidence)) == [str(state) for state in below]
    assert command("gate", report, "--fail-under", "margin=0").exit_code == 1  # some fail without any error
    assert command("gate", report, "--fail-under", "margin=0.02", "--exit-zero").exit_code == 0
    # without those that fail alone
    content = json.loads(report.read_text())
    part = content["margins"][0]
    part["contested_states"] = [one for one in told if one["certified"] is not None]
    part["contested"] = len(part["contested_states"])
    strong = folder / "strong.json"
    strong.write_text(json.dumps(content))
    least = part["contested_states"][0]["certified"]
    assert command("gate", strong, "--fail-under", f"margin={least!r}").exit_code == 0
    above = float(np.nextafter(least, 1.0))
    assert command("gate", strong, "--fail-under", f"margin={above!r}").exit_code == 1
    assert command("gate", report, "--baseline", strong, "-q").exit_code == 1
    assert command("gate", strong, "--baseline", report, "-q").exit_code == 0


def test_the_gate_of_the_command_is_that_of_its_report(folder: Path) -> None:
    done = command("margin", "via", *PLACES, "--fail-under", "margin=0.02", "--resolution", "0.1")
    assert done.exit_code == 1
    assert "FAILED" in done.output
    below = sum(one["certified"] is None or one["certified"] < 0.02 for one in states(folder))
    assert f"{below} of" in done.output  # the error of the gate is tried, however coarse the resolution


def test_without_contested_states_nothing_was_evaluated(tmp_path: Path) -> None:
    report = tmp_path / "report.json"
    alone = ("--map", "lab", "--close", "0")
    done = command("margin", "via", *alone, "--fail-under", "margin=0.02", "-o", f"json:{report}")
    assert done.exit_code == 5
    assert "no verdict depended on the policy" in done.output
    assert command("gate", report, "--fail-under", "margin=0.02").exit_code == 5
    assert command("gate", report, "--min-contested", "1").exit_code == 5
    assert command("margin", "via", *alone, "-q").exit_code == 0  # without a gate nothing fails


def test_close_places_are_named_apart(tmp_path: Path) -> None:
    report = tmp_path / "report.json"
    done = command(
        "margin", "via", "--map", "lab", "--close", "30", "--resolution", "0.1", "-o", f"json:{report}"
    )
    assert done.exit_code == 0
    assert "put to the test in 0 of 1,119 states and 30 close places" in done.stdout.partition("\n")[0]
    document = load_document(report)
    (check,) = evaluate(Gate((parse_threshold("margin=0.4", MarginsDocument),)), document)
    assert not check.passed
    assert all(line.startswith("Close place ") for line in check.evidence)
    assert command("gate", report, "--min-contested", "1").exit_code == 5  # of driven states


def test_too_few_contested_states_are_nothing_evaluated(folder: Path) -> None:
    count = len(states(folder))
    assert command("gate", folder / "report.json", "--min-contested", count).exit_code == 0
    assert command("gate", folder / "report.json", "--min-contested", count + 1).exit_code == 5


@pytest.mark.parametrize(
    ("asked", "told"),
    [
        (("--fail-under", "0.9"), "choose one of margin=ERROR"),
        (("--fail-under", "margin=2%"), "is not an error that something can survive"),
        (("--fail-under", "margin=-1"), "is not an error that something can survive"),
        (("--fail-under", "margin=0.6"), "try errors up to 0.6 with --most"),
        (("--max-unsafe", "0"), "--max-unsafe is not about a report of margins"),
        (("--channel", "radar"), "there is no observation channel 'radar'"),
        (("--term", "pose.x"), "states no term 'pose.x'"),
        (("--most", "0"), "is not a finite number above 0"),
        (
            ("--errors", "husky", "--term", "timing.interval", "-o", "witnesses:w.json"),
            "which a file has one",
        ),
    ],
)
def test_what_cannot_be_asked_is_refused(asked: tuple[str, ...], told: str) -> None:
    done = command("margin", "via", *PLACES, *asked)
    assert done.exit_code == 2
    assert told in " ".join(done.output.split())


def test_stored_margins_are_shown_in_other_formats_and_compared(folder: Path, tmp_path: Path) -> None:
    for name in ("report.md", "states.csv", "junit.xml", "found.sarif", "report.html"):
        kind = {"md": "markdown", "csv": "csv", "xml": "junit", "sarif": "sarif", "html": "html"}[
            name.split(".")[1]
        ]
        again = tmp_path / name
        assert command("report", folder / "report.json", "-q", "-o", f"{kind}:{again}").exit_code == 0
        assert again.read_bytes() == (folder / name).read_bytes()
    assert command("report", folder / "both.json", "-q", "-o", f"figure:{tmp_path / 'a.svg'}").exit_code == 0
    assert (tmp_path / "a.svg").read_bytes() == (folder / "both.svg").read_bytes()
    compared = command("compare", folder / "report.json", folder / "both.json")
    assert compared.exit_code == 0
    assert "least error proved" in compared.output
    done = command("report", folder / "report.json", "-o", "states:-")
    assert (done.exit_code, "run viatool margin again with --output states:PATH" in done.output) == (2, True)


def test_a_baseline_counts_the_states_that_fail_without_an_error(folder: Path, tmp_path: Path) -> None:
    paths = []
    for bare in (1, 3):
        content = json.loads((folder / "report.json").read_text())
        for state in content["margins"][0]["contested_states"][:bare]:
            state["certified"] = None
        paths.append(tmp_path / f"{bare}.json")
        paths[-1].write_text(json.dumps(content))
    done = command("gate", paths[1], "--baseline", paths[0])
    assert (done.exit_code, "share proved at an error of 0" in done.output) == (1, True)
    assert command("gate", paths[0], "--baseline", paths[1], "-q").exit_code == 0


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("crossed", "is not a viatool report"),
        ("missing", "is not a viatool report"),
        ("schema", "schema version 2"),
    ],
)
def test_a_report_that_contradicts_itself_is_refused(
    folder: Path, tmp_path: Path, change: str, said: str
) -> None:
    content = json.loads((folder / "report.json").read_text())
    part = content["margins"][0]
    if change == "crossed":
        part["contested_states"][-1] |= {"certified": 0.4, "refuted": 0.3}
    elif change == "missing":
        part["contested_states"].pop()
    else:
        content["schema_version"] = 2
    stored = tmp_path / "report.json"
    stored.write_text(json.dumps(content))
    done = command("gate", stored, "--fail-under", "margin=0.02")
    assert (done.exit_code, said in done.output) == (2, True)


def test_verify_tells_the_margins_of_its_states(tmp_path: Path) -> None:
    asked = ("--map", "lab", "--poses", "random:300", "--eps", "0.01")
    alone, both = tmp_path / "margins.json", tmp_path / "both.json"
    assert command("margin", "via", *asked, "-q", "-o", f"json:{alone}").exit_code == 0
    done = command("verify", "via", *asked, "--margins", "-o", f"json:{both}")
    assert done.exit_code == 0
    assert "Largest error that is proved" in done.stdout
    content = json.loads(both.read_text())
    jsonschema.validate(content, json.loads((ROOT / "docs" / "report.schema.json").read_text()))
    (part,) = json.loads(alone.read_text())["margins"]
    assert content["margins"]["contested_states"] == part["contested_states"]
    assert "Largest error that is proved" in command("report", both).stdout
    for one in part["contested_states"]:
        safe = one["certified"] is not None and one["certified"] >= 0.01
        assert safe or one["state"] in [other["state"] for other in content["unsafe_states"]]
    done = command("verify", "via", *asked, "--criterion", "sampled", "--margins")
    assert (done.exit_code, "--margins need a criterion that proves" in done.output) == (2, True)
