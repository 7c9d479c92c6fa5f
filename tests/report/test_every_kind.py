"""Every format serves every kind of run that offers what it needs, and every stored report is read again."""

from __future__ import annotations

import csv
import io
import json
import re
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import jsonschema
import numpy as np
import pytest
from click.testing import CliRunner
from click.testing import Result as Done
from pydantic_sarif.model import StaticAnalysisResultsFormatSarifVersion210JsonSchema as SarifLog
from rich.console import Console

import viatool
from tests.hall import MAP, write_policy
from tests.report.toy_kind import TOY, ToyDocument
from viatool import load_map, load_policy
from viatool.cli import main
from viatool.doctor import diagnose
from viatool.errors import ConfigurationError
from viatool.margins import margin
from viatool.missions import mission
from viatool.places import Resolution, certify
from viatool.report import (
    FORMATS,
    KINDS,
    Check,
    Document,
    Gate,
    Output,
    evaluate,
    formats_of,
    load_document,
    parse_output,
    parse_threshold,
    print_comparison,
    print_report,
)
from viatool.report.diagnoses.run import DiagnosisRun
from viatool.report.document import Explorable
from viatool.report.files import as_bytes
from viatool.report.kinds import live_of
from viatool.report.margins.run import MarginsRun
from viatool.report.missions.run import MissionsRun
from viatool.report.outputs import FOLDERS, content_of, format_named
from viatool.report.places.run import PlacesRun
from viatool.report.simulations.run import SimulationRun
from viatool.report.states.run import StatesRun
from viatool.setting.setting import Setting
from viatool.simulate import Places, simulate

ROOT = Path(__file__).resolve().parents[2]
HOSTILE = "<img src=x onerror=owned()>\"'`|**b**\r\n::error::x\x1b[31m%0A=1]]>&amp; @team $x$ <!--"
FAILED = Check(f"condition {HOSTILE}", passed=False, figures=HOSTILE)
PREMISES = (
    SimpleNamespace(name="interval", value="0.1 s", source="the policy's specification"),
    SimpleNamespace(name=f"eps of {HOSTILE}", value=HOSTILE, source=f"map {HOSTILE}"),
)
SCHEMAS = {
    StatesRun: "report.schema.json",
    PlacesRun: "certificate.schema.json",
    SimulationRun: "simulation.schema.json",
    MissionsRun: "mission.schema.json",
    MarginsRun: "margin.schema.json",
    DiagnosisRun: "diagnosis.schema.json",
}
LIVE = tuple(SCHEMAS)
JUDGED = (StatesRun, PlacesRun, SimulationRun, MissionsRun)
"""Kinds of run of which each part passes or fails."""
SERVED = {
    StatesRun: "json gate states csv witnesses mcap figure html markdown junit sarif github evidence",
    PlacesRun: "json gate cells csv witnesses figure html markdown junit sarif github",
    SimulationRun: "json gate trajectory csv figure html markdown junit sarif github",
    MissionsRun: "json gate tube csv witnesses mcap figure html markdown junit sarif github",
    MarginsRun: "json gate states csv witnesses figure html markdown junit sarif github",
    DiagnosisRun: "json gate csv figure html markdown github",
}


@dataclass(frozen=True)
class Runs:
    """A live document of each kind."""

    of: dict[type[Document], Document]


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Runs:
    folder = tmp_path_factory.mktemp("hall")
    write_policy(folder / "policy.onnx")
    hostile = MAP.replace("name: past", f"name: {json.dumps(HOSTILE)}")
    (folder / "map.yaml").write_text(hostile, encoding="utf-8")
    policy, world_map = load_policy(folder / "policy.onnx"), load_map(folder / "map.yaml")
    result = viatool.verify(folder / "policy.onnx", world_map, eps=0.01, horizon=None)
    certificate = certify(
        policy, world_map, world_map.scenarios[0], eps=0.01, resolution=Resolution(0.5, 0), seed=1
    )
    simulation = simulate(policy, Setting.of(policy, world_map, 0.0))
    missions = mission(policy, world_map, eps=0.01, time_limit=5.0)
    margins = margin(policy, world_map, places=Places(count=60), resolution=0.1)
    diagnosis = diagnose(policy, world_map, world_map.scenarios)
    return Runs(
        {
            StatesRun: told(StatesRun(result)),
            PlacesRun: told(PlacesRun(certificate)),
            SimulationRun: told(SimulationRun(simulation)),
            MissionsRun: told(MissionsRun(missions)),
            MarginsRun: told(MarginsRun(margins)),
            DiagnosisRun: told(DiagnosisRun(diagnosis)),
        }
    )


