"""How far a runtime's kernel may be from the function that it computes, as the declarations of activations say it.

An error is so many roundings, in the precision in which a node is evaluated, of a scale that the argument and the value
give, and what is lost where numbers below the smallest normal one are flushed to zero. The margins are at least twice
what was ever measured in onnxruntime (`tests/benchmarks/activation_error.py`); composites (Silu as ``x * sigmoid(x)``,
...) count each of their operations.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from viatool.arrays import Floats, Hull

Parameters = Mapping[str, float]

EXPONENTIAL_UNITS = 16.0
"""Roundings of an exponential, of its value times the larger of 1 and its argument."""

_AMPLIFYING = frozenset(("alpha", "beta", "gamma", "slope"))
"""Parameters by which an expression multiplies, or that it adds."""


def amplitude(parameters: Parameters) -> float:
    """Return how much larger than its argument and its value, and than 1, an intermediate result may be.

    A program computes ``alpha * (exp(x) - 1)`` with an error that is relative to alpha, also where the value is small.
    """
    return math.prod(max(1.0, abs(value)) for name, value in parameters.items() if name in _AMPLIFYING)


@dataclass(frozen=True)
class KernelError:
    """An error relative to the largest of 1, the argument and the value.

    Parameters
    ----------
    units : float
        Roundings of the scale.
    """

    units: float = 64.0

    def roundings(self, parameters: Parameters) -> float:
        """Return how many roundings of the scale the kernel errs by, given the parameters of the activation."""
        return self.units

    def scale(self, parameters: Parameters, argument: Floats, value: Floats) -> Floats:
        """Return what the error is proportional to, given absolute values of argument and value, (B, N) each."""
        return np.asarray(amplitude(parameters) * np.maximum(1.0, np.maximum(value, argument)))

    def lost(self, parameters: Parameters, argument: Hull, tiny: float) -> Floats:
        """Return what flushes to zero cost (B, N) between bounds of the argument, given the smallest normal number."""
        return np.zeros_like(argument[0])


@dataclass(frozen=True)
class RelativeError(KernelError):
    """An error relative to the value, however small: IEEE 754 rounds it correctly, or it is a few products."""

    def scale(self, parameters: Parameters, argument: Floats, value: Floats) -> Floats:
        """Return the value."""
        return value

    def at_zero(self, tiny: float) -> float:
        """Return what is lost where an argument below the smallest normal number is taken for zero."""
        return tiny

    def lost(self, parameters: Parameters, argument: Hull, tiny: float) -> Floats:
        """Return what a flushed value or argument makes."""
        return np.where((argument[0] < tiny) & (argument[1] > -tiny), self.at_zero(tiny), tiny)


@dataclass(frozen=True)
class RootError(RelativeError):
    """That of a square root."""

    def at_zero(self, tiny: float) -> float:
        """Return the root of what was flushed."""
        return math.sqrt(tiny)


@dataclass(frozen=True)
class ReciprocalError(RelativeError):
    """That of a reciprocal."""

    def at_zero(self, tiny: float) -> float:
        """Return infinity."""
        return math.inf


@dataclass(frozen=True)
class PowerError(RelativeError):
    """That of a small power: a few products, or the function of a library that is as good as two of them."""

    def roundings(self, parameters: Parameters) -> float:
        """Return two for each factor."""
        return max(self.units, 2.0 * parameters["exponent"])


@dataclass(frozen=True)
class ExponentialError(RelativeError):
    """That of an exponential, whose argument is reduced first."""

    units: float = EXPONENTIAL_UNITS

    def scale(self, parameters: Parameters, argument: Floats, value: Floats) -> Floats:
        """Return the value times the larger of 1 and the argument."""
        return np.asarray(value * np.maximum(1.0, argument))


@dataclass(frozen=True)
class LogisticError(RelativeError):
    """That of ``1 / (1 + exp(-x))``: ``1 / (1 + e (1 + d))`` is off by at most d of itself.

    It errs by ``16 max(1, |x|) y (1 - y)``, where ``y (1 - y) |x| <= 0.28``, and by the quotient.
    """

    units: float = 24.0

    def scale(self, parameters: Parameters, argument: Floats, value: Floats) -> Floats:
        """Return the value times the argument, as long as that is less than its limit."""
        return np.asarray(np.minimum(value * np.maximum(1.0, argument), value + 0.3))


@dataclass(frozen=True)
class BoundedError(KernelError):
    """An error relative to 1, of what keeps to its range whatever its argument is.

    What rounding moves an argument by hardly moves a flat curve. A sigmoid of an exponential that errs by
    ``16 max(1, |x|)`` roundings of itself is off by that times ``y (1 - y)``: at most 4; a tanh of ``exp(-2 |x|)`` by
    ``16 max(1, |2 x|) (1 - y^2) / 2``: at most 8. Sum and quotient add three.
    """

    def scale(self, parameters: Parameters, argument: Floats, value: Floats) -> Floats:
        """Return 1, or the value if it is larger."""
        return np.maximum(1.0, value)


RECURRENT_ERROR = BoundedError(24.0)
"""That of a gate within a recurrent operator, of which onnxruntime's GRU computes both functions by one fraction of
polynomials: up to 10.3 roundings were measured, where the operators of their own err by 3."""


@dataclass(frozen=True)
class GuardedError(KernelError):
    """None between the limits `min` and `max`; beyond them the program gives no number."""

    units: float = 0.0

    def scale(self, parameters: Parameters, argument: Floats, value: Floats) -> Floats:
        """Return 0."""
        return np.zeros_like(value)

    def lost(self, parameters: Parameters, argument: Hull, tiny: float) -> Floats:
        """Return infinity where the limits are left."""
        inside = (argument[0] >= parameters["min"]) & (argument[1] <= parameters["max"])
        return np.where(inside, 0.0, np.inf)


@dataclass(frozen=True)
class SoftmaxError(KernelError):
    """That of a softmax of K values as a function of the log-odds of one.

    The program's ``exp(x_j - m)``, m the largest, errs by ``|x_j - m|`` roundings of itself for the difference and by
    ``16 max(1, |x_j - m|)`` of the exponential, together at most ``16 + 17 |x_j - m|``. Their mean over the softmax p
    is at most ``16 + 17 log K``, since ``sum_j p_j |x_j - m| <= log K``; the sum errs by K more, quotient and casts by
    a few.
    In the numerator ``|x_i - m|`` is at most the magnitude of the log-odds, and ``p_i |x_i - m| <= 1 / e``, as p_i is
    at most ``exp(-|x_i - m|)``. Every exponential may be flushed to zero.
    """

    units: float = 1.0

    def scale(self, parameters: Parameters, argument: Floats, value: Floats) -> Floats:
        """Return all roundings together."""
        return np.asarray(value * self.of_terms(parameters) + 17.0 * np.minimum(value * argument, 0.4))

    def lost(self, parameters: Parameters, argument: Hull, tiny: float) -> Floats:
        """Return what flushed exponentials make of sum and numerator."""
        return np.full_like(argument[0], 2 * parameters["terms"] * tiny)

    def of_terms(self, parameters: Parameters) -> float:
        """Return the roundings of sum, exponentials and quotient."""
        terms = parameters["terms"]
        return 2 * EXPONENTIAL_UNITS + 4.0 + (EXPONENTIAL_UNITS + 1) * math.log(terms) + terms


@dataclass(frozen=True)
class LogSoftmaxError(SoftmaxError):
    """That of ``x_i - m - log(sum)``: the sum's, relative to 1, and two differences of the size of the value."""

    def scale(self, parameters: Parameters, argument: Floats, value: Floats) -> Floats:
        """Return all roundings together."""
        return np.asarray(self.of_terms(parameters) + 2 * value)
