"""Whether another array library would carry the engine: the pass over an affine layer and an activation, three times.

    pip install array-api-compat array-api-strict torch
    python tests/benchmarks/array_backend.py

Times the operations that dominate a pass (an affine map of all forms, their scaling by slopes, their L1 norms) with
numpy itself, with numpy through array-api-compat, and with torch on the CPU, on one thread; and lists the functions
that the engine uses and the array API standard does not have.
"""

from __future__ import annotations

import os
import re
import time
from collections import Counter
from pathlib import Path

os.environ["OMP_NUM_THREADS"] = "1"

import array_api_compat
import array_api_strict
import numpy as np
import torch

ROOT = Path(__file__).resolve().parents[2]
SHAPES = {"26 x 26, 256 states": (256, 26, 26), "512 x 512, 8 states": (8, 512, 512)}


def layer(xp, forms, weight, slope):
    """Map forms (B, S, N), scale them neuron by neuron and take their norms, as `viatool.taylor.model` does."""
    batch, symbols, size = forms.shape
    mapped = xp.reshape(xp.reshape(forms, (batch * symbols, size)) @ weight.T, (batch, symbols, size))
    scaled = mapped * slope[:, None, :]
    norms = xp.sum(xp.abs(scaled), axis=1)
    return xp.where(norms > 1.0, xp.sqrt(norms), norms)


def seconds(function, least=0.5):
    """Return the CPU seconds of one call, the best of three series."""
    function()
    best = np.inf
    for _ in range(3):
        calls, start = 0, time.process_time()
        while time.process_time() - start < least:
            function()
            calls += 1
        best = min(best, (time.process_time() - start) / calls)
    return best


def main():
    torch.set_num_threads(1)
    rng = np.random.default_rng(0)
    print(f"numpy {np.__version__}, torch {torch.__version__}, CPU microseconds of one layer, one thread")
    for name, (batch, symbols, size) in SHAPES.items():
        arrays = (
            rng.normal(size=(batch, symbols, size)),
            rng.normal(size=(size, size)),
            rng.normal(size=(batch, size)),
        )
        tensors = tuple(torch.from_numpy(array) for array in arrays)
        plain = seconds(lambda arrays=arrays: layer(np, *arrays))
        through = seconds(lambda arrays=arrays: layer(array_api_compat.array_namespace(*arrays), *arrays))
        on_torch = seconds(
            lambda tensors=tensors: layer(array_api_compat.array_namespace(*tensors), *tensors)
        )
        print(
            f"{name:<22} numpy {1e6 * plain:9.1f}   through array-api-compat {1e6 * through:9.1f} "
            f"({through / plain:.2f}x)   torch {1e6 * on_torch:9.1f} ({on_torch / plain:.2f}x)"
        )
    used, calls = re.compile(r"\bnp\.((?:\w+\.)*\w+)\("), Counter()
    for path in sorted((ROOT / "viatool" / "taylor").glob("*.py")):
        calls.update(used.findall(path.read_text(encoding="utf-8")))
    missing = {name: count for name, count in calls.items() if name not in array_api_strict.__all__}
    print(
        f"viatool/taylor calls {len(calls)} numpy functions in {calls.total()} places; the standard "
        f"lacks {len(missing)} of them, in {sum(missing.values())} places: {', '.join(sorted(missing))}"
    )


if __name__ == "__main__":
    main()
