"""Operator readers, one short file for each family; importing the package registers them all."""

from __future__ import annotations

from viatool.policy.operators import (
    control_flow,
    convolution,
    elementwise,
    linear,
    matrix,
    normalisation,
    recurrent,
    reduction,
    selection,
    shape,
)
from viatool.policy.operators.registry import (
    Call,
    Comparison,
    Entry,
    Result,
    Scope,
    Value,
    entry_of,
    registered,
)

__all__ = [
    "Call",
    "Comparison",
    "Entry",
    "Result",
    "Scope",
    "Value",
    "control_flow",
    "convolution",
    "elementwise",
    "entry_of",
    "linear",
    "matrix",
    "normalisation",
    "recurrent",
    "reduction",
    "registered",
    "selection",
    "shape",
]