def told(document: Document, premises: tuple[SimpleNamespace, ...] = PREMISES) -> Document:
    """Return a document with premises."""
    content = {**document.content, "premises": [vars(premise) for premise in premises]}
    document.content = content
    document.record = document.RECORD.model_validate(content)
    return document


def written(document: Document, name: str, *checks: Check) -> bytes:
    if name in FOLDERS:
        files = format_named(name).render(document, checks, "")
        return b"".join(b"".join(as_bytes(content)) for content in files.values())
    return b"".join(content_of(Output(name, Path("-")), document, checks))


@pytest.fixture(autouse=True)
def _outside_of_github(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("GITHUB_STEP_SUMMARY", raising=False)


@pytest.mark.parametrize("kind", LIVE)
def test_what_serves_a_kind_of_run_is_known(kind: type[Document]) -> None:
    assert set(formats_of(kind)) == set(SERVED[kind].split())


def test_every_stored_kind_has_a_live_one() -> None:
    assert [live_of(kind) for kind in KINDS] == list(LIVE)
    assert all(issubclass(live_of(kind), kind) and live_of(live_of(kind)) is live_of(kind) for kind in KINDS)
    assert len({kind.SIGN for kind in KINDS}) == len(KINDS)


@pytest.mark.parametrize(("kind", "name"), [(kind, name) for kind in LIVE for name in FORMATS])
def test_every_format_serves_every_kind_or_says_so(runs: Runs, kind: type[Document], name: str) -> None:
    if name in formats_of(kind):
        assert written(runs.of[kind], name, FAILED)
        return
    with pytest.raises(ConfigurationError, match=f"the format '{name}' cannot show {kind.WHAT}") as caught:
        parse_output(f"{name}:file", kind)
    offered = caught.value.hint.partition("formats are ")[2].split(", ")
    assert tuple(offered) == formats_of(kind)


@pytest.mark.parametrize("kind", LIVE)
def test_the_json_keeps_to_its_published_schema(runs: Runs, kind: type[Document]) -> None:
    schema = json.loads((ROOT / "docs" / SCHEMAS[kind]).read_text(encoding="utf-8"))
    content = json.loads(written(runs.of[kind], "json"))
    jsonschema.validate(content, schema)
    assert content["premises"] == [vars(premise) for premise in PREMISES]


@pytest.mark.parametrize("kind", JUDGED)
def test_sarif_keeps_to_the_standard(runs: Runs, kind: type[Document]) -> None:
    log = json.loads(written(runs.of[kind], "sarif", FAILED))
    SarifLog.model_validate(log)
    (run,) = log["runs"]
    rules = [rule["id"] for rule in run["tool"]["driver"]["rules"]]
    assert all(rules[found["ruleIndex"]] == found["ruleId"] for found in run["results"])
    assert len(run["results"]) == run["properties"]["resultsFound"] > 1
    marks = [found["partialFingerprints"]["viatoolState/v1"] for found in run["results"]]
    assert len(set(marks)) == len(marks)
    assert run["properties"]["premises"] == [vars(premise) for premise in PREMISES]


@pytest.mark.parametrize("kind", JUDGED)
def test_junit_is_what_dashboards_read(runs: Runs, kind: type[Document]) -> None:
    root = ElementTree.fromstring(written(runs.of[kind], "junit", FAILED))
    (suite,) = root
    assert (root.tag, suite.tag) == ("testsuites", "testsuite")
    assert {part.tag for part in suite} == {"properties", "testcase"}
    cases = list(suite.iter("testcase"))
    names = [(case.get("classname"), case.get("name")) for case in cases]
    assert len(set(names)) == len(names) > 1
    found = [part.tag for case in cases for part in case]
    assert set(found) <= {"failure", "error", "skipped", "system-out"}
    for element in (root, suite):
        assert int(element.get("tests", "")) == len(cases)
        assert int(element.get("failures", "")) == found.count("failure") > 0
        assert int(element.get("errors", "")) == found.count("error")
    values = {p.get("name"): p.get("value") for p in suite.iter("property")}
    assert values["premise: interval"] == "0.1 s [the policy's specification]"


@pytest.mark.parametrize("kind", LIVE)
def test_hostile_names_stay_text(runs: Runs, kind: type[Document]) -> None:
    document = runs.of[kind]
    for name in {"csv", "markdown", "github", "junit"} & set(formats_of(kind)):
        text = written(document, name, FAILED).decode()
        assert not re.search("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f]", text)
        if name == "github":
            for line in text.splitlines():
                assert re.match(r"::(notice|error|warning) file=[^,:]*,title=[^,:]*::", line)
        else:
            assert not [line for line in text.splitlines() if line.lstrip().startswith(("::", "##["))]
    bare = re.sub(r"\\.", "", written(document, "markdown", FAILED).decode())
    assert not re.search(r"<(?!/?(?:details|summary)\b)", bare)
    assert "**b**" not in bare
    assert "@" not in bare
    rows = list(csv.reader(io.StringIO(written(document, "csv").decode())))
    assert len({len(row) for row in rows}) == 1
    if "html" in formats_of(kind):
        page = re.sub(
            r"<script>.*?</script>", "", written(document, "html", FAILED).decode(), flags=re.DOTALL
        )
        assert "<img src=x" not in page


@pytest.mark.parametrize("kind", LIVE)
def test_what_took_effect_is_told(runs: Runs, kind: type[Document]) -> None:
    texts = {
        name: written(runs.of[kind], name).decode()
        for name in formats_of(kind)
        if name in ("markdown", "html")
    }
    stream = io.StringIO()
    print_report(runs.of[kind], Console(file=stream, width=300))
    texts["console"] = stream.getvalue()
    for text in texts.values():
        for word in ("interval", "0.1 s", "specification"):
            assert word in text
    assert "\x1b" not in stream.getvalue()
    assert "\n::error" not in stream.getvalue()


@pytest.fixture(scope="module")
def stored(runs: Runs, tmp_path_factory: pytest.TempPathFactory) -> dict[type[Document], Path]:
    folder = tmp_path_factory.mktemp("stored")
    paths = {kind: folder / f"{kind.__name__}.json" for kind in LIVE}
    for kind, path in paths.items():
        path.write_bytes(written(runs.of[kind], "json"))
    return paths


@pytest.mark.parametrize("kind", LIVE)
def test_a_stored_report_says_what_the_run_said(
    runs: Runs, stored: dict[type[Document], Path], kind: type[Document]
) -> None:
    document = load_document(stored[kind])
    assert issubclass(kind, type(document))
    assert document.content == json.loads(written(runs.of[kind], "json"))
    plain = {"json"} if isinstance(document, Explorable) else {"json", "html"}
    for name in set(formats_of(type(document))) - plain:
        assert written(document, name, FAILED) == written(runs.of[kind], name, FAILED)


def command(*arguments: object) -> Done:
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


@pytest.mark.parametrize("kind", JUDGED)
def test_gate_compare_and_report_take_every_kind(
    stored: dict[type[Document], Path], kind: type[Document], tmp_path: Path
) -> None:
    path = stored[kind]
    assert command("gate", path, "--fail-under", "0", "--baseline", path, "-q").exit_code == 0
    failed = command("gate", path, "--fail-under", "100%", "--max-unsafe", "0")
    assert failed.exit_code == 1
    assert failed.output.count("FAILED") == 2
    assert command("gate", path, "--fail-under", "100%", "--exit-zero").exit_code == 0
    compared = command("compare", path, path)
    assert compared.exit_code == 0
    assert "differs" not in compared.output
    shown = command("report", path, "-o", f"markdown:{tmp_path / 'report.md'}")
    assert shown.exit_code == 0
    assert "In effect" in shown.output
    assert (tmp_path / "report.md").read_text(encoding="utf-8").startswith("## viatool: ")


@pytest.mark.parametrize("kind", [StatesRun, PlacesRun])
def test_a_format_that_needs_more_than_the_json_names_the_command(
    stored: dict[type[Document], Path], kind: type[Document]
) -> None:
    done = command("report", stored[kind], "-o", "junit:-")
    assert done.exit_code == 2
    assert "'junit' needs more than the JSON" in done.output
    assert f"run viatool {kind.COMMAND} again with --output junit:PATH" in done.output


def test_a_diagnosis_is_gated_by_how_the_policy_does_as_specified(stored: dict[type[Document], Path]) -> None:
    path = stored[DiagnosisRun]
    content = load_document(path).content
    own = content["readings"][content["specified"]]["driven"]["success"]
    assert command("gate", path, "--fail-under", str(own["rate"]), "--baseline", path, "-q").exit_code == 0
    done = command("gate", path, "--max-unsafe", "0")
    assert (done.exit_code, "--max-unsafe is not about a diagnosis" in done.output) == (2, True)
    assert command("compare", path, path).exit_code == 0


def test_a_simulation_is_told_whole_by_its_json(stored: dict[type[Document], Path]) -> None:
    for name in ("csv", "junit", "sarif", "github"):
        done = command("report", stored[SimulationRun], "-q", "-o", f"{name}:-")
        assert (done.exit_code, bool(done.stdout)) == (0, True)


@pytest.mark.parametrize(("one", "other"), [(a, b) for a in LIVE for b in LIVE if a is not b])
def test_kinds_are_not_mixed(
    stored: dict[type[Document], Path], one: type[Document], other: type[Document]
) -> None:
    for done in (
        command("compare", stored[one], stored[other]),
        command("gate", stored[other], "--baseline", stored[one]),
    ):
        assert done.exit_code == 2
        assert one.WHAT in done.output
        assert f"cannot be compared with {other.WHAT}" in done.output


@pytest.mark.parametrize("kind", LIVE)
def test_other_premises_are_named(stored: dict[type[Document], Path], kind: type[Document]) -> None:
    now, before = load_document(stored[kind]), load_document(stored[kind])
    told(before, (SimpleNamespace(name="interval", value="0.2 s", source="--interval"),))
    checks = evaluate(Gate((), baseline=before), now)
    assert checks
    assert all("the baseline has another interval and eps of" in check.figures for check in checks)
    stream = io.StringIO()
    print_comparison(before, now, Console(file=stream, width=300))
    assert re.search(r"interval +0\.2 s +0\.1 s +differs", stream.getvalue())
    told(before, ())  # of a version that told no premises
    assert not any("another" in check.figures for check in evaluate(Gate((), baseline=before), now))


@pytest.mark.parametrize(
    ("kind", "changes", "passes"),
    [
        (PlacesRun, {}, True),
        (PlacesRun, {"contested_rate": {"part": 0, "total": 10, "rate": 0.0}}, False),
        (PlacesRun, {"roots": {"examined": 1, "total": 2}}, False),
        (SimulationRun, {}, True),
        (SimulationRun, {"success": {"count": 0, "total": 2, "rate": 0.0, "interval": [0.0, 0.7]}}, False),
    ],
)
def test_a_baseline_is_held(
    stored: dict[type[Document], Path], kind: type[Document], changes: dict[str, object], passes: bool
) -> None:
    before = load_document(stored[kind])
    now = type(before)({**before.content, **changes})
    assert all(check.passed for check in evaluate(Gate(baseline=before), now)) is passes


def test_a_part_of_the_map_passes_no_condition(stored: dict[type[Document], Path]) -> None:
    whole = load_document(stored[PlacesRun])
    part = type(whole)({**whole.content, "roots": {"examined": 1, "total": 2}})
    gate = Gate((parse_threshold("0", PlacesRun),), max_unsafe=10**9, baseline=whole)
    assert all(check.passed for check in evaluate(gate, whole))
    checks = evaluate(gate, part)
    assert not any(check.passed for check in checks)
    assert all("only 1 of 2 roots" in check.figures for check in checks)
    assert not any(check.passed for check in evaluate(Gate(baseline=part), whole))


def test_no_episodes_pass_no_condition(stored: dict[type[Document], Path]) -> None:
    content = load_document(stored[SimulationRun]).content
    empty = {"count": 0, "total": 0, "rate": 0.0, "interval": [0.0, 1.0]}
    none = SimulationRun.__mro__[1](
        {**content, **dict.fromkeys(("success", "collision", "timeout"), empty), "episodes": []}
    )
    (check, limit) = evaluate(Gate((parse_threshold("0", SimulationRun),), max_unsafe=0), none)
    assert check.empty
    assert limit.empty
    assert not check.passed


def test_what_a_simulation_does_not_have_is_refused(stored: dict[type[Document], Path]) -> None:
    done = command("gate", stored[SimulationRun], "--max-unknown", "3")
    assert done.exit_code == 2
    assert "--max-unknown is not about a simulation" in done.output


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "{}",
        "nonsense",
        '{"verdicts": 3}',
        '{"volume": {}}',
        '{"episodes": [NaN]}',
        '{"episodes": []}',
        "[" * 9999,
    ],
)
def test_what_is_no_report_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "file.json"
    path.write_text(text, encoding="utf-8")
    for name in ("gate", "report"):
        done = command(name, path)
        assert done.exit_code == 2
        assert f"'{path}' is not a viatool report" in done.output


