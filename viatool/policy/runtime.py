"""The deployed program: the model as onnxruntime runs it, on one thread."""

from __future__ import annotations

from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray

from viatool.errors import PolicyError
from viatool.policy.graph import Graph
from viatool.policy.model_file import ModelFile, Port
from viatool.policy.tensors import read_tensor

Floats = NDArray[np.float64]

_ROWS = 65536
_NUMPY_TYPES = {"float16": np.float16, "float32": np.float32, "float64": np.float64}


class Runtime:
    """Runs a model on observations.

    Parameters
    ----------
    model : bytes
        The model, complete, with one input and one output.
    port : Port
        Its input.

    Notes
    -----
    A single observation is run exactly as on the robot. Several are run in one batch where the model allows
    it, which may round differently in the last place; a model for one observation is run once for each.
    """

    def __init__(self, model: bytes, port: Port) -> None:
        self._model = model
        self._port = port
        self._session: Any = None
        self.batches = port.batched

    def __getstate__(self) -> dict[str, Any]:
        """Drop the session, which cannot be pickled."""
        return {**self.__dict__, "_session": None}

    def __call__(self, observations: Floats) -> Floats:
        """Run the program: ``(B, n)`` float64, rounded to the model's input type, to ``(B, A)`` float64.

        Raises
        ------
        PolicyError
            If onnxruntime cannot load or run the model.
        """
        rows = observations.astype(_NUMPY_TYPES[self._port.precision])
        if len(rows) <= 1 or not self.batches:
            results = [self._run(row.reshape(self._port.shape)).reshape(1, -1) for row in rows]
        else:
            parts = [rows[start : start + _ROWS] for start in range(0, len(rows), _ROWS)]
            results = [
                self._run(part.reshape(-1, *self._port.shape[1:])).reshape(len(part), -1) for part in parts
            ]
        return np.concatenate(results).astype(np.float64)

    def _run(self, feed: NDArray[Any]) -> NDArray[Any]:
        if self._session is None:
            self._session = self._open()
        try:
            return np.asarray(self._session.run(None, {self._port.name: feed})[0])
        except Exception as error:  # onnxruntime raises its own, undocumented classes
            raise PolicyError(
                f"onnxruntime cannot run the policy: {_first_line(error)}",
                "run the model in onnxruntime alone first",
            ) from error

    def _open(self) -> Any:
        import onnxruntime

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 4
        try:
            return onnxruntime.InferenceSession(self._model, options, providers=["CPUExecutionProvider"])
        except Exception as error:  # onnxruntime raises its own, undocumented classes
            raise PolicyError(
                f"onnxruntime cannot load the policy: {_first_line(error)}",
                "export for a version of ONNX that the installed onnxruntime runs",
            ) from error


def _first_line(error: Exception) -> str:
    return (str(error) or type(error).__name__).splitlines()[0][:300]


def runtime_of(model: ModelFile, graph: Graph, port: Port) -> Runtime:
    """Return the program of one output: the same nodes and weights, without what the output does not need.

    Raises
    ------
    PolicyError
        If the element type is one that onnxruntime does not run on a CPU.
    """
    if port.precision not in _NUMPY_TYPES:
        raise PolicyError(
            f"the input '{port.name}' is {port.precision}, which onnxruntime does not run on a CPU"
        )
    proto = onnx.ModelProto()
    proto.CopyFrom(model.proto)
    source = model.proto.graph
    del proto.graph.node[:], proto.graph.initializer[:], proto.graph.input[:], proto.graph.output[:]
    del proto.graph.value_info[:], proto.functions[:], proto.metadata_props[:]
    proto.graph.node.extend(node.proto for node in graph.nodes)
    proto.graph.initializer.extend(_inline(tensor, model) for tensor in graph.initializers.values())
    proto.graph.input.extend(value for value in source.input if value.name == port.name)
    proto.graph.output.extend(value for value in source.output if value.name == graph.outputs[0])
    return Runtime(proto.SerializeToString(), port)


def _inline(tensor: onnx.TensorProto, model: ModelFile) -> onnx.TensorProto:
    if tensor.data_location != onnx.TensorProto.EXTERNAL:
        return tensor
    constant = read_tensor(tensor, model.folder)
    inline = onnx.TensorProto(name=tensor.name, data_type=tensor.data_type, dims=tensor.dims)
    if constant.dtype == "bfloat16":
        inline.raw_data = (constant.array.view(np.uint32) >> 16).astype("<u2").tobytes()
    else:
        inline.raw_data = constant.array.astype(constant.array.dtype.newbyteorder("<")).tobytes()
    return inline
