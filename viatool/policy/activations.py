"""What each activation function is: one sympy expression, from which everything else is derived.

To add an activation, add one declaration below: its ONNX name, how far a runtime's kernel may be from it, its
parameters with their defaults, and its expression. Evaluation, derivatives, kinks, monotone and convex pieces, and
bounds follow from the expression.
Expressions are written so that float64 evaluation neither overflows nor cancels on the branch that is taken.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, TypeAlias

import numpy as np
import sympy
from scipy import special

from viatool.arrays import Floats
from viatool.policy.kernel_error import (
    RECURRENT_ERROR,
    BoundedError,
    ExponentialError,
    GuardedError,
    KernelError,
    LogisticError,
    LogSoftmaxError,
    PowerError,
    ReciprocalError,
    RootError,
    SoftmaxError,
    amplitude,
)

X = sympy.Symbol("x", real=True)
Expression: TypeAlias = sympy.Expr


class NormalCdf(sympy.Function):  # type: ignore[misc]  # sympy carries no types
    """The standard normal distribution function, accurate in both tails where ``1 + erf`` would cancel."""

    def fdiff(self, argindex: int = 1) -> Expression:
        """Return the normal density."""
        return sympy.exp(-(self.args[0] ** 2) / 2) / sympy.sqrt(2 * sympy.pi)


FLOAT_MODULES: list[Any] = [{"NormalCdf": special.ndtr}, "scipy", "numpy"]
"""The namespace in which expressions are compiled for float64 evaluation."""


@dataclass(frozen=True)
class _Declaration:
    """What an activation is.

    Parameters
    ----------
    expression : callable
        Makes its sympy expression of its parameters.
    defaults : dict
        Its parameters.
    error : KernelError
        How far a runtime may be from it.
    jumps : bool
        Whether its value jumps somewhere, as it does in every step function.
    passes_on : bool
        Whether the program passes its argument on as it is: what the function says is knowledge alone.
    """

    expression: Callable[..., Expression]
    defaults: dict[str, float]
    error: KernelError
    jumps: bool
    passes_on: bool


_DECLARATIONS: dict[str, _Declaration] = {}


def _declare(
    name: str,
    error: KernelError | None = None,
    *,
    jumps: bool = False,
    passes_on: bool = False,
    **defaults: float,
) -> Callable[[Callable[..., Expression]], Callable[..., Expression]]:
    """Register an activation with the defaults of its parameters; without an error it has that of 64 roundings."""

    def register(expression: Callable[..., Expression]) -> Callable[..., Expression]:
        _DECLARATIONS[name] = _Declaration(expression, defaults, error or KernelError(), jumps, passes_on)
        return expression

    return register


def _pieces(*pieces: tuple[object, object]) -> Expression:
    return sympy.Piecewise(*pieces)


@_declare("Relu", KernelError(0.0))
def _relu() -> Expression:
    return _pieces((0, X < 0), (X, True))


@_declare("LeakyRelu", KernelError(1.0), alpha=0.01)
def _leaky_relu(alpha: float) -> Expression:
    return _pieces((alpha * X, X < 0), (X, True))


@_declare("ThresholdedRelu", KernelError(0.0), jumps=True, alpha=1.0)
def _thresholded_relu(alpha: float) -> Expression:
    return _pieces((0, X <= alpha), (X, True))


@_declare("Elu", KernelError(8.0), alpha=1.0)
def _elu(alpha: float) -> Expression:
    return _pieces((alpha * (sympy.exp(X) - 1), X < 0), (X, True))


@_declare("Celu", KernelError(8.0), alpha=1.0)
def _celu(alpha: float) -> Expression:
    return _pieces((alpha * (sympy.exp(X / alpha) - 1), X < 0), (X, True))


@_declare("Selu", KernelError(48.0), alpha=1.67326319217681884765625, gamma=1.05070102214813232421875)
def _selu(alpha: float, gamma: float) -> Expression:
    return _pieces((gamma * alpha * (sympy.exp(X) - 1), X < 0), (gamma * X, True))


@_declare("Sigmoid", BoundedError(8.0))
def _sigmoid() -> Expression:
    return (1 + sympy.tanh(X / 2)) / 2


@_declare("Logistic", LogisticError())
def _logistic() -> Expression:
    """Return the sigmoid as ``1 / (1 + exp(-x))`` spells it: 0 where the exponential overflows."""
    return _quotient_of_exponentials()


@_declare("Softmax", SoftmaxError(), terms=2.0)
def _softmax(terms: float) -> Expression:
    """Return a softmax of so many values as a function of log-odds: one of them less log sum exp of the others."""
    return _quotient_of_exponentials()


def _quotient_of_exponentials() -> Expression:
    """Return the sigmoid in a form that is accurate relative to its value in both tails."""
    return _pieces((sympy.exp(X) / (1 + sympy.exp(X)), X < 0), (1 / (1 + sympy.exp(-X)), True))


@_declare("LogSoftmax", LogSoftmaxError(), terms=2.0)
def _log_softmax(terms: float) -> Expression:
    """Return the logarithm of a softmax of so many values, as a function of the log-odds of one."""
    return _pieces((X - sympy.log(1 + sympy.exp(X)), X < 0), (-sympy.log(1 + sympy.exp(-X)), True))


@_declare("SpelledSigmoid", BoundedError(32.0))
def _spelled_sigmoid() -> Expression:
    """Return ``exp(x) / (1 + exp(x))`` as a program spells it, which rounds relative to 1."""
    return _quotient_of_exponentials()


@_declare("SpelledTanh", BoundedError(32.0))
def _spelled_tanh() -> Expression:
    """Return ``(exp(x) - exp(-x)) / (exp(x) + exp(-x))`` as a program spells it."""
    return _tanh()


@_declare("Known", KernelError(0.0), passes_on=True, min=-np.inf, max=np.inf)
def _known(min: float, max: float) -> Expression:
    """Return x, known to lie between limits but for rounding: enclosures are cut, the program is not."""
    return _clip(min, max)


@_declare("Guard", GuardedError(), passes_on=True, min=-np.inf, max=np.inf)
def _guard(min: float, max: float) -> Expression:
    """Return x, with which the program can go on between limits only: beyond them it gives no number."""
    return X


@_declare("HardSigmoid", KernelError(8.0), alpha=0.2, beta=0.5)
def _hard_sigmoid(alpha: float, beta: float) -> Expression:
    line = alpha * X + beta
    return _pieces((0, X <= -beta / alpha), (1, X >= (1 - beta) / alpha), (line, True))


@_declare("Tanh", BoundedError(12.0))
def _tanh() -> Expression:
    return sympy.tanh(X)


@_declare("RecurrentSigmoid", RECURRENT_ERROR)
def _recurrent_sigmoid() -> Expression:
    """Return the sigmoid as recurrent operators compute it."""
    return _sigmoid()


@_declare("RecurrentTanh", RECURRENT_ERROR)
def _recurrent_tanh() -> Expression:
    """Return the tanh as recurrent operators compute it."""
    return _tanh()


@_declare("Softplus", KernelError(24.0))
def _softplus() -> Expression:
    return _pieces((sympy.log(1 + sympy.exp(X)), X < 0), (X + sympy.log(1 + sympy.exp(-X)), True))


@_declare("Softsign", KernelError(8.0))
def _softsign() -> Expression:
    return _pieces((X / (1 - X), X < 0), (X / (1 + X), True))


@_declare("Silu", KernelError(12.0))
def _silu() -> Expression:
    return _pieces((X * sympy.exp(X) / (1 + sympy.exp(X)), X < 0), (X / (1 + sympy.exp(-X)), True))


@_declare("Swish", slope=1.0)
def _swish(slope: float) -> Expression:
    """``x * sigmoid(slope * x)`` with a positive slope; at 1.702 it is the quick form of Gelu."""
    return _pieces(
        (X * sympy.exp(slope * X) / (1 + sympy.exp(slope * X)), X < 0),
        (X / (1 + sympy.exp(-slope * X)), True),
    )


@_declare("HardSwish", KernelError(12.0))
def _hard_swish() -> Expression:
    return _pieces((0, X <= -3), (X, X >= 3), (X * (X + 3) / 6, True))


@_declare("Gelu", KernelError(32.0))
def _gelu() -> Expression:
    return X * NormalCdf(X)


@_declare("GeluTanh", KernelError(32.0))
def _gelu_tanh() -> Expression:
    growth = sympy.exp(-2 * sympy.sqrt(2 / sympy.pi) * (sympy.Abs(X) + _exact(0.044715) * sympy.Abs(X) ** 3))
    left = growth.subs(sympy.Abs(X), -X)
    right = growth.subs(sympy.Abs(X), X)
    return _pieces((X * left / (1 + left), X < 0), (X / (1 + right), True))


@_declare("ErfGate", slope=1.0, divisor=1.0)
def _erf_gate(slope: float, divisor: float) -> Expression:
    """``x * (1 + erf(slope * x / divisor))``, as exporters write Gelu with a rounded square root of 2."""
    return 2 * X * NormalCdf(sympy.sqrt(2) * (slope * X / divisor))


@_declare("TanhGate", slope=0.7978845608028654, cubic=0.044715)
def _tanh_gate(slope: float, cubic: float) -> Expression:
    """``x * (1 + tanh(slope * (x + cubic * x^3)))``, as exporters write GeluTanh with rounded constants."""
    growth = sympy.exp(2 * slope * (X + cubic * X**3))
    decay = sympy.exp(-2 * slope * (X + cubic * X**3))
    return _pieces((2 * X * growth / (1 + growth), X < 0), (2 * X / (1 + decay), True))


@_declare("HardSigmoidGate", alpha=0.2, beta=0.5)
def _hard_sigmoid_gate(alpha: float, beta: float) -> Expression:
    """``x * HardSigmoid(x)``, as exporters write HardSwish with a rounded sixth."""
    return _pieces((0, X <= -beta / alpha), (X, X >= (1 - beta) / alpha), (X * (alpha * X + beta), True))


@_declare("SoftplusThreshold", threshold=20.0)
def _softplus_threshold(threshold: float) -> Expression:
    """Softplus, and x itself above a positive threshold, as torch computes it."""
    return _pieces(
        (sympy.log(1 + sympy.exp(X)), X < 0),
        (X + sympy.log(1 + sympy.exp(-X)), X <= threshold),
        (X, True),
    )


@_declare("Sign", jumps=True)
def _sign() -> Expression:
    return _pieces((-1, X < 0), (0, X <= 0), (1, True))


@_declare("Threshold", jumps=True, threshold=0.0, value=0.0)
def _threshold(threshold: float, value: float) -> Expression:
    return _pieces((value, X <= threshold), (X, True))


@_declare("HardShrink", jumps=True, lambd=0.5)
def _hard_shrink(lambd: float) -> Expression:
    return _pieces((X, X < -lambd), (0, X <= lambd), (X, True))


@_declare("SoftShrink", lambd=0.5)
def _soft_shrink(lambd: float) -> Expression:
    return _pieces((X + lambd, X < -lambd), (0, X <= lambd), (X - lambd, True))


@_declare("Mish", KernelError(96.0))
def _mish() -> Expression:
    left, right = sympy.exp(X), sympy.exp(-X)
    return _pieces(
        (X * left * (left + 2) / (left * (left + 2) + 2), X < 0),
        (X - 2 * X * right**2 / ((1 + right) ** 2 + right**2), True),  # tight over intervals in this form
    )


@_declare("Erf", KernelError(12.0))
def _erf() -> Expression:
    return sympy.erf(X)


@_declare("Exp", ExponentialError())
def _exp() -> Expression:
    return sympy.exp(X)


@_declare("Log")
def _log() -> Expression:
    return sympy.log(X)


@_declare("Abs", KernelError(0.0))
def _abs() -> Expression:
    return _pieces((-X, X < 0), (X, True))


@_declare("Sqrt", RootError(4.0))
def _sqrt() -> Expression:
    return sympy.sqrt(X)


@_declare("Pow", PowerError(4.0), exponent=2.0)
def _pow(exponent: float) -> Expression:
    return X ** int(exponent)


@_declare("Reciprocal", ReciprocalError(4.0))
def _reciprocal() -> Expression:
    return 1 / X


@_declare("Clip", KernelError(0.0), min=-np.inf, max=np.inf)
def _clip(min: float, max: float) -> Expression:
    pieces = [(X, True)]
    if max != np.inf:
        pieces.insert(0, (max, X >= max))
    if min != -np.inf:
        pieces.insert(0, (min, X <= min))
    return _pieces(*pieces)


@_declare("ClippedTan", KernelError(16.0), min=-1.0, max=1.0)
def _clipped_tan(min: float, max: float) -> Expression:
    """Return the tangent of an angle that is clipped to limits within a quarter turn: how steered wheels turn a car."""
    return _pieces((sympy.tan(min), X <= min), (sympy.tan(max), X >= max), (sympy.tan(X), True))


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

    @cached_property
    def expression(self) -> Expression:
        """Return the function as a sympy expression in `X`."""
        return self._declaration.expression(**{name: _exact(value) for name, value in self.parameters})

    @property
    def named(self) -> dict[str, float]:
        """Return the parameters by their names."""
        return dict(self.parameters)

    @property
    def error(self) -> KernelError:
        """Return how far a runtime's kernel may be from the function."""
        return self._declaration.error

    @property
    def jumps(self) -> bool:
        """Tell whether the value jumps somewhere, as it does in every step function."""
        return self._declaration.jumps

    @property
    def passes_on(self) -> bool:
        """Tell whether the program passes its argument on as it is: what the function says is knowledge alone."""
        return self._declaration.passes_on

    @property
    def amplitude(self) -> float:
        """Return how much larger than its argument and its value, and than 1, an intermediate result may be."""
        return amplitude(self.named)

    @property
    def _declaration(self) -> _Declaration:
        return _DECLARATIONS[self.name]

    def __call__(self, x: Floats) -> Floats:
        """Evaluate elementwise in float64; the error is far below one float32 rounding."""
        return _compiled(self)(x)


def _exact(value: float) -> Expression:
    """Return a parameter with 17 digits, as compiling prints it: with 15 it would lose its last bits."""
    return sympy.Float(value, 17) if np.isfinite(value) else value


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


@cache
def _compiled(function: ActivationFunction) -> Callable[[Floats], Floats]:
    evaluate = sympy.lambdify(X, function.expression, modules=FLOAT_MODULES)

    def evaluated(x: Floats) -> Floats:
        with np.errstate(all="ignore"):  # branches that are not taken may overflow
            return np.broadcast_to(np.asarray(evaluate(x), dtype=np.float64), x.shape)

    return evaluated
