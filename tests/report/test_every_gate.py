"""Whatever a gate asks for: exit code, JUnit, SARIF and annotations agree, and each lists what fails it."""

from __future__ import annotations

import csv
import io
import json
import random
from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, fields, replace
from datetime import date
from fractions import Fraction
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import click
import numpy as np
import pytest
from click.testing import CliRunner

import viatool
from tests.hall import MAP, write_policy
from viatool import load_map, load_policy
from viatool.cli import main
from viatool.cli.failures import explain
from viatool.cli.gating import leave_by_gate
from viatool.errors import ViatoolError
from viatool.loop.horizon import Crashes, Horizon
from viatool.margins import margin
from viatool.missions import mission
from viatool.places import STATUSES, Certificate, Resolution, certify
from viatool.report import Acceptance, Check, Document, Gate, Output, evaluate, load_document
from viatool.report.gate import Threshold
from viatool.report.margins.document import MarginsDocument
from viatool.report.missions.document import MissionsDocument
from viatool.report.outputs import content_of
from viatool.report.places.run import PlacesRun
from viatool.report.ruling import Ruling
from viatool.report.sections import Key
from viatool.report.simulations.document import SimulationDocument
from viatool.report.simulations.run import SimulationRun
from viatool.report.states.run import StatesRun
from viatool.safety.judgement import Contested, Judgement
from viatool.setting.setting import Setting
from viatool.simulate import Places, simulate
from viatool.verification.result import Result

TODAY = date(2026, 12, 1)
EACH = 200
"""Gates of each of five kinds of document."""


@dataclass(frozen=True)
class Made:
    """A document, and by an account of its own what each rate misses and each limit counts of it."""

    document: Document
    failing: Mapping[str, set[Key]]


Make = Callable[[random.Random], Made]


@pytest.fixture(scope="module")
def makers(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Make]:
    folder = tmp_path_factory.mktemp("hall")
    policy = load_policy(write_policy(folder / "policy.onnx"))
    (folder / "map.yaml").write_text(MAP, encoding="utf-8")
    hall, room = load_map(folder / "map.yaml"), load_map(Path("maps/room.yaml"))
    result = viatool.verify(policy, hall, eps=0.05, close=20, horizon=Horizon(2))
    certificate = certify(policy, room, room.scenarios[0], eps=0.01, resolution=Resolution(0.3, 0), seed=1)
    missions = mission(policy, hall, eps=0.01, time_limit=0.5).to_json()
    margins = margin(policy, hall, places=Places(count=10), resolution=0.1).to_json()
    simulation = SimulationRun(simulate(policy, Setting.of(policy, hall, 0.0))).content
    return {
        "states": lambda chance: make_states(chance, result),
        "places": lambda chance: make_places(chance, certificate),
        "missions": lambda chance: make_missions(chance, deepcopy(missions)),
        "margins": lambda chance: make_margins(chance, deepcopy(margins)),
        "simulations": lambda chance: make_simulation(chance, deepcopy(simulation)),
    }


def make_states(chance: random.Random, result: Result) -> Made:
    """Judge the states and close places by chance; all that is not safe is contested."""
    random_ = np.random.default_rng(chance.randrange(2**32))
    close = None if chance.random() < 0.2 or result.close is None else judged(random_, result.close)
    run = replace(judged(random_, result), close=close)
    judgement, outcome = run.judgement, run.outcomes[run.episode]
    unsafe = np.zeros(len(run.trajectory), dtype=bool)
    unsafe[run.witnesses.state] = True
    lacking = {
        "overall": ~judgement.safe,
        "contested": ~judgement.safe,
        "danger": ~judgement.danger,
        "sampled": ~judgement.sampled,
        "unsafe": unsafe,
        "unknown": ~judgement.safe & ~unsafe,
        **{name: ~judgement.safe & (outcome == name) for name in ("success", "collision", "timeout")},
    }
    if run.horizon is not None:
        lacking["horizon"] = run.horizon.tubes.steps < 2
    failing = {name: {("", int(k)) for k in np.flatnonzero(rows)} for name, rows in lacking.items()}
    beside = [] if close is None else np.flatnonzero(~close.judgement.safe)
    return Made(StatesRun(run), {**failing, "close": {("close_", int(k)) for k in beside}})


