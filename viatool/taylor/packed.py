"""A network as the compiled engine reads it: structs of 8-byte fields, and one array of numbers that they point into.

The layout is that of engine/kernel.h; what it means is derived in docs/kernel.md.
"""

from __future__ import annotations

import ctypes
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from viatool.arrays import Floats
from viatool.policy.activations import ActivationFunction, activation
from viatool.policy.kernel_error import BoundedError, KernelError
from viatool.policy.network import (
    Activation,
    Affine,
    Cast,
    Input,
    Maximum,
    Minimum,
    Network,
    Node,
    Product,
)
from viatool.policy.weights import Sparse
from viatool.rounding import ENGINE_ROUNDOFF, LARGEST, SMALLEST_NORMAL, UNIT_ROUNDOFF
from viatool.taylor.curve import Curve, CurveCells, curve_of
from viatool.taylor.rounding import affine_rounding, floors_of, gamma
from viatool.taylor.tabulated import STEPS, Tabulated, tabulated

_KINDS: dict[type, int] = {Input: 0, Affine: 1, Activation: 2}
_EXACT, _OF_THE_LARGEST, _OF_THE_VALUE = 0, 1, 2
_MOST_SYMBOLS = 1024
_MOST_FLOATS = 2**24
_MOST_CELLS = 64
_SPARE_TERMS = 10
"""Roundings of one sum besides its products: of the middle of each hull, of both ends of what comes out, ..."""


def _struct(name: str, fields: Iterable[str], kind: Any = ctypes.c_int64) -> Any:
    return type(name, (ctypes.Structure,), {"_fields_": [(field, kind) for field in fields]})


_Node = _struct(
    "_Node",
    (
        "kind", "size", "offset", "source", "sources", "bias", "bias_size", "curve", "elementwise", "factor",
        "flushed", "floor", "error",
    ),
)  # fmt: skip
_Source = _struct("_Source", ("node", "weight", "absolute", "merged", "weight_t", "absolute_t", "merged_t"))
_CELLS = ("count", "edges", "kinds", "lowest", "highest")
_Curve = _struct(
    "_Curve",
    (
        "pieces", "kinks", "breaks", "slopes", "lowest", "highest", "rounded", "rising", "bend", "relu",
        "grid", "steps", "tails",
        *(f"values_{field}" for field in _CELLS), *(f"derivative_{field}" for field in _CELLS),
    ),
)  # fmt: skip
_Figure = _struct(
    "_Figure", ("gamma", "backward", "unit", "tiny", "largest", "error_units", "amplitude"), ctypes.c_double
)
Allowances = _struct(
    "Allowances",
    ("sums", "lines", "underflow", "slopes", "tilts", "program", "errors", "back", "core"),
    ctypes.c_double,
)
"""Factors of the terms that cover rounding, all 1; a test shows that each is needed."""


class PackedNetwork(ctypes.Structure):
    """The struct that the functions of the kernel take first; it keeps alive what it points to."""

    _fields_ = (
        ("nodes", ctypes.c_int64),
        ("trunk", ctypes.c_int64),
        ("neurons", ctypes.c_int64),
        ("node", ctypes.c_void_p),
        ("source", ctypes.c_void_p),
        ("curve", ctypes.c_void_p),
        ("figure", ctypes.c_void_p),
        ("numbers", ctypes.c_void_p),
        ("tables", ctypes.c_void_p),
        ("allow", ctypes.c_void_p),
        ("gamma", ctypes.c_double),
    )


def packed(network: Network, trunk: int) -> PackedNetwork | None:
    """Pack a network of which the first `trunk` nodes are enclosed by models; None if the kernel does not cover it."""
    if not is_covered(network):
        return None
    packing = _Packing(_most_readers(network))
    for node, floor in zip(network.nodes, floors_of(network), strict=True):
        packing.add(node, floor)
    return packing.network(trunk)


def is_covered(network: Network) -> bool:
    """Tell whether the kernel has every kind of node of a network, and the memory for it."""
    symbols = network.input_size + sum(node.size for node in network.nodes if isinstance(node, Activation))
    floats = symbols * sum(node.size for node in network.nodes)
    return symbols <= _MOST_SYMBOLS and floats <= _MOST_FLOATS and all(map(_node_is_covered, network.nodes))


def _node_is_covered(node: Node) -> bool:
    match node:
        case Input():
            return True
        case Affine():
            arrays = not any(isinstance(weight, Sparse) for weight in (*node.weights, *node.magnitudes))
            return bool(node.sources) and arrays
        case Activation():
            return _error_of(node.function) is not None and _curve_is_covered(curve_of(node.function))
        case Product() | Maximum() | Minimum() | Cast():
            return False


def _most_readers(network: Network) -> int:
    """Return how many nodes read the one that most of them read."""
    return max(Counter(source for node in network.nodes for source in node.sources).values(), default=0)


def _error_of(function: ActivationFunction) -> int | None:
    """Return what the error of a runtime's kernel is relative to; None where that is not among the kernel's own."""
    error = function.error
    if function.passes_on or function.jumps:
        return None
    if type(error) is BoundedError:
        return _OF_THE_VALUE
    if type(error) is not KernelError:
        return None
    return _OF_THE_LARGEST if error.units else _EXACT


def _curve_is_covered(curve: Curve) -> bool:
    if curve.lines is not None:
        return True
    few = all(curve.cells(derivative).kinds.size <= _MOST_CELLS for derivative in (0, 1))
    return few and tabulated(curve) is not None


