"""The program as onnxruntime runs it: optimised and as written, one observation at a time and in a batch."""

from __future__ import annotations

from typing import Any

import numpy as np
import onnx

from tests.attack.building import Array
from tests.attack.graphs import RandomGraph

LEVELS = ("default", "off")


class Program:
    """All ways in which onnxruntime runs a graph on one thread.

    Parameters
    ----------
    graph : RandomGraph
        n inputs, A actions.
    """

    def __init__(self, graph: RandomGraph) -> None:
        self.graph = graph
        self.size = int(np.prod(graph.shape))
        self._single = {level: open_session(graph.model, level) for level in LEVELS}
        self._batch = {}
        if graph.batched:
            free = onnx.ModelProto()
            free.CopyFrom(graph.model)
            free.graph.input[0].type.tensor_type.shape.dim[0].dim_param = "batch"
            self._batch = {level: open_session(free, level) for level in LEVELS}

    def rounded(self, points: Array) -> Array:
        """Return points in the type of the input."""
        with np.errstate(over="ignore"):
            return points.astype(np.dtype(self.graph.kind))

    def one_by_one(self, points: Array, level: str) -> Array:
        """Run points (P, n) alone: (P, A) float64."""
        rows = self.rounded(points).reshape(-1, *self.graph.shape)
        session = self._single[level]
        return np.array([session.run(None, {"x": row})[0].ravel() for row in rows], dtype=np.float64)

    def together(self, points: Array, level: str) -> Array:
        """Run points (P, n) in one batch where the graph has a batch axis: (P, A) float64."""
        if not self._batch:
            return self.one_by_one(points, level)
        rows = self.rounded(points).reshape(-1, *self.graph.shape[1:])
        return np.asarray(self._batch[level].run(None, {"x": rows})[0], dtype=np.float64).reshape(
            len(rows), -1
        )


def open_session(model: onnx.ModelProto, level: str = "default") -> Any:
    """Open a model on one thread, at onnxruntime's default level of optimisation or with none."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    if level == "off":
        options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_DISABLE_ALL
    content = model.SerializeToString()
    return onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
