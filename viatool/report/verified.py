"""What every report of something proved says: the sensor error, the criterion and the arithmetic."""

from __future__ import annotations

from collections.abc import Mapping

from viatool.report.document import Document
from viatool.report.records import VerifiedRecord
from viatool.report.wording import describe_eps
from viatool.setting.criteria import described

ARITHMETIC = {
    "float32": "float32: bounds cover the rounding of the deployed program, in any order of summation",
    "real": "real: bounds hold for the exact network, not for the rounding of the deployed program",
}


class Verified(Document):
    """A document of a run that proves."""

    record: VerifiedRecord

    @property
    def terms(self) -> Mapping[str, str]:
        """Return eps, criterion and arithmetic, and what was left out of a run that was stopped early."""
        record = self.record
        return {
            "eps": describe_eps(record.eps),
            "criterion": record.criterion,
            "arithmetic": record.arithmetic,
            **({"stopped early": self.incomplete} if self.left_out else {}),
        }

    def stated(self, *places: str) -> str:
        """Return in words the terms of the error model below some places, such as ``actuation``; empty if none."""
        return ", ".join(
            f"{premise.name} {premise.value}"
            for premise in self.record.premises
            if premise.name.startswith(tuple(f"{place}." for place in places))
        )

    @property
    def assumptions(self) -> Mapping[str, str]:
        """Return what criterion and arithmetic mean."""
        record = self.record
        return {
            "criterion": described(record.criterion),
            "arithmetic": ARITHMETIC.get(record.arithmetic, record.arithmetic),
        }
