"""The deployed program: the model as onnxruntime runs it, on one thread."""

from __future__ import annotations

import copy
import os
import tempfile
from pathlib import Path
from typing import Any, Literal

import numpy as np
import onnx
from numpy.typing import NDArray

from viatool.arrays import Floats
from viatool.errors import PolicyError
from viatool.policy.graph import Graph
from viatool.policy.model_file import ModelFile, Ports
from viatool.policy.tensors import read_tensor
from viatool.versions import version_of

_ROWS = 65536
_OLDEST_RUN = 7
_OLDEST_IR = 4
"""Before it, initialisers had to be listed as inputs."""
_NUMPY_TYPES = {"float16": np.float16, "float32": np.float32, "float64": np.float64}

Optimisation = Literal["none", "basic", "extended", "default"]
"""How far onnxruntime rewrites a model before it runs it; what is not asked for otherwise runs as ``default``."""

_LEVELS: dict[Optimisation, str] = {
    "none": "ORT_DISABLE_ALL",
    "basic": "ORT_ENABLE_BASIC",
    "extended": "ORT_ENABLE_EXTENDED",
    "default": "ORT_ENABLE_ALL",
}

_OF_ELEMENT_TYPE = ("NOT_IMPLEMENTED", "Type Error")
"""What onnxruntime says of an operator that it does not have for some element type."""

_OTHER_FLOATS = {onnx.TensorProto.FLOAT16, onnx.TensorProto.BFLOAT16, onnx.TensorProto.DOUBLE}

_IN_FLOAT32 = (
    "export the policy in float32 (module.float()), for which onnxruntime has every operator, and run that"
)

_LAYOUT_STEP = "NchwcTransformer"
"""The one step that writes for one kind of processor: it moves the blocks of convolutions about in memory."""


