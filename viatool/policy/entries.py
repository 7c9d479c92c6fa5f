"""An output of which some entries are the action: a Gaussian head that gives mean and deviation in one row.

The entries are picked by one more node at the end of the model, so that reader, program and self-check know nothing of
it; what the file itself gives stays an output, as it is on the robot.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import onnx

from viatool.errors import PolicyError
from viatool.policy.before_choice import before_choice, told_of
from viatool.policy.graph import read_graph
from viatool.policy.model_file import ModelFile
from viatool.policy.specification import PolicySpecification

SUFFIX = "/entries"
"""Behind the name of an output: the value that holds its entries."""

_NEGATIVE_AXES = 11
"""The first opset in which Gather counts axes from behind."""


def as_specified(
    model: ModelFile, spec: PolicySpecification | None, output: str | None
) -> tuple[ModelFile, str | None]:
    """Return a model with the numbers that a specification describes as an output, and the name of that one.

    Parameters
    ----------
    model : ModelFile
        Of a policy.
    spec : PolicySpecification or None
        Which entries of its output are actions, and whether these choose.
    output : str or None
        The output, where it is named.

    Returns
    -------
    ModelFile, str or None
        As given where the output is what is described.

    Raises
    ------
    PolicyError
        If it has no such entries, or chooses otherwise than by the largest.
    """
    if spec is None:
        return model, output
    if spec.choice is not None:
        return before_choice(model, output, spec.choice.commands or ())
    entries = [action.entry for action in spec.action if action.entry is not None]
    own = [value.name for value in model.proto.graph.output if value.name not in spec.memory.values()]
    name = output if output is not None else own[0] if len(own) == 1 else None
    if not entries or name not in own:
        return model, output
    return _with_entries(model, str(name), entries)


def _with_entries(model: ModelFile, output: str, entries: Sequence[int]) -> tuple[ModelFile, str]:
    """Return a model that also gives some entries of an output, and what that is called."""
    read_graph(model.proto, model.folder)  # refuses what is damaged
    extended = onnx.ModelProto()
    extended.CopyFrom(model.proto)
    kind, shape = told_of(extended, output)
    size = shape[-1] if shape else None
    if size is not None and max(entries) >= size:
        raise PolicyError(
            f"{model.path}: an action takes entry {max(entries)} of the output '{output}', which has {size} "
            f"(0 to {size - 1})",
            "correct `entry` of the actions",
        )
    if not shape and model.opset < _NEGATIVE_AXES:
        raise PolicyError(
            f"{model.path}: the shape of the output '{output}' is not known, so no entry of it is found",
            f"export with opset_version {_NEGATIVE_AXES} or newer",
        )
    made = output + SUFFIX
    indices = onnx.numpy_helper.from_array(np.array(entries, dtype=np.int64), f"{made}/numbers")
    taken = {
        value.name for value in (*extended.graph.input, *extended.graph.output, *extended.graph.initializer)
    }
    taken |= {name for node in extended.graph.node for name in node.output}
    if taken & {made, indices.name}:
        raise PolicyError(f"{model.path}: a value is called '{made}'", "export the policy with other names")
    extended.graph.initializer.append(indices)
    axis = len(shape) - 1 if shape else -1
    extended.graph.node.append(
        onnx.helper.make_node("Gather", [output, indices.name], [made], made, axis=axis)
    )
    extended.graph.output.add(name=made).type.tensor_type.elem_type = kind
    return replace(model, proto=extended), made