def judged(chance: np.random.Generator, result: Result) -> Result:
    """Judge by chance; counterexamples are some of those that were found."""
    count, bad = len(result.trajectory), chance.choice([0.0, 0.02, 0.3])
    safe = chance.random(count) >= bad
    danger, sampled = safe & (chance.random(count) >= bad), chance.random(count) >= bad
    found = result.witnesses.select(np.flatnonzero(chance.random(len(result.witnesses)) < 0.5 * (bad > 0)))
    safe[found.state] = danger[found.state] = False
    contested = ~safe | (chance.random(count) < 0.1)
    horizon = result.horizon
    if horizon is not None:
        tubes = replace(horizon.tubes, steps=chance.choice([0, 1, 2], count, p=[bad / 2, bad / 2, 1 - bad]))
        horizon = replace(horizon, tubes=tubes, crashes=none_of(horizon.crashes))
    return replace(
        result,
        horizon=horizon,
        judgement=Judgement(safe, danger, sampled),
        witnesses=found,
        contested=Contested(contested, contested),
    )


def none_of(crashes: Crashes) -> Crashes:
    return Crashes(*(getattr(crashes, one.name)[:0] for one in fields(crashes) if one.name != "last"))


def make_places(chance: random.Random, certificate: Certificate) -> Made:
    """Take back some proofs, and some counterexamples."""
    random_, findings = np.random.default_rng(chance.randrange(2**32)), certificate.findings
    refuted, certified, unknown = (STATUSES.index(name) for name in ("refuted", "certified", "unknown"))
    kept = random_.random(len(findings.pose)) < chance.choice([0.0, 0.2, 1.0])
    status = findings.status.copy()
    status[np.flatnonzero(status == refuted)[~kept]] = certified
    status[status == unknown] = certified
    proved = np.flatnonzero(status == certified)
    status[proved[random_.random(len(proved)) < chance.choice([0.0, 0.01])]] = unknown
    names = (
        "pose",
        "previous",
        "action",
        "observation",
        "seconds",
        "clearance",
        "closest",
        "believed",
        "turn",
        "passed",
    )
    found = replace(findings, status=status, **{name: getattr(findings, name)[kept] for name in names})
    examined = certificate.examined if chance.random() < 0.9 else certificate.examined - 1
    changed = replace(certificate, findings=found, examined=examined)
    bad = {("refuted-place", square(pose)) for pose in found.pose}
    # A cell may reach into several squares: in which of them it is, is told by the raster.
    raster = changed.raster
    volume = raster.volumes[unknown].sum(axis=0).reshape(-1)
    open_ = {("unknown-place", square(middle)) for middle in raster.middles.reshape(-1, 2)[volume > 0.0]}
    assert bool(open_) == bool((status == unknown).any())
    both = bad | open_
    return Made(PlacesRun(changed), {"contested": both, "overall": both, "unsafe": bad, "unknown": open_})


def square(place: Sequence[float]) -> tuple[int, int]:
    return int(np.floor(place[0] / 0.5)), int(np.floor(place[1] / 0.5))


def make_missions(chance: random.Random, content: dict[str, Any]) -> Made:
    """Give missions verdicts by chance."""
    verdicts = chance.choices(("proved", "refuted", "unknown"), (4, 1, 1), k=chance.randrange(6))
    kept = content["missions"][0]
    content["missions"] = [
        {**kept, "scenario": f"m{k}", "verdict": verdict} for k, verdict in enumerate(verdicts)
    ]
    content["mission_verdicts"] = {name: verdicts.count(name) for name in ("proved", "refuted", "unknown")}
    proved = verdicts.count("proved")
    content["mission_rate"] = {
        "safe": proved,
        "total": len(verdicts),
        "rate": proved / len(verdicts) if verdicts else None,
    }
    bad = {("", k) for k, verdict in enumerate(verdicts) if verdict != "proved"}
    refuted = {("", k) for k, verdict in enumerate(verdicts) if verdict == "refuted"}
    failing = {"overall": bad, "mission": bad, "unsafe": refuted, "unknown": bad - refuted}
    return Made(MissionsDocument(content), failing)


def make_margins(chance: random.Random, content: dict[str, Any]) -> Made:
    """Give contested states errors by chance; what fails depends on the error that is asked for."""
    (part,) = content["margins"]
    close = sorted(chance.random() < 0.5 for _ in range(chance.randrange(8)))
    part["contested_states"] = [
        {
            "state": number,
            "close": beside,
            "scenario": "past",
            "time": 0.1 * number,
            "pose": [0.0, 0.1 * number, 0.0],
            "distance": 0.1,
            "certified": chance.choice([None, 0.0, 0.01, 0.02, 0.05]),
            "refuted": None,
            "decides": [],
        }
        for number, beside in enumerate(close)
    ]
    states = part["contested_states"]
    part["states"] = part["close"]["states"] = len(states)
    part["contested"] = sum(not state["close"] for state in states)
    part["close"]["contested"] = sum(state["close"] for state in states)
    return Made(MarginsDocument(content), {})


