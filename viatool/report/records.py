"""What every report JSON says of its run, typed; the records of the kinds of run add to it.

Field names are a contract with other programs; the JSON Schemas in docs/ are generated from the records.
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated, Any, ClassVar

from pydantic import BaseModel, ConfigDict, Field, model_validator
from typing_extensions import Self

from viatool.report.sections import Share

Count = Annotated[int, Field(ge=0, strict=True)]
Amount = Annotated[float, Field(ge=0.0)]
Fraction = Annotated[float, Field(ge=0.0, le=1.0)]
SCHEMA_VERSION = 1
"""Of the reports that are read."""


class ReportPart(BaseModel):
    """A part of a report: further keys are kept."""

    model_config = ConfigDict(frozen=True, extra="allow")


class CountedRecord(ReportPart):
    """A part of a whole, both counted; `PART` names the field of the part."""

    PART: ClassVar[str]

    total: Count

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.share.part > self.share.total:
            raise ValueError(f"{self.PART} is {self.share.part} of {self.share.total}")
        return self

    @property
    def share(self) -> Share:
        """Return the part of the whole."""
        return Share(getattr(self, self.PART), self.total)


class FileIdentity(ReportPart):
    """A file that was read, and the digest of what was in it."""

    path: str
    sha256: str


class PremiseRecord(ReportPart):
    """What took effect, and which file, option or default it came from."""

    name: str
    value: str
    source: str


class RunRecord(ReportPart):
    """What every report says of its run: what was examined, what took effect, with which versions."""

    schema_version: Annotated[int, Field(ge=1, le=SCHEMA_VERSION)]
    policy: FileIdentity
    map: FileIdentity
    versions: dict[str, str]
    premises: list[PremiseRecord] = []

    @property
    @abstractmethod
    def stages(self) -> dict[str, float]:
        """Return the seconds of each stage."""

    @property
    @abstractmethod
    def total_seconds(self) -> float:
        """Return the seconds of the run."""


class VerifiedRecord(RunRecord):
    """A run that proves: with which sensor error, by which criterion, for which arithmetic."""

    eps: Any
    criterion: str
    arithmetic: str
    seconds: dict[str, float]

    @property
    def stages(self) -> dict[str, float]:
        """Return the seconds of each stage."""
        return {stage: value for stage, value in self.seconds.items() if stage != "total"}

    @property
    def total_seconds(self) -> float:
        """Return the seconds of the run: as the report says, or the sum over its stages."""
        return self.seconds.get("total", sum(self.seconds.values()))
