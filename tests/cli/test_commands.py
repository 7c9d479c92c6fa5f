"""Every command on a small hall: what it prints, what it writes, how it exits."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import jsonschema
import numpy as np
import pytest
import yaml
from click.testing import Result
from onnx import TensorProto, helper

import viatool
from tests.hall import MAP
from tests.policy.models import model_of, node, save
from viatool.report import formats_of
from viatool.report.outputs import FOLDERS
from viatool.report.states.run import StatesRun

ROOT = Path(__file__).resolve().parents[2]
Run = Callable[..., Result]
VERIFY = ("verify", "policy.onnx", "--map", "map.yaml", "--eps", "0.01")
SUFFIX = {
    "mcap": "mcap",
    "gate": "json",
    "states": "npz",
    "csv": "csv",
    "figure": "png",
    "html": "html",
    "junit": "xml",
    "sarif": "sarif",
    "witnesses": "json",
}


def arrays_of(path: Path) -> dict[str, np.ndarray]:
    with np.load(path) as archive:
        return dict(archive)


@pytest.fixture
def stored(run: Run, tmp_path: Path) -> Path:
    """Return a report in JSON."""
    path = tmp_path / "report.json"
    assert run(*VERIFY, "--output", f"json:{path}", "--quiet").exit_code == 0
    return path


def test_the_report_keeps_to_the_published_schema(stored: Path) -> None:
    report = json.loads(stored.read_text(encoding="utf-8"))
    schema = json.loads((ROOT / "docs" / "report.schema.json").read_text(encoding="utf-8"))
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.validate(report, schema)
    rates = ("safety_rate", "sampled_safety_rate", "danger_rate", "contested_rate")
    documented = (
        *(
            "schema_version",
            "policy",
            "map",
            "eps",
            "criterion",
            "arithmetic",
            "engine",
            "states",
            "verdicts",
        ),
        *(*rates, "task", "reachable_width", "seconds", "versions"),
    )
    assert set(documented) <= report.keys()
    assert report["eps"] == 0.01
    assert sum(report["verdicts"].values()) == report["states"] == report["safety_rate"]["overall"]["total"]
    assert report["reachable_width"].keys() == {"linear", "angular"}


def test_a_rate_without_states_is_null_in_json(stored: Path) -> None:
    assert json.loads(stored.read_text(encoding="utf-8"))["safety_rate"]["timeout"] == {
        "safe": 0,
        "total": 0,
        "rate": None,
    }


def test_the_state_table_holds_every_array(run: Run, tmp_path: Path) -> None:
    path = tmp_path / "states.npz"
    assert run(*VERIFY, "-o", f"states:{path}").exit_code == 0
    table = arrays_of(path)
    states = len(table["pose"])
    shapes = {"pose": 3, "observation": 26, "eps": 26, "lower": 2, "upper": 2, "witness": 26}
    assert {name: table[name].shape for name in shapes} == {name: (states, n) for name, n in shapes.items()}
    assert set(table["verdict"]) <= {"safe", "unsafe", "unknown"}
    assert table["outcome"].shape == (2,)
    unsafe = table["verdict"] == "unsafe"
    assert unsafe.any()
    assert (np.isfinite(table["witness"]).all(axis=1) == unsafe).all()
    assert (np.abs(table["witness"] - table["observation"]) <= table["eps"])[unsafe].all()
    assert (table["lower"] <= table["upper"]).all()


@pytest.mark.parametrize("name", formats_of(StatesRun))
def test_every_format_is_written_the_same_twice(run: Run, tmp_path: Path, name: str) -> None:
    contents = []
    for attempt in range(2):
        path = tmp_path / f"{attempt}.{SUFFIX.get(name, 'out')}"
        assert run(*VERIFY, "-o", f"{name}:{path}", "-q").exit_code == 0
        contents.append((path / "manifest.json" if name in FOLDERS else path).read_bytes())
    assert contents[0]
    if name in ("csv", "figure", "github", "sarif"):  # the others tell how long the run took
        assert contents[0] == contents[1]


@pytest.mark.parametrize("suffix", ["png", "svg", "pdf"])
def test_the_figure_is_of_the_asked_kind(run: Run, tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"run.{suffix}"
    assert run(*VERIFY, "-o", f"figure:{path}", "-q").exit_code == 0
    marks = {"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF"}
    assert path.read_bytes().startswith(marks[suffix])


def test_a_person_reads_the_figures_that_count(run: Run) -> None:
    result = run(*VERIFY)
    assert result.exit_code == 0
    for text in (
        "are proved safe",
        "unsafe",
        "danger distance",
        "sampled",
        "contested",
        "m/s",
        "rad/s",
        "float32",
    ):
        assert text in result.stdout
    assert "\x1b" not in result.stdout


def test_a_report_on_stdout_has_stdout_to_itself(run: Run) -> None:
    result = run(*VERIFY, "-o", "json:-")
    assert json.loads(result.stdout)["schema_version"] == 1
    assert "are proved safe" in result.stderr


def test_quiet_says_nothing(run: Run) -> None:
    result = run(*VERIFY, "--quiet")
    assert (result.exit_code, result.output) == (0, "")


@pytest.mark.parametrize(
    ("conditions", "code"),
    [
        (("--fail-under", "0.5"), 0),
        (("--fail-under", "1.0"), 1),
        (("--fail-under", "100%"), 1),
        (("--fail-under", "1.0", "--clearance", "0.9"), 1),
        (("--fail-under", "0.5", "--fail-under", "danger=0.99"), 1),
        (("--fail-under", "contested=0.5"), 1),
        (("--max-unsafe", "0"), 1),
        (("--max-unsafe", "1000", "--max-unknown", "1000"), 0),
        (("--fail-under", "1.0", "--exit-zero"), 0),
        (("--fail-under", "timeout=0.5"), 5),
        (("--fail-under", "timeout=0.5", "--exit-zero"), 5),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else str(value),
)
def test_the_gate_decides_the_exit_code(run: Run, conditions: tuple[str, ...], code: int) -> None:
    assert run(*VERIFY, *conditions).exit_code == code


def test_a_failed_gate_still_writes_its_reports(run: Run, tmp_path: Path) -> None:
    assert run(*VERIFY, "--fail-under", "1", "-o", f"json:{tmp_path / 'r.json'}").exit_code == 1
    assert (tmp_path / "r.json").is_file()


def test_a_stored_report_is_gated_like_the_run_itself(run: Run, stored: Path) -> None:
    assert run("gate", stored).exit_code == 0
    assert run("gate", stored, "--fail-under", "0.5", "--baseline", stored).exit_code == 0
    failed = run("gate", stored, "--fail-under", "1.0")
    assert (failed.exit_code, "FAILED" in failed.stdout) == (1, True)


def test_two_reports_are_compared(run: Run, stored: Path) -> None:
    result = run("compare", stored, stored)
    assert result.exit_code == 0
    assert "contested rate" in result.stdout


def test_a_simulated_trajectory_is_verified_like_the_run_itself(
    run: Run, stored: Path, tmp_path: Path
) -> None:
    states, again = tmp_path / "trajectory.npz", tmp_path / "again.json"
    assert run("simulate", "policy.onnx", "--map", "map.yaml", "-o", states).exit_code == 0
    assert run(*VERIFY, "--trajectory", states, "-o", f"json:{again}").exit_code == 0
    reports = [json.loads(path.read_text(encoding="utf-8")) for path in (stored, again)]
    assert reports[0]["safety_rate"] == reports[1]["safety_rate"]


def test_scenarios_are_drawn_on_demand(run: Run) -> None:
    result = run("simulate", "policy.onnx", "--map", "map.yaml", "--scenarios", "7", "--seed", "3")
    assert (result.exit_code, "7 episodes" in result.stdout) == (0, True)


def test_bounds_need_no_specification(run: Run, tmp_path: Path) -> None:
    np.save(tmp_path / "observations.npy", np.zeros((3, 26)))
    result = run(
        "bounds", "foreign.onnx", tmp_path / "observations.npy", "--eps", "0.1", "-o", tmp_path / "b.npz"
    )
    assert result.exit_code == 0
    bounds = arrays_of(tmp_path / "b.npz")
    policy = viatool.load_policy("foreign.onnx")
    sets = viatool.reach(policy, np.zeros((3, 26)), 0.1)
    np.testing.assert_array_equal(bounds["lower"], sets.lower)
    np.testing.assert_array_equal(bounds["upper"], sets.upper)


def test_inspect_promises_no_bounds_of_a_policy_that_cannot_be_run(run: Run, tmp_path: Path) -> None:
    save(model_of([node("Erf", ["x"], ["y"])], dtype=TensorProto.DOUBLE), tmp_path, "double.onnx")
    result = run("inspect", tmp_path / "double.onnx")
    assert result.exit_code == 2
    assert "bounds work" not in result.stdout
    assert "export the policy in float32" in result.stderr


@pytest.mark.parametrize(("kind", "told"), [("float16", True), ("float32", False)])
def test_bounds_tell_where_they_are_mostly_rounding(run: Run, tmp_path: Path, kind: str, told: bool) -> None:
    nodes = [node("MatMul", ["x", "w"], ["y"])]
    dtype = helper.np_dtype_to_tensor_dtype(np.dtype(kind))
    save(model_of(nodes, {"w": np.ones((4, 1), dtype=kind)}, dtype=dtype), tmp_path, "sum.onnx")
    np.save(tmp_path / "one.npy", np.full((1, 4), 3.0))
    result = run("bounds", tmp_path / "sum.onnx", tmp_path / "one.npy", "--eps", "0.001")
    assert result.exit_code == 0
    assert ("exported in float32 it would round less" in " ".join(result.stdout.split())) == told


def test_bounds_read_text_and_write_what_reads_back_exactly(run: Run, tmp_path: Path) -> None:
    (tmp_path / "o.csv").write_text(
        "# two rows\n" + ",".join(["0.5"] * 26) + "\n" + " ".join(["1"] * 26) + "\n"
    )
    assert (
        run("bounds", "policy.onnx", tmp_path / "o.csv", "--eps", "0.1", "-o", tmp_path / "b.csv").exit_code
        == 0
    )
    rows = np.loadtxt(tmp_path / "b.csv", delimiter=",", skiprows=1)
    policy = viatool.load_policy("policy.onnx")
    sets = viatool.reach(policy, rows[:, :26], policy.spec.radii(0.1))
    np.testing.assert_array_equal(rows[:, -4:], np.hstack([sets.lower, sets.upper]))


@pytest.mark.parametrize("policy", ["policy.onnx", "foreign.onnx"])
def test_inspect_tells_what_a_policy_is(run: Run, policy: str) -> None:
    result = run("inspect", policy)
    assert result.exit_code == 0
    for fact in ("opset 1", "Tanh", "before the network", "after the network", "agrees with the network"):
        assert fact in result.stdout


def test_inspect_writes_what_it_found(run: Run, tmp_path: Path) -> None:
    assert run("inspect", "policy.onnx", "--output", f"json:{tmp_path / 'found.json'}").exit_code == 0
    written = json.loads((tmp_path / "found.json").read_text(encoding="utf-8"))
    assert written["verifiable"] is True
    assert json.loads(run("inspect", "policy.onnx", "-o", "json:-").stdout) == written
    assert run("inspect", "policy.onnx", "-o", "xml:-").exit_code == 2
    assert run("inspect", "policy.onnx", "foreign.onnx", "-o", "json:-").exit_code == 2


def test_inspect_goes_on_after_a_policy_that_cannot_be_read(run: Run, hall: Path) -> None:
    (hall / "text.onnx").write_text("not a model")
    result = run("inspect", "text.onnx", "policy.onnx")
    assert result.exit_code == 2
    assert "text.onnx" in result.stderr
    assert "agrees with the network" in result.stdout


def test_the_report_says_which_maps_were_applied(run: Run, hall: Path, tmp_path: Path) -> None:
    policy = viatool.load_policy("policy.onnx")
    assert policy.spec is not None
    sidecar = policy.spec.model_dump(mode="json")
    sidecar["action_map"] = {"scale": [0.25, 0.5], "offset": [0.125, 0.0], "clip": True}
    (tmp_path / "robot.yaml").write_text(json.dumps(sidecar), encoding="utf-8")
    report = tmp_path / "report.json"
    result = run(
        *VERIFY[:1],
        "foreign.onnx",
        *VERIFY[2:],
        "--spec",
        tmp_path / "robot.yaml",
        "--output",
        f"json:{report}",
    )
    assert result.exit_code == 0
    assumed = json.loads(report.read_text(encoding="utf-8"))["assumptions"]
    assert "command = (0.25, 0.5) * output + (0.125, 0), clipped to" in assumed["after_the_network"]
    assert assumed["before_the_network"]
    assert "(0.25, 0.5) * output" in " ".join(result.stdout.split())


def test_a_template_of_a_specification_can_be_filled_in(run: Run, tmp_path: Path) -> None:
    assert run("inspect", "foreign.onnx", "--write-spec", tmp_path / "template.yaml").exit_code == 0
    spec = viatool.load_policy("foreign.onnx", tmp_path / "template.yaml").spec
    assert spec is not None
    assert (spec.observation_size, spec.action_size) == (26, 2)
    assert run("inspect", "policy.onnx", "--write-spec", tmp_path / "own.yaml").exit_code == 0
    arguments = ("--map", "map.yaml", "--eps", "0.01", "--spec", tmp_path / "own.yaml")
    assert run("verify", "foreign.onnx", *arguments).exit_code == 0


def test_a_map_is_summarised_and_drawn(run: Run, tmp_path: Path) -> None:
    result = run("map", "map.yaml", "-o", tmp_path / "map.svg")
    assert result.exit_code == 0
    assert "2 fixed" in result.stdout
    assert (tmp_path / "map.svg").stat().st_size > 1000


def _broken_inputs(folder: Path) -> None:
    (folder / "text.onnx").write_text("not a model")
    (folder / "broken.yaml").write_text("arena: [unclosed")
    (folder / "wrong.yaml").write_text(
        "schema_version: 1\nname: x\narena: {shape: box, center: [0, 0], size: [-1, 2]}\n"
    )
    (folder / "short.csv").write_text("1,2,3\n")
    (folder / "words.csv").write_text("one,two\n")
    (folder / "report.json").write_text('{"schema_version": 1}')
    np.savez(folder / "other.npz", pose=np.zeros((2, 3)), observation=np.zeros((2, 5)))


@pytest.mark.parametrize(
    ("arguments", "code", "named"),
    [
        (("verify", "missing.onnx", "--map", "map.yaml", "--eps", "0.01"), 2, "missing.onnx"),
        (("verify", "text.onnx", "--map", "map.yaml", "--eps", "0.01"), 2, "text.onnx"),
        (("verify", "wide.onnx", "--map", "map.yaml", "--eps", "0.01"), 2, "30"),
        (("verify", "foreign.onnx", "--map", "map.yaml", "--eps", "0.01"), 2, "specification"),
        (("verify", "policy.onnx", "--map", "missing.yaml", "--eps", "0.01"), 2, "missing.yaml"),
        (("verify", "policy.onnx", "--map", "broken.yaml", "--eps", "0.01"), 2, "broken.yaml"),
        (("verify", "policy.onnx", "--map", "wrong.yaml", "--eps", "0.01"), 2, "size"),
        (("verify", "policy.onnx", "--map", "policy.onnx", "--eps", "0.01"), 2, "policy.onnx"),
        (("verify", "policy.onnx", "--map", ".", "--eps", "0.01"), 2, "."),
        (("verify", "policy.onnx", "--map", "map.yaml"), 2, "--eps"),
        (("verify", "policy.onnx", "--map", "map.yaml", "--eps", "sonar=0.1"), 2, "sonar"),
        (("verify", "policy.onnx", "--map", "map.yaml", "--eps", "0.1", "--eps", "budget=0.1"), 2, "budget"),
        ((*VERIFY, "--trajectory", "missing.npz"), 2, "missing.npz"),
        ((*VERIFY, "--trajectory", "other.npz"), 2, "5"),
        ((*VERIFY, "--trajectory", "map.yaml"), 2, "map.yaml"),
        ((*VERIFY, "--spec", "broken.yaml"), 2, "broken.yaml"),
        ((*VERIFY, "--spec", "missing.yaml"), 2, "missing.yaml"),
        ((*VERIFY, "--footprint", "round"), 2, "round"),
        ((*VERIFY, "--footprint", "-1"), 2, "-1"),
        ((*VERIFY, "--danger", "0.1"), 2, "0.1"),
        ((*VERIFY, "--baseline", "report.json"), 2, "report.json"),
        ((*VERIFY, "--baseline", "text.onnx"), 2, "text.onnx"),
        ((*VERIFY, "--output", "json:map.yaml/report.json"), 2, "map.yaml"),
        ((*VERIFY, "--output", "json:."), 2, "directory"),
        ((*VERIFY, "--output", "json:a.json", "--output", "sarif:a.json"), 2, "a.json"),
        (("gate", "missing.json"), 2, "missing.json"),
        (("gate", "report.json"), 2, "report.json"),
        (("compare", "report.json", "report.json"), 2, "report.json"),
        (("bounds", "policy.onnx", "short.csv", "--eps", "0.1"), 2, "26"),
        (("bounds", "policy.onnx", "words.csv", "--eps", "0.1"), 2, "words.csv"),
        (("bounds", "policy.onnx", "map.yaml", "--eps", "0.1"), 2, ".yaml"),
        (("bounds", "foreign.onnx", "short.csv", "--eps", "0.1"), 2, "26"),
        (("inspect", "text.onnx"), 2, "text.onnx"),
        (("map", "broken.yaml"), 2, "broken.yaml"),
        (("map", "map.yaml", "-o", "map.txt"), 2, "map.txt"),
        (("simulate", "foreign.onnx", "--map", "map.yaml"), 2, "specification"),
        (("simulate", "policy.onnx", "--map", "map.yaml", "-o", "trajectory.txt"), 2, "trajectory.txt"),
        (("train", "--map", "missing.yaml", "-o", "run"), 2, "missing.yaml"),
        (("train", "--set", "sedes=3", "-o", "run"), 2, "sedes"),
        (("export", "missing.pt"), 2, "missing.pt"),
        (("export", "map.yaml"), 2, "map.yaml"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else str(value),
)
def test_each_wrong_input_is_named_in_one_message(
    run: Run, hall: Path, arguments: tuple[str, ...], code: int, named: str
) -> None:
    _broken_inputs(hall)
    before = sorted(path.name for path in hall.iterdir())
    result = run(*arguments)
    assert result.exit_code == code, result.output
    assert result.stdout == ""
    assert result.stderr.startswith("error: ")
    assert named in result.stderr
    assert "Traceback" not in result.stderr
    assert "internal error" not in result.stderr
    assert sorted(path.name for path in hall.iterdir()) == before


def test_a_pipe_without_unicode_still_gets_its_report(hall: Path) -> None:
    program = "from viatool.cli import main; main()"
    run = subprocess.run(
        [sys.executable, "-c", program, *VERIFY],
        cwd=hall,
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "PYTHONPATH": str(ROOT), "PYTHONIOENCODING": "ascii"},
    )
    assert run.returncode == 0, run.stderr
    assert "are proved safe" in run.stdout


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=lambda number: number.name)
def test_an_interrupt_leaves_no_file_and_exits_130(
    hall: Path, tmp_path: Path, number: signal.Signals
) -> None:
    heard = (
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"  # shells ignore it for jobs
    )
    program = f"{heard}; from viatool.cli import main; main()"
    arguments = ["policy.onnx", "--map", "map.yaml", "--eps", "0.01", "--scenarios", "2000"]
    process = subprocess.Popen(
        [sys.executable, "-c", program, "verify", *arguments, "-o", f"json:{tmp_path / 'r.json'}"],
        cwd=hall,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert process.stderr is not None
    process.stderr.readline()  # the first progress: long after the imports, long before the end
    process.send_signal(number)
    stdout, stderr = process.communicate(timeout=60)
    assert process.returncode == 130, stderr
    assert "Traceback" not in stderr
    assert stdout == ""
    assert list(tmp_path.iterdir()) == []


def test_a_horizon_is_reported_gated_and_replayed(run: Run, tmp_path: Path) -> None:
    kinds = ("json", "states", "witnesses", "markdown", "figure", "html", "csv")
    outputs = {kind: tmp_path / f"{kind}.{SUFFIX.get(kind, kind)}" for kind in kinds}
    asked = [part for kind, path in outputs.items() for part in ("--output", f"{kind}:{path}")]
    done = run(*VERIFY, "--horizon", "3", "--pose-error", "0.01,0.02", "--fail-under", "horizon=0", *asked)
    assert done.exit_code == 0, done.output
    assert "Horizon" in done.output
    assert "passed  safety rate over the horizon >= 0" in done.output
    report = json.loads(outputs["json"].read_text(encoding="utf-8"))
    schema = json.loads((ROOT / "docs" / "report.schema.json").read_text(encoding="utf-8"))
    jsonschema.validate(report, schema)
    assert report["horizon"]["pose_error"] == {"position": 0.01, "heading": 0.02}
    assert len(report["horizon"]["safety_rate"]) == report["horizon"]["steps"] == 3
    assert arrays_of(outputs["states"])["tube_lower"].shape == (report["states"], 3, 3)
    for kind in ("markdown", "html"):
        assert "unsafe over 3 intervals" in outputs[kind].read_text(encoding="utf-8")
    again = run("replay", outputs["witnesses"])
    assert again.exit_code == 0, again.output


def test_options_about_a_horizon_ask_for_one(run: Run) -> None:
    done = run(*VERIFY, "--fail-under", "horizon=0.9")
    assert done.exit_code == 2
    assert "add --horizon" in done.output


def test_what_is_given_in_place_of_another_file_is_called_by_its_name(run: Run, tmp_path: Path) -> None:
    image, training = tmp_path / "floor.png", tmp_path / "training.yaml"
    image.write_bytes(b"\x89PNG\r\n\x1a\n")
    training.write_text("method: via\nepochs: 60\n", encoding="utf-8")
    for command in (("map", image), ("verify", "policy.onnx", "--map", image)):
        said = run(*command).stderr
        assert "is an image, not the YAML of a map" in said
        assert "viatool init --map IMAGE" in said
    said = run("inspect", "policy.onnx", "--spec", training).stderr.splitlines()
    assert said[0] == f"error: {training}: this is a training configuration, not a specification"
    assert len(said) == 2
    said = run(*VERIFY, "--fail-under", "margin=0.01").stderr
    assert "viatool margin gates on it" in said


def test_a_specification_that_lies_beside_a_policy_is_named(run: Run, hall: Path, tmp_path: Path) -> None:
    policy = tmp_path / "foreign.onnx"
    policy.write_bytes((hall / "foreign.onnx").read_bytes())
    asked = ("doctor", policy, "--map", "map.yaml")
    assert "describe it with --spec robot.yaml" in run(*asked).stderr
    policy.with_suffix(".yaml").touch()
    assert f"give --spec {policy.with_suffix('.yaml')}" in run(*asked).stderr


def test_a_map_without_scenarios_is_said_to_have_none(run: Run, tmp_path: Path) -> None:
    world_map = tmp_path / "bare.yaml"
    fields = yaml.safe_load(MAP)
    fields = {name: value for name, value in fields.items() if name not in ("scenarios", "generator")}
    world_map.write_text(yaml.safe_dump(fields), encoding="utf-8")
    for command in ("mission", "simulate", "certify", "verify"):
        eps = () if command == "simulate" else ("--eps", 0.01)
        said = run(command, "policy.onnx", "--map", world_map, *eps).stderr
        assert f"map '{world_map}' has no scenarios" in said
        assert ("--trajectory" in said) == (command == "verify")
