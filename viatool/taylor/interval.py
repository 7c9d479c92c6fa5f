"""Arrays of intervals with outward rounding, used to evaluate formulas rigorously.

An `Interval` overloads the arithmetic operators, so a formula that is compiled with
`ENCLOSED_FUNCTIONS` as its namespace evaluates to a guaranteed enclosure of its range.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from viatool.arrays import Floats
from viatool.rounding import LAST_PLACE

_TINY = 5e-324
_LARGEST = float(np.finfo(np.float64).max)
_FUNCTION_ULPS = 8  # numpy and scipy state at most 4 for exp, log, tan, tanh, erf
_QUARTER = 1.57  # radians, before the pole of the tangent


def step_down(x: Floats, ulps: int | Floats = 1) -> Floats:
    """Return floats at least `ulps` units in the last place below `x`; infinity becomes the largest float."""
    return np.minimum(x, _LARGEST) - (np.minimum(np.abs(x), _LARGEST) * (ulps * LAST_PLACE) + _TINY)


def step_up(x: Floats, ulps: int | Floats = 1) -> Floats:
    """Return floats at least `ulps` units in the last place above `x`; -inf becomes the smallest float."""
    return np.maximum(x, -_LARGEST) + (np.minimum(np.abs(x), _LARGEST) * (ulps * LAST_PLACE) + _TINY)


@dataclass(frozen=True, eq=False)
class Interval:
    """Intervals ``[lower, upper]``, elementwise; NaN never appears.

    An undefined operation gives the whole line.

    **Sound:** yes; every operation rounds outward.
    """

    lower: Floats
    upper: Floats

    def __neg__(self) -> Interval:
        return Interval(-self.upper, -self.lower)

    def __add__(self, other: Interval | float) -> Interval:
        other = interval_of(other)
        return _outward(self.lower + other.lower, self.upper + other.upper)

    __radd__ = __add__

    def __sub__(self, other: Interval | float) -> Interval:
        return self + -interval_of(other)

    def __rsub__(self, other: Interval | float) -> Interval:
        return interval_of(other) + -self

    def __mul__(self, other: Interval | float) -> Interval:
        other = interval_of(other)
        corners = [a * b for a in (self.lower, self.upper) for b in (other.lower, other.upper)]
        corners = [np.where(np.isnan(corner), 0.0, corner) for corner in corners]  # 0 * inf
        lower = np.minimum(np.minimum(corners[0], corners[1]), np.minimum(corners[2], corners[3]))
        upper = np.maximum(np.maximum(corners[0], corners[1]), np.maximum(corners[2], corners[3]))
        return _outward(lower, upper)

    __rmul__ = __mul__

    def __truediv__(self, other: Interval | float) -> Interval:
        return self * _reciprocal(interval_of(other))

    def __rtruediv__(self, other: Interval | float) -> Interval:
        return interval_of(other) * _reciprocal(self)

    def __pow__(self, exponent: float) -> Interval:
        if exponent < 0:
            return _reciprocal(self**-exponent)
        if exponent != int(exponent):
            if 2 * exponent != int(2 * exponent):
                raise NotImplementedError(f"an interval to the power {exponent}")
            return _sqrt(self) ** int(2 * exponent)
        return _integer_power(self, int(exponent))


def interval_of(value: Interval | float) -> Interval:
    """Enclose a constant: exact if float32 can hold it, else known to the nearest float64."""
    if isinstance(value, Interval):
        return value
    point = np.asarray(value, dtype=np.float64)
    with np.errstate(over="ignore"):
        single = np.float32(point)
    if float(single) == float(point):  # 0.5, 2, ...: exact
        return Interval(point, point)
    return Interval(step_down(point), step_up(point))  # 1/3, pi, ...: the nearest float


def point(value: float) -> Interval:
    """Return the interval of one float64, exactly."""
    return Interval(np.asarray(value, dtype=np.float64), np.asarray(value, dtype=np.float64))


def _outward(lower: Floats, upper: Floats, ulps: int = 1) -> Interval:
    lower, upper = step_down(lower, ulps), step_up(upper, ulps)
    return Interval(np.where(np.isnan(lower), -np.inf, lower), np.where(np.isnan(upper), np.inf, upper))


def _reciprocal(x: Interval) -> Interval:
    spans = (x.lower < 0) & (x.upper > 0)
    lower = np.where(x.upper == 0, -np.inf, 1 / np.where(x.upper == 0, 1.0, x.upper))
    upper = np.where(x.lower == 0, np.inf, 1 / np.where(x.lower == 0, 1.0, x.lower))
    result = _outward(lower, upper)
    return Interval(
        np.where(spans | (lower == -np.inf), -np.inf, result.lower),
        np.where(spans | (upper == np.inf), np.inf, result.upper),
    )


def _integer_power(x: Interval, exponent: int) -> Interval:
    low, high = x.lower**exponent, x.upper**exponent
    if exponent % 2:
        return _outward(low, high, 4)
    inside = (x.lower <= 0) & (x.upper >= 0)
    power = _outward(np.minimum(low, high), np.maximum(low, high), 4)
    return Interval(np.where(inside, 0.0, np.maximum(power.lower, 0.0)), power.upper)


def _increasing(
    function: Callable[[Floats], Floats], least: float = -np.inf, greatest: float = np.inf
) -> Callable[[Any], Interval]:
    def enclosed(x: Interval | float) -> Interval:
        x = interval_of(x)
        result = _outward(function(x.lower), function(x.upper), _FUNCTION_ULPS)
        return Interval(np.clip(result.lower, least, greatest), np.clip(result.upper, least, greatest))

    return enclosed


_sqrt = _increasing(np.sqrt, least=0.0)


def _normal_cdf(x: Interval | float) -> Interval:
    """Enclose the normal distribution function; scipy loses x^2 ulps in its left tail, then underflows."""
    from scipy import special

    x = interval_of(x)
    ulps_lower, ulps_upper = (
        _FUNCTION_ULPS + 2 * np.clip(end, -40.0, 0.0) ** 2 for end in (x.lower, x.upper)
    )
    lower = step_down(special.ndtr(x.lower), ulps_lower) - 1e-300
    upper = step_up(special.ndtr(x.upper), ulps_upper) + 1e-300
    return Interval(np.clip(lower, 0.0, 1.0), np.clip(upper, 0.0, 1.0))


def _tan(x: Interval | float) -> Interval:
    """Enclose the tangent, which rises between its poles; beyond a quarter turn it may be anything."""
    x = interval_of(x)
    held = (x.lower > -_QUARTER) & (x.upper < _QUARTER)
    result = _outward(np.tan(x.lower), np.tan(x.upper), _FUNCTION_ULPS)
    return Interval(np.where(held, result.lower, -np.inf), np.where(held, result.upper, np.inf))


def _erf(x: Floats) -> Floats:
    from scipy import special

    return np.asarray(special.erf(x), dtype=np.float64)


ENCLOSED_FUNCTIONS: dict[str, Any] = {
    "exp": _increasing(np.exp, least=0.0),
    "log": _increasing(np.log),
    "tan": _tan,
    "tanh": _increasing(np.tanh, -1.0, 1.0),
    "erf": _increasing(_erf, -1.0, 1.0),
    "NormalCdf": _normal_cdf,
    "sqrt": _sqrt,
    "pi": interval_of(np.pi),
}
"""The functions that may stand in a declared activation, each with its enclosure."""
