"""The engine: a network and boxes of observations give guaranteed bounds of the actions."""

from viatool.taylor.propagation import Box
from viatool.taylor.reach import Arithmetic, ReachableSet, Refinement, reach
from viatool.taylor.symbolic import SymbolicAction, symbolic_actions

__all__ = ["Arithmetic", "Box", "ReachableSet", "Refinement", "SymbolicAction", "reach", "symbolic_actions"]