def test_parts_beyond_their_whole_are_refused(stored: dict[type[Document], Path]) -> None:
    content = load_document(stored[PlacesRun]).content
    with pytest.raises(ConfigurationError, match="part is 11 of 10"):
        type(load_document(stored[PlacesRun]))(
            {**content, "free_rate": {"part": 11, "total": 10, "rate": 1.0}}
        )


def test_a_toy_format_is_its_module_and_one_line(
    runs: Runs, stored: dict[type[Document], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(FORMATS, "toy", "tests.report.toy_format")
    for kind in LIVE:
        output = parse_output(f"toy:{tmp_path / 'live.toy'}", kind)
        text = b"".join(content_of(output, runs.of[kind], (FAILED,))).decode()
        assert text.startswith(str(runs.of[kind].headline))
        assert text.endswith("sections, 1 conditions\n")
        done = command("report", stored[kind], "-q", "-o", "toy:-")
        assert (done.exit_code, done.stdout.endswith("sections, 0 conditions\n")) == (0, True)
    wrong = command("report", stored[StatesRun], "-o", f"toy:{tmp_path / 'file.txt'}")
    assert (wrong.exit_code, "end it in .toy" in wrong.output) == (2, True)


def test_a_toy_kind_of_run_is_served_by_every_text_format() -> None:
    toy = ToyDocument(TOY)
    names = [name for name in FORMATS if name in formats_of(ToyDocument)]
    assert names == ["json", "gate", "csv", "html", "markdown", "junit", "sarif", "github"]
    for name in names:
        assert name == "gate" or "broke" in written(toy, name, FAILED).decode()
    stream = io.StringIO()
    gate = Gate((parse_threshold("0.6", ToyDocument),), max_unsafe=1)
    print_report(toy, Console(file=stream, width=100), evaluate(gate, toy))
    assert "50.00 % of the toys hold" in stream.getvalue()
    assert (stream.getvalue().count("FAILED"), stream.getvalue().count("passed")) == (1, 1)


def test_figures_of_every_kind_are_pictures(runs: Runs) -> None:
    for kind in LIVE:
        assert written(runs.of[kind], "figure").startswith(b"\x89PNG")
    cells = np.load(io.BytesIO(written(runs.of[PlacesRun], "cells")))
    assert "status" in cells
    states = np.load(io.BytesIO(written(runs.of[StatesRun], "states")))
    assert len(states["verdict"]) == runs.of[StatesRun].size