class _Packing:
    """What has been packed so far."""

    def __init__(self, readers: int) -> None:
        self._nodes: list[Any] = []
        self._sources: list[Any] = []
        self._curves: list[Any] = []
        self._figures: list[Any] = []
        self._numbers: list[Floats] = []
        self._places: dict[int, int] = {}
        self._placed: list[Any] = []
        self._length = 0
        self._offset = 0
        self._readers, self._backwards = readers, readers + _SPARE_TERMS

    def add(self, node: Node, floor: Floats) -> None:
        """Add a node and what it has at least."""
        fields: dict[str, int] = {"kind": _KINDS[type(node)], "size": node.size, "offset": self._offset}
        fields |= {"source": len(self._sources), "floor": self._place(floor)}
        unit = UNIT_ROUNDOFF[node.precision]
        figures = {"unit": unit, "tiny": SMALLEST_NORMAL[node.precision], "largest": LARGEST[node.precision]}
        match node:
            case Affine():
                for source, *weights in zip(
                    node.sources, node.weights, node.absolute_weights, node.magnitudes, strict=True
                ):
                    self._add_source(source, weights)
                factor, terms = affine_rounding(node, unit)
                fields |= {"bias": self._place(node.bias), "bias_size": self._place(node.bias_magnitude)}
                fields |= {"elementwise": node.is_elementwise, "factor": self._place(factor)}
                fields |= {"flushed": self._place(2 * terms * figures["tiny"])}
                products = sum(weight.shape[1] for weight in node.weights)
                count = products + len(node.sources) + node.roundings + _SPARE_TERMS
                figures["gamma"] = float(gamma(count, ENGINE_ROUNDOFF))
                backwards = node.size + node.roundings + self._readers + _SPARE_TERMS
                self._backwards = max(self._backwards, backwards)
                figures["backward"] = float(gamma(backwards, ENGINE_ROUNDOFF))
            case Activation():
                self._sources.append(_Source(node=node.source))
                fields |= {"curve": len(self._curves), "error": _error_of(node.function) or _EXACT}
                self._curves.append(self._curve(curve_of(node.function)))
                figures["error_units"] = node.function.error.roundings(node.function.named)
                figures["amplitude"] = node.function.amplitude
        self._nodes.append(_Node(**fields, sources=len(node.sources)))
        self._figures.append(_Figure(**figures))
        self._offset += node.size

    def network(self, trunk: int) -> PackedNetwork:
        """Return all of it."""
        kept = [_array(part) for part in (self._nodes, self._sources, self._curves, self._figures)]
        numbers = np.concatenate(self._numbers)
        allow = Allowances(*(1.0 for _ in Allowances._fields_))
        result = PackedNetwork(
            len(self._nodes), trunk, self._offset, *(ctypes.addressof(part) for part in kept),
            numbers.ctypes.data, numbers.ctypes.data, ctypes.addressof(allow),
            float(gamma(self._roundings(), ENGINE_ROUNDOFF)),
        )  # fmt: skip
        result.kept = [*kept, numbers]
        result.allowances = allow
        return result

    def _roundings(self) -> int:
        """Return the roundings of a sum over all neurons that follows one of them back to the inputs."""
        return self._offset + self._backwards

    def _add_source(self, source: int, weights: Sequence[Any]) -> None:
        straight = [self._place(weight) for weight in weights]
        turned = [self._place(weight, turned=True) for weight in weights]
        self._sources.append(_Source(source, *straight, *turned))

    def _place(self, values: Any, *, turned: bool = False) -> int:
        """Put numbers behind the others, once; return where they begin."""
        key = 2 * id(values) + turned
        if key not in self._places:
            array = np.asarray(values, dtype=np.float64)
            array = array.T if turned else array
            if array.ndim == 2:  # each row as long as whole vectors of the processor
                array = np.pad(array, ((0, 0), (0, -array.shape[1] % 8)))
            self._places[key] = self._length
            self._placed.append(values)  # or another array might come to have its identity
            self._numbers.append(array.ravel())
            self._length += array.size
        return self._places[key]

    def _curve(self, curve: Curve) -> Any:
        lines = curve.lines
        if lines is not None:
            exact = np.isin(lines.slopes, (-1.0, 0.0, 1.0)) & (lines.lowest == 0) & (lines.highest == 0)
            places = [lines.breaks, lines.slopes, lines.lowest, lines.highest, ~exact]
            rising = bool((lines.slopes >= 0).all())
            return _Curve(
                lines.slopes.size, lines.breaks.size, *(self._place(np.array(part, float)) for part in places), rising,
                curve.overall_bend, curve.function == activation("Relu"),
            )  # fmt: skip
        table = tabulated(curve)
        assert isinstance(table, Tabulated)
        fields = {"kinks": curve.breaks.size, "breaks": self._place(curve.breaks)}
        fields |= {
            "grid": self._place(table.cells.ravel()),
            "steps": STEPS,
            "tails": self._place(table.tails.ravel()),
        }
        for name, derivative in (("values", 0), ("derivative", 1)):
            cells: CurveCells = curve.cells(derivative)
            fields[f"{name}_count"] = cells.kinds.size
            for field, part in zip(_CELLS[1:], (cells.edges, cells.kinds, *cells.table), strict=True):
                fields[f"{name}_{field}"] = self._place(np.array(part, float).ravel())
        return _Curve(**fields)


def _array(parts: Sequence[Any]) -> Any:
    """Return structs one behind the other, at least one so that there is an address."""
    return (type(parts[0]) * len(parts))(*parts) if parts else _Node()
