"""The field's benchmarks as they stand in examples/arch-comp, for policies that the script there trains."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import yaml

from tests.missions.parking import drive
from viatool.cli import main

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "examples" / "arch-comp"
RUNS = 2000
ERRORS = {"nav": 0.0, "unicycle": 1e-4}
OBSERVED = {"nav": [0, 1, 3, 2], "unicycle": [0, 1, 2, 3]}
ABOVE = {"nav": 0.0, "unicycle": 20.0}
UPDATES = {"nav": 200, "unicycle": 400}


@pytest.fixture(scope="module", params=UPDATES)
def trained(request, tmp_path_factory):
    name, path = request.param, tmp_path_factory.mktemp("arch") / f"{request.param}.onnx"
    command = [sys.executable, FOLDER / "train.py", name, path, "--updates", str(UPDATES[name])]
    subprocess.run(command, check=True, capture_output=True)
    return name, path


def proof(name, path, folder, capsys):
    """What `viatool mission` writes, with the files and options of docs/missions.md."""
    report, tube = folder / "report.json", folder / "tube.npz"
    errors = ["--errors", FOLDER / "unicycle-errors.yaml"] if name == "unicycle" else []
    outputs = ["--output", f"json:{report}", "--output", f"tube:{tube}"]
    files = ["--spec", FOLDER / f"{name}.yaml", "--map", FOLDER / f"{name}-map.yaml"]
    with pytest.raises(SystemExit) as ended:
        main(list(map(str, ["mission", path, *files, *errors, *outputs])))
    assert ended.value.code == 0
    capsys.readouterr()
    return json.loads(report.read_text()), np.load(tube)


def program_of(path):
    """Return what onnxruntime makes of states as the network observes them, (R, 4)."""
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    return lambda observed: session.run(None, {session.get_inputs()[0].name: observed})[0]


def runs(name, program, starts, seed=0):
    """States (R, K + 1, 24, 4) of runs of the exported program, by Runge-Kutta: disturbed at corners, held or anew."""
    generator, states, found = np.random.default_rng(seed), starts, []
    held = generator.choice([-1.0, 1.0], (len(starts), 2))
    for _ in range(30 if name == "nav" else 50):
        observed = states[:, OBSERVED[name]].astype(np.float32)
        commands = program(observed)
        anew = generator.choice([-1.0, 1.0], held.shape)
        disturbed = ERRORS[name] * np.where(np.arange(len(starts))[:, None] % 2, held, anew)
        found.append(drive(states, commands - ABOVE[name] + disturbed, np.inf, least=-np.inf))
        states = found[-1][:, -1]
    return np.stack(found, axis=1)


def test_the_benchmarks_are_proved_from_one_part_and_hold_every_run(trained, tmp_path, capsys):
    name, path = trained
    report, tube = proof(name, path, tmp_path, capsys)
    (mission,) = report["missions"]
    assert (mission["verdict"], mission["start_parts"]) == ("proved", 1)
    starts = yaml.safe_load((FOLDER / f"{name}-map.yaml").read_text())["scenarios"][0]["start"]
    lower, upper = np.array(starts["lower"]), np.array(starts["upper"])
    share = np.random.default_rng(1).uniform(0.0, 1.0, (RUNS, 4))
    share[::2] = np.round(share[::2])
    states = runs(name, program_of(path), lower + share * (upper - lower))
    for step in range(states.shape[1] - 1):
        part = tube["step"] == step + 1
        ends = states[:, step, -1]
        assert (tube["lower"][part][0] - 1e-7 <= ends).all()
        assert (ends <= tube["upper"][part][0] + 1e-7).all()
    if name == "nav":
        inside = np.minimum(states[..., :2] - 1.0, 2.0 - states[..., :2]).min(axis=-1)
        assert inside.max() < 0.0
        assert np.abs(states[:, -1, -1, :2]).max() < 0.5
    else:
        assert (np.abs(states[:, -1, -1]) < [0.6, 0.2, 0.06, 0.3]).all()
