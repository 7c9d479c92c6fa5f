"""Opening a model file: one regular file of bounded size, parsed once; its inputs and outputs; what it is."""

from __future__ import annotations

import hashlib
import math
import os
import re
import stat
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, pairwise
from pathlib import Path
from typing import Any

import onnx
from google.protobuf.message import DecodeError  # type: ignore[import-untyped]  # none published

from viatool.errors import PolicyError
from viatool.policy.graph import Graph, live, read_graph
from viatool.policy.network import Precision
from viatool.policy.specification import METADATA_KEY, PolicySpecification
from viatool.policy.specification_file import specification_from_json
from viatool.policy.tensors import MAX_BYTES, as_precision, dtype_name
from viatool.samples import POLICIES

_EXPORT_HINT = "give the .onnx file of an exported actor"
_IMPORT_HINT = "make an ONNX policy of a Stable-Baselines3 or TorchScript model with `viatool import`"
_ZIP = b"PK\x03\x04"
_NAMES = frozenset(("name", "op_type", "domain", "input", "output", "overload", "ref_attr_name"))
_LONGEST_NAME = 1024
_MEAN = re.compile(r"(^|[^a-z])(mean|means|mu|loc|deterministic)([^a-z]|$)", re.IGNORECASE)
"""Names of outputs that exporters give to the mean of a Gaussian head."""
_LARGEST_INPUT = 2**16
"""Most numbers of an observation."""


@dataclass(frozen=True, eq=False)
class ModelFile:
    """A parsed model.

    Parameters
    ----------
    path : Path
        Where it stands.
    sha256 : str
        Of the file's bytes.
    proto : onnx.ModelProto
        The model.
    """

    path: Path
    sha256: str
    proto: onnx.ModelProto

    @property
    def folder(self) -> Path:
        """Return the folder in which external data may lie."""
        return self.path.parent

    @property
    def opset(self) -> int:
        """Return the version of the default opset, 0 if none is imported."""
        return next((int(o.version) for o in self.proto.opset_import if o.domain in ("", "ai.onnx")), 0)

    @property
    def producer(self) -> str:
        """Return the exporter that the file names."""
        return f"{self.proto.producer_name} {self.proto.producer_version}".strip()

    def specification(self) -> PolicySpecification | None:
        """Return the specification in the metadata, None where there is none."""
        for entry in self.proto.metadata_props:
            if entry.key == METADATA_KEY:
                return specification_from_json(entry.value, f"{self.path}: metadata entry '{METADATA_KEY}'")
        return None


@dataclass(frozen=True)
class Port:
    """One input of a graph.

    Parameters
    ----------
    name : str
        Of the value.
    shape : tuple of int
        At batch size 1.
    precision : str
        Element type.
    batched : bool
        Whether the first axis is a free batch axis.
    """

    name: str
    shape: tuple[int, ...]
    precision: Precision
    batched: bool

    @property
    def size(self) -> int:
        """Return how many numbers it takes."""
        return math.prod(self.shape)


@dataclass(frozen=True)
class Ports:
    """The inputs of a graph whose numbers, one input after another, are the observation.

    Parameters
    ----------
    each : tuple of Port
        In the order of the observation, of one element type.
    """

    each: tuple[Port, ...]

    @property
    def precision(self) -> Precision:
        """Return the element type of all of them."""
        return self.each[0].precision

    @property
    def size(self) -> int:
        """Return the length of the observation."""
        return sum(port.size for port in self.each)

    @property
    def names(self) -> tuple[str, ...]:
        """Return their names."""
        return tuple(port.name for port in self.each)

    @property
    def words(self) -> str:
        """Return which input takes how many numbers, for a message."""
        return ", ".join(f"{port.name} {port.size}" for port in self.each)

    @cached_property
    def places(self) -> Mapping[str, slice]:
        """Return which part of the observation each input takes, by name."""
        ends = accumulate((port.size for port in self.each), initial=0)
        parts = (slice(first, last) for first, last in pairwise(ends))
        return dict(zip(self.names, parts, strict=True))


