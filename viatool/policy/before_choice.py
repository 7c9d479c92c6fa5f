"""A model that ends in the number of what it chose, read up to the values that are compared.

Value networks are exported with an ArgMax at their end, or a TopK of one, and perhaps a table from which the chosen
command is taken. What is chosen is a step of computed values; the values themselves are a network like any other, and
the specification's table says what each of them stands for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray

from viatool.errors import PolicyError
from viatool.policy.graph import read_graph
from viatool.policy.model_file import ModelFile
from viatool.policy.tensors import read_tensor

_CARRIED = frozenset(("Cast", "Flatten", "Identity", "Reshape", "Squeeze", "Unsqueeze"))
"""Operators that hand on which number was chosen."""

_HINT = "let the model end with the values that are compared, one for each command in the order of the table"


_TABLES = frozenset(("Gather", "GatherND"))
"""Operators that take a command out of a table."""

Commands = Sequence[Sequence[float]]


def before_choice(model: ModelFile, output: str | None, commands: Commands) -> tuple[ModelFile, str | None]:
    """Return a model with the values that its output chooses among as one more output, and the name of that one.

    Parameters
    ----------
    model : ModelFile
        Of a policy whose specification has a choice.
    output : str, optional
        Which output it chooses with; its only one by default.
    commands : sequence
        The table of the specification.

    Returns
    -------
    ModelFile, str or None
        As given where the output is not a choice itself. The rest of the model stays, since what runs is all of it.

    Raises
    ------
    PolicyError
        If it chooses otherwise than the largest of one value for each command, of equal ones the first, or sends other
        commands than those of the specification.
    """
    outputs = [value.name for value in model.proto.graph.output]
    last = output if output is not None else outputs[0] if len(outputs) == 1 else None
    if last not in outputs:
        return model, output
    read_graph(model.proto, model.folder)  # refuses what is damaged
    makers = {made: node for node in model.proto.graph.node for made in node.output if made}
    name, met, table = str(last), set[str](), None
    while (node := makers.get(name)) is not None and name not in met:
        met.add(name)
        if node.op_type in _CARRIED:
            name = node.input[0]
        elif table is None and (found := _table(model, node)) is not None:
            table, name = found, node.input[1]
        else:
            break
    if node is None or node.op_type not in ("ArgMax", "TopK") or node.domain not in ("", "ai.onnx"):
        return model, output
    values = node.input[0]
    extended = onnx.ModelProto()
    extended.CopyFrom(model.proto)
    told = told_of(extended, values)
    _require_largest_of_all(model, node, name, told)
    if table is not None:
        _require_same_commands(model, table, commands)
    if values not in outputs:
        extended.graph.output.add(name=values).type.tensor_type.elem_type = told[0]
    return replace(model, proto=extended), values


def told_of(proto: onnx.ModelProto, name: str) -> tuple[int, list[int | None]]:
    """Return the element type of a value, and its shape as far as it is known; nothing known is no axis at all."""
    try:
        inferred = onnx.shape_inference.infer_shapes(proto)
    except Exception:  # it raises its own, undocumented classes; then nothing is inferred
        inferred = proto
    for value in [*inferred.graph.value_info, *inferred.graph.output, *inferred.graph.input]:
        tensor = value.type.tensor_type
        if value.name == name and tensor.elem_type:
            shape = [int(axis.dim_value) if axis.HasField("dim_value") else None for axis in tensor.shape.dim]
            return tensor.elem_type, shape
    return onnx.TensorProto.FLOAT, []


def _require_largest_of_all(
    model: ModelFile, node: onnx.NodeProto, number: str, told: tuple[int, list[int | None]]
) -> None:
    """Refuse a node that makes a number of anything but the first of the largest values."""
    attributes: dict[str, Any] = {
        entry.name: onnx.helper.get_attribute_value(entry) for entry in node.attribute
    }
    shape = told[1]
    axis = int(attributes.get("axis", 0 if node.op_type == "ArgMax" else -1))
    problem = ""
    if attributes.get("select_last_index", 0) or not attributes.get("largest", 1):
        problem = "does not take the first of the largest values"
    elif node.op_type == "TopK" and (number != node.output[1] or _count_of(model, node, attributes) != 1):
        problem = "gives more than the number of the largest value"
    elif axis != -1 and axis != len(shape) - 1:
        problem = f"compares values along axis {axis}, not the last"
    elif any(size != 1 for size in shape[1:-1]):
        problem = "makes several choices at once"
    if problem:
        raise PolicyError(
            f"{model.path}: node '{node.name or node.output[0]}' ({node.op_type}) {problem}", _HINT
        )


def _table(model: ModelFile, node: onnx.NodeProto) -> NDArray[Any] | None:
    """Return the table out of which a node takes a row, None where it is no such node."""
    rows = all(
        onnx.helper.get_attribute_value(entry) == 0
        for entry in node.attribute
        if entry.name in ("axis", "batch_dims")
    )
    if node.op_type not in _TABLES or len(node.input) != 2 or not rows:
        return None
    return _stored(model, node.input[0])


def _require_same_commands(model: ModelFile, table: NDArray[Any], commands: Commands) -> None:
    """Refuse a model whose own table has other commands than the specification."""
    told = np.array(commands, dtype=np.float64)
    if not np.array_equal(table.astype(np.float32), told.astype(np.float32)):
        raise PolicyError(
            f"{model.path}: the model sends the commands {table.tolist()} of a table of its own, its specification "
            f"names {told.tolist()}",
            "write the commands of the model's table, in its order and with its numbers",
        )


def _stored(model: ModelFile, name: str) -> NDArray[Any] | None:
    """Return a stored tensor, None where the value is computed."""
    made = [entry.attribute[0].t for entry in model.proto.graph.node
            if entry.op_type == "Constant" and entry.output[0] == name and entry.attribute]  # fmt: skip
    stored = [tensor for tensor in model.proto.graph.initializer if tensor.name == name]
    arrays = [read_tensor(tensor, model.folder).array for tensor in (*stored, *made)]
    return arrays[0] if arrays else None


def _count_of(model: ModelFile, node: onnx.NodeProto, attributes: dict[str, Any]) -> int | None:
    """Return how many values a TopK takes; None where that is not a stored number."""
    if "k" in attributes:
        return int(attributes["k"])
    stored = _stored(model, node.input[1])
    return int(stored.ravel()[0]) if stored is not None and stored.size == 1 else None
