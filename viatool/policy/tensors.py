"""Stored tensors: from the bytes of a model file to arrays; every size is checked before memory is taken."""

from __future__ import annotations

import math
import os
import stat
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import onnx
from numpy.typing import NDArray

from viatool.arrays import Singles
from viatool.errors import PolicyError
from viatool.policy.network import Precision

Array = NDArray[Any]

MAX_BYTES = 2**28
"""Largest tensor, and largest sum of the tensors in external files, that is read."""

MAX_RANK = 32

_DTYPES: dict[int, tuple[str, str]] = {
    onnx.TensorProto.FLOAT: ("float32", "<f4"),
    onnx.TensorProto.DOUBLE: ("float64", "<f8"),
    onnx.TensorProto.FLOAT16: ("float16", "<f2"),
    onnx.TensorProto.BFLOAT16: ("bfloat16", "<u2"),
    onnx.TensorProto.INT64: ("int64", "<i8"),
    onnx.TensorProto.INT32: ("int32", "<i4"),
    onnx.TensorProto.INT16: ("int16", "<i2"),
    onnx.TensorProto.INT8: ("int8", "<i1"),
    onnx.TensorProto.UINT64: ("uint64", "<u8"),
    onnx.TensorProto.UINT32: ("uint32", "<u4"),
    onnx.TensorProto.UINT16: ("uint16", "<u2"),
    onnx.TensorProto.UINT8: ("uint8", "<u1"),
    onnx.TensorProto.BOOL: ("bool", "?"),
}
PRECISIONS = ("bfloat16", "float16", "float32", "float64")


@dataclass(frozen=True, eq=False)
class Constant:
    """A value that does not depend on the observation.

    Parameters
    ----------
    array : ndarray
        Its numbers; bfloat16 ones are held as float32. Those of a folded constant are the real numbers that the graph
        means, in float64, unless every program has them.
    dtype : str
        The element type in the model.
    roundings : int
        How many roundings of its element type a program's value may be off, relative to the magnitude of each element;
        0 for what is stored, and for what every program folds to the same numbers.
    magnitude : ndarray, optional
        What was added up before it cancelled; None for the absolute values of the elements.
    """

    array: Array
    dtype: str
    roundings: int = 0
    magnitude: Array | None = None

    @property
    def shape(self) -> tuple[int, ...]:
        """Return the shape of the tensor."""
        return cast(tuple[int, ...], self.array.shape)

    def rearranged(self, move: Callable[[Array], Array]) -> Constant:
        """Return the constant with its elements elsewhere, each with its own magnitude."""
        magnitude = None if self.magnitude is None else move(self.magnitude)
        return replace(self, array=move(self.array), magnitude=magnitude)


def dtype_name(element_type: int) -> str | None:
    """Return the name of an ONNX element type that can be held, None for any other (strings, ...)."""
    found = _DTYPES.get(element_type)
    return None if found is None else found[0]


def as_precision(dtype: str) -> Precision | None:
    """Return a floating-point element type as a precision of the network, None for any other type."""
    return cast(Precision, dtype) if dtype in PRECISIONS else None


def convert(array: Array, dtype: str) -> Array:
    """Convert an array to an element type as ONNX Cast does; bfloat16 is rounded but held as float32."""
    with np.errstate(all="ignore"):
        if dtype == "bfloat16":
            return round_to_bfloat16(np.asarray(array, dtype=np.float32))
        return np.asarray(array).astype(dtype)


def round_to_bfloat16(array: Singles) -> Singles:
    """Round float32 numbers to the nearest bfloat16, ties to even."""
    bits = array.view(np.uint32).astype(np.uint64)
    rounded = (bits + 0x7FFF + ((bits >> 16) & 1)) & 0xFFFF0000
    result = rounded.astype(np.uint32).view(np.float32)
    return np.where(np.isfinite(array), result, array).astype(np.float32)


def read_tensor(tensor: onnx.TensorProto, folder: Path | None) -> Constant:
    """Return a stored tensor.

    Parameters
    ----------
    tensor : onnx.TensorProto
        With its data inline, or external.
    folder : Path, optional
        Where external files may lie; None refuses them.

    Raises
    ------
    PolicyError
        If its type, its shape or its data are not what they should be.
    """
    name = tensor.name or "(unnamed)"
    if tensor.data_type not in _DTYPES:
        known = onnx.TensorProto.DataType.items()
        kind = next((text for text, number in known if number == tensor.data_type), str(tensor.data_type))
        raise PolicyError(
            f"tensor '{name}' has element type {kind}; numbers and booleans are read",
            "export the policy with float32 weights",
        )
    dtype, layout = _DTYPES[tensor.data_type]
    shape = tuple(int(size) for size in tensor.dims)
    count = _element_count(name, shape)
    expected = count * np.dtype(layout).itemsize
    if tensor.data_location == onnx.TensorProto.EXTERNAL:
        stored = np.frombuffer(_external_bytes(tensor, expected, folder), dtype=layout)
    elif tensor.HasField("raw_data"):
        if len(tensor.raw_data) != expected:
            raise PolicyError(
                f"tensor '{name}' of shape {list(shape)} needs {expected} bytes, not {len(tensor.raw_data)}",
                "export the policy again: the file is damaged",
            )
        stored = np.frombuffer(tensor.raw_data, dtype=layout)
    else:
        stored = _typed_data(tensor, name, layout, count)
    return Constant(_decoded(stored, dtype).reshape(shape), dtype)


