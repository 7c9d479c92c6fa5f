"""Which operators are read, by name and opset version, and by which function.

A reader is a function of a `Call`; it is registered for the versions of the operator whose meaning it knows.
An operator in a version that nobody registered is refused, never guessed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from viatool.arrays import Floats
from viatool.policy.assembly import Assembly, Computed, Counted, Refusal
from viatool.policy.folded_rounding import numbers_of
from viatool.policy.graph import GraphNode
from viatool.policy.tensors import Constant

Value = Constant | Computed
Treatment = Literal["exact", "enclosed", "folded"]


@dataclass(frozen=True)
class Comparison:
    """``subject > bound`` for every element, or its opposite; only a rectifier can be made of it.

    Parameters
    ----------
    subject : Computed
        What is compared.
    bound : float
        With which number.
    strict : bool
        Whether the bound itself counts as below.
    above : bool
        Whether the condition holds above the bound, else at or below it.
    """

    subject: Computed
    bound: float
    strict: bool
    above: bool


Result = Value | Comparison


@dataclass(frozen=True, eq=False)
class Scope:
    """What a call that holds graphs of its own needs.

    Parameters
    ----------
    values : mapping
        Of everything that stands before it, by name.
    read : callable
        Makes the values of the outputs of a call from those of a scope.
    """

    values: Mapping[str, Any]
    read: Callable[[GraphNode, Mapping[str, Any]], Sequence[Result | None]]


@dataclass(frozen=True, eq=False)
class Call:
    """One node with its inputs, as an operator reader sees it.

    Parameters
    ----------
    node : GraphNode
        The call in the file.
    version : int
        The opset version that defines the operator's meaning here.
    inputs : sequence of Constant, Computed or None
        None where an optional input is left out; at least one is computed.
    attributes : dict
        With the defaults of the standard.
    assembly : Assembly
        Where network nodes go.
    scope : Scope, optional
        What is known around the call, for operators that hold graphs of their own.
    """

    node: GraphNode
    version: int
    inputs: Sequence[Result | None]
    attributes: Mapping[str, Any]
    assembly: Assembly
    scope: Scope | None = None

    def has(self, index: int) -> bool:
        """Whether an optional input is given."""
        return index < len(self.inputs) and self.inputs[index] is not None

    def value(self, index: int) -> Value:
        """Return an input that must be given."""
        value = self.inputs[index] if index < len(self.inputs) else None
        if value is None:
            raise Refusal(f"lacks input {index}")
        if isinstance(value, Comparison):
            raise Refusal("computes with a comparison of computed values", "clip instead of comparing")
        return value

    def computed(self, index: int) -> Computed:
        """Return an input that must depend on the observation."""
        value = self.value(index)
        if isinstance(value, Constant):
            raise Refusal(f"has a constant as input {index}, where a computed value is expected")
        return value

    def constant(self, index: int, meaning: str) -> Constant:
        """Return an input that must not depend on the observation."""
        value = self.value(index)
        if isinstance(value, Computed):
            raise Refusal(
                f"takes its {meaning} from the observation", "export the policy with fixed shapes and weights"
            )
        return value

    def weights(self, index: int, meaning: str) -> Floats:
        """Return a constant input as finite float64 numbers."""
        return finite(self.constant(index, meaning), meaning)

    def scalar(self, index: int, meaning: str, default: float) -> float:
        """Return an optional constant input that must be a single number, not NaN."""
        if not self.has(index):
            return default
        constant = self.constant(index, meaning)
        array = np.asarray(constant.array, dtype=np.float64)
        if constant.roundings:
            array = finite(constant, meaning)
        if array.size != 1 or np.isnan(array).any():
            raise Refusal(f"has a {meaning} that is not a single number")
        return float(array.ravel()[0])

    def integer(self, name: str) -> int:
        """Return an integer attribute."""
        value = self.attributes.get(name)
        if not isinstance(value, int):
            raise Refusal(f"has no integer attribute '{name}'")
        return value

    def flag(self, name: str) -> bool:
        """Return an attribute that is 0 or 1; an operator without it says 0."""
        value = self.attributes.get(name, 0)
        if value not in (0, 1) or not isinstance(value, int):
            raise Refusal(f"has {name} = {value}, which is neither 0 nor 1", "export the policy again")
        return bool(value)

    def number(self, name: str) -> float:
        """Return a finite floating-point attribute."""
        value = self.attributes.get(name)
        if not isinstance(value, float) or not np.isfinite(value):
            raise Refusal(f"has no finite attribute '{name}'")
        return value

    def integers(self, name: str) -> tuple[int, ...] | None:
        """Return an attribute that is a list of integers, None where it is left out."""
        value = self.attributes.get(name)
        if value is None:
            return None
        if not isinstance(value, tuple) or not all(isinstance(entry, int) for entry in value):
            raise Refusal(f"has an attribute '{name}' that is not a list of integers")
        return value


Reader = Callable[[Call], Sequence[Result | None]]
"""Makes the values of a call's outputs; None for one that is not read."""


@dataclass(frozen=True)
class Entry:
    """How one operator is read.

    Parameters
    ----------
    operator : str
        Its name in the default domain.
    versions : tuple of int
        The opset versions that define it and are known.
    treatment : str
        ``exact``: its result is linear in its computed input. ``enclosed``: it bends, so that the engine
        approximates it with a guaranteed error. ``folded``: evaluated where it does not depend on the
        observation, otherwise refused outside the patterns of the note.
    reader : callable
        Makes the network nodes.
    note : str
        A limit, for the table in the documentation.
    """

    operator: str
    versions: tuple[int, ...]
    treatment: Treatment
    reader: Reader
    note: str = ""


_REGISTRY: dict[tuple[str, int], Entry] = {}


def reads(operator: str, *versions: int, treatment: Treatment, note: str = "") -> Callable[[Reader], Reader]:
    """Register a reader for some versions of an operator."""

    def register(reader: Reader) -> Reader:
        entry = Entry(operator, versions, treatment, reader, note)
        for version in versions:
            if (operator, version) in _REGISTRY:
                raise ValueError(f"{operator} version {version} is registered twice")
            _REGISTRY[operator, version] = entry
        return reader

    return register


def entry_of(operator: str, version: int) -> Entry | None:
    """Return how an operator of the default domain is read in a version, None if it is not."""
    return _REGISTRY.get((operator, version))


def registered() -> Mapping[tuple[str, int], Entry]:
    """Return all entries by operator and version."""
    return dict(_REGISTRY)


def finite(constant: Constant, meaning: str) -> Floats:
    """Return a constant as float64 numbers, all finite and the same in every runtime.

    Raises
    ------
    Refusal
        If one is NaN or infinite, or if runtimes fold the constant differently.
    """
    if constant.roundings:
        raise Refusal(
            f"has a {meaning} that runtimes compute differently",
            "let the exporter fold constants, or simplify the model (onnxsim) before it is verified",
        )
    return counted(constant, meaning).values


def counted(constant: Constant, meaning: str) -> Counted:
    """Return a constant as finite float64 numbers, with the roundings that the caller counts.

    Raises
    ------
    Refusal
        If one is NaN or infinite.
    """
    array = np.asarray(constant.array, dtype=np.float64)
    if not np.isfinite(array).all():
        raise Refusal(f"has a {meaning} with NaN or infinite numbers", "train and export the policy again")
    return numbers_of(constant)
