"""What the copied program does: counterexamples are run again, and commands are held against their boxes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.recheck.evidence import StoredEvidence, TablePart
from viatool.recheck.motion import Motion
from viatool.recheck.outcome import Outcome, numbered
from viatool.recheck.scene import EpisodeScenes

Floats = NDArray[np.float64]

_STATES, _SAMPLES = 200, 4
_ROUNDING = 1e-5  # by which onnxruntime may differ on another machine
_OVER_TIME = frozenset(("before", "late"))


class Program:
    """The copied ONNX in onnxruntime, and what the robot's software does with its outputs."""

    def __init__(self, evidence: StoredEvidence) -> None:
        import onnxruntime

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 4
        self._model, self._commands = evidence.setting["model"], evidence.setting["commands"]
        path = str(evidence.copies("policy")[0])
        self._session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])

    def __call__(self, observation: Floats) -> Floats:
        """Return the command (A,) after an observation (n,), before the robot's limits."""
        numbers, feed, first = observation.astype(self._model["precision"]), {}, 0
        for port in self._model["inputs"]:
            size = int(np.prod(port["shape"]))
            feed[port["name"]] = numbers[first : first + size].reshape(port["shape"])
            first += size
        (given,) = self._session.run([self._model["output"]], feed)
        raw = np.asarray(given, dtype=np.float64).reshape(-1)
        entries, commands = self._model["entries"], self._commands
        raw = raw if entries is None else raw[entries]
        if commands["choice"] is not None:
            return np.array(commands["choice"][int(np.argmax(raw))], dtype=np.float64)
        actions = raw * np.array(commands["scale"]) + np.array(commands["offset"])
        if commands["limits"] is not None:
            actions = np.clip(actions, *np.transpose(commands["limits"]))
        return np.asarray(actions[commands["columns"]])


def check_witnesses(evidence: StoredEvidence, found: Outcome) -> None:
    """Run every counterexample: within its box, by the program's command, and too near on the arc that is driven."""
    reasons, commands = evidence.beyond(), evidence.setting["commands"]
    single = [entry for part in evidence.parts for entry in part.witnesses if not _OVER_TIME & entry.keys()]
    over_time = len(evidence.witnesses["witnesses"]) - len(single)
    if over_time:
        found.not_rechecked.append(f"{over_time} counterexamples over several intervals")
    if single and commands is None:
        found.not_rechecked.append(f"commands of the counterexamples: {evidence.setting['commands_are']}")
    if single and reasons:
        found.not_rechecked.append(f"paths of the counterexamples: {', '.join(reasons)}")
    program = Program(evidence) if single and commands is not None else None
    scenes = None if reasons else EpisodeScenes(evidence)
    before = len(found.contradicted)
    for part in evidence.parts:
        _check_part(_Replay(evidence, part, program, scenes), found)
    if single and len(found.contradicted) == before:
        found.verdicts += len(single) if program is not None and scenes is not None else 0
        found.confirmed.append(f"{len(single)} counterexamples, as far as they are rechecked")


@dataclass(frozen=True)
class _Replay:
    """What the counterexamples of a part are run with: nothing where that is not rechecked."""

    evidence: StoredEvidence
    part: TablePart
    program: Program | None
    scenes: EpisodeScenes | None


def _check_part(replay: _Replay, found: Outcome) -> None:
    """Check that each unsafe state has its counterexample, and each counterexample."""
    part = replay.part
    single = [entry for entry in part.witnesses if not _OVER_TIME & entry.keys()]
    unsafe = np.flatnonzero(part.table["verdict"] == "unsafe")
    named = sorted(int(entry["state"]) for entry in single)
    message = f"witnesses.json: is of {part.name} {numbered(named)}, unsafe are {numbered(unsafe)}"
    found.expect(named == unsafe.tolist(), message)
    held = np.flatnonzero(np.isfinite(part.table["witness"]).all(axis=1))
    found.expect(held.tolist() == unsafe.tolist(), f"states.npz: `witness` is not of the unsafe {part.name}s")
    for entry in single:
        name = f"witnesses.json: {part.place(entry['state'])}"
        _check_observation(replay, entry, name, found)
        if replay.program is not None:
            _check_command(replay, entry, name, found)
        if replay.scenes is not None:
            _check_path(replay, entry, name, found)


