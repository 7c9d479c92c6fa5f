"""A folder of evidence: what is in it, that it appears whole or not at all, and the commands around it."""

from __future__ import annotations

import hashlib
import json
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
import yaml
from click.testing import CliRunner

import viatool
from tests.hall import MAP, write_policy
from viatool.cli import main
from viatool.errors import ConfigurationError
from viatool.recheck import recheck
from viatool.report import Check, Output, write_outputs
from viatool.report.evidence.questions import QUESTIONS
from viatool.report.files import write_folder
from viatool.report.states.run import StatesRun

NAME = "<img src=x onerror=alert(1)>&\"'"


def run(*arguments: object) -> tuple[int, str]:
    done = CliRunner().invoke(main, [str(argument) for argument in arguments])
    return done.exit_code, done.output


@pytest.fixture(scope="module")
def hall(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("hall")
    write_policy(folder / "policy.onnx")
    (folder / "map.yaml").write_text(MAP.replace("name: past", f"name: {json.dumps(NAME)}"), encoding="utf-8")
    return folder


@pytest.fixture(scope="module")
def document(hall: Path) -> StatesRun:
    return StatesRun(viatool.verify(hall / "policy.onnx", hall / "map.yaml", eps=0.01))


@pytest.fixture(scope="module")
def folder(hall: Path, document: StatesRun) -> Path:
    checks = [Check(f"rate of {NAME}", passed=False, figures="1 of 2")]
    write_outputs(document, [Output("evidence", hall / "evidence")], checks)
    return hall / "evidence"


def read(folder: Path, name: str) -> dict:
    return json.loads((folder / name).read_text(encoding="utf-8"))


def test_the_lab_is_confirmed_from_the_command_line_alone(tmp_path: Path) -> None:
    folder = tmp_path / "evidence"
    arguments = ["verify", "via", "--map", "lab", "--eps", "0.01", "-q", "--fail-under", "0.99"]
    assert run(*arguments, "--output", f"evidence:{folder}") == (0, "")
    code, told = run("check", folder)
    assert code == 0, told
    assert "states keep 0.4 m under any command" in told
    digest = hashlib.sha256((folder / "manifest.json").read_bytes()).hexdigest()
    assert f"manifest sha256: {digest}" in told
    assert run("check", folder, "-q", "--expect", digest) == (0, "")
    code, told = run("check", folder, "--expect", "0" * 64)
    assert code == 1
    assert "contradicted: manifest.json: its sha256 is" in told
    assert run(*arguments, "--output", f"evidence:{folder}") == (0, "")  # an older folder is replaced


def test_the_checker_runs_without_the_command_line_and_without_the_engine(folder: Path) -> None:
    program = (
        "import sys\nfrom viatool.recheck.__main__ import main\ncode = main([sys.argv[1]])\n"
        "rooms = {name.split('.')[1] for name in sys.modules if name.startswith('viatool.')}\n"
        "print(code, rooms - {'lazy_names'})"  # how the names of the package itself are found
    )
    done = subprocess.run([sys.executable, "-c", program, folder], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "0 {'recheck'}"
    assert done.stdout.splitlines()[-2].startswith("result: confirmed")


def test_claims_assumptions_and_inputs_are_in_the_folder(folder: Path, hall: Path) -> None:
    report, claims = read(folder, "report.json"), read(folder, "claims.json")
    assert {claim["figure"] for claim in claims["claims"]} >= {
        "safety_rate.overall",
        "stake",
        "verdicts.unsafe",
    }
    assert claims["gate"] == [{"condition": f"rate of {NAME}", "passed": False, "figures": "1 of 2"}]
    first = next(claim for claim in claims["claims"] if claim["figure"] == "safety_rate.overall")
    assert f"{report['safety_rate']['overall']['safe']} of {report['states']} states" in first["text"]
    inputs = {one["role"]: one for one in read(folder, "setting.json")["inputs"]}
    assert (folder / inputs["policy"]["file"]).read_bytes() == (hall / "policy.onnx").read_bytes()
    assert inputs["map"]["sha256"] == report["map"]["sha256"]
    assumptions = {one["name"]: one for one in read(folder, "assumptions.json")}
    assert set(assumptions) >= {name.replace("_", " ") for name in report["assumptions"]}
    assert assumptions["arithmetic"]["status"] == "tool"
    assert assumptions["states"]["status"] == "open"
    assert any(name.startswith("left out: ") for name in assumptions)


def test_only_what_measure_errors_wrote_counts_as_measured(hall: Path, tmp_path: Path) -> None:
    terms = yaml.safe_dump({"sensor": {"lidar": {"absolute": 0.01}}})
    found = {}
    for name, text in {
        "stated": terms,
        "measured": f"# Measured from drive.bag against lab.yaml.\n{terms}",
    }.items():
        (tmp_path / f"{name}.yaml").write_text(text)
        arguments = ["verify", hall / "policy.onnx", "--map", hall / "map.yaml", "--eps", "0.01", "-q"]
        arguments += ["--errors", tmp_path / f"{name}.yaml", "-o", f"evidence:{tmp_path / name}"]
        assert run(*arguments) == (0, "")
        assert (tmp_path / name / "inputs" / "errors" / f"{name}.yaml").read_text() == text
        listed = read(tmp_path / name, "assumptions.json")
        found[name] = {one["status"] for one in listed if one["name"] == "sensor.lidar.absolute"}
        assert recheck(tmp_path / name).code == 0
    assert found == {"stated": {"open"}, "measured": {"measure-errors"}}


def test_the_page_reaches_for_nothing_and_shows_names_as_text(folder: Path) -> None:
    text = (folder / "index.html").read_text(encoding="utf-8")
    tags, places = [], []

    class Reader(HTMLParser):
        def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
            tags.append(tag)
            places.extend(value for name, value in attributes if name in ("href", "src"))

    Reader().feed(text)
    assert not {"script", "img", "link", "iframe"} & set(tags)
    assert "&lt;img src=x" in text
    assert "$" not in re.sub(r"<style>.*?</style>", "", text, flags=re.S)
    for place in places:
        assert place.startswith("#") or (folder / place).is_file(), place
    assert text.index('<section id="gate"') < text.index("of the states are proved safe")
    assert "default-src 'none'" in text


def test_every_answer_lies_where_the_questions_say(folder: Path) -> None:
    page = (folder / "index.html").read_text(encoding="utf-8")
    for one in QUESTIONS:
        if one.link.startswith("#"):
            assert f'id="{one.link[1:]}"' in page
        elif one.link:
            assert (folder / one.link).is_file()
        else:
            assert one.answer.startswith("not here")
    assert {name for one in QUESTIONS for name in one.asked_by.split(", ")} == {
        "UL 4600",
        "ISO 13482",
        "ISO 3691-4",
    }


def test_a_folder_with_files_of_others_is_left_alone(document: StatesRun, tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("years of work")
    with pytest.raises(ConfigurationError, match=r"it holds 'thesis\.txt'"):
        write_outputs(document, [Output("evidence", tmp_path / "mine")])
    assert [path.name for path in tmp_path.rglob("*")] == ["mine", "thesis.txt"]
    write_outputs(document, [Output("evidence", tmp_path / "own")])
    (tmp_path / "own" / "notes.txt").write_text("mine")
    with pytest.raises(ConfigurationError, match=r"notes\.txt"):
        write_outputs(document, [Output("evidence", tmp_path / "own")])


def test_a_file_in_the_place_of_a_folder_is_refused(document: StatesRun, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigurationError, match="it is a file"):
        write_outputs(document, [Output("evidence", tmp_path / "file")])


def test_an_older_folder_stays_when_writing_fails(tmp_path: Path) -> None:
    write_folder(tmp_path / "kept", "evidence", {"a.txt": "old"})

    def broken():
        yield "new"
        raise RuntimeError("out of paper")

    with pytest.raises(RuntimeError):
        write_folder(tmp_path / "kept", "evidence", {"b.txt": "new", "a.txt": broken()})
    assert (tmp_path / "kept" / "a.txt").read_text() == "old"
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["a.txt", "kept", "manifest.json"]


def test_inputs_that_were_changed_meanwhile_are_no_evidence(tmp_path: Path) -> None:
    write_policy(tmp_path / "policy.onnx")
    (tmp_path / "map.yaml").write_text(MAP)
    document = StatesRun(viatool.verify(tmp_path / "policy.onnx", tmp_path / "map.yaml", eps=0.01))
    (tmp_path / "map.yaml").write_text(MAP + "# changed\n")
    with pytest.raises(ConfigurationError, match=r"the map '.*' is no longer the one that was verified"):
        write_outputs(document, [Output("evidence", tmp_path / "evidence")])
    assert not (tmp_path / "evidence").exists()


@pytest.mark.parametrize("command", ["certify", "mission"])
def test_other_commands_say_who_writes_evidence(command: str, tmp_path: Path) -> None:
    code, told = run(command, "via", "--map", "lab", "--eps", "0.01", "-o", f"evidence:{tmp_path / 'e'}")
    assert code == 2
    assert "it is written by viatool verify" in told


def test_evidence_is_a_folder_and_stdout_is_not() -> None:
    code, told = run("verify", "via", "--map", "lab", "--eps", "0.01", "-o", "evidence:-")
    assert code == 2
    assert "is a folder, which stdout is not" in told


def test_a_folder_that_is_none_of_evidence_is_unreadable(tmp_path: Path) -> None:
    code, told = run("check", tmp_path)
    assert code == 2
    assert "is not an evidence folder: it has no manifest.json" in told


@pytest.mark.parametrize(
    ("options", "code", "named"),
    [
        (["--criterion", "sampled"], 5, "geometry of safe states: criterion sampled"),
        (["--delay", "0.05"], 5, "geometry of safe states: a delay of 0.05 s"),
        (["--criterion", "braking", "--footprint", "0.1"], 0, "holds every command of the network"),
        (["--pose-error", "0.01,0.01"], 0, "holds every command of the network"),
        (["--only-contested"], 0, "holds every command of the network"),
        (["--horizon", "2"], 0, "verdicts over the horizon"),
    ],
)
def test_what_is_not_rechecked_is_named_and_nothing_at_all_is_no_pass(
    hall: Path, tmp_path: Path, options: list[str], code: int, named: str
) -> None:
    arguments = ["verify", hall / "policy.onnx", "--map", hall / "map.yaml", "--eps", "0.01", "-q", *options]
    assert run(*arguments, "-o", f"evidence:{tmp_path / 'e'}") == (0, "")
    found, told = run("check", tmp_path / "e")
    assert found == code, told
    assert named in told
    result = told.splitlines()[-1]
    assert result.startswith("result: no verdict could be rechecked" if code else "result: confirmed")
    assert "not rechecked:" in result


def test_the_grid_of_an_occupancy_map_is_rechecked(tmp_path: Path) -> None:
    arguments = ["verify", "via", "--map", "corridor-grid", "--eps", "0.01", "-q"]
    assert run(*arguments, "-o", f"evidence:{tmp_path / 'e'}") == (0, "")
    assert {path.suffix for path in (tmp_path / "e" / "inputs" / "map").iterdir()} == {".yaml", ".pgm"}
    assert recheck(tmp_path / "e").code == 0
    with np.load(tmp_path / "e" / "grid.npz") as stored:
        grid = dict(stored)
    grid["blocked"][:] = True
    np.savez(tmp_path / "e" / "grid.npz", **grid)
    found = recheck(tmp_path / "e")
    assert found.code == 1
    assert any("grid.npz: was changed" in line for line in found.contradicted)
    assert found.unconfirmed


def test_a_query_is_there_for_the_states_that_depend_on_the_policy(folder: Path) -> None:
    table = np.load(folder / "states.npz")
    rows = [int(path.stem.removeprefix("state-")) for path in (folder / "queries").glob("*.vnnlib")]
    assert rows
    assert (table["verdict"][rows] == "safe").all()
    first = (folder / "queries" / f"state-{rows[0]}.vnnlib").read_text()
    assert first.startswith(f"; the commands of state {rows[0]}\n")
    model, name, _ = (folder / "queries" / "instances.csv").read_text().splitlines()[0].split(",")
    assert (folder / "queries" / model).resolve().is_file()
    assert (folder / "queries" / name).is_file()
