"""What declared activations are made of, in sympy; imported where something is derived from a declaration."""

from __future__ import annotations

import numpy as np
import sympy

from viatool.policy.algebra import Expression

X = sympy.Symbol("x", real=True)
exp, log, tan, tanh, sqrt, erf = sympy.exp, sympy.log, sympy.tan, sympy.tanh, sympy.sqrt, sympy.erf
pieces = sympy.Piecewise


class NormalCdf(sympy.Function):  # type: ignore[misc]  # sympy carries no types
    """The standard normal distribution function, accurate in both tails where ``1 + erf`` would cancel."""

    def fdiff(self, argindex: int = 1) -> Expression:
        """Return the normal density."""
        return sympy.exp(-(self.args[0] ** 2) / 2) / sympy.sqrt(2 * sympy.pi)


normal_cdf = NormalCdf


def pi() -> Expression:
    """Return the number."""
    return sympy.pi


def exact(value: float) -> Expression:
    """Return a number with 17 digits, as compiling prints it: with 15 it would lose its last bits."""
    return sympy.Float(value, 17) if np.isfinite(value) else value
