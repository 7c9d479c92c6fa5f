"""Elementwise functions with their parameters, and the register of those that are declared.

An expression and its derivatives come from `formulas`, where they are stored with viatool, else from `derivation`,
which imports sympy: what is declared anew works at once, and a little later.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from math import isfinite
from typing import Any

import numpy as np

from viatool.arrays import Floats
from viatool.policy.algebra import Expression
from viatool.policy.formulas import Branch, Form, Formulas, stored
from viatool.policy.kernel_error import KernelError, amplitude


@dataclass(frozen=True)
class Declaration:
    """What an activation is.

    Parameters
    ----------
    expression : callable
        Makes its sympy expression of x and of its parameters.
    defaults : dict
        Its parameters.
    error : KernelError
        How far a runtime may be from it.
    jumps : bool
        Whether its value jumps somewhere, as it does in every step function.
    passes_on : bool
        Whether the program passes its argument on as it is: what the function says is knowledge alone.
    form : tuple of str
        The parameters whose value decides the form of the expression, as every value does that is not finite.
    """

    expression: Callable[..., Expression]
    defaults: dict[str, float]
    error: KernelError
    jumps: bool
    passes_on: bool
    form: tuple[str, ...]


_DECLARATIONS: dict[str, Declaration] = {}


def declare(
    name: str,
    error: KernelError | None = None,
    *,
    jumps: bool = False,
    passes_on: bool = False,
    form: tuple[str, ...] = (),
    **defaults: float,
) -> Callable[[Callable[..., Expression]], Callable[..., Expression]]:
    """Register an activation with the defaults of its parameters; without an error it has that of 64 roundings."""

    def register(expression: Callable[..., Expression]) -> Callable[..., Expression]:
        declaration = Declaration(expression, defaults, error or KernelError(), jumps, passes_on, form)
        _DECLARATIONS[name] = declaration
        return expression

    return register


@dataclass(frozen=True)
class ActivationFunction:
    """One elementwise function with its parameters; equal functions compare and hash equal.

    Parameters
    ----------
    name : str
        A declared name, mostly that of the ONNX operator.
    parameters : tuple of (str, float)
        In the order of the declaration.
    """

    name: str
    parameters: tuple[tuple[str, float], ...] = ()

    @property
    def named(self) -> dict[str, float]:
        """Return the parameters by their names."""
        return dict(self.parameters)

    @property
    def error(self) -> KernelError:
        """Return how far a runtime's kernel may be from the function."""
        return self.declaration.error

    @property
    def jumps(self) -> bool:
        """Tell whether the value jumps somewhere, as it does in every step function."""
        return self.declaration.jumps

    @property
    def passes_on(self) -> bool:
        """Tell whether the program passes its argument on as it is: what the function says is knowledge alone."""
        return self.declaration.passes_on

    @property
    def amplitude(self) -> float:
        """Return how much larger than its argument and its value, and than 1, an intermediate result may be."""
        return amplitude(self.named)

    @property
    def declaration(self) -> Declaration:
        """Return what was declared under its name."""
        return _DECLARATIONS[self.name]

    @property
    def form(self) -> Form:
        """Return the form of its expression."""
        decisive = self.declaration.form
        given = tuple((k, v) for k, v in self.parameters if k in decisive or not isfinite(v))
        free = tuple(name for name in self.named if name not in dict(given))
        return Form(self.name, given, free)

    @property
    def formulas(self) -> Formulas:
        """Return its branches and their derivatives; equal functions share them."""
        return _formulas_of(self)

    def __call__(self, x: Floats) -> Floats:
        """Evaluate elementwise in float64; the error is far below one float32 rounding."""
        result = np.full(x.shape, np.nan)
        with np.errstate(all="ignore"):  # branches that are not taken may overflow
            for holds, value in _evaluated(self):
                result = np.where(holds(x), value(x), result)
        return result


@lru_cache(maxsize=256)
def _formulas_of(function: ActivationFunction) -> Formulas:
    form, declared = function.form, function.declaration.expression

    def derive(derivatives: int | None = None) -> tuple[Branch, ...]:
        from viatool.policy.derivation import derived

        return derived(form, declared, derivatives)

    found = stored(form)
    named = function.named
    return Formulas(derive() if found is None else found, {name: named[name] for name in form.free}, derive)


@lru_cache(maxsize=256)
def _evaluated(function: ActivationFunction) -> list[tuple[Callable[[Floats], Any], Callable[[Floats], Any]]]:
    """Return condition and value of each branch, the last one first."""
    formulas = function.formulas
    return [
        (formulas.condition(index), formulas.derivative(index, 0, FLOAT_FUNCTIONS))
        for index in reversed(range(len(formulas.branches)))
    ]


def _special(name: str) -> Callable[[Floats], Floats]:
    """Return a function of scipy, which is imported when it is called."""

    def evaluated(x: Floats) -> Floats:
        from scipy import special

        return np.asarray(getattr(special, name)(x), dtype=np.float64)

    return evaluated


FLOAT_FUNCTIONS: dict[str, Any] = {
    "exp": np.exp,
    "log": np.log,
    "tan": np.tan,
    "tanh": np.tanh,
    "sqrt": np.sqrt,
    "erf": _special("erf"),
    "NormalCdf": _special("ndtr"),
    "pi": np.pi,
}
"""The functions that may stand in a declared activation, for float64."""


def activation(name: str, **parameters: float) -> ActivationFunction:
    """Return a declared activation, its missing parameters taken from the ONNX defaults.

    Raises
    ------
    ValueError
        If the name or a parameter is not declared.
    """
    if name not in _DECLARATIONS:
        raise ValueError(
            f"activation '{name}' is not declared; declared are {', '.join(sorted(_DECLARATIONS))}"
        )
    defaults = _DECLARATIONS[name].defaults
    unknown = parameters.keys() - defaults.keys()
    if unknown:
        raise ValueError(f"activation '{name}' has no parameter {', '.join(sorted(unknown))}")
    return ActivationFunction(
        name, tuple((key, float(parameters.get(key, value))) for key, value in defaults.items())
    )


def declared_activations() -> tuple[str, ...]:
    """Return the names of all declared activations, sorted."""
    return tuple(sorted(_DECLARATIONS))
