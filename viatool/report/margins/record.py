"""Margins as data: the typed form of their JSON."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator
from typing_extensions import Self

from viatool.report.records import (
    Amount,
    Count,
    FileIdentity,
    Fraction,
    ReportPart,
    VerifiedRecord,
)


class VariedRecord(ReportPart):
    """What varies: channels or a term of the error model.

    `proportions` says by how much each grows with the error, 1 but for channels that err by less; `unit` is that of the
    error, empty where channels have different ones; errors up to `most` are tried, and both ends followed to within
    `resolution`.
    """

    kind: Literal["channels", "term"]
    proportions: dict[str, Amount]
    unit: str
    most: Amount
    resolution: Amount


class QuantilesRecord(ReportPart):
    """Quantiles over the contested states, each an error that occurs.

    Of `certified` None is a state that is not proved even at an error of 0, of `refuted` one without a counterexample
    up to the largest error that was tried.
    """

    least: Amount | None
    p10: Amount | None
    p25: Amount | None
    median: Amount | None
    p75: Amount | None
    p90: Amount | None
    largest: Amount | None


class CurveRecord(ReportPart):
    """How many contested states are proved, and how many refuted, at each of some errors."""

    error: list[Amount]
    proved: list[Count]
    refuted: list[Count]


class DecidingRecord(ReportPart):
    """An entry of an observation, and its part of what the errors do to the clearance, to first order."""

    entry: str
    weight: Fraction


class DecidersRecord(ReportPart):
    """The same in the mean over the states about which an error decides: of channels, and of every entry."""

    channels: dict[str, Fraction]
    entries: list[DecidingRecord]


class ContestedStateRecord(ReportPart):
    """A contested state or close place, by its number among its own kind: where it is, and which errors it survives.

    `time` is in seconds since the start of its scenario, `distance` in metres from the footprint to the nearest
    obstacle. `certified` is the largest error that is proved safe, None if not even 0 is; `refuted` the smallest
    with a counterexample, None if none was found.
    """

    state: Count
    close: bool
    scenario: str
    time: float
    pose: tuple[float, float, float]
    distance: float
    certified: Amount | None
    refuted: Amount | None
    decides: list[DecidingRecord]

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if None not in (self.certified, self.refuted) and self.certified > self.refuted:  # type: ignore[operator]
            raise ValueError(f"certified is {self.certified}, above {self.refuted}, which is refuted")
        return self


class CloseRecord(ReportPart):
    """How many close places were examined, how many of them are contested, and if there are none, why."""

    states: Count
    contested: Count
    reason: str


class PolicyMarginsRecord(ReportPart):
    """The margins of one policy: its `states`, how many are `contested`, and all that is, the weakest first."""

    policy: FileIdentity
    states: Count
    contested: Count
    close: CloseRecord
    certified: QuantilesRecord
    refuted: QuantilesRecord
    curve: CurveRecord
    deciding: DecidersRecord
    contested_states: list[ContestedStateRecord]
    origin: str

    @model_validator(mode="after")
    def _adds_up(self) -> Self:
        close = sum(state.close for state in self.contested_states)
        for what, listed, count, of in (
            ("states", len(self.contested_states) - close, self.contested, self.states),
            ("close places", close, self.close.contested, self.close.states),
        ):
            if listed != count or count > of:
                raise ValueError(f"{listed} {what} are listed, {count} of {of} are contested")
        return self

    @property
    def tested(self) -> int:
        """Return how many states and close places are contested."""
        return self.contested + self.close.contested


class MarginsRecord(VerifiedRecord):
    """The margins of one or several policies; `policy` is the first one, `eps` what readings err that do not vary."""

    engine: Any
    varied: VariedRecord
    margins: Annotated[list[PolicyMarginsRecord], Field(min_length=1)]
    assumptions: dict[str, str]
