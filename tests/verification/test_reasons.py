"""Why states are not safe: each part of a reason against shapely, onnxruntime or a verification of its own."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
import shapely
from onnx import TensorProto, helper, numpy_helper

import viatool
from tests.hall import MAP, SPECIFICATION
from viatool.cli import main
from viatool.safety.reasons import CAUSES, Reason
from viatool.simulate import Places
from viatool.uncertainty import ErrorModel
from viatool.verification import reasoning
from viatool.verification.examination import StateExamination
from viatool.verification.result import Result
from viatool.world import load_map

KEEP = 0.4
POLICY = Path(__file__).parents[2] / "policies" / "td7.onnx"
ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def driven() -> Result:
    """A state that fails without any error, and one that two errors make fail together."""
    return viatool.verify("td7", "lab", eps=0.3, close=0)


@pytest.fixture(scope="module")
def placed() -> Result:
    """Places with bounds as loose as can be, so that some are not known."""
    return viatool.verify("td7", "lab", eps=0.3, refine="none", places=Places(count=2000))


def reasons(result: Result) -> list[Reason]:
    return list(result.reasons.each)


def again(result: Result, state: int, eps: object, **asked: object) -> str:
    """The verdict of one state by itself."""
    one = result.trajectory.select(np.array([state]))
    found = viatool.verify(result.policy_path, "lab", eps=eps, trajectory=one, close=0, **asked)
    return str(found.verdict[0])


def without(result: Result, names: list[str]) -> dict[str, float]:
    """The radii with some of them dropped."""
    radii = {channel.name: 0.3 for channel in result.channels if channel.value is None}
    return {**radii, **{name.removeprefix("eps of "): 0.0 for name in names}}


def path(pose: np.ndarray, command: np.ndarray, instants: int = 400) -> np.ndarray:
    """Where a command leads that is held for a control interval, by small steps, (T, 2)."""
    v, omega = command
    places, (x, y, turn), step = [pose[:2]], pose, 0.1 / instants
    for _ in range(instants):
        x += v * step * np.cos(turn + 0.5 * omega * step)
        y += v * step * np.sin(turn + 0.5 * omega * step)
        turn += omega * step
        places.append((x, y))
    return np.array(places)


def nearest(result: Result, state: int, places: np.ndarray) -> tuple[float, str]:
    """How near a path comes to what stands there, and to what."""
    world_map = load_map("lab")
    circles = world_map.obstacles.circles
    scenario = result.trajectory.scenarios[result.trajectory.episode[state]]
    circles = np.concatenate([circles, scenario.obstacles.circles])
    line = shapely.LineString(places)
    found = {"wall of the arena": shapely.Polygon(world_map.arena).exterior.distance(line)}
    for x, y, radius in circles:
        name = f"circle of radius {radius:.3g} m at ({x:.2f}, {y:.2f})"
        found[name] = shapely.Point(x, y).distance(line) - radius
    name = min(found, key=found.__getitem__)
    return found[name], name


def check_failing(result: Result) -> None:
    """Hold what is said of counterexamples to onnxruntime and shapely."""
    session = onnxruntime.InferenceSession(POLICY, providers=["CPUExecutionProvider"])
    unsafe = [one for one in reasons(result) if one.verdict == "unsafe"]
    assert unsafe
    for one in unsafe:
        seen = result.witness[one.state].astype(np.float32)[None]
        command = session.run(None, {session.get_inputs()[0].name: seen})[0][0]
        assert one.command == pytest.approx(command, abs=1e-6)
        left, name = nearest(result, one.state, path(result.poses[one.state], one.command))
        assert left <= KEEP
        assert (one.clearance, one.obstacle) == (pytest.approx(left, abs=1e-4), name)
        assert (one.bound[0] - 1e-6 <= one.command).all()
        assert (one.command <= one.bound[1] + 1e-6).all()
        assert f"{one.clearance:.4g} m of {name}" in one.brief
        assert f"{one.clearance:.4g} m of {name}" in one.words


def check_errors(result: Result) -> None:
    """Hold what is said of errors to verifications of each state by itself."""
    for one in reasons(result):
        needs, others = ([name for name, _ in some] for some in (one.needs, one.alternatives))
        if one.without_errors != "safe":
            assert not needs
            assert again(result, one.state, 0.0) == one.without_errors
            continue
        assert needs
        assert again(result, one.state, without(result, needs)) == "safe"
        for name in needs:
            fewer = [other for other in needs if other != name]
            assert again(result, one.state, without(result, fewer)) != "safe"
        for name in others:
            assert again(result, one.state, without(result, [name])) == "safe"
        if one.share > 0.0:
            assert again(result, one.state, one.eps) == "safe"


def test_what_a_counterexample_comes_near_to_and_by_which_command(driven: Result, placed: Result) -> None:
    check_failing(driven)
    check_failing(placed)


def test_the_least_set_of_errors_is_one(driven: Result) -> None:
    assert sorted(len(one.needs) for one in reasons(driven)) == [0, 2]
    check_errors(driven)


def test_what_is_said_of_errors_where_bounds_are_loose(placed: Result) -> None:
    some = [one for one in reasons(placed) if one.verdict == "unknown"][:2]
    assert [one.verdict for one in some] == ["unknown"] * 2
    for one in some:
        assert again(placed, one.state, without(placed, [one.needs[0][0]]), refine="none") == "safe"
        assert again(placed, one.state, one.eps, refine="none") == "safe"
        assert again(placed, one.state, 0.3, refine="none") == "unknown"


def test_a_state_that_fails_with_perfect_sensors_says_so(driven: Result) -> None:
    worst = reasons(driven)[0]
    assert (worst.cause, worst.without_errors, worst.needs) == ("policy", "unsafe", ())
    assert "fails even with perfect sensors" in worst.brief
    assert "The policy has to act otherwise" in worst.words
    session = onnxruntime.InferenceSession(POLICY, providers=["CPUExecutionProvider"])
    seen = driven.observations[worst.state].astype(np.float32)[None]
    command = session.run(None, {session.get_inputs()[0].name: seen})[0][0].astype(np.float64)
    assert nearest(driven, worst.state, path(driven.poses[worst.state], command))[0] <= KEEP
    assert "perfect sensors" not in reasons(driven)[1].words


def test_refine_more_is_said_where_bounds_are_loose_and_splitting_proves_it(placed: Result) -> None:
    loose = [one for one in reasons(placed) if one.refined]
    assert loose
    for one in loose[:2]:
        assert (one.cause, one.verdict) == ("bounds", "unknown")
        assert "--refine split proves it" in one.words
        assert again(placed, one.state, 0.3, refine="none") == "unknown"
        assert again(placed, one.state, 0.3, refine="split") == "safe"
        assert (one.bound[0] <= one.attained[0] + 1e-6).all()
        assert (one.attained[1] <= one.bound[1] + 1e-6).all()
        assert one.attained_clearance > KEEP
        assert one.gap.max() > 0.01
        assert one.gap == pytest.approx(
            np.maximum(one.attained[0] - one.bound[0], one.bound[1] - one.attained[1]), abs=1e-9
        )


def test_what_is_attained_is_attained(placed: Result) -> None:
    """Observations at corners of the box make onnxruntime command what reaches from one end to the other, about."""
    session = onnxruntime.InferenceSession(POLICY, providers=["CPUExecutionProvider"])
    one = next(one for one in reasons(placed) if one.refined)
    rng = np.random.default_rng(0)
    signs = rng.choice([-1.0, 0.0, 1.0], size=(20_000, len(placed.radii)))
    seen = placed.observations[one.state] + signs * placed.radii
    commands = session.run(None, {session.get_inputs()[0].name: seen.astype(np.float32)})[0]
    assert (one.attained[0] <= commands.min(axis=0) + 0.05 * np.ptp(commands, axis=0)).all()
    assert (one.attained[1] >= commands.max(axis=0) - 0.05 * np.ptp(commands, axis=0)).all()
    assert (commands >= one.bound[0] - 1e-6).all()
    assert (commands <= one.bound[1] + 1e-6).all()


def sliding(folder: Path) -> Path:
    """Write a policy that turns towards what stands on its left only while it is slow."""
    weights = np.zeros((2, 26), np.float32)
    weights[:, 22] = 5.0, -20.0  # of goal_sine
    constants = {"weights": weights, "bias": np.array([0.25, 0.0], np.float32)}
    graph = helper.make_graph(
        [helper.make_node("Gemm", ["observation", "weights", "bias"], ["action"], transB=1)],
        "actor",
        [helper.make_tensor_value_info("observation", TensorProto.FLOAT, ["batch", 26])],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, ["batch", 2])],
        [numpy_helper.from_array(array, name) for name, array in constants.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(model, {"viatool.spec": json.dumps(SPECIFICATION)})
    onnx.save(model, folder / "policy.onnx")
    (folder / "map.yaml").write_text(MAP)
    return folder


@pytest.fixture(scope="module")
def sliding_by(tmp_path_factory: pytest.TempPathFactory) -> Result:
    folder = sliding(tmp_path_factory.mktemp("sliding"))
    asked = folder / "policy.onnx", folder / "map.yaml"
    one = viatool.verify(*asked, eps=0.05).trajectory.select(np.array([0]))
    seen = one.observations.copy()
    seen[:, 22] = 0.0
    place = np.array([[0.7 + 0.0004, 0.55, 0.5 * np.pi]])
    return viatool.verify(*asked, eps=0.05, trajectory=replace(one, poses=place, observations=seen))


def test_tighter_bounds_are_not_promised_where_what_is_attained_fails_together(sliding_by: Result) -> None:
    (one,) = reasons(sliding_by)
    assert (one.verdict, one.cause) == ("unknown", "commands")
    assert "tighter bounds cannot prove it" in one.words
    assert "--refine" not in one.words
    assert one.attained_clearance < KEEP
    assert one.gap.max() < 1e-3
    assert [name for name, _ in one.needs] == ["eps of goal_sine"]
    # turning hardest towards it at half of the speed fails, and no observation gives both
    x, y = place = sliding_by.poses[0][:2]
    assert shapely.Point(0.0, 0.55).distance(shapely.Point(place)) - 0.3 > KEEP
    together = path(np.array([x, y, 0.5 * np.pi]), np.array([0.25, 1.0]))
    assert shapely.Point(0.0, 0.55).distance(shapely.LineString(together)) - 0.3 < KEEP
    for error in np.linspace(-0.05, 0.05, 201):
        each = path(np.array([x, y, 0.5 * np.pi]), np.array([0.25 + 5.0 * error, -20.0 * error]))
        assert shapely.Point(0.0, 0.55).distance(shapely.LineString(each)) - 0.3 > KEEP
    assert one.command == pytest.approx([0.25, 1.0], abs=1e-3)


def test_a_state_that_stands_too_near_says_that_no_command_helps(sliding_by: Result) -> None:
    nearer = replace(sliding_by.trajectory, poses=np.array([[0.69, 0.55, 0.5 * np.pi]]))
    found = viatool.verify(sliding_by.policy_path, sliding_by.world_map.path, eps=0.05, trajectory=nearer)
    (one,) = reasons(found)
    assert (one.verdict, one.cause) == ("unsafe", "pose")
    assert one.standing == pytest.approx(0.39)
    assert "no command helps" in one.words


def test_terms_of_the_error_model_are_needed_as_well() -> None:
    model = ErrorModel.model_validate({"obstacles": {"speed": 0.3}})
    asked = {"eps": 0.0, "clearance": 0.5, "danger": 0.5, "close": 0}
    found = viatool.verify("via", "lab", errors=model, **asked)
    plain = viatool.verify("via", "lab", trajectory=found.trajectory, **asked)
    lost = [one for one in reasons(found) if plain.verdict[one.state] == "safe"]
    assert lost
    for one in lost:
        assert [name for name, _ in one.needs] == ["obstacles.speed"]
        assert "0.30 m/s" in one.obstacle
        assert "safe without obstacles.speed (0.3 m/s)" in one.brief
        assert "eps" not in one.words


def test_a_mutant_that_proves_everything_is_caught(driven: Result, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(StateExamination, "proves", lambda self, states: np.ones(len(states), dtype=bool))
    wrong = viatool.verify("td7", "lab", eps=0.3, trajectory=driven.trajectory, close=0)
    monkeypatch.undo()
    with pytest.raises(AssertionError):
        check_errors(wrong)


def test_a_mutant_that_names_another_command_is_caught(
    driven: Result, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(reasoning.ClosestCommands, "met", lambda self, found: self)
    wrong = viatool.verify("td7", "lab", eps=0.3, trajectory=driven.trajectory, close=0)
    with pytest.raises(AssertionError):
        check_failing(wrong)


def test_where_all_is_safe_nothing_is_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reasoning, "_look", pytest.fail)
    monkeypatch.setattr(reasoning, "_judge_again", pytest.fail)
    found = viatool.verify("via", "lab", eps=0.01, close=0)
    assert (found.verdict == "safe").all()
    assert found.to_json()["reasons"] == []


def test_of_many_the_worst_are_told_and_the_others_counted(
    placed: Result, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(reasoning, "MOST", 3)
    monkeypatch.setattr(reasoning, "_affordable", lambda again: 2)
    report = tmp_path / "report.json"
    asked = [
        "verify",
        "td7",
        "--map",
        "lab",
        "--eps",
        "0.3",
        "--refine",
        "none",
        "--poses",
        "random:2000",
        "-q",
    ]
    assert run([*asked, "-o", f"json:{report}"])[0] == 0
    told = json.loads(report.read_text())
    assert [one["state"] for one in told["reasons"]] == [one.state for one in reasons(placed)[:3]]
    assert told["reasons_left_out"] == len(placed.reasons.each) - 3
    assert [one["without_errors"] is None for one in told["reasons"]] == [False, False, True]
    unsafe, unknown = (
        next(one.state for one in reasons(placed)[::-1] if one.verdict == verdict) for verdict in CAUSES_OF
    )
    assert run(["explain", report, "--state", unsafe]) == (2, CAUSES_OF["unsafe"].format(unsafe))
    assert run(["explain", report, "--state", unknown]) == (2, CAUSES_OF["unknown"].format(unknown))


CAUSES_OF = {
    "unsafe": "error: state {} is unsafe, but it is none of the 3 worst, of which the report says why",
    "unknown": "error: state {} may be safe or unknown: it is none of the 3 worst, of which the report says why",
}


def run(arguments: list[object]) -> tuple[int, str]:
    """Run a command; return its exit code and the first line of what it prints."""
    from click.testing import CliRunner

    found = CliRunner().invoke(main, [str(argument) for argument in arguments])
    return found.exit_code, (found.output.splitlines() or [""])[0]


def test_the_worst_come_first(placed: Result) -> None:
    told = reasons(placed)
    assert [one.verdict for one in told] == sorted(
        (one.verdict for one in told), key=["unsafe", "unknown"].index
    )
    unsafe = [one.clearance for one in told if one.verdict == "unsafe"]
    assert unsafe == sorted(unsafe)
    assert {one.state for one in told} == set(np.flatnonzero(placed.verdict != "safe").tolist())


def test_close_places_say_why_as_well(tmp_path: Path) -> None:
    report = tmp_path / "report.json"
    asked = ["verify", "td7", "--map", "lab", "--eps", "0.1", "--close", "60", "-q", "-o", f"json:{report}"]
    assert run(asked)[0] == 0
    close = json.loads(report.read_text())["close"]
    told = {one["state"]: one for one in close["reasons"]}
    assert len(told) == close["verdicts"]["unsafe"] + close["verdicts"]["unknown"] > 3
    worst = close["reasons"][0]
    place = f"Close place {worst['state']} is {worst['verdict']}: scenario {worst['scenario']} at"
    code, said = run(["explain", report, "--close", worst["state"]])
    assert code == 0
    assert said.startswith(place)
    safe = next(number for number in range(60) if number not in told)
    assert run(["explain", report, "--close", safe]) == (
        0,
        f"Close place {safe} is proved safe: nothing to explain.",
    )
    assert run(["explain", report, "--close", 60]) == (
        2, "error: there is no close place 60: the report is on close places 0 to 59",
    )  # fmt: skip


def test_every_cause_is_in_the_schema() -> None:
    schema = json.loads((ROOT / "docs" / "report.schema.json").read_text())
    assert set(schema["$defs"]["ReasonRecord"]["properties"]["cause"]["enum"]) == set(CAUSES)
    assert re.search("bounds", schema["$defs"]["ReasonRecord"]["description"])
