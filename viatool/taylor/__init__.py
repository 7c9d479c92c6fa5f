"""The engine: a network and boxes of observations give guaranteed bounds of the actions."""

from viatool.taylor.propagation import Box
from viatool.taylor.reach import Arithmetic, ReachableSet, Refinement, reach

__all__ = ["Arithmetic", "Box", "ReachableSet", "Refinement", "reach"]
