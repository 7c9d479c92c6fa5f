"""Pickles read as data: nothing that they name is imported, called or run.

A pickle is a program that names functions and calls them. Here every name becomes a stand-in of this module, which
keeps what it was called with; arrays of numbers alone are rebuilt, from their bytes.
"""

from __future__ import annotations

import io
import pickle
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.errors import PolicyError

TRUST = "add --trust to run it, if it comes from someone whom you trust"

_NUMBERS = frozenset(("b1", "f2", "f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8"))
_MAX_DIMENSIONS = 8


class Inert:
    """An object of a class that a pickle names: how it was made, and nothing more.

    Parameters
    ----------
    *arguments, **named
        With which the pickle called it.
    """

    origin = ""
    """The name in the pickle, module first."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        self.arguments = arguments
        self.named = named
        self.state: Any = None

    def __setstate__(self, state: Any) -> None:
        self.state = state

    def __setitem__(self, key: Any, value: Any) -> None:
        """Accept entries, as of a dictionary's subclass; they are not kept."""

    def __call__(self, *arguments: Any, **named: Any) -> Inert:
        """Return another stand-in."""
        return Inert(*arguments, **named)

    def append(self, value: Any) -> None:
        """Accept an entry, as of a list's subclass; it is not kept."""

    def extend(self, values: Iterable[Any]) -> None:
        """Accept entries, as of a list's subclass; they are not kept."""

    def field(self, name: str) -> Any:
        """Return an entry of the object's state; None where there is none."""
        return self.state.get(name) if isinstance(self.state, dict) else None


class _ElementType:
    """A numpy.dtype of numbers."""

    def __init__(self, code: Any, *rest: Any) -> None:
        self.code = code
        self.order = "="

    def __setstate__(self, state: Any) -> None:
        self.order = state[1] if state[1] in ("<", ">") else "="

    def dtype(self) -> np.dtype[Any]:
        if self.code not in _NUMBERS:
            raise pickle.UnpicklingError(f"an array holds '{self.code}', not numbers")
        return np.dtype(f"{self.order}{self.code}")


class _Array:
    """A numpy.ndarray of numbers, which gets its values when its state is set."""

    def __init__(self, *arguments: Any) -> None:
        self.values: NDArray[Any] = np.zeros(0)

    def __setstate__(self, state: Any) -> None:
        _, shape, element, fortran, content = state
        self.values = _values(content, element, shape, "F" if fortran else "C")


def _values(content: Any, element: _ElementType, shape: tuple[int, ...], order: Any) -> NDArray[Any]:
    if not isinstance(content, bytes | bytearray) or len(shape) > _MAX_DIMENSIONS:
        raise pickle.UnpicklingError("an array is not made of bytes")
    return np.frombuffer(bytes(content), element.dtype()).reshape(shape, order="F" if order == "F" else "C")


def _from_buffer(content: Any, element: _ElementType, shape: tuple[int, ...], order: Any) -> _Array:
    array = _Array()
    array.values = _values(content, element, shape, order)
    return array


def _scalar(element: _ElementType, content: Any = b"") -> Any:
    return _values(content, element, (1,), "C")[0].item()


def _encoded(text: str, encoding: str = "latin1") -> bytes:
    return text.encode("latin1")


def _no_bytes() -> bytes:
    return b""


def _class_by_value(kind: Any, name: Any, bases: Any, fields: Any, *rest: Any) -> type[Inert]:
    """Return the stand-in of a class that the pickle itself defines; it is never one of a library."""
    module = fields.get("__module__") if isinstance(fields, dict) else None
    return type("Own", (Inert,), {"origin": f"own class {module or '__main__'}.{name}"})


def _reconstructed(kind: Any, base: Any = None, state: Any = None) -> Any:
    return kind() if isinstance(kind, type) and issubclass(kind, Inert) else Inert(kind, base, state)


_REBUILT: dict[tuple[str, str], Any] = {
    ("numpy", "dtype"): _ElementType,
    ("numpy", "ndarray"): _Array,
    ("collections", "OrderedDict"): dict,
    ("copyreg", "_reconstructor"): _reconstructed,
    ("_codecs", "encode"): _encoded,
    ("builtins", "bytes"): _no_bytes,
    ("__builtin__", "bytes"): _no_bytes,
    ("cloudpickle.cloudpickle", "_make_skeleton_class"): _class_by_value,
    **{
        (f"numpy.{core}.{module}", name): stand_in
        for core in ("core", "_core")
        for module, name, stand_in in (
            ("multiarray", "_reconstruct", _Array),
            ("multiarray", "scalar", _scalar),
            ("numeric", "_frombuffer", _from_buffer),
        )
    },
}


class _Reader(pickle.Unpickler):
    """An unpickler that finds stand-ins only."""

    def __init__(self, content: bytes, admits: Callable[[str], bool]) -> None:
        super().__init__(io.BytesIO(content))
        self.admits = admits
        self.refused = ""

    def find_class(self, module: str, name: str, /) -> Any:
        """Return the stand-in of a name."""
        rebuilt = _REBUILT.get((module, name))
        if rebuilt is not None:
            return rebuilt
        origin = f"{module}.{name}"
        if not self.admits(origin):
            self.refused = origin
            raise pickle.UnpicklingError(origin)
        return type(name.rpartition(".")[2] or "unnamed", (Inert,), {"origin": origin})


def read_inert(content: bytes, where: str, admits: Callable[[str], bool] = lambda origin: True) -> Any:
    """Read a pickle without running anything.

    Parameters
    ----------
    content : bytes
        The pickle.
    where : str
        The file and the field, for messages.
    admits : callable
        Tells of a name, such as ``gymnasium.spaces.box.Box``, whether it may occur; its stand-in is read then.

    Returns
    -------
    object
        Made of dictionaries, lists, tuples, strings, numbers, arrays (see `numbers_of`) and `Inert`; a class that is
        named but not called is a subclass of `Inert`.

    Raises
    ------
    PolicyError
        If it is no pickle, or names what is not admitted.
    """
    reader = _Reader(content, admits)
    try:
        return reader.load()
    except Exception as error:  # whatever a damaged pickle makes of the reader
        if reader.refused:
            raise PolicyError(
                f"{where} is a pickle that names '{reader.refused}', which is not run or read", TRUST
            ) from None
        raise PolicyError(
            f"{where} is not a pickle that can be read: {str(error) or type(error).__name__}",
            "give the file as it was saved",
        ) from error


def origin_of(value: Any) -> str:
    """Return the name of a class that a pickle names, or of an object's class; "" for anything else."""
    kind = value if isinstance(value, type) else type(value)
    return kind.origin if issubclass(kind, Inert) else ""


def numbers_of(value: Any) -> NDArray[np.float64] | None:
    """Return the numbers of an array or a number, as float64 in its shape; None for anything else."""
    if isinstance(value, _Array):
        return value.values.astype(np.float64)
    if isinstance(value, bool | int | float):
        return np.asarray(value, np.float64)
    return np.asarray(value, np.float64) if isinstance(value, np.ndarray | np.number) else None


def kind_of(value: Any) -> str:
    """Return the name of a value's class, without its module, whether a pickle only names it or it is there."""
    return (origin_of(value) or type(value).__name__).rpartition(".")[2]


def field_of(value: Any, name: str) -> Any:
    """Return a field of an object, whether a pickle only names its class or it is there; None where it has none."""
    return value.field(name) if isinstance(value, Inert) else getattr(value, name, None)
