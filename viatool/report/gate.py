"""The gate: conditions on a report, decided on integers, never on rounded rates."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from datetime import date
from decimal import Decimal, InvalidOperation
from fractions import Fraction

from viatool.errors import ConfigurationError
from viatool.report.accepted import NOTHING_ACCEPTED, Acceptance, Settled, settle
from viatool.report.comparison import Difference, differences, require_same_kind
from viatool.report.document import Document, LeftOut
from viatool.report.numbers import count, digits_needed, down, percent_of
from viatool.report.sections import NOTHING, Check, Count, Finding, Share, Survivor

NONE_LEFT = LeftOut(0, count=True)


@dataclass(frozen=True)
class Threshold:
    """A least rate: ``safe / total >= least`` for one of the rates of a document; or an error that all survive."""

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
        The most failures, and the most of what stayed open.
    min_contested : int, optional
        Of how many the verdict has to depend on the policy; of fewer, nothing was evaluated.
    baseline : Document, optional
        An older report of the same kind: no rate may fall below its rate, and nothing may fail that did not.
    accepted : tuple of Acceptance
        Findings that thresholds and limits do not count; the baseline does.
    exit_zero : bool
        What does not hold is reported, and fails nothing.
    today : date
        Decides which of them have expired.
    """

    thresholds: tuple[Threshold, ...] = ()
    max_unsafe: int | None = None
    max_unknown: int | None = None
    baseline: Document | None = None
    min_contested: int | None = None
    accepted: tuple[Acceptance, ...] = ()
    exit_zero: bool = False
    today: date = field(default_factory=date.today)


def parse_threshold(text: str, kind: type[Document]) -> Threshold:
    """Read ``0.99``, ``99%``, ``danger=0.95`` or ``margin=0.02`` exactly as it is written.

    Parameters
    ----------
    text : str
        What the user wrote.
    kind : type
        The class of the document that has the rates.

    Raises
    ------
    ConfigurationError
        If the name is unknown, a rate is not between 0 and 1, or an error is negative.
    """
    name, equals, number = text.rpartition("=")
    name = name if equals else "overall"
    if name in kind.RADII:
        return Threshold(name, _parse_error(number.strip(), text, name))
    if name == "margin":
        raise ConfigurationError(
            f"'{text}': {kind.WHAT} has no margin to survive",
            f"viatool margin gates on it: --fail-under {text}",
        )
    if name not in kind.RATES:
        radii = [f"{one}=ERROR" for one in kind.RADII]
        raise ConfigurationError(
            f"'{text}': {kind.WHAT} has no rate '{name}'", f"choose one of {', '.join([*radii, *kind.RATES])}"
        )
    return Threshold(name, _parse_rate(number.strip(), text))


def _parse_rate(number: str, text: str) -> Fraction:
    rate = _exactly(number.removesuffix("%"))
    if number.endswith("%"):
        rate /= 100
    if not 0 <= rate <= 1:
        raise ConfigurationError(
            f"'{text}' is not a rate", "write a number from 0 to 1, such as 0.99, or 99%"
        )
    return rate


def _parse_error(number: str, text: str, name: str) -> Fraction:
    error = _exactly(number)
    if error < 0:
        raise ConfigurationError(
            f"'{text}' is not an error that something can survive",
            f"write a number of at least 0 in the unit of what varies, such as {name}=0.02",
        )
    return error


def _exactly(number: str) -> Fraction:
    """Return a number as it is written, or -1 if it is none."""
    try:
        decimal = Decimal(number)
    except InvalidOperation:
        return Fraction(-1)
    # An exponent beyond anything that is meant would only cost memory as a fraction.
    return Fraction(decimal) if decimal.is_finite() and abs(decimal.adjusted()) < 50 else Fraction(-1)


def evaluate(gate: Gate, document: Document) -> tuple[Check, ...]:
    """Decide every condition of a gate.

    Parameters
    ----------
    gate : Gate
        The conditions.
    document : Document
        The report.

    Returns
    -------
    tuple of Check
        In the order of the conditions; empty for a gate without conditions, which never fails.

    Raises
    ------
    ConfigurationError
        If a condition is about what such a report does not have, or the baseline is of another kind of run.
    """
    checks = tuple(_evaluate(gate, document))
    if not gate.exit_zero:
        return checks
    return tuple(replace(check, waived=check.outcome == "failure") for check in checks)


