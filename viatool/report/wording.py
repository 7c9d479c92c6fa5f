"""Sentences about a run that several formats and kinds of run share."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from viatool.report.numbers import seconds, significant

if TYPE_CHECKING:
    from viatool.report.document import Document


def describe_eps(eps: Any) -> str:
    """Write the sensor error in words: one radius, or one for each channel."""
    if isinstance(eps, Mapping):
        parts = [f"{name or 'default'}={significant(float(radius), 6)}" for name, radius in eps.items()]
        return ", ".join(parts)
    if isinstance(eps, int | float):
        return significant(float(eps), 6)
    return str(eps)


def describe_value(value: Any) -> str:
    """Write a value of a report in words."""
    if isinstance(value, Mapping):
        return ", ".join(f"{name.replace('_', ' ')} {describe_value(part)}" for name, part in value.items())
    if isinstance(value, float):
        return significant(value, 6)
    return "none" if value is None else str(value)


def describe_seconds(document: Document, mark: str) -> str:
    """Write in words how long the run took, stage by stage."""
    record = document.record
    stages = [f"{stage} {seconds(value)}" for stage, value in record.stages.items()]
    return mark.join([*stages, f"total {seconds(record.total_seconds)}"])


def identities(document: Document) -> dict[str, str]:
    """List which files were examined, with which versions, and in which time."""
    record = document.record
    return {
        "policy": record.policy.path,
        "policy sha256": record.policy.sha256,
        "map": record.map.path,
        "map sha256": record.map.sha256,
        "versions": ", ".join(f"{name} {version}" for name, version in record.versions.items()),
        "time": describe_seconds(document, ", "),
    }