def open_model(path: str | os.PathLike[str]) -> ModelFile:
    """Parse a model file, given by its path or by the name of a sample.

    Raises
    ------
    PolicyError
        If it is missing, is not a regular file, is too large, or is not an ONNX model.
    """
    path = POLICIES.find(path)
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            raise PolicyError(f"the policy {path} is not a file", _EXPORT_HINT)
        if status.st_size > 2 * MAX_BYTES:
            raise PolicyError(
                f"the policy {path} has {status.st_size / 2**20:.0f} MiB, far more than a policy needs",
                "export the actor alone",
            )
        content = path.read_bytes()
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else "the path is not valid"
        raise PolicyError(f"cannot read the policy {path}: {reason}", POLICIES.hint()) from error
    proto = onnx.ModelProto()
    try:
        proto.ParseFromString(content)
    except (DecodeError, UnicodeDecodeError, ValueError, RecursionError) as error:
        hint = _IMPORT_HINT if content.startswith(_ZIP) else _EXPORT_HINT
        raise PolicyError(f"{path} is not an ONNX model, or is damaged", hint) from error
    if not _has_sane_names(proto):
        raise PolicyError(
            f"{path} is damaged: it holds names that are not text, or are absurdly long", _EXPORT_HINT
        )
    if not proto.HasField("graph") or not proto.opset_import:
        raise PolicyError(f"{path} is not an ONNX model: it holds no graph", _EXPORT_HINT)
    return ModelFile(path, hashlib.sha256(content).hexdigest(), proto)


def _has_sane_names(message: Any) -> bool:
    """Whether every string of a protobuf message is one (damaged ones come back as bytes) and no name is absurd."""
    for descriptor, value in message.ListFields():
        values = [value] if isinstance(value, str | bytes) or hasattr(value, "ListFields") else value
        if descriptor.type == descriptor.TYPE_STRING:
            longest = _LONGEST_NAME if descriptor.name in _NAMES else None
            if not all(
                isinstance(text, str) and (longest is None or len(text) <= longest) for text in values
            ):
                return False
        if descriptor.type == descriptor.TYPE_MESSAGE and not all(_has_sane_names(part) for part in values):
            return False
    return True


def actor_graph(
    model: ModelFile,
    input_names: str | Sequence[str] | None = None,
    output_name: str | None = None,
    memory: Mapping[str, str] | None = None,
) -> tuple[Graph, Ports]:
    """Return the live part of the graph between its inputs and one output.

    Parameters
    ----------
    model : ModelFile
        A parsed model.
    input_names : str or sequence of str, optional
        The inputs that together are the observation, in its order; in the graph's order where they are not given.
    output_name : str, optional
        The action.
    memory : mapping, optional
        Inputs that take what an output gave in the step before; they are the last part of the observation.

    Raises
    ------
    PolicyError
        If the names are unknown, or are needed and not given, or an input's shape is not that of one observation.
    """
    memory = memory or {}
    graph = read_graph(model.proto, model.folder)
    if not graph.outputs:
        raise PolicyError("the model has no output", _EXPORT_HINT)
    unknown = [name for name in (output_name, *memory.values()) if name and name not in graph.outputs]
    if unknown:
        raise PolicyError(
            f"the model has no output '{unknown[0]}'", f"choose one of {', '.join(graph.outputs)}"
        )
    unknown = [name for name in memory if name not in graph.inputs]
    if unknown:
        raise PolicyError(
            f"the model has no input '{unknown[0]}'", f"choose one of {', '.join(graph.inputs)}"
        )
    if output_name in memory.values():
        raise PolicyError(
            f"the output '{output_name}' is the action, and cannot be memory as well",
            "name another output, or leave it out of `memory`",
        )
    if output_name is None:
        output_name = _only_output(graph, [name for name in graph.outputs if name not in memory.values()])
    part = live(graph, output_name)
    read = live(graph, output_name, *memory.values()).inputs
    needed = [*(name for name in read if name not in memory), *memory]
    named = [input_names] if isinstance(input_names, str) else list(input_names or needed)
    names = [*(name for name in named if name not in memory), *memory]
    unknown = [name for name in names if name not in graph.inputs]
    if unknown:
        raise PolicyError(
            f"the model has no input '{unknown[0]}'", f"choose one of {', '.join(graph.inputs)}"
        )
    idle = [name for name in memory if name not in read]
    if idle:
        raise PolicyError(
            f"the input '{idle[0]}' is said to be memory, but neither the action nor the memory depends on it",
            "leave it out of `memory`",
        )
    if not needed:
        raise PolicyError(
            f"the output '{output_name}' does not depend on any input",
            "choose another output, or export again",
        )
    if sorted(names) != sorted(needed):
        raise PolicyError(
            f"the output '{output_name}' depends on the inputs {', '.join(needed)}, "
            f"and those that are named are {', '.join(names)}",
            f"name each once, in the order of the channels, as `input: [{', '.join(needed)}]` in the specification",
        )
    batch = _names_of_a_batch(list(read.values()))
    return part, _ports([_port(read[name], batch, remembered=name in memory) for name in names])


