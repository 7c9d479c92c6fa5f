"""``--stop-early``: the exit code of the whole run, and a report that says what was left out."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import pytest
from click.testing import Result

RUN = ("verify", "policy.onnx", "--map", "map.yaml", "--eps", "0.05")


@pytest.fixture
def blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Judge a few states at a time."""
    monkeypatch.setattr("viatool.verification.states._MOST_STATES", 8)


@pytest.mark.usefixtures("blocks")
@pytest.mark.parametrize(
    "gate",
    [
        ("--fail-under", "0.3"),
        ("--fail-under", "1", "--fail-under", "danger=1"),
        ("--fail-under", "sampled=0.5", "--min-contested", "100000"),
        ("--fail-under", "collision=0.5"),
        ("--max-unknown", "0", "--max-unsafe", "0"),
    ],
)
def test_the_exit_code_is_that_of_the_whole_run(run: Callable[..., Result], gate: tuple[str, ...]) -> None:
    whole, early = run(*RUN, *gate, "-q"), run(*RUN, *gate, "-q", "--stop-early")
    assert whole.exit_code == early.exit_code


@pytest.mark.usefixtures("blocks")
def test_the_report_says_what_was_left_out(run: Callable[..., Result], tmp_path: Path) -> None:
    outputs = [
        f"--output={one}:{tmp_path / name}"
        for one, name in (("json", "r.json"), ("junit", "r.xml"), ("states", "r.npz"))
    ]
    whole = json.loads(run(*RUN, "-q", "--output", "json:-").stdout)
    found = run(*RUN, "--fail-under", "0.3", "--stop-early", *outputs)
    assert found.exit_code == 0, found.output
    report = json.loads((tmp_path / "r.json").read_text())
    judged, left = report["states"], report["not_judged"]["overall"]
    assert judged + left == whole["states"]
    assert judged < 0.5 * whole["states"]
    told = f"stopped early, {left:,} of {judged + left:,} states not judged"
    assert told in found.output.splitlines()[0]
    assert report["safety_rate"]["overall"]["total"] == judged == sum(report["verdicts"].values())
    assert report["task"] == whole["task"]
    cases = ElementTree.parse(tmp_path / "r.xml").getroot()
    assert told in next(one.get("value", "") for one in cases.iter("property") if one.get("name") == "stake")
    assert int(cases.get("skipped", "0")) == 1  # the one drive, of which states are missing
    again = run("report", tmp_path / "r.npz", "--output", f"json:{tmp_path / 'again.json'}")
    assert again.exit_code == 0, again.output
    assert json.loads((tmp_path / "again.json").read_text()) == report
    codes = [run("gate", tmp_path / "r.json", "--fail-under", rate).exit_code for rate in ("0.3", "1")]
    assert codes == [0, 1]
    assert "NOT DECIDED" in run("gate", tmp_path / "r.json", "--fail-under", "0.9").output
    assert "not judged" in run("gate", tmp_path / "r.json", "--baseline", tmp_path / "r.json").output


@pytest.mark.parametrize(
    ("more", "named"),
    [
        ((), "there is no gate"),
        (("--fail-under", "0.9", "--margins"), "--margins"),
        (("--fail-under", "0.9", "--explain-errors"), "--explain-errors"),
        (("--fail-under", "0.9", "--baseline", "map.yaml"), "--baseline"),
        (("--fail-under", "0.9", "--accepted", "map.yaml"), "--accepted"),
        (("--fail-under", "0.9", "--output", "evidence:folder"), "--output evidence"),
    ],
)
def test_what_needs_every_state_is_refused(
    run: Callable[..., Result], more: tuple[str, ...], named: str
) -> None:
    found = run(*RUN, "--stop-early", *more)
    assert found.exit_code == 2
    assert named in found.output
    assert "hint: " in found.output


MISSIONS = ("mission", "policy.onnx", "--map", "map.yaml", "--eps", "0.01", "--time-limit", "3")
"""The first one collides, the second one is late."""