def _element_count(name: str, shape: tuple[int, ...]) -> int:
    if len(shape) > MAX_RANK:
        raise PolicyError(f"tensor '{name}' has {len(shape)} axes", "export the policy again")
    if any(size < 0 for size in shape):
        raise PolicyError(
            f"tensor '{name}' has the impossible shape {list(shape)}", "export the policy again"
        )
    count = math.prod(shape)
    if count * 8 > 2 * MAX_BYTES:
        raise PolicyError(
            f"tensor '{name}' of shape {list(shape)} is larger than any policy viatool reads",
            "check the file, or export the actor alone",
        )
    return count


def _decoded(stored: Array, dtype: str) -> Array:
    if dtype == "bfloat16":
        return (stored.astype(np.uint32) << 16).view(np.float32)
    return stored.astype(dtype)


_TYPED_FIELDS: dict[str, Callable[[onnx.TensorProto], Any]] = {
    "<f4": lambda tensor: tensor.float_data,
    "<f8": lambda tensor: tensor.double_data,
    "<i8": lambda tensor: tensor.int64_data,
    "<u4": lambda tensor: tensor.uint64_data,
    "<u8": lambda tensor: tensor.uint64_data,
}


def _typed_data(tensor: onnx.TensorProto, name: str, layout: str, count: int) -> Array:
    field = _TYPED_FIELDS.get(layout, lambda t: t.int32_data)(tensor)
    if len(field) != count:
        raise PolicyError(
            f"tensor '{name}' of shape {list(tensor.dims)} needs {count} numbers, not {len(field)}",
            "export the policy again: the file is damaged",
        )
    numbers = np.asarray(field)
    if layout == "<f2":  # float16 stands as bits in int32_data
        return numbers.astype(np.uint16).view(np.float16)
    return numbers.astype(layout)


def _external_bytes(tensor: onnx.TensorProto, expected: int, folder: Path | None) -> bytes:
    name = tensor.name or "(unnamed)"
    entries = {entry.key: entry.value for entry in tensor.external_data}
    if folder is None:
        raise PolicyError(
            f"tensor '{name}' keeps its data outside the model, where none is allowed",
            "export the weights inline",
        )
    path = _external_path(name, entries.get("location", ""), folder)
    try:
        offset = int(entries.get("offset", "0"))
        length = int(entries.get("length", str(expected)))
    except ValueError as error:
        raise PolicyError(
            f"tensor '{name}' has a broken offset or length", "export the policy again"
        ) from error
    if offset < 0 or length != expected:
        raise PolicyError(
            f"tensor '{name}' needs {expected} bytes, its entry gives {length} from {offset}",
            "export the policy again: the file is damaged",
        )
    try:
        with path.open("rb") as file:
            file.seek(min(offset, 2**62))
            content = file.read(expected)
    except OSError as error:
        raise PolicyError(
            f"cannot read {path}, which holds tensor '{name}': {error.strerror}",
            f"copy {path.name} beside the model, or export with external_data=False",
        ) from error
    if len(content) != expected:
        raise PolicyError(
            f"{path} ends before the data of tensor '{name}' ({len(content)} of {expected} bytes)",
            "copy the file again: it is truncated",
        )
    return content


def _external_path(name: str, location: str, folder: Path) -> Path:
    """Return the file beside the model that a tensor names; nothing outside the folder, and no link."""
    parts = location.replace("\\", "/").split("/")
    if not location or "\0" in location or os.path.isabs(location) or ":" in parts[0] or ".." in parts:
        raise PolicyError(
            f"tensor '{name}' keeps its data in '{location[:200]}', which is outside the model's folder",
            "put the data file beside the model and name it relative to it",
        )
    path = folder
    for part in parts:
        path = path / part
        try:
            mode = path.lstat().st_mode
        except (OSError, ValueError) as error:
            raise PolicyError(
                f"the file '{location[:200]}' with the data of tensor '{name}' does not stand beside the model",
                f"copy {parts[-1]} there, or export with external_data=False",
            ) from error
        if stat.S_ISLNK(mode):
            raise PolicyError(
                f"tensor '{name}' keeps its data in '{location[:200]}', which is a link",
                "copy the data file itself",
            )
    if not stat.S_ISREG(mode):
        raise PolicyError(
            f"tensor '{name}' keeps its data in '{location[:200]}', which is not a file",
            "export the policy again",
        )
    return path
