"""Counterexamples of certify within the whole error model, each checked by an oracle with arithmetic of its own."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from tests.sight.ray_oracle import outlines, ranges
from viatool import load_map, load_policy
from viatool.cli import main
from viatool.loop import deceived, refuting
from viatool.places import STATUSES, Resolution, SearchBudget, certify
from viatool.report.places.run import PlacesRun
from viatool.safety import witness
from viatool.setting import admissible
from viatool.uncertainty import ErrorModel
from viatool.verification.witness_file import load_witnesses, replay
from viatool.world import Obstacles

POLICY = load_policy(Path("policies/via.onnx"))
LIDAR = POLICY.spec.channel("lidar").lidar.lidar()
ROOM = load_map(Path("maps/room.yaml"))
POSTS = np.array([[x, y, 0.04] for x in (-1.3, 0.0, 1.3) for y in (-1.3, 1.3)])
WORLD = replace(ROOM, obstacles=ROOM.obstacles + Obstacles(POSTS))
SCENARIO = WORLD.scenarios[0]
EPS = 0.01
NEAR = 2e-6
"""What float32 takes of a reading of some metres."""
TERMS = {
    "relative": {"relative": 0.05},
    "bias": {"bias": 0.08},
    "angle": {"angle": 0.08},
    "thin": {"thin": 0.1},
    "missing": {"missing": 2},
    "pose": {"pose": {"x": 0.1, "y": 0.1, "theta": 0.1}},
    "all": {
        "relative": 0.02, "bias": 0.03, "angle": 0.03, "thin": 0.1, "missing": 2,
        "pose": {"x": 0.05, "y": 0.05, "theta": 0.05},
    },
}  # fmt: skip


def certified(terms, **options):
    sensor = {name: value for name, value in terms.items() if name != "pose"}
    model = ErrorModel.model_validate({"sensor": {"lidar": sensor}, "pose": terms.get("pose", {})})
    return certify(
        POLICY, WORLD, SCENARIO, eps=EPS, errors=model, resolution=Resolution(0.08, 0), seed=5,
        **{"budget": SearchBudget(share=0.04), **options},
    )  # fmt: skip


def misses(terms, certificate):
    """By how much counterexamples leave what the model allows at most, in metres (or what the channel has).

    For each one its bins are told apart from its pose, with the turn and the thin obstacles that it says; then the
    bias is looked for that needs the fewest rays to be lost.
    """
    found, worst = certificate.findings, 0.0
    every = outlines(WORLD, SCENARIO)
    bare = outlines(ROOM, SCENARIO)
    pose = terms.get("pose", {"x": 0.0, "y": 0.0, "theta": 0.0})
    away = np.abs(found.believed - found.pose) - [pose["x"], pose["y"], pose["theta"]]
    worst = max(worst, float(away.max()))
    turn = found.turn if found.turn.size else np.zeros((len(found.pose), 1))
    worst = max(worst, float(np.abs(turn).max() - terms.get("angle", 0.0)))
    turned = found.pose + turn * [0.0, 0.0, 1.0]
    rays, past = (ranges(turned, LIDAR.angles(), what, LIDAR.maximum_range) for what in (every, bare))
    passed = found.passed[:, :20] if found.passed.size else np.zeros((len(found.pose), 20), dtype=bool)
    assert "thin" in terms or not passed.any()
    rays = np.where(np.repeat(passed, LIDAR.each, axis=1), past, rays)
    rays = np.sort(np.clip(rays, LIDAR.minimum_range, LIDAR.maximum_range).reshape(len(rays), 20, -1), axis=2)
    goal = np.array(SCENARIO.goal) - found.believed[:, :2]
    bearing = np.arctan2(goal[:, 1], goal[:, 0]) - found.believed[:, 2]
    others = np.stack([np.hypot(*goal.T), np.cos(bearing), np.sin(bearing), *found.previous.T], axis=1)
    worst = max(worst, float(np.abs(found.observation[:, 20:25] - others).max() - EPS))
    return max(
        worst, *(_scan_misses(terms, rays[row], found.observation[row, :20]) for row in range(len(rays)))
    )


def _scan_misses(terms, rays, seen):
    """By how much a scan leaves what is allowed, with the best of many biases and as many lost rays as allowed."""
    least = np.inf
    bias = terms.get("bias", 0.0)
    for common in np.linspace(-bias, bias, 201 if bias else 1):
        off = np.full((terms.get("missing", 0) + 1, 20), np.inf)
        for lost in range(len(off)):
            true = rays[:, lost]
            own = EPS + terms.get("relative", 0.0) * true
            low, high = true - own + common, true + own + common
            if set(terms) - {"pose"}:
                low, high = (np.clip(end, LIDAR.minimum_range, LIDAR.maximum_range) for end in (low, high))
            off[lost] = np.maximum(np.maximum(low - seen, seen - high), 0.0)
        allowed = 2.0 * bias / 200 + NEAR
        needed = np.where((off <= allowed).any(axis=0), (off <= allowed).argmax(axis=0), 99)
        left = float(off.min(axis=0).max()) if needed.sum() > terms.get("missing", 0) else 0.0
        least = min(least, left if left > allowed else 0.0)
    return least


@pytest.fixture(scope="module")
def certificates():
    return {name: certified(terms) for name, terms in TERMS.items()}


@pytest.mark.parametrize("name", TERMS)
def test_counterexamples_obey_the_model_and_fail_again(certificates, name):
    found = certificates[name].findings
    lower, upper = certificates[name].lattice.bounds(
        found.nodes.select(found.status == STATUSES.index("refuted"))
    )
    states = np.hstack([found.pose, found.previous])
    assert len(states) > 20
    assert ((states >= lower - 1e-9) & (states <= upper + 1e-9)).all()
    assert misses(TERMS[name], certificates[name]) <= NEAR
    actions = np.clip(POLICY.run(found.observation), [0.0, -1.0], [0.5, 1.0])
    np.testing.assert_allclose(actions, found.action, atol=1e-6)
    assert (found.clearance < 0.4).all()


def test_each_term_is_used(certificates):
    alone = certified({})
    refuted = {name: len(one.findings.pose) for name, one in certificates.items()}
    assert refuted["all"] > len(alone.findings.pose)
    assert max(np.ptp(certificates["angle"].findings.turn), 0.0) > 0.1
    assert certificates["thin"].findings.passed.any()
    assert np.abs(certificates["pose"].findings.believed - certificates["pose"].findings.pose).max() > 0.09


MUTANTS = {
    "bias": (admissible.AdmissibleSets, "_bias", lambda right: lambda self, columns: 1.5 * right(self, columns)),
    "missing": (
        deceived, "_without_nearest",
        lambda right: lambda lidar, rays, count: right(lidar, rays, count + 6)[6:],
    ),
    "angle": (deceived, "_WITHIN", lambda right: 1.5),
}  # fmt: skip


@pytest.mark.parametrize("name", MUTANTS)
def test_the_oracle_and_the_check_catch_observations_beyond_the_model(monkeypatch, name):
    where, what, mutate = MUTANTS[name]
    monkeypatch.setattr(where, what, mutate(getattr(where, what)))
    if name == "bias":  # is refused by the check itself
        found, right = [], refuting.explain_known
        monkeypatch.setattr(
            refuting, "explain_known", lambda *given: found.append(right(*given)) or found[-1]
        )
        certified(TERMS[name])
        assert None in found
        monkeypatch.setattr(refuting, "explain_known", lambda *given: {})
    assert misses(TERMS[name], certified(TERMS[name])) > 1e-3


def test_witness_files_say_the_errors_and_are_replayed(certificates, tmp_path):
    target = tmp_path / "witnesses.json"
    target.write_text(json.dumps(PlacesRun(certificates["all"]).witness_file()))
    file = load_witnesses(target)
    again = replay(POLICY, WORLD, file)
    assert len(file) > 20
    assert again.violates.all()
    told = [entry.get("errors", {}).get("lidar", {}) for entry in file.entries]
    assert any("bias" in one for one in told)
    assert any("angle" in one for one in told)
    assert all("believed_pose" in entry for entry in file.entries)
    assert witness.MARGIN > 0.0


def test_the_command_writes_what_replay_reads(tmp_path):
    (tmp_path / "errors.yaml").write_text("sensor: {lidar: {relative: 0.05, missing: 1}}\npose: {x: 0.05}")
    target = tmp_path / "witnesses.json"
    asked = [
        "certify", "policies/via.onnx", "--map", "maps/room.yaml", "--smallest", "0.1", "--halvings", "0", "--sample",
        "0.05", "--eps", "0.01", "--errors", str(tmp_path / "errors.yaml"), "-o", f"witnesses:{target}",
    ]  # fmt: skip
    run = CliRunner().invoke(main, asked)
    assert run.exit_code == 0, run.output
    again = CliRunner().invoke(main, ["replay", str(target)])
    assert again.exit_code == 0, again.output