class Runtime:
    """Runs a model on observations.

    Parameters
    ----------
    model : onnx.ModelProto
        The model, complete; what it gives is all of its outputs, one after another.
    ports : Ports
        Its inputs.
    optimisation : str
        How far onnxruntime may rewrite it.

    Notes
    -----
    A single observation is run exactly as on the robot. Several are run one by one until `batches` is set,
    which only the self-check does, after it has seen that a batch gives the same actions; a batch may round
    differently in the last place.
    """

    def __init__(self, model: onnx.ModelProto, ports: Ports, optimisation: Optimisation = "default") -> None:
        self.ports = ports
        self.outputs: tuple[str, ...] = tuple(value.name for value in model.graph.output)
        self._inputs = frozenset(value.name for value in model.graph.input)
        self.optimisation = optimisation
        self._model: bytes = model.SerializeToString()
        has_batch_axis = all(len(port.shape) > 1 and port.shape[0] == 1 for port in ports.each)
        self._batch_model = _with_free_batch(model, ports) if has_batch_axis else None
        self._sessions: dict[bool, Any] = {}
        self.batches = False

    def __getstate__(self) -> dict[str, Any]:
        """Drop the sessions, which cannot be pickled."""
        return {**self.__dict__, "_sessions": {}}

    @property
    def content(self) -> bytes:
        """Return the model as a file: the graph behind the outputs that count, with its weights."""
        return self._model

    @property
    def words(self) -> str:
        """Return which program it is for which bounds of it hold, for a report."""
        return f"onnxruntime {version_of('onnxruntime')} on a CPU, at every level of its optimisation"

    def at(self, optimisation: Optimisation) -> Runtime:
        """Return the same model as onnxruntime runs it at another level of optimisation."""
        other = copy.copy(self)
        other.optimisation, other.batches, other._sessions = optimisation, False, {}
        return other

    def executed_model(self) -> onnx.ModelProto:
        """Return the model that onnxruntime runs in place of the one it is given, as it writes it itself.

        Raises
        ------
        PolicyError
            If onnxruntime cannot load the model, or does not write what it runs.

        Notes
        -----
        Without the step that gives the data of convolutions the layout of this processor. It moves numbers about,
        sums in another order, and joins a normalisation or an activation to the convolution before it, with the
        same operations on each number; rules for rounding hold in any order.
        """
        try:
            with tempfile.TemporaryDirectory(prefix="viatool-") as folder:
                path = Path(folder) / "executed.onnx"
                _open(self._model, self.optimisation, path)
                return onnx.load(path)
        except PolicyError:
            raise
        except Exception as error:  # no room, a missing file, or whatever reading a damaged one raises
            raise PolicyError(
                f"onnxruntime does not write the model that it runs: {_first_line(error)}",
                "make room in the folder for temporary files, or update the onnxruntime package",
            ) from error

    def __call__(self, observations: Floats) -> Floats:
        """Run the program: ``(B, n)`` float64, rounded to the model's input type, to ``(B, A)`` float64.

        Raises
        ------
        PolicyError
            If onnxruntime cannot load or run the model.
        """
        return self.batch(observations) if self.batches and len(observations) > 1 else self.rows(observations)

    def rows(self, observations: Floats) -> Floats:
        """Run observations one by one."""
        rows = self._typed(observations)[:, None]
        return np.array([_in_a_row(self._run(row, batch=False), 1)[0] for row in rows], dtype=np.float64)

    def apart(self, observation: Floats) -> dict[str, NDArray[Any]]:
        """Run one observation (n,), and return each output by its name, as the model gives it."""
        return dict(zip(self.outputs, self._run(self._typed(observation[None]), batch=False), strict=True))

    def batch(self, observations: Floats) -> Floats:
        """Run observations together.

        Raises
        ------
        PolicyError
            If the model is one for a single observation.
        """
        if self._batch_model is None:
            raise PolicyError("the model has no batch axis", "run its observations one by one")
        rows = self._typed(observations)
        parts = [rows[start : start + _ROWS] for start in range(0, len(rows), _ROWS)]
        shaped = [_in_a_row(self._run(part, batch=True), len(part)) for part in parts]
        return np.concatenate(shaped).astype(np.float64)

    def _typed(self, observations: Floats) -> NDArray[Any]:
        with np.errstate(over="ignore"):
            return observations.astype(_NUMPY_TYPES[self.ports.precision])

    def _run(self, rows: NDArray[Any], *, batch: bool) -> list[NDArray[Any]]:
        """Run one observation, or those of a batch: the inputs apart, and the outputs."""
        if batch not in self._sessions:
            content = self._batch_model if batch else self._model
            assert content is not None
            self._sessions[batch] = _open(content, self.optimisation)
        feed = {
            port.name: rows[:, self.ports.places[port.name]].reshape(
                (-1, *port.shape[1:]) if batch else port.shape
            )
            for port in self.ports.each
            if port.name in self._inputs
        }
        try:
            return [np.asarray(given) for given in self._sessions[batch].run(None, feed)]
        except Exception as error:  # onnxruntime raises its own, undocumented classes
            raise PolicyError(
                f"onnxruntime cannot run the policy: {_first_line(error)}",
                "run the model in onnxruntime alone first",
            ) from error


def _in_a_row(outputs: list[NDArray[Any]], count: int) -> NDArray[Any]:
    """Return the numbers of all outputs for each of so many observations, one output after another."""
    if any(output.size % count for output in outputs):
        raise PolicyError("the model mixes the observations of a batch", "run its observations one by one")
    return np.concatenate([output.reshape(count, -1) for output in outputs], axis=1)


def _open(model: bytes, optimisation: Optimisation, written: Path | None = None) -> Any:
    """Return a session; with a path, onnxruntime writes there what it runs, apart from the layout of its data."""
    # Asked for before the import, onnxruntime tells its maker nothing of what is run here; ask otherwise with 0.
    os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    options.graph_optimization_level = getattr(onnxruntime.GraphOptimizationLevel, _LEVELS[optimisation])
    left_out = []
    if written is not None:
        options.optimized_model_filepath, left_out = str(written), [_LAYOUT_STEP]
    try:
        return onnxruntime.InferenceSession(
            model, options, providers=["CPUExecutionProvider"], disabled_optimizers=left_out
        )
    except Exception as error:  # onnxruntime raises its own, undocumented classes
        raise PolicyError(
            f"onnxruntime cannot load the policy: {_first_line(error)}", _remedy(str(error), model)
        ) from error