def _evaluate(gate: Gate, document: Document) -> Sequence[Check]:
    hardest = {one.name: one for one in sorted(gate.thresholds, key=lambda one: one.least)}
    weak = [
        one for name, asked in hardest.items() if name in document.RADII for one in _weak(asked, document)
    ]
    settled = settle(gate.accepted, document, gate.today, weak)
    checks = [_threshold(threshold, document, settled) for threshold in gate.thresholds]
    for name, most in (("unsafe", gate.max_unsafe), ("unknown", gate.max_unknown)):
        if most is not None:
            checks.append(_limit(name, most, document, settled))
    if gate.min_contested is not None:
        checks.append(_at_stake(gate.min_contested, document))
    if gate.baseline is not None:
        checks += _regressions(gate.baseline, document)
    checks += settled.checks
    if document.size == 0:  # then every count is 0 and says nothing
        return [_undecidable(check.condition, document.EMPTY) for check in checks]
    if document.incomplete and not document.left_out:
        checks = [_unsure(check, document.incomplete) for check in checks]
    return checks


def is_certain(checks: Sequence[Check]) -> bool:
    """Tell whether a gate ends in the same way whatever was left out: passed, failed or with nothing to decide.

    Notes
    -----
    Sound: yes, if each condition is `open` unless nothing that is left out decides it. What has nothing to decide on
    outweighs what fails, and one condition that fails outweighs all that hold.
    """
    undecided = [check for check in checks if check.open]
    if not undecided or any(check.empty and not check.open for check in checks):
        return True
    if any(check.may_be_empty for check in undecided):
        return False
    return any(not check.passed and not check.open for check in checks)


def _unsure(check: Check, why: str) -> Check:
    return replace(check, passed=False, figures=f"{check.figures}, but {why}")


def _failing(
    passed: bool, name: str, document: Document, settled: Settled = NOTHING_ACCEPTED
) -> tuple[Finding, ...]:
    """Return what one of the rates or limits of a document counts, without what is accepted, if that does not pass."""
    if passed and (document.left_out or not document.incomplete):
        return ()
    return tuple(finding for finding in document.counted(name) if not settled.excuses(finding, name))


def _undecidable(condition: str, reason: str) -> Check:
    return Check(condition, passed=False, figures=reason, empty=True)


def _threshold(threshold: Threshold, document: Document, settled: Settled) -> Check:
    """Decide a least rate; accepted findings are not held against it, and the rate is shown as it is."""
    if threshold.name in document.RADII:
        return _survived(threshold, document, settled)
    rate = document.rates.get(threshold.name, NOTHING)
    digits = digits_needed(threshold.least)
    condition = f"{document.RATES[threshold.name]} >= {percent_of(threshold.least, digits)}"
    left = document.left_out.get(threshold.name, NONE_LEFT) if rate is not NOTHING else NONE_LEFT
    if rate.total + left.number == 0:
        return _undecidable(condition, document.nothing(threshold.name))
    aside = min(settled.uncounted.get(threshold.name, 0), rate.total - rate.part)
    worst = Share(rate.part + aside, rate.total + left.number)
    best = Share(worst.part + left.number, worst.total)
    may_be_empty = rate.total == 0 and not left.count
    figures = f"{rate.percentage(digits)} ({rate.of()}){_beside(aside)}"
    if left.number:
        figures = f"{worst.percentage(digits)} to {best.percentage(digits)}, {count(left.number)} not judged"
    holds, fails = _reaches(worst, threshold.least), not _reaches(best, threshold.least)
    if may_be_empty or not (holds or fails):
        return Check(condition, False, figures, open=True, may_be_empty=may_be_empty)
    return Check(condition, holds, figures, failing=_failing(holds, threshold.name, document, settled))


def _reaches(share: Share, least: Fraction) -> bool:
    return share.part * least.denominator >= least.numerator * share.total


