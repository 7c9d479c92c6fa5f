"""Numbers for people: rates are rounded down, so that 100 % is shown only when every state is safe."""

from __future__ import annotations

from decimal import ROUND_CEILING, ROUND_FLOOR, Decimal
from fractions import Fraction

MISSING = "n/a"


def percentage(part: int, total: int, digits: int = 2) -> str:
    """Write ``part / total`` in per cent, rounded down in integer arithmetic.

    Parameters
    ----------
    part, total : int
        ``0 <= part <= total``.
    digits : int
        Digits after the point.

    Returns
    -------
    str
        Such as ``"99.99 %"``; n/a if `total` is 0, for there is no rate then.
    """
    return MISSING if total == 0 else percent_of(Fraction(part, total), digits)


def percent_of(rate: Fraction, digits: int = 2) -> str:
    """Write a rate in per cent, rounded down."""
    scale = 10**digits
    whole, rest = divmod(rate.numerator * 100 * scale // rate.denominator, scale)
    return f"{whole}.{rest:0{digits}d} %" if digits else f"{whole} %"


def digits_needed(rate: Fraction, most: int = 12) -> int:
    """Return how many digits after the point, at least 2, write `rate` in per cent without rounding."""
    return next((digits for digits in range(2, most) if (rate * 10 ** (digits + 2)).denominator == 1), most)


def count(number: int) -> str:
    """Write an integer in groups of thousands."""
    return f"{number:,}"


def counted(number: int, noun: str, plural: str = "") -> str:
    """Write a number with its noun, such as ``1 state`` and ``2 states``."""
    return f"{count(number)} {noun if number == 1 else plural or noun + 's'}"


def significant(value: float, digits: int = 3) -> str:
    """Write a measured number to some significant digits, without an exponent where that is readable."""
    if abs(value) < 1e-12:  # rounding of the mean of equal numbers, for example
        return "0"
    return f"{value:.{digits}g}" if 1e-4 <= abs(value) < 1e5 else f"{value:.{digits - 1}e}"


def down(value: float, digits: int = 3) -> str:
    """Write a number that is a promise to some significant digits: never more than it is."""
    return _towards(value, digits, ROUND_FLOOR)


def up(value: float, digits: int = 3) -> str:
    """Write a number from which on something fails to some significant digits: never less than it is."""
    return _towards(value, digits, ROUND_CEILING)


def _towards(value: float, digits: int, rounding: str) -> str:
    exact = Decimal(value)
    if not exact:
        return "0"
    step = Decimal((0, (1,), exact.adjusted() - digits + 1))
    return f"{float(exact.quantize(step, rounding=rounding)):g}"


def seconds(value: float) -> str:
    """Write a duration."""
    if value < 1e-3:
        return f"{value * 1e6:.0f} µs"
    return f"{value * 1e3:.0f} ms" if value < 1.0 else f"{value:.2f} s"
