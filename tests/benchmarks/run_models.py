"""Run every model of a folder on its inputs with the onnxruntime of this Python; it needs numpy besides.

    python run_models.py FOLDER RESULTS.npz

Each `NAME.onnx` has its inputs, (P, *shape), in `NAME.npy`. The results are named `NAME/LEVEL` and are (P, outputs);
where this version cannot load a model there are none.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import onnxruntime

LEVELS = {"default": "ORT_ENABLE_ALL", "disabled": "ORT_DISABLE_ALL"}


def main() -> None:
    folder, target = map(Path, sys.argv[1:])
    found = {}
    for path in sorted(folder.glob("*.onnx")):
        points = np.load(path.with_suffix(".npy"))
        for level, constant in LEVELS.items():
            options = onnxruntime.SessionOptions()
            options.graph_optimization_level = getattr(onnxruntime.GraphOptimizationLevel, constant)
            options.intra_op_num_threads, options.log_severity_level = 1, 4
            try:
                session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
            except Exception:  # each version has its own way to say that it lacks an operator
                continue
            rows = [session.run(None, {"x": point})[0].ravel() for point in points]
            found[f"{path.stem}/{level}"] = np.array(rows, dtype=np.float64)
    np.savez(target, version=onnxruntime.__version__, **found)


if __name__ == "__main__":
    main()