def make_simulation(chance: random.Random, content: dict[str, Any]) -> Made:
    """Let episodes end by chance."""
    outcomes = chance.choices(("success", "collision", "timeout"), (4, 1, 1), k=chance.randrange(6))
    kept = content["episodes"][0]
    content["episodes"] = [{**kept, "outcome": outcome} for outcome in outcomes]
    for name in ("success", "collision", "timeout"):
        count = outcomes.count(name)
        rate = count / len(outcomes) if outcomes else 0.0
        content[name] = {"count": count, "total": len(outcomes), "rate": rate, "interval": [0.0, 1.0]}
    bad = {("", k) for k, outcome in enumerate(outcomes) if outcome != "success"}
    crashed = {("", k) for k, outcome in enumerate(outcomes) if outcome == "collision"}
    return Made(SimulationDocument(content), {"overall": bad, "clear": crashed, "unsafe": crashed})


def make_gate(chance: random.Random, make: Make, made: Made) -> tuple[Gate, list[str]]:
    """Ask for some conditions by chance, and return what each is about, in the order in which they are decided."""
    document, thresholds = made.document, []
    for name in [*document.RATES, *document.RADII]:
        if chance.random() < 0.3:
            radius = name in document.RADII
            least = (
                Fraction(chance.choice((0, 1, 2, 3)), 100) if radius else Fraction(chance.randrange(11), 10)
            )
            thresholds.append(Threshold(name, least))
    limits = {
        name: chance.choice((0, 1, 5)) if name in document.limited and chance.random() < 0.3 else None
        for name in ("unsafe", "unknown", "contested")
    }
    about = [one.name for one in thresholds]
    about += [name for name in ("unsafe", "unknown") if limits[name] is not None]
    about += ["contested states"] if limits["contested"] is not None else []
    gate = Gate(
        tuple(thresholds),
        limits["unsafe"],
        limits["unknown"],
        make(chance).document if chance.random() < 0.2 else None,
        limits["contested"],
        accepted_of(chance, document),
        exit_zero=chance.random() < 0.3,
        today=TODAY,
    )
    return gate, about


def accepted_of(chance: random.Random, document: Document) -> tuple[Acceptance, ...]:
    if not isinstance(document, StatesRun) or chance.random() < 0.7:
        return ()
    states = [finding.state for finding in document.findings()[0] if finding.state is not None]
    states = chance.sample(states, min(2, len(states))) + ([10**6] if chance.random() < 0.1 else [])
    days = [date(2026, 11, 30), TODAY, date(2027, 1, 31)]
    return tuple(
        Acceptance(verdict="unsafe", state=state, reason="why", expires=chance.choice(days))
        for state in states
    )


def excused(gate: Gate) -> set[Key]:
    return {("", one.state) for one in gate.accepted if one.expires >= TODAY}


def exit_code(checks: Sequence[Check]) -> int:
    try:
        leave_by_gate(click.Context(click.Command("verify")), checks, quiet=False)
    except click.exceptions.Exit as ended:
        return ended.exit_code
    except ViatoolError as error:
        return explain(error)[0]
    return 0


def render(document: Document, name: str, checks: Sequence[Check]) -> bytes:
    return b"".join(content_of(Output(name, Path("-")), document, checks))


def keys(check: Check) -> set[Key]:
    return {finding.key for finding in check.failing}