def _check_observation(replay: _Replay, entry: dict[str, Any], name: str, found: Outcome) -> None:
    table, row = replay.part.table, entry["state"]
    seen = np.array(entry["observation"], dtype=float)
    within = (seen >= table["observation_lower"][row]) & (seen <= table["observation_upper"][row])
    found.expect(bool(within.all()), f"{name}: the observation is outside of its box")
    same = np.array_equal(seen, table["witness"][row])
    found.expect(same, f"{name}: the observation is not that of states.npz")
    away = np.abs(np.array(entry["pose"], dtype=float) - table["pose"][row])
    near = bool((away <= np.array(replay.evidence.setting["pose_radii"]) + 1e-9).all())
    found.expect(near, f"{name}: the pose is not that of states.npz")
    found.expect(entry["episode"] == table["episode"][row], f"{name}: the episode is not that of states.npz")


def _check_command(replay: _Replay, entry: dict[str, Any], name: str, found: Outcome) -> None:
    assert replay.program is not None
    stated, rules = np.array(entry["action"], dtype=float), replay.evidence.rules
    own = np.clip(replay.program(np.array(entry["observation"], dtype=float)), rules["lower"], rules["upper"])
    same = bool((np.abs(own - stated) <= _ROUNDING * (1.0 + np.abs(own))).all())
    found.expect(same, f"{name}: the program commands {own.tolist()}, not {stated.tolist()}")


def _check_path(replay: _Replay, entry: dict[str, Any], name: str, found: Outcome) -> None:
    assert replay.scenes is not None
    rules, stated = replay.evidence.rules, float(entry["closest"]["clearance"])
    command, pose = (np.array(entry[part], dtype=float) for part in ("action", "pose"))
    scene = replay.scenes.of(int(replay.part.table["episode"][entry["state"]]))
    left = Motion(rules).least_clearance(scene, command, pose)
    message = f"{name}: its arc keeps {left:.6f} m, so it is no counterexample"
    found.expect(left <= rules["collision"], message)
    same = left <= stated + 1e-6 and (left >= stated - 1e-3 or stated == 0.0)
    found.expect(same, f"{name}: its arc comes within {left:.6f} m, the file says {stated:.6f} m")


def check_network(evidence: StoredEvidence, found: Outcome) -> None:
    """Look for an observation whose command lies outside of its box; that none is found proves nothing."""
    found.not_rechecked.append(
        "that each box of commands holds every command of the network, which takes an engine"
    )
    setting = evidence.setting
    if not setting["is_box"] or setting["commands"] is None or setting["commands"]["choice"] is not None:
        return
    program, chance = Program(evidence), np.random.default_rng(0)
    spare = 0.0 if evidence.report["arithmetic"] == "float32" else 1e-4
    looked_at = sum(_sample(part, program, chance, spare, found) for part in evidence.parts)
    found.confirmed.append(
        f"{looked_at:,} sampled observations give commands within their boxes, which is no proof"
    )


def _sample(
    part: TablePart, program: Program, chance: np.random.Generator, spare: float, found: Outcome
) -> int:
    """Run observations of the boxes of some states, and return how many."""
    table = part.table
    bounded = np.flatnonzero(np.isfinite(table["lower"] + table["upper"]).all(axis=1))
    rows = bounded[:: -(-len(bounded) // _STATES) or 1]
    for row in rows.tolist():
        names = ("observation", "observation_lower", "observation_upper", "lower", "upper")
        seen, low, high, least, most = (table[name][row] for name in names)
        for number in range(_SAMPLES):
            share = chance.random(len(low)) if number % 2 else chance.integers(0, 2, len(low))
            point = (low + share * (high - low)).astype(np.float32).astype(np.float64)
            sent = program(np.where((point >= low) & (point <= high), point, seen))
            within = bool(((sent >= least - spare) & (sent <= most + spare)).all())
            name = f"states.npz: {part.place(row)}"
            found.expect(
                within, f"{name}: an observation of its box gives {sent.tolist()}, outside its commands"
            )
    return len(rows) * _SAMPLES
