"""What each activation function is: one expression, from which everything else is derived.

To add an activation, add one declaration below: its ONNX name, how far a runtime's kernel may be from it, its
parameters with their defaults, and its expression. Evaluation, derivatives, kinks, monotone and convex pieces, and
bounds follow from the expression.
Expressions are written so that float64 evaluation neither overflows nor cancels on the branch that is taken.
"""

from __future__ import annotations

import numpy as np

from viatool.policy.activation_function import (
    ActivationFunction,
    activation,
    declared_activations,
)
from viatool.policy.activation_function import declare as _declare
from viatool.policy.algebra import Expression, erf, exact, exp, log, normal_cdf, pi, pieces, sqrt, tan, tanh
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
)

__all__ = ["ActivationFunction", "activation", "declared_activations"]


@_declare("Relu", KernelError(0.0))
def _relu(x: Expression) -> Expression:
    return pieces((0, x < 0), (x, True))


@_declare("LeakyRelu", KernelError(1.0), alpha=0.01)
def _leaky_relu(x: Expression, alpha: Expression) -> Expression:
    return pieces((alpha * x, x < 0), (x, True))


@_declare("ThresholdedRelu", KernelError(0.0), jumps=True, alpha=1.0)
def _thresholded_relu(x: Expression, alpha: Expression) -> Expression:
    return pieces((0, x <= alpha), (x, True))


@_declare("Elu", KernelError(8.0), alpha=1.0)
def _elu(x: Expression, alpha: Expression) -> Expression:
    return pieces((alpha * (exp(x) - 1), x < 0), (x, True))


@_declare("Celu", KernelError(8.0), alpha=1.0)
def _celu(x: Expression, alpha: Expression) -> Expression:
    return pieces((alpha * (exp(x / alpha) - 1), x < 0), (x, True))


@_declare("Selu", KernelError(48.0), alpha=1.67326319217681884765625, gamma=1.05070102214813232421875)
def _selu(x: Expression, alpha: Expression, gamma: Expression) -> Expression:
    return pieces((gamma * alpha * (exp(x) - 1), x < 0), (gamma * x, True))


@_declare("Sigmoid", BoundedError(8.0))
def _sigmoid(x: Expression) -> Expression:
    return (1 + tanh(x / 2)) / 2


@_declare("Logistic", LogisticError())
def _logistic(x: Expression) -> Expression:
    """Return the sigmoid as ``1 / (1 + exp(-x))`` spells it: 0 where the exponential overflows."""
    return _quotient_of_exponentials(x)


@_declare("Softmax", SoftmaxError(), terms=2.0)
def _softmax(x: Expression, terms: Expression) -> Expression:
    """Return a softmax of so many values as a function of log-odds: one of them less log sum exp of the others."""
    return _quotient_of_exponentials(x)


def _quotient_of_exponentials(x: Expression) -> Expression:
    """Return the sigmoid in a form that is accurate relative to its value in both tails."""
    return pieces((exp(x) / (1 + exp(x)), x < 0), (1 / (1 + exp(-x)), True))


@_declare("LogSoftmax", LogSoftmaxError(), terms=2.0)
def _log_softmax(x: Expression, terms: Expression) -> Expression:
    """Return the logarithm of a softmax of so many values, as a function of the log-odds of one."""
    return pieces((x - log(1 + exp(x)), x < 0), (-log(1 + exp(-x)), True))


@_declare("SpelledSigmoid", BoundedError(32.0))
def _spelled_sigmoid(x: Expression) -> Expression:
    """Return ``exp(x) / (1 + exp(x))`` as a program spells it, which rounds relative to 1."""
    return _quotient_of_exponentials(x)


@_declare("SpelledTanh", BoundedError(32.0))
def _spelled_tanh(x: Expression) -> Expression:
    """Return ``(exp(x) - exp(-x)) / (exp(x) + exp(-x))`` as a program spells it."""
    return _tanh(x)


@_declare("Known", KernelError(0.0), passes_on=True, min=-np.inf, max=np.inf)
def _known(x: Expression, min: Expression, max: Expression) -> Expression:
    """Return x, known to lie between limits but for rounding: enclosures are cut, the program is not."""
    return _clip(x, min, max)


@_declare("Guard", GuardedError(), passes_on=True, min=-np.inf, max=np.inf)
def _guard(x: Expression, min: Expression, max: Expression) -> Expression:
    """Return x, with which the program can go on between limits only: beyond them it gives no number."""
    return x


@_declare("HardSigmoid", KernelError(8.0), alpha=0.2, beta=0.5)
def _hard_sigmoid(x: Expression, alpha: Expression, beta: Expression) -> Expression:
    line = alpha * x + beta
    return pieces((0, x <= -beta / alpha), (1, x >= (1 - beta) / alpha), (line, True))


@_declare("Tanh", BoundedError(12.0))
def _tanh(x: Expression) -> Expression:
    return tanh(x)


@_declare("RecurrentSigmoid", RECURRENT_ERROR)
def _recurrent_sigmoid(x: Expression) -> Expression:
    """Return the sigmoid as recurrent operators compute it."""
    return _sigmoid(x)


@_declare("RecurrentTanh", RECURRENT_ERROR)
def _recurrent_tanh(x: Expression) -> Expression:
    """Return the tanh as recurrent operators compute it."""
    return _tanh(x)


@_declare("Softplus", KernelError(24.0))
def _softplus(x: Expression) -> Expression:
    return pieces((log(1 + exp(x)), x < 0), (x + log(1 + exp(-x)), True))


@_declare("Softsign", KernelError(8.0))
def _softsign(x: Expression) -> Expression:
    return pieces((x / (1 - x), x < 0), (x / (1 + x), True))


