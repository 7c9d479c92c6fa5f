"""How far onnxruntime's activations in float32 are from the truth, beside the margins that bounds allow them.

    python tests/benchmarks/activation_error.py [--every 4099] [--range LOW HIGH] [--activation NAME ...]

Takes every N-th of the 2^32 float32 numbers (all of them with `--every 1`), runs each declared activation in
onnxruntime, and compares with float64. The error is given in unit roundoffs (2^-24) of the scale that
its declaration names, as the margins of viatool/policy/activations.py are; a margin below twice the largest error seen
is flagged, and the command fails. The float64 reference itself is compared with 240-bit arithmetic at random points of
the range.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = os.environ["MKL_NUM_THREADS"] = "1"

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[2]))

from tests.oracles import MP, activate
from tests.runtimes import onnx_model, onnx_session
from tests.strategies import ACTIVATIONS
from viatool.policy.activations import ActivationFunction
from viatool.policy.network import Activation, Input, Network
from viatool.rounding import SMALLEST_NORMAL

Floats = NDArray[np.float64]

UNIT = 2.0**-24
LARGEST = float(np.finfo(np.float32).max)
LENGTH = 1 << 20
SHORT = 1000
SAFETY = 2.0


@dataclass(frozen=True)
class Worst:
    """The largest error seen, in units, and where."""

    units: float
    x: float
    points: int


def float32_numbers(every: int, low: float, high: float) -> Iterator[NDArray[np.float32]]:
    """Yield every N-th float32 number of a range, in blocks."""
    step = every * LENGTH
    for start in range(0, 1 << 32, step):
        bits = np.arange(start, min(start + step, 1 << 32), every, dtype=np.uint64).astype(np.uint32)
        x = bits.view(np.float32)
        yield x[np.isfinite(x) & (x >= low) & (x <= high)]


def defined(function: ActivationFunction, x: Floats, value: Floats) -> NDArray[np.bool_]:
    """Return where a function is defined and its value fits float32."""
    inside = np.isfinite(value) & (np.abs(value) <= LARGEST)
    if function.name in ("Log", "Sqrt"):
        inside &= x >= 0
    return inside


def errors(function: ActivationFunction, session: Any, x: NDArray[np.float32]) -> tuple[Floats, int]:
    """Return the error of onnxruntime at points in units, and at how many of them the function is defined."""
    exact = x.astype(np.float64)
    with np.errstate(all="ignore"):
        value = function(exact)
        found = session.run(None, {"v0": x[:, None]})[0][:, 0].astype(np.float64)
        inside = defined(function, exact, value)
        size = function.error.scale(function.named, np.abs(exact), np.abs(value))
        beyond = np.maximum(np.abs(found - value) - SMALLEST_NORMAL["float32"], 0.0)
        units = np.where(inside & (beyond > 0), beyond / (UNIT * size), 0.0)
    return np.where(np.isnan(units), np.inf, units), int(inside.sum())


def worst_error(function: ActivationFunction, every: int, low: float, high: float) -> Worst:
    """Compare onnxruntime with float64, on long arrays and on ones shorter than a vector register."""
    session = onnx_session(onnx_model(Network((Input(1), Activation(0, function, 1)))))
    worst, where, points = 0.0, 0.0, 0
    short = (np.random.default_rng(5).normal(size=(SHORT, 3)) * 4).clip(low, high).astype(np.float32)
    for x in chain(short, float32_numbers(every, low, high)):
        if x.size:
            units, inside = errors(function, session, x)
            points += inside
            k = int(units.argmax())
            if units[k] > worst:
                worst, where = float(units[k]), float(x[k])
    return Worst(worst, where, points)


def reference_error(function: ActivationFunction, low: float, high: float, count: int = 400) -> float:
    """Return the largest error of the float64 reference at random float32 numbers, in the same units."""
    rng = np.random.default_rng(3)
    bits = rng.integers(0, 1 << 32, 20 * count, dtype=np.uint64).astype(np.uint32)
    single = bits.view(np.float32)
    x = single[np.isfinite(single)].astype(np.float64)
    x = x[(x >= max(low, -1e4)) & (x <= min(high, 1e4)) & (np.abs(x) > 1e-12)][:count]
    with np.errstate(all="ignore"):
        value = function(x)
        x, value = x[defined(function, x, value)], value[defined(function, x, value)]
    worst = 0.0
    for point, found in zip(x.tolist(), value.tolist(), strict=True):
        truth: Any = activate(function, MP.mpf(point))
        worst = max(worst, float(abs(truth - found) / (UNIT * max(1, abs(truth), abs(point)))))
    return worst


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--every", type=int, default=4099, help="stride through the float32 numbers; 1 for all"
    )
    parser.add_argument("--range", type=float, nargs=2, default=(-LARGEST, LARGEST), metavar=("LOW", "HIGH"))
    parser.add_argument("--activation", action="append", help="only these")
    arguments = parser.parse_args()
    low, high = arguments.range
    print(
        f"{'activation':18} {'points':>13} {'worst':>8} {'at x':>14} {'margin':>7} {'spare':>7} {'float64':>9} {'s':>6}"
    )
    flagged = []
    for function in ACTIVATIONS:
        if arguments.activation and function.name not in arguments.activation:
            continue
        start = time.perf_counter()
        worst = worst_error(function, arguments.every, low, high)
        margin = function.error.roundings(function.named)
        enough = margin >= SAFETY * worst.units
        flagged += [] if enough else [function.name]
        spare = f"{margin / worst.units:.1f}x" if worst.units else "exact"
        print(
            f"{function.name:18} {worst.points:13,d} {worst.units:8.3f} {worst.x:14.7g} {margin:7.0f} {spare:>7}"
            f" {reference_error(function, low, high):9.1e} {time.perf_counter() - start:6.1f}"
            f"{'' if enough else '  TOO SMALL'}",
            flush=True,
        )
    if flagged:
        sys.exit(f"margins below {SAFETY:g} times the largest error seen: {', '.join(flagged)}")


if __name__ == "__main__":
    main()
