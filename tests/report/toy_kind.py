"""A kind of run as an adapter writes it: a document of some JSON, with cases, remarks, findings and rows."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, ClassVar

from viatool.report.document import Annotated, Cased, Located, Tabled
from viatool.report.records import RunRecord
from viatool.report.sections import (
    Annotation,
    Case,
    Count,
    Facts,
    Finding,
    Headline,
    Rules,
    Section,
    Share,
    Tally,
)

FILE = {"path": "file", "sha256": "a" * 64}
TOY: dict[str, Any] = {"schema_version": 1, "policy": FILE, "map": FILE, "versions": {}, "broke": ["b"]}


class ToyRecord(RunRecord):
    """The JSON of the toys."""

    broke: list[str]

    @property
    def stages(self) -> dict[str, float]:
        """Return no stages."""
        return {}

    @property
    def total_seconds(self) -> float:
        """Return a second."""
        return 1.0


class ToyDocument(Cased, Annotated, Located, Tabled):
    """Two toys, a and b."""

    RECORD, SIGN, WHAT, SUBJECTS = ToyRecord, "broke", "a toy report", "toys"
    EMPTY, COMMAND = "no toys to decide on", "toy"
    RATES: ClassVar[Mapping[str, str]] = {"overall": "share of toys that hold"}
    FINDING_RULES: ClassVar[Rules] = {"broken": ("error", "A toy broke.")}

    record: ToyRecord

    @property
    def headline(self) -> Headline:
        """Return the share."""
        return Headline(self.rates["overall"].percentage(), "of the toys hold")

    @property
    def terms(self) -> Mapping[str, str]:
        """Return nothing."""
        return {}

    @property
    def subject(self) -> Sequence[str]:
        """Return where."""
        return ["in the hall"]

    @property
    def sections(self) -> Sequence[Section]:
        """Return the toys that broke."""
        return [Facts("Toys", (("broke", ", ".join(self.record.broke)),))]

    @property
    def assumptions(self) -> Mapping[str, str]:
        """Return a fact."""
        return {"toys": "are small"}

    @property
    def rates(self) -> Mapping[str, Share]:
        """Return the share."""
        return {"overall": Share(2 - len(self.record.broke), 2)}

    @property
    def size(self) -> int:
        """Return two."""
        return 2

    @property
    def tallies(self) -> Sequence[Tally]:
        """Return nothing."""
        return []

    @property
    def limited(self) -> Mapping[str, Count]:
        """Return how many broke."""
        return {"unsafe": Count(len(self.record.broke), "broken toys")}

    def cases(self) -> Sequence[Case]:
        """Return both."""
        return [
            Case("toy", name, *(("failure", "broke", "in two") if name in self.record.broke else ()))
            for name in ("a", "b")
        ]

    def annotations(self) -> Sequence[Annotation]:
        """Return what broke."""
        return [Annotation("error", f"toy {name} broke", "in two") for name in self.record.broke]

    def findings(self) -> tuple[Iterable[Finding], int]:
        """Return what broke."""
        found = [Finding("broken", f"Toy {name} broke.", "hall", name) for name in self.record.broke]
        return found, len(found)

    def columns(self) -> Sequence[str]:
        """Return one."""
        return ["broke"]

    def rows(self) -> Iterator[Sequence[object]]:
        """Yield what broke."""
        for name in self.record.broke:
            yield [name]