def test_a_report_of_missions_says_what_was_left_out(run: Callable[..., Result], tmp_path: Path) -> None:
    names = {"json": "m.json", "junit": "m.xml", "html": "m.html", "markdown": "m.md"}
    outputs = [f"--output={one}:{tmp_path / name}" for one, name in names.items()]
    found = run(*MISSIONS, "--max-unsafe", "0", "--stop-early", *outputs)
    assert run(*MISSIONS, "--max-unsafe", "0", "-q").exit_code == found.exit_code == 1, found.output
    told = "stopped early, 1 of 2 missions not judged; of the others: 0 of 1 proved"
    assert found.output.splitlines()[0] == told
    for name in ("m.xml", "m.html", "m.md"):
        assert told in (tmp_path / name).read_text(), name
    report = json.loads((tmp_path / "m.json").read_text())
    assert report["not_judged"] == {"overall": 1, "scenarios": ["clear"]}
    assert report["mission_verdicts"] == {"proved": 0, "refuted": 1, "unknown": 0}
    assert ElementTree.parse(tmp_path / "m.xml").getroot().get("skipped") == "1"
    again = run("gate", tmp_path / "m.json", "--fail-under", "0.5")
    assert (again.exit_code, "NOT DECIDED" in again.output) == (1, True)
    assert "was not judged" in run("explain", tmp_path / "m.json", "--scenario", "clear").output


@pytest.mark.parametrize(
    ("more", "named"),
    [
        ((), "there is no gate"),
        (("--max-unsafe", "0", "--explain-errors"), "--explain-errors"),
        (("--max-unsafe", "0", "--baseline", "map.yaml"), "--baseline"),
        (("--max-unsafe", "0", "--accepted", "map.yaml"), "--accepted"),
    ],
)
def test_what_needs_every_mission_is_refused(
    run: Callable[..., Result], more: tuple[str, ...], named: str
) -> None:
    found = run(*MISSIONS, "--stop-early", *more)
    assert found.exit_code == 2
    assert named in found.output


CELLS = (
    "certify",
    "policy.onnx",
    "--map",
    "map.yaml",
    "--eps",
    "0.01",
    "--smallest",
    "0.3",
    "--halvings",
    "0",
)


@pytest.mark.parametrize(
    ("gate", "code"), [(("--fail-under", "0.99"), 1), (("--fail-under", "overall=0.01"), 0)]
)
def test_a_certificate_says_what_was_left_out(
    run: Callable[..., Result],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    gate: tuple[str, ...],
    code: int,
) -> None:
    monkeypatch.setattr("viatool.places.campaign.RootWork.piece", 4)
    names = {"json": "c.json", "junit": "c.xml", "html": "c.html", "markdown": "c.md"}
    outputs = [f"--output={one}:{tmp_path / name}" for one, name in names.items()]
    early = (*CELLS, *gate, "--stop-early", "--checkpoint", tmp_path / "kept")
    whole, found = run(*CELLS, *gate, "-q"), run(*early, *outputs)
    assert whole.exit_code == found.exit_code == code, found.output
    again = json.loads(run(*early, "--resume", "-q", "--output", "json:-").stdout)
    report = json.loads((tmp_path / "c.json").read_text())
    assert {**again, "seconds": 0} == {**report, "seconds": 0}
    judged, left = report["roots"]["examined"], report["not_judged"]
    assert judged + left["overall"] == report["roots"]["total"]
    assert left["smallest_cells"] == 512 * left["overall"]
    told = f"stopped early, {left['overall']} of {report['roots']['total']} roots not judged; of the others: "
    assert found.output.startswith(told)
    for name in ("c.xml", "c.html", "c.md"):
        assert told in (tmp_path / name).read_text(), name
    cases = ElementTree.parse(tmp_path / "c.xml").getroot()
    assert not [
        one for one in cases.iter("testcase") if one.get("classname") == "viatool.heading" and not len(one)
    ]
    assert "NOT DECIDED" in run("gate", tmp_path / "c.json", "--fail-under", "0.5").output


@pytest.mark.parametrize(
    ("more", "named"),
    [
        ((), "there is no gate"),
        (("--sample", "0.1", "--max-unsafe", "0"), "--sample"),
        (("--budget-cells", "9", "--max-unsafe", "0"), "--budget-cells"),
        (("--explain-errors", "--max-unsafe", "0"), "--explain-errors"),
        (("--steps", "2", "--max-unsafe", "0"), "beyond the next action"),
    ],
)
def test_what_needs_every_cell_is_refused(
    run: Callable[..., Result], more: tuple[str, ...], named: str
) -> None:
    found = run(*CELLS, "--stop-early", *more)
    assert found.exit_code == 2
    assert named in found.output