def _remedy(message: str, model: bytes) -> str:
    """Return what to do about a model that onnxruntime cannot load."""
    if any(sign in message for sign in _OF_ELEMENT_TYPE) and _OTHER_FLOATS & _element_types(model):
        return _IN_FLOAT32
    return "export for a version of ONNX that the installed onnxruntime runs"


def _element_types(model: bytes) -> set[int]:
    """Return the element types of inputs and weights, and those to which values are cast."""
    graph = onnx.load_model_from_string(model).graph
    casts = (node.attribute for node in graph.node if node.op_type == "Cast")
    return {
        *(value.type.tensor_type.elem_type for value in graph.input),
        *(tensor.data_type for tensor in graph.initializer),
        *(attribute.i for attributes in casts for attribute in attributes if attribute.name == "to"),
    }


def _with_free_batch(model: onnx.ModelProto, ports: Ports) -> bytes:
    free = onnx.ModelProto()
    free.CopyFrom(model)
    for value in free.graph.input:
        if value.name in ports.names:
            value.type.tensor_type.shape.dim[0].dim_param = "batch"
    for value in free.graph.output:
        value.type.tensor_type.ClearField("shape")
    content: bytes = free.SerializeToString()
    return content


def _first_line(error: Exception) -> str:
    return (str(error) or type(error).__name__).splitlines()[0][:300]


def runtime_of(model: ModelFile, graph: Graph, ports: Ports) -> Runtime:
    """Return the program of the outputs of a graph: the same nodes and weights, without what these do not need.

    Raises
    ------
    PolicyError
        If the element type is one that onnxruntime does not run on a CPU.
    """
    if ports.precision not in _NUMPY_TYPES:
        raise PolicyError(
            f"the input '{ports.names[0]}' is {ports.precision}, "
            "in which onnxruntime computes next to nothing on a CPU",
            _IN_FLOAT32,
        )
    proto = onnx.ModelProto()
    proto.CopyFrom(model.proto)
    source = model.proto.graph
    del proto.graph.node[:], proto.graph.initializer[:], proto.graph.input[:], proto.graph.output[:]
    del proto.graph.value_info[:], proto.functions[:], proto.metadata_props[:]
    proto.ir_version = max(proto.ir_version, _OLDEST_IR)
    proto.graph.node.extend(_trimmed(node.proto) for node in graph.nodes)
    proto.graph.initializer.extend(_inline(tensor, model) for tensor in graph.initializers.values())
    proto.graph.input.extend(value for value in source.input if value.name in graph.inputs)
    proto.graph.output.extend(value for value in source.output if value.name in graph.outputs)
    if 0 < model.opset < _OLDEST_RUN:
        proto = _modernised(proto)
    return Runtime(proto, ports)


def _trimmed(node: onnx.NodeProto) -> onnx.NodeProto:
    """Return a node without the empty names at the end of its inputs, on which onnxruntime may crash."""
    trimmed = onnx.NodeProto()
    trimmed.CopyFrom(node)
    while trimmed.input and not trimmed.input[-1]:
        del trimmed.input[-1]
    return trimmed


def _modernised(proto: onnx.ModelProto) -> onnx.ModelProto:
    """Return the model in the oldest opset that onnxruntime runs; the self-check compares them."""
    from onnx import version_converter

    try:
        converted = version_converter.convert_version(proto, _OLDEST_RUN)
    except Exception as error:  # the converter raises bare RuntimeError and its own classes
        raise PolicyError(
            f"the model's opset is too old for onnxruntime and cannot be raised: {_first_line(error)}",
            "export with opset_version 7 or newer",
        ) from error
    del converted.graph.value_info[:]  # the converter leaves entries without a type
    return converted


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
