"""The gate: conditions on a report, decided on integers, never on rounded rates."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from decimal import Decimal, InvalidOperation
from fractions import Fraction

from viatool.errors import ConfigurationError
from viatool.report.document import Rate, ReportDocument, UnsafeState
from viatool.report.numbers import count, digits_needed, percent_of, percentage
from viatool.report.wording import settings

RATES = {
    "overall": "safety rate",
    "danger": "danger rate",
    "contested": "contested rate",
    "sampled": "sampled safety rate",
    "success": "safety rate in successful episodes",
    "collision": "safety rate in colliding episodes",
    "timeout": "safety rate in episodes that ran out of time",
    "horizon": "safety rate over the horizon",
}


EMPTY = "no states to decide on"
NAMED = 3  # new unsafe states that a message names
SAME = 1e-3  # metres and radians within which a pose counts as the same


@dataclass(frozen=True)
class Threshold:
    """A least rate: ``safe / total >= least`` for one of `RATES`."""

    name: str
    least: Fraction


@dataclass(frozen=True)
class Gate:
    """What a report must fulfil.

    Parameters
    ----------
    thresholds : tuple of Threshold
        Least rates.
    max_unsafe, max_unknown : int, optional
        The most states with that verdict.
    baseline : ReportDocument, optional
        An older report: no rate may fall below its rate, and no state may be unsafe that was not.
    """

    thresholds: tuple[Threshold, ...] = ()
    max_unsafe: int | None = None
    max_unknown: int | None = None
    baseline: ReportDocument | None = None


@dataclass(frozen=True)
class Check:
    """One decided condition of a gate.

    Parameters
    ----------
    condition : str
        What was asked for.
    passed : bool
        Whether it holds.
    figures : str
        What decided it.
    empty : bool
        There was nothing to decide on; such a condition never passes.
    """

    condition: str
    passed: bool
    figures: str
    empty: bool = False


def parse_threshold(text: str) -> Threshold:
    """Read ``0.99``, ``99%`` or ``danger=0.95`` exactly as it is written.

    Raises
    ------
    ConfigurationError
        If the name is unknown or the number is not between 0 and 1.
    """
    name, equals, number = text.rpartition("=")
    name = name if equals else "overall"
    if name not in RATES:
        raise ConfigurationError(f"'{text}' names no rate", f"choose one of {', '.join(RATES)}")
    return Threshold(name, _parse_rate(number.strip(), text))


def _parse_rate(number: str, text: str) -> Fraction:
    try:
        decimal = Decimal(number.removesuffix("%"))
        # An exponent beyond any rate that is meant would only cost memory as a fraction.
        rate = Fraction(decimal) if decimal.is_finite() and abs(decimal.adjusted()) < 50 else Fraction(-1)
    except InvalidOperation:
        rate = Fraction(-1)
    if number.endswith("%"):
        rate /= 100
    if not 0 <= rate <= 1:
        raise ConfigurationError(
            f"'{text}' is not a rate", "write a number from 0 to 1, such as 0.99, or 99%"
        )
    return rate


def evaluate(gate: Gate, document: ReportDocument) -> tuple[Check, ...]:
    """Decide every condition of a gate.

    Parameters
    ----------
    gate : Gate
        The conditions.
    document : ReportDocument
        The report.

    Returns
    -------
    tuple of Check
        In the order of the conditions; empty for a gate without conditions, which never fails.
    """
    checks = [_threshold(threshold, document) for threshold in gate.thresholds]
    for verdict, most in (("unsafe", gate.max_unsafe), ("unknown", gate.max_unknown)):
        if most is not None:
            found = int(getattr(document.verdicts, verdict))
            checks.append(
                Check(f"at most {count(most)} {verdict}", found <= most, f"{count(found)} {verdict}")
            )
    if gate.baseline is not None:
        checks += _regressions(gate.baseline, document)
    if document.states == 0:  # then every count is 0 and says nothing
        return tuple(Check(check.condition, passed=False, figures=EMPTY, empty=True) for check in checks)
    return tuple(checks)


def _threshold(threshold: Threshold, document: ReportDocument) -> Check:
    rate = rate_named(document, threshold.name)
    digits = digits_needed(threshold.least)
    condition = f"{RATES[threshold.name]} >= {percent_of(threshold.least, digits)}"
    if rate.total == 0:
        return Check(condition, passed=False, figures=EMPTY, empty=True)
    return Check(
        condition,
        rate.safe * threshold.least.denominator >= threshold.least.numerator * rate.total,
        f"{percentage(rate.safe, rate.total, digits)} ({count(rate.safe)} of {count(rate.total)})",
    )


def rate_named(document: ReportDocument, name: str) -> Rate:
    """Look up one of `RATES` in a report; that of a horizon which was not asked for has no states."""
    if name == "horizon":
        return document.horizon.safety_rate[-1] if document.horizon else Rate(safe=0, total=0, rate=None)
    by_outcome = {
        "danger": document.danger_rate,
        "contested": document.contested_rate,
        "sampled": document.sampled_safety_rate,
    }.get(name)
    if by_outcome is not None:
        return by_outcome.overall
    rate = getattr(document.safety_rate, name)
    assert isinstance(rate, Rate)
    return rate


def _regressions(baseline: ReportDocument, document: ReportDocument) -> list[Check]:
    checks = []
    for name, title in RATES.items():
        before, now = rate_named(baseline, name), rate_named(document, name)
        if before.total == 0 or now.total == 0:
            continue
        passed = now.safe * before.total >= before.safe * now.total
        figures = f"{percentage(now.safe, now.total, 4)}, was {percentage(before.safe, before.total, 4)}"
        checks.append(Check(f"{title} not below the baseline", passed, figures))
    checks.append(_new_unsafe_states(baseline, document))
    aside = _other_settings(baseline, document)
    return [replace(check, figures=check.figures + aside) for check in checks]


def _other_settings(baseline: ReportDocument, document: ReportDocument) -> str:
    """Name the settings in which two reports differ: their figures answer different questions then."""
    before, now = settings(baseline), settings(document)
    other = [name for name in now if before.get(name, now[name]) != now[name]]
    return f" (the baseline has another {' and '.join(other)})" if other else ""


def _new_unsafe_states(baseline: ReportDocument, document: ReportDocument) -> Check:
    """Decide on the states themselves if both reports list them, and on their number otherwise."""
    if baseline.unsafe_states is None or document.unsafe_states is None:
        before, now = baseline.verdicts.unsafe, document.verdicts.unsafe
        figures = f"{count(now)}, was {count(before)}"
        return Check("no more unsafe states than the baseline", now <= before, figures)
    known: dict[tuple[str, float], list[UnsafeState]] = {}
    for state in baseline.unsafe_states:
        known.setdefault((state.scenario, round(state.time, 3)), []).append(state)
    new = [
        state
        for state in document.unsafe_states
        if not any(_same_pose(state, old) for old in known.get((state.scenario, round(state.time, 3)), []))
    ]
    named = "; ".join(f"{state.scenario} at {state.time:.2f} s" for state in new[:NAMED])
    figures = f"{count(len(new))} new" + (f": {named}{', ...' if len(new) > NAMED else ''}" if new else "")
    return Check("no unsafe state that the baseline lacks", not new, figures)


def _same_pose(state: UnsafeState, other: UnsafeState) -> bool:
    """Tell whether two states of one scenario and time are one: runs on other machines differ by rounding."""
    x, y, turn = (a - b for a, b in zip(state.pose, other.pose, strict=True))
    return math.hypot(x, y) < SAME and abs(math.remainder(turn, math.tau)) < SAME