def _ports(each: Sequence[Port]) -> Ports:
    """Return inputs together."""
    ports = Ports(tuple(each))
    if len({port.precision for port in each}) > 1:
        types = ", ".join(f"{port.name} {port.precision}" for port in each)
        raise PolicyError(
            f"the inputs have several element types: {types}", "export the actor with float32 inputs alone"
        )
    if ports.size > _LARGEST_INPUT:
        raise PolicyError(
            f"the inputs have {ports.size} numbers together: {ports.words}", "export the actor alone"
        )
    return ports


def _only_output(graph: Graph, outputs: Sequence[str]) -> str:
    """Return the only one of some outputs that depends on an input; several need a choice, never a guess."""
    if not outputs:
        raise PolicyError(
            f"all outputs of the model are memory ({', '.join(graph.outputs)}), and none is the action",
            "leave the action out of `memory`",
        )
    if len(outputs) == 1:
        return outputs[0]
    depending = [name for name in outputs if live(graph, name).inputs]
    if len(depending) == 1:
        return depending[0]
    means = [name for name in depending if _MEAN.search(name)]
    name = means[0] if len(means) == 1 else "NAME"
    guess = f"'{name}' sounds like the mean of a Gaussian head; " if len(means) == 1 else ""
    raise PolicyError(
        f"the model has {len(depending)} outputs that depend on its inputs: {', '.join(depending)}",
        f"{guess}choose the action with --graph-output {name}, or with `output: {name}` in the specification",
    )


def _names_of_a_batch(values: Sequence[onnx.ValueInfoProto]) -> frozenset[str]:
    """Return what the free first axes of inputs are called; an axis of that name is the batch of other inputs."""
    axes = [value.type.tensor_type.shape.dim for value in values]
    return frozenset(each[0].dim_param for each in axes if len(each) > 1) - {""}


def _port(value: onnx.ValueInfoProto, batch: Collection[str], *, remembered: bool) -> Port:
    """Return an input of one observation: its batch is a free first axis or a named one, of a memory any free one."""
    if not value.type.HasField("tensor_type"):
        raise PolicyError(
            f"the input '{value.name}' is not a tensor", "export the actor with a vector as its input"
        )
    tensor = value.type.tensor_type
    dtype = dtype_name(tensor.elem_type)
    precision = as_precision(dtype) if dtype else None
    if precision is None:
        raise PolicyError(
            f"the input '{value.name}' is of type {dtype or tensor.elem_type}, not a floating-point one",
            "export the actor with a float32 observation",
        )
    if not tensor.HasField("shape"):
        raise PolicyError(f"the input '{value.name}' has no shape", "export with the size of the observation")
    sizes = [int(axis.dim_value) if axis.HasField("dim_value") else None for axis in tensor.shape.dim]
    batched = len(sizes) > 1 and sizes[0] is None
    free = [axis for axis, size in enumerate(sizes) if size is None]
    own = [axis for axis in free if tensor.shape.dim[axis].dim_param in batch]
    only = own or (free if remembered else [])
    at = 0 if batched else only[0] if len(only) == 1 and len(sizes) > 1 else None
    shape = tuple(1 if axis == at else size for axis, size in enumerate(sizes))
    written = ", ".join("?" if size is None else str(size) for size in sizes)
    if any(size is None or size < 1 for size in shape):
        raise PolicyError(
            f"the input '{value.name}' has the shape [{written}]: its size is not fixed",
            "export with only the first axis dynamic",
        )
    fixed = tuple(size for size in shape if size is not None)
    if math.prod(fixed) > _LARGEST_INPUT:
        raise PolicyError(
            f"the input '{value.name}' has the shape [{written}], {math.prod(fixed)} numbers",
            "export the actor alone",
        )
    return Port(value.name, fixed, precision, batched)