@_declare("Silu", KernelError(12.0))
def _silu(x: Expression) -> Expression:
    return pieces((x * exp(x) / (1 + exp(x)), x < 0), (x / (1 + exp(-x)), True))


@_declare("Swish", slope=1.0)
def _swish(x: Expression, slope: Expression) -> Expression:
    """``x * sigmoid(slope * x)`` with a positive slope; at 1.702 it is the quick form of Gelu."""
    return pieces(
        (x * exp(slope * x) / (1 + exp(slope * x)), x < 0),
        (x / (1 + exp(-slope * x)), True),
    )


@_declare("HardSwish", KernelError(12.0))
def _hard_swish(x: Expression) -> Expression:
    return pieces((0, x <= -3), (x, x >= 3), (x * (x + 3) / 6, True))


@_declare("Gelu", KernelError(32.0))
def _gelu(x: Expression) -> Expression:
    return x * normal_cdf(x)


@_declare("GeluTanh", KernelError(32.0))
def _gelu_tanh(x: Expression) -> Expression:
    slope, cubic = 2 * sqrt(2 / pi()), exact(0.044715)
    growth, decay = exp(slope * (x + cubic * x**3)), exp(-slope * (x + cubic * x**3))
    return pieces((x * growth / (1 + growth), x < 0), (x / (1 + decay), True))


@_declare("ErfGate", slope=1.0, divisor=1.0)
def _erf_gate(x: Expression, slope: Expression, divisor: Expression) -> Expression:
    """``x * (1 + erf(slope * x / divisor))``, as exporters write Gelu with a rounded square root of 2."""
    return 2 * x * normal_cdf(sqrt(2) * (slope * x / divisor))


@_declare("TanhGate", slope=0.7978845608028654, cubic=0.044715)
def _tanh_gate(x: Expression, slope: Expression, cubic: Expression) -> Expression:
    """``x * (1 + tanh(slope * (x + cubic * x^3)))``, as exporters write GeluTanh with rounded constants."""
    growth = exp(2 * slope * (x + cubic * x**3))
    decay = exp(-2 * slope * (x + cubic * x**3))
    return pieces((2 * x * growth / (1 + growth), x < 0), (2 * x / (1 + decay), True))


@_declare("HardSigmoidGate", alpha=0.2, beta=0.5)
def _hard_sigmoid_gate(x: Expression, alpha: Expression, beta: Expression) -> Expression:
    """``x * HardSigmoid(x)``, as exporters write HardSwish with a rounded sixth."""
    return pieces((0, x <= -beta / alpha), (x, x >= (1 - beta) / alpha), (x * (alpha * x + beta), True))


@_declare("SoftplusThreshold", threshold=20.0)
def _softplus_threshold(x: Expression, threshold: Expression) -> Expression:
    """Softplus, and x itself above a positive threshold, as torch computes it."""
    return pieces(
        (log(1 + exp(x)), x < 0),
        (x + log(1 + exp(-x)), x <= threshold),
        (x, True),
    )


@_declare("Sign", jumps=True)
def _sign(x: Expression) -> Expression:
    return pieces((-1, x < 0), (0, x <= 0), (1, True))


@_declare("Threshold", jumps=True, threshold=0.0, value=0.0)
def _threshold(x: Expression, threshold: Expression, value: Expression) -> Expression:
    return pieces((value, x <= threshold), (x, True))


@_declare("HardShrink", jumps=True, lambd=0.5)
def _hard_shrink(x: Expression, lambd: Expression) -> Expression:
    return pieces((x, x < -lambd), (0, x <= lambd), (x, True))


@_declare("SoftShrink", lambd=0.5)
def _soft_shrink(x: Expression, lambd: Expression) -> Expression:
    return pieces((x + lambd, x < -lambd), (0, x <= lambd), (x - lambd, True))


@_declare("Mish", KernelError(96.0))
def _mish(x: Expression) -> Expression:
    left, right = exp(x), exp(-x)
    return pieces(
        (x * left * (left + 2) / (left * (left + 2) + 2), x < 0),
        (x - 2 * x * right**2 / ((1 + right) ** 2 + right**2), True),  # tight over intervals in this form
    )


@_declare("Erf", KernelError(12.0))
def _erf(x: Expression) -> Expression:
    return erf(x)


@_declare("Exp", ExponentialError())
def _exp(x: Expression) -> Expression:
    return exp(x)


@_declare("Log")
def _log(x: Expression) -> Expression:
    return log(x)


@_declare("Abs", KernelError(0.0))
def _abs(x: Expression) -> Expression:
    return pieces((-x, x < 0), (x, True))


@_declare("Sqrt", RootError(4.0))
def _sqrt(x: Expression) -> Expression:
    return sqrt(x)


@_declare("Pow", PowerError(4.0), form=("exponent",), exponent=2.0)
def _pow(x: Expression, exponent: float) -> Expression:
    return x ** int(exponent)


@_declare("Reciprocal", ReciprocalError(4.0))
def _reciprocal(x: Expression) -> Expression:
    return 1 / x


@_declare("Clip", KernelError(0.0), min=-np.inf, max=np.inf)
def _clip(x: Expression, min: Expression, max: Expression) -> Expression:
    parts: list[tuple[Expression, Expression]] = [(x, True)]
    if max != np.inf:
        parts.insert(0, (max, x >= max))
    if min != -np.inf:
        parts.insert(0, (min, x <= min))
    return pieces(*parts)


@_declare("ClippedTan", KernelError(16.0), min=-1.0, max=1.0)
def _clipped_tan(x: Expression, min: Expression, max: Expression) -> Expression:
    """Return the tangent of an angle that is clipped to limits within a quarter turn: how steered wheels turn a car."""
    return pieces((tan(min), x <= min), (tan(max), x >= max), (tan(x), True))
