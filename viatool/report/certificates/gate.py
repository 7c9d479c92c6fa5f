"""The gate of a certificate: least certified shares, decided on integers, of a map that was examined as a whole."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from viatool.errors import ConfigurationError
from viatool.report.gate import Check, Threshold, parse_threshold
from viatool.report.numbers import count, digits_needed, percent_of, percentage

if TYPE_CHECKING:
    from viatool.report.certificates.document import CertificateDocument, Share

RATES = {"contested": "certified share of the contested volume", "overall": "safe share of the free volume"}


def parse_thresholds(texts: Sequence[str]) -> tuple[Threshold, ...]:
    """Read ``contested=0.9`` or ``0.99``.

    Raises
    ------
    ConfigurationError
        If a name is no rate of a certificate, or a number is not between 0 and 1.
    """
    thresholds = tuple(parse_threshold(text) for text in texts)
    for threshold in thresholds:
        if threshold.name not in RATES:
            raise ConfigurationError(
                f"a certificate has no rate '{threshold.name}'", f"choose one of {', '.join(RATES)}"
            )
    return thresholds


def decide(thresholds: Sequence[Threshold], document: CertificateDocument) -> tuple[Check, ...]:
    """Decide every threshold; none holds unless the whole map was examined."""
    return tuple(_check(threshold, document) for threshold in thresholds)


def _check(threshold: Threshold, document: CertificateDocument) -> Check:
    rate: Share = document.contested_rate if threshold.name == "contested" else document.free_rate
    digits = digits_needed(threshold.least)
    condition = f"{RATES[threshold.name]} >= {percent_of(threshold.least, digits)}"
    if rate.total == 0:
        return Check(condition, passed=False, figures="no volume to decide on", empty=True)
    roots = document.roots
    figures = percentage(rate.part, rate.total, digits)
    if roots.examined < roots.total:
        figures += f", but only {count(roots.examined)} of {count(roots.total)} roots were examined"
        return Check(condition, passed=False, figures=figures)
    holds = rate.part * threshold.least.denominator >= threshold.least.numerator * rate.total
    return Check(condition, holds, figures)
