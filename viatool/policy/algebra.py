"""The functions in which activations are declared; sympy is imported when one of them is called."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any, TypeAlias

Expression: TypeAlias = Any
"""An expression of sympy, which carries no types."""


def _symbolic(name: str) -> Callable[..., Expression]:
    def applied(*given: Expression) -> Expression:
        return getattr(import_module("viatool.policy.symbols"), name)(*given)

    return applied


exp, log, tan, tanh, sqrt = map(_symbolic, ("exp", "log", "tan", "tanh", "sqrt"))
erf, normal_cdf = map(_symbolic, ("erf", "normal_cdf"))
pi, exact = map(_symbolic, ("pi", "exact"))
pieces = _symbolic("pieces")
"""A function of pairs of an expression and the condition under which it holds; the first that holds counts."""
