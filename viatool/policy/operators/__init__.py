"""Operator readers, one short file for each family; importing the package registers them all."""

from __future__ import annotations

from viatool.policy.operators import elementwise, linear, matrix, shape
from viatool.policy.operators.registry import Call, Entry, Value, entry_of, registered

__all__ = ["Call", "Entry", "Value", "elementwise", "entry_of", "linear", "matrix", "registered", "shape"]
