"""Is a specification right? The policy is read in other plausible ways, and driven or compared with a recording."""

from __future__ import annotations

from viatool.doctor import commands, scales, scans  # noqa: F401  # they register their readings
from viatool.doctor.course import scenarios_of
from viatool.doctor.diagnosis import Diagnosis, diagnose
from viatool.doctor.evidence import Compared, Driven, Paired
from viatool.doctor.search import Examined, Ranking, Repeat

__all__ = [
    "Compared",
    "Diagnosis",
    "Driven",
    "Examined",
    "Paired",
    "Ranking",
    "Repeat",
    "diagnose",
    "scenarios_of",
]