def _survived(threshold: Threshold, document: Document, settled: Settled) -> Check:
    """Decide whether every subject survives an error, and name those that do not, the weakest first."""
    condition = f"{document.RADII[threshold.name]} >= {float(threshold.least):.12g}"
    found = document.survived.get(threshold.name, ())
    if not found:
        return _undecidable(condition, document.EMPTY)
    weak = _weak(threshold, document)
    failing = tuple(one for one in weak if not settled.excuses(one, threshold.name))
    if not weak:
        return Check(condition, passed=True, figures=f"the weakest is {_proved(found[0])}")
    figures = f"{count(len(weak))} of {count(len(found))} do not{_beside(len(weak) - len(failing))}"
    return Check(condition, not failing, figures, failing=failing)


def _weak(threshold: Threshold, document: Document) -> tuple[Finding, ...]:
    """Return what does not survive an error: unsafe if it was seen to fail within that, else unknown."""
    least = float(threshold.least)  # as the error was, which was examined as a float
    return tuple(
        replace(
            one.finding,
            text=f"{one.name[:1].upper()}{one.name[1:]} is {_proved(one)}.",
            verdict="unsafe" if one.refuted is not None and one.refuted <= least else "unknown",
            takes={threshold.name: 1},
        )
        for one in document.survived.get(threshold.name, ())
        if one.error is None or not one.error >= least
    )


def _proved(survivor: Survivor) -> str:
    return (
        "not proved even at an error of 0"
        if survivor.error is None
        else f"proved up to {down(survivor.error)}"
    )


def _beside(accepted: int) -> str:
    return f", {count(accepted)} accepted" if accepted else ""


def _limit(name: str, most: int, document: Document, settled: Settled) -> Check:
    found = _counted(f"--max-{name}", name, document)
    condition = f"at most {count(most)} {found.noun}"
    aside = min(settled.uncounted.get(name, 0), found.number)
    left = document.left_out.get(name, NONE_LEFT).number
    passed, figures = found.number - aside <= most, f"{count(found.number)} {found.noun}{_beside(aside)}"
    if left:
        figures += f", {count(left)} not judged"
    if passed and found.number - aside + left > most:
        return Check(condition, False, figures, open=True)
    return Check(condition, passed, figures, failing=_failing(passed, name, document, settled))


def _at_stake(least: int, document: Document) -> Check:
    found = _counted("--min-contested", "contested", document)
    condition, figures = f"at least {count(least)} {found.noun}", f"{count(found.number)} {found.noun}"
    left = document.left_out.get("contested", NONE_LEFT).number
    if found.number < least <= found.number + left:
        return Check(condition, False, f"{figures}, {count(left)} not judged", open=True, may_be_empty=True)
    if found.number < least:
        hint = "evaluate more scenarios, or a map with less room, so that verdicts depend on the policy"
        return Check(condition, passed=False, figures=figures, empty=True, hint=hint)
    return Check(condition, passed=True, figures=figures)


def _counted(option: str, name: str, document: Document) -> Count:
    if name not in document.limited:
        raise ConfigurationError(
            f"{option} is not about {document.WHAT}", "use --fail-under with one of its rates instead"
        )
    return document.limited[name]


def _regressions(baseline: Document, document: Document) -> list[Check]:
    require_same_kind(baseline, document)
    checks = [*_fallen_rates(baseline, document), *document.new_failures(baseline)]
    if document.left_out:
        checks = [_unsure(check, document.incomplete) for check in checks]
    if baseline.incomplete:
        aside = f", but of the baseline {baseline.incomplete}"
        checks = [replace(check, passed=False, figures=check.figures + aside) for check in checks]
    aside = _other_settings(differences(baseline, document))
    return [replace(check, figures=check.figures + aside) for check in checks]


def _fallen_rates(baseline: Document, document: Document) -> Iterator[Check]:
    before, now, unsure = baseline.rates, document.rates, bool(baseline.incomplete)
    for name, title in document.RATES.items():
        old, new = before.get(name, NOTHING), now.get(name, NOTHING)
        if old.total and new.total:
            passed = new.part * old.total >= old.part * new.total
            figures = f"{new.percentage(4)}, was {old.percentage(4)}"
            failing = _failing(passed and not unsure, name, document)
            yield Check(f"{title} not below the baseline", passed, figures, failing=failing)


def _other_settings(differing: list[Difference]) -> str:
    """Name the settings and premises in which two reports differ: their figures answer different questions then."""
    other = " and ".join(difference.name for difference in differing)
    return f" (the baseline has another {other})" if other else ""