@pytest.mark.parametrize("kind", ["states", "places", "missions", "margins", "simulations"])
def test_no_format_contradicts_the_exit_code_or_leaves_out_what_fails(
    kind: str, makers: dict[str, Make], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.delenv("GITHUB_STEP_SUMMARY", raising=False)
    chance, codes = random.Random(f"{kind} 1"), set()
    for _ in range(EACH):
        made = makers[kind](chance)
        gate, about = make_gate(chance, makers[kind], made)
        checks = evaluate(gate, made.document)
        code = exit_code(checks)
        codes.add(code)
        oracle_of_conditions(made, gate, about, checks, code)
        lists_agree(made.document, checks)
        levels_agree(made.document, checks, code)
        stored_agrees(made.document, gate, checks, tmp_path / f"{kind}.json")
    assert {0, 1, 5} <= codes


def oracle_of_conditions(
    made: Made, gate: Gate, about: Sequence[str], checks: Sequence[Check], code: int
) -> None:
    """The exit code, and what each failed condition lists, are those of an account that knows no report."""
    document, out = made.document, excused(gate)
    for name, check in zip(about, checks, strict=False):
        if check.empty or check.passed or name == "contested states":
            assert not check.failing
            continue
        if name == "margin":
            (part,), least = document.content["margins"], float(gate.thresholds[about.index(name)].least)
            weak = [s for s in part["contested_states"] if s["certified"] is None or s["certified"] < least]
            kinds = {True: "close", False: "driven"}
            policy = Path(part["policy"]["path"]).name
            assert keys(check) == {(f"{policy}/{kinds[s['close']]}", s["state"]) for s in weak}
        else:
            assert keys(check) == made.failing[name] - out
            if not document.incomplete:
                assert check.failing
    failed = [check for check in checks if not check.passed]
    expected = 0 if not failed or gate.exit_zero else 1
    expected = 5 if any(check.empty for check in failed) else expected
    assert code == (2 if any(check.unfounded for check in failed) else expected)


def levels_agree(document: Document, checks: Sequence[Check], code: int) -> None:
    """A CI server sees an error exactly if the exit code is not 0."""
    root = ElementTree.fromstring(render(document, "junit", checks))
    failures, errors = (len(root.findall(f".//{tag}")) for tag in ("failure", "error"))
    assert (root.get("failures"), root.get("errors")) == (str(failures), str(errors))
    assert {0: not failures and not errors, 1: failures and not errors}.get(code, errors)
    results = json.loads(render(document, "sarif", checks))["runs"][0]["results"]
    assert any(one["level"] == "error" for one in results) == (code != 0)
    lines = render(document, "github", checks).decode().splitlines()
    assert any(line.startswith("::error") for line in lines) == (code != 0)
    assert json.loads(render(document, "gate", checks))["conditions"] == [
        {
            **{name: getattr(check, name) for name in ("condition", "passed", "figures", "empty", "hint")},
            "unfounded": check.unfounded,
            "waived": check.waived,
            "open": check.open,
            "evidence": list(check.evidence),
        }
        for check in checks
    ]


def lists_agree(document: Document, checks: Sequence[Check]) -> None:
    """Everything that fails a condition is in each format that lists the parts of a run."""
    ruling, failing = Ruling(checks), set().union(*(keys(check) for check in checks))
    counted = {key for check in checks if check.outcome == "failure" for key in keys(check)}
    errors = [
        r
        for r in json.loads(render(document, "sarif", checks))["runs"][0]["results"]
        if r["level"] == "error"
    ]
    assert sum(one["ruleId"] != "gate" for one in errors) == len(counted)
    root = ElementTree.fromstring(render(document, "junit", checks))
    cases = {one.get("name"): one for one in root.iter("testcase") if one.get("classname") == "viatool.gate"}
    for check, name in zip(checks, ruling.names, strict=True):
        text = "".join(cases[name].itertext())
        assert all(sentence in text for sentence in check.evidence[:1000])
    assert sum(case.find("failure") is not None for case in root.iter("testcase")) == sum(
        check.outcome == "failure" for check in checks
    ) + sum(bool(counted & set(case.subjects)) for case in document.cases())
    if not checks:
        return
    table = list(csv.DictReader(io.StringIO(render(document, "csv", checks).decode())))
    of_rows = [set(one) for _, one in zip(document.rows(), document.row_keys(), strict=False)]
    for row, one in zip(table, of_rows, strict=False):
        assert row["fails"] == "; ".join(ruling.conditions(one))
        assert bool(row["fails"]) == bool(one & failing)
    assert failing <= set().union(*of_rows) | {("close_", int(row["state"])) for row in table[len(of_rows) :]}
    if isinstance(document, StatesRun):
        arrays = np.load(io.BytesIO(render(document, "states", checks)))
        for prefix in document.state_tables():
            told = dict(zip(arrays[f"{prefix}conditions"], arrays[f"{prefix}fails"].T, strict=True))
            assert list(told) == [check.condition for check in checks if not check.passed]
            for check in checks:
                if not check.passed:
                    there = {k for table, k in keys(check) if table == prefix}
                    assert set(np.flatnonzero(told[check.condition]).tolist()) == there


def stored_agrees(document: Document, gate: Gate, checks: Sequence[Check], path: Path) -> None:
    """The gate on the stored report decides the same."""
    path.write_bytes(render(document, "json", ()))
    stored = load_document(path)
    again = evaluate(replace(gate, accepted=()), stored)
    same = evaluate(replace(gate, accepted=()), document)
    assert [(c.condition, c.outcome, c.figures) for c in again] == [
        (c.condition, c.outcome, c.figures) for c in same
    ]
    assert exit_code(again) == exit_code(same)
    for one, other in zip(again, same, strict=True):
        assert keys(one) <= keys(other)


@pytest.fixture
def driven(tmp_path: Path) -> tuple[Path, Path]:
    """Return a policy that comes too near to something, and its map."""
    (tmp_path / "map.yaml").write_text(MAP, encoding="utf-8")
    return write_policy(tmp_path / "policy.onnx"), tmp_path / "map.yaml"


def test_the_command_line_agrees_with_its_reports(driven: tuple[Path, Path], tmp_path: Path) -> None:
    files = {
        name: tmp_path / f"out.{end}" for name, end in (("junit", "xml"), ("states", "npz"), ("html", "html"))
    }
    files |= {"json": tmp_path / "out.json", "csv": tmp_path / "out.csv"}
    words = ["verify", str(driven[0]), "--map", str(driven[1]), "--eps", "0.01", "--close", "20", "-q"]
    words += [f"--output={name}:{path}" for name, path in files.items()]
    gate = ["--fail-under", "danger=1", "--fail-under", "close=1"]
    failed = CliRunner().invoke(main, [*words, *gate])
    assert (failed.exit_code, failed.stdout) == (1, "")
    (line,) = failed.stderr.splitlines()
    assert line.startswith("gate FAILED: danger rate >= 100.00 %: ")
    assert line.endswith("(and 1 other condition)")
    assert ElementTree.parse(files["junit"]).getroot().get("failures") != "0"
    page = files["html"].read_text(encoding="utf-8")
    assert '<option value="1">close rate &gt;= 100.00 %</option>' in page
    rows = list(csv.DictReader(io.StringIO(files["csv"].read_text(encoding="utf-8"))))
    beside = [row for row in rows if "close rate" in row["fails"]]
    assert beside
    assert all(row["scenario"].startswith("beside ") for row in beside)
    kept = CliRunner().invoke(main, ["gate", str(files["json"]), *gate, "-q"])
    assert (kept.exit_code, kept.stderr) == (1, failed.stderr)
    again = CliRunner().invoke(main, [*words[:6], "--trajectory", str(files["states"]), "-q"])
    assert again.exit_code == 0, again.stderr
    let = CliRunner().invoke(main, [*words, *gate, "--exit-zero"])
    assert (let.exit_code, let.stderr.startswith("gate FAILED, exit 0: ")) == (0, True)
    suite = ElementTree.parse(files["junit"]).getroot()
    assert (suite.get("failures"), suite.get("errors")) == ("0", "0")
    assert "warning: " in "".join(suite.itertext())


def test_widths_say_of_which_states_they_are(driven: tuple[Path, Path]) -> None:
    few = StatesRun(viatool.verify(*driven, eps=0.01, close=0, only_contested=True))
    every = StatesRun(viatool.verify(*driven, eps=0.01, close=0))
    words = "contested states alone"
    assert (few.bounded, every.bounded) == (words, "")
    assert all(words in name for name in few.costs)
    for name in ("markdown", "html", "json"):
        assert words in render(few, name, ()).decode()
        assert words not in render(every, name, ()).decode()


def test_conditions_that_are_asked_twice_keep_names_of_their_own() -> None:
    assert Ruling([Check("a", True, ""), Check("b", True, ""), Check("a", False, "")]).names == [
        "a",
        "b",
        "a (2)",
    ]


@pytest.mark.parametrize(
    "broken",
    [("fails", lambda self, keys: False), ("of_check", staticmethod(lambda check: "warning"))],
)
def test_the_account_notices_a_format_that_disagrees(
    broken: tuple[str, Any], makers: dict[str, Make], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(Ruling, *broken)
    with pytest.raises(AssertionError):
        test_no_format_contradicts_the_exit_code_or_leaves_out_what_fails(
            "missions", makers, monkeypatch, tmp_path
        )
