"""Time and tightness of reachable sets, beside the targets.

    python tests/benchmarks/reach.py [--case NAME ...] [--states N] [--json FILE] [--escape N]

For each network and setting: milliseconds of CPU per state on one thread, and the ratio of certified to attained width,
summed over states and actions, in real arithmetic. What is attained is the best of every setting's own search and
of a gradient attack with restarts, so a ratio can only flatter the engine where the attack falls short. Beside it
stand the width that the float32 contract adds, in percent, and the share of bounds within 1e-4 of what is attained.

With `--escape N` nothing is timed: N points (uniform, corners, and corners near the attack's best) are run through
onnxruntime in float32 and through the network in float64, and those outside of the tightest bounds are counted.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from functools import cache
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = os.environ["MKL_NUM_THREADS"] = "1"

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[2]))

from tests.attacks import attack, sample
from tests.runtimes import onnx_model, onnx_session
from viatool.policy import load_policy
from viatool.policy.activations import activation
from viatool.policy.network import Activation, Affine, Input, Network, Node
from viatool.simulate import roll_out
from viatool.taylor import ReachableSet, reach
from viatool.world import load_map

Floats = NDArray[np.float64]
ROOT = Path(__file__).parents[2]
SEED = 2026


@dataclass(frozen=True, eq=False)
class Bare:
    """A network without a specification."""

    network: Network
    spec: Any = None
    runtime: Any = field(default_factory=lambda: SimpleNamespace(batches=True))

    @cache  # noqa: B019 - a handful of networks, alive to the end
    def session(self) -> Any:
        return onnx_session(onnx_model(self.network))

    def run(self, points: Floats) -> Floats:
        return np.asarray(self.session().run(None, {"v0": points.astype(np.float32)})[0], dtype=np.float64)


def random_actor(*widths: int, hidden: str) -> Bare:
    """Return a network with He (ReLU) or Xavier (tanh) weights, no biases, and a tanh at the end."""
    rng = np.random.default_rng([SEED, *widths])
    nodes: list[Node] = [Input(widths[0])]
    for layer, (before, after) in enumerate(pairwise(widths)):
        last = layer == len(widths) - 2
        function = "Tanh" if last else hidden
        gain = 2.0 / before if function == "Relu" else 2.0 / (before + after)
        weight = (rng.normal(size=(after, before)) * np.sqrt(gain)).astype(np.float32).astype(np.float64)
        nodes.append(Affine((len(nodes) - 1,), (weight,), np.zeros(after)))
        nodes.append(Activation(len(nodes) - 1, activation(function), after))
    return Bare(Network(tuple(nodes)))


def visited_states(policy: Any, count: int) -> Floats:
    """Return states that a policy visits on random scenarios of the lab."""
    world_map = load_map(ROOT / "maps" / "lab.yaml")
    scenarios = world_map.generator.draw(max(20, count // 50), SEED)
    observations = roll_out(policy, world_map, scenarios, seed=SEED).observations
    chosen = np.random.default_rng(SEED).permutation(len(observations))[:count]
    return np.asarray(observations[np.sort(chosen)], dtype=np.float64)


@dataclass(frozen=True)
class Case:
    """A network, states, an eps, and settings with their targets (ms per state, ratio)."""

    load: Callable[[], Any]
    eps: float
    states: int
    settings: dict[str, tuple[float, float]] = field(default_factory=dict)


OPTIONS: dict[str, dict[str, Any]] = {
    "none": {"refine": "none"},
    "monotone": {"refine": "monotone"},
    "split": {"refine": "split"},
    "split 2%": {"refine": "split", "tolerance": 0.02, "most_parts": 32},
    "order 2": {"refine": "none", "order": 2},
}


def exported(name: str) -> Callable[[], Any]:
    return lambda: load_policy(ROOT / "policies" / name)


NONE = float("nan")
CASES = {
    "via.onnx": Case(
        exported("via.onnx"),
        0.01,
        2000,
        {"none": (0.06, 1.05), "monotone": (0.3, 1.012), "split": (5, 1.001)},
    ),
    "via.onnx, eps 0.1": Case(
        exported("via.onnx"),
        0.1,
        200,
        {"none": (NONE, 1.40), "monotone": (NONE, 1.24), "split 2%": (20, 1.03), "split": (NONE, NONE)},
    ),
    "26-26-26-2 relu": Case(
        lambda: random_actor(26, 26, 26, 2, hidden="Relu"),
        0.01,
        500,
        {"none": (0.06, 1.11), "monotone": (0.5, 1.03), "split": (10, 1.002)},
    ),
    "26-26-26-2 tanh": Case(
        lambda: random_actor(26, 26, 26, 2, hidden="Tanh"),
        0.01,
        500,
        {"none": (0.1, 1.06), "monotone": (1.0, 1.0005), "order 2": (1.5, 1.003)},
    ),
    "26-64-64-2 relu": Case(
        lambda: random_actor(26, 64, 64, 2, hidden="Relu"),
        0.01,
        200,
        {"monotone": (2, 1.04), "split": (50, 1.005)},
    ),
    "26-256-256-2 relu": Case(
        lambda: random_actor(26, 256, 256, 2, hidden="Relu"),
        0.01,
        40,
        {"none": (5, 1.28), "monotone": (20, 1.25)},
    ),
    "via-64.onnx": Case(
        exported("via-64.onnx"), 0.01, 200, dict.fromkeys(("none", "monotone", "split"), (NONE, NONE))
    ),
    "via-tanh.onnx": Case(
        exported("via-tanh.onnx"), 0.01, 200, dict.fromkeys(("none", "monotone", "order 2"), (NONE, NONE))
    ),
}


@dataclass(frozen=True)
class Row:
    """One line of the table."""

    case: str
    setting: str
    states: int
    eps: float
    milliseconds: float
    target_milliseconds: float
    ratio: float
    target_ratio: float
    float32_extra_percent: float
    exact_percent: float


def states_of(name: str, policy: Any, count: int) -> Floats:
    if name.startswith("via"):
        return visited_states(policy, count)
    size = policy.network.input_size
    return np.random.default_rng([SEED, count]).uniform(-1, 1, (count, size))


def box_of(policy: Any, states: Floats, eps: float) -> tuple[Floats, Floats]:
    radius = policy.spec.radii(eps) if policy.spec is not None else np.full(states.shape[1], eps)
    return states - radius, states + radius


def attacked(policy: Any, lower: Floats, upper: Floats, restarts: int = 6) -> tuple[Floats, Floats]:
    """Return the best points of a gradient attack, (2 A, B, n), and their actions in float64, (2 A, B, A)."""
    network, rng = policy.network, np.random.default_rng(SEED)
    points = []
    for action in range(network.output_size):
        for sign in (1.0, -1.0):
            seed = np.zeros((lower.shape[0], network.output_size))
            seed[:, action] = sign
            points.append(attack(network, lower, upper, seed, rng, restarts=restarts, steps=32)[0])
    return np.stack(points), np.stack([network(point) for point in points])


def timed(policy: Any, states: Floats, eps: float, **options: Any) -> tuple[ReachableSet, float]:
    """Return reachable sets and the milliseconds per state, after a warm-up; the better of two runs if short."""
    reach(policy, states[:8], eps, **options)
    best = np.inf
    for _ in range(2):
        start = time.process_time()
        sets = reach(policy, states, eps, **options)
        best = min(best, time.process_time() - start)
        if best > 5:
            break
    return sets, 1e3 * best / len(states)


def measure(name: str, case: Case, count: int) -> list[Row]:
    """Run every setting of a case."""
    policy = case.load()
    states = states_of(name, policy, count)
    _, found = attacked(policy, *box_of(policy, states, case.eps))
    low, high = found.min(axis=0), found.max(axis=0)
    runs = {}
    for setting in case.settings:
        options = OPTIONS[setting]
        runs[setting] = timed(policy, states, case.eps, arithmetic="real", **options)
        low = np.minimum(low, runs[setting][0].attained_lower)
        high = np.maximum(high, runs[setting][0].attained_upper)
    deployed = reach(policy, states, case.eps, refine="none", arithmetic="float32")
    rows = []
    for setting, (sets, milliseconds) in runs.items():
        time_target, ratio_target = case.settings[setting]
        width = sets.width
        slack = 1e-12 + 1e-9 * np.abs(sets.upper)
        assert (low >= sets.lower - slack).all(), f"{name}, {setting}: an action below its bound"
        assert (high <= sets.upper + slack).all(), f"{name}, {setting}: an action above its bound"
        exact = np.concatenate(
            [high + 1e-4 * (high - low) >= sets.upper, low - 1e-4 * (high - low) <= sets.lower]
        )
        rows.append(
            Row(
                name,
                setting,
                len(states),
                case.eps,
                milliseconds,
                time_target,
                float(width.sum() / (high - low).sum()),
                ratio_target,
                float(100 * (deployed.width - width).sum() / width.sum()),
                float(100 * exact.mean()),
            )
        )
    return rows


HEADER = f"{'case':20} {'setting':9} {'states':>6} {'ms/state':>9} {'target':>7} {'ratio':>8} {'target':>7}"
HEADER += f" {'float32':>8} {'exact':>6}"


def line(row: Row) -> str:
    def target(value: float) -> str:
        return "" if np.isnan(value) else f"{value:g}"

    met = not (row.milliseconds > row.target_milliseconds or row.ratio > row.target_ratio)
    return (
        f"{row.case:20} {row.setting:9} {row.states:6d} {row.milliseconds:9.3f} {target(row.target_milliseconds):>7}"
        f" {row.ratio:8.5f} {target(row.target_ratio):>7} {row.float32_extra_percent:+7.3f}%"
        f" {row.exact_percent:5.1f}%{'' if met else '  missed'}"
    )


# --- escapes ---------------------------------------------------------------------------------------------


def escapes_of(name: str, case: Case, points: int) -> tuple[int, int, float]:
    """Return the points evaluated, the escapes, and the largest share of a box's deviation that was used."""
    policy = case.load()
    states = states_of(name, policy, min(case.states, 100))
    lower, upper = box_of(policy, states, case.eps)
    settings = [{**OPTIONS[setting], "most_parts": 40} for setting in case.settings]
    deployed = [reach(policy, states, case.eps, **options) for options in settings]
    real = [reach(policy, states, case.eps, arithmetic="real", **options) for options in settings]
    tightest = [
        (np.max([s.lower for s in sets], axis=0), np.min([s.upper for s in sets], axis=0))
        for sets in (deployed, real)
    ]
    best, _ = attacked(policy, lower, upper, restarts=2)
    rng = np.random.default_rng([SEED, points])
    batch = max(1, 200_000 // len(states))
    done = escaped = 0
    used = 0.0
    while done < points:
        drawn = sample(lower, upper, batch, rng)
        near = best[rng.integers(len(best), size=batch // 3)]
        flipped = rng.uniform(size=near.shape) < 0.1
        drawn[: batch // 3] = np.where(flipped, lower + upper - near, near).clip(lower, upper)
        flat = drawn.reshape(-1, drawn.shape[2])
        for run, (low, high), slack in (
            (policy.run, tightest[0], 0.0),
            (policy.network, tightest[1], 1e-12),  # what float64 itself rounds
        ):
            actions = run(flat).reshape(batch, len(states), -1)
            escaped += int(((actions < low - slack) | (actions > high + slack)).any(axis=2).sum())
            done += flat.shape[0]
        actions = policy.run(flat).reshape(actions.shape)
        over = np.maximum(np.maximum(tightest[1][0] - actions, actions - tightest[1][1]), 0)
        used = max(used, float((over / deployed[0].deviation).max()))
    return done, escaped, used


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--case", action="append", help="only cases whose name contains this")
    parser.add_argument("--states", type=int, help="states for each case")
    parser.add_argument("--json", type=Path, help="also write the table here")
    parser.add_argument(
        "--escape", type=float, metavar="N", help="evaluate N points and count escapes instead"
    )
    arguments = parser.parse_args()
    wanted = arguments.case or [""]
    cases = {name: case for name, case in CASES.items() if any(part in name for part in wanted)}
    if arguments.escape:
        total = escaped = 0
        for name, case in cases.items():
            done, out, used = escapes_of(name, case, int(arguments.escape / len(cases)))
            total, escaped = total + done, escaped + out
            print(
                f"{name:20} {done:12,d} points {out:6d} escapes, {100 * used:5.1f} % of the float32 margin used"
            )
        print(f"{'all':20} {total:12,d} points {escaped:6d} escapes")
        sys.exit(escaped > 0)
    rows = []
    print(HEADER)
    for name, case in cases.items():
        for row in measure(name, case, min(arguments.states or case.states, case.states)):
            rows.append(row)
            print(line(row), flush=True)
    if arguments.json:
        about = {"python": platform.python_version(), "numpy": np.__version__, "machine": platform.machine()}
        table = [{k: None if v != v else v for k, v in asdict(row).items()} for row in rows]
        arguments.json.write_text(json.dumps({"seed": SEED, **about, "rows": table}, indent=1) + "\n")


if __name__ == "__main__":
    main()
