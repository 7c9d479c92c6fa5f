"""The engine: a network and boxes of observations give guaranteed bounds of the actions."""

from viatool.taylor.kernel import engine_of
from viatool.taylor.memory import bounds_in_passing
from viatool.taylor.propagation import Box
from viatool.taylor.reach import Arithmetic, ReachableSet, Refinement, efforts_of, reach
from viatool.taylor.symbolic import SymbolicAction, symbolic_actions

__all__ = [
    "Arithmetic",
    "Box",
    "ReachableSet",
    "Refinement",
    "SymbolicAction",
    "bounds_in_passing",
    "efforts_of",
    "engine_of",
    "reach",
    "symbolic_actions",
]
