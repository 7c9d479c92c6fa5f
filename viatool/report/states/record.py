"""The report on states as data: the typed form of its JSON, which the gate and comparisons read."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, model_validator
from typing_extensions import Self

from viatool.report.error_costs import ErrorCostsRecord
from viatool.report.margins.record import PolicyMarginsRecord, VariedRecord
from viatool.report.reasons import ReasonRecord
from viatool.report.records import Count, CountedRecord, Fraction, ReportPart, VerifiedRecord

OUTCOMES = ("overall", "success", "collision", "timeout")


class Verdicts(ReportPart):
    """How many states have each verdict."""

    safe: Count
    unsafe: Count
    unknown: Count


class RateRecord(CountedRecord):
    """Safe states among all that count; `rate` is None when there are none."""

    PART = "safe"

    safe: Count
    rate: Fraction | None


class RateByOutcomeRecord(ReportPart):
    """A rate over all states, and over the states of the episodes with each outcome."""

    overall: RateRecord
    success: RateRecord
    collision: RateRecord
    timeout: RateRecord

    @model_validator(mode="after")
    def _adds_up(self) -> Self:
        parts = (self.success, self.collision, self.timeout)
        for name in ("safe", "total"):
            counted = sum(getattr(part, name) for part in parts)
            if counted > getattr(self.overall, name):
                raise ValueError(f"{name} of the outcomes is {counted}, of all {getattr(self.overall, name)}")
        return self


class StakeRecord(ReportPart):
    """In how many of the states the verdict depended on the policy: some command of the robot could make them fail."""

    contested: Count
    states: Count


class TaskRecord(ReportPart):
    """How the simulated or recorded episodes ended: measured, not proved."""

    episodes: Count
    success_rate: Fraction | None
    collision_rate: Fraction | None
    timeout_rate: Fraction | None
    average_cost: float | None


class Width(ReportPart):
    """Width of the reachable set of one action over the states, in the action's unit."""

    mean: float
    std: float
    max: float


class PossibleCommands(ReportPart):
    """Of a policy that chooses: the commands of its table, and how many of them are possible in a state."""

    commands: Count
    mean: float
    most: Count


class UnsafeState(ReportPart):
    """Where a state with a counterexample is: seconds since the start of its scenario, and x, y, theta."""

    state: Count
    scenario: str
    time: float
    pose: tuple[float, float, float]


class NotJudgedRecord(ReportPart):
    """How many states were left out once the outcome of the gate was certain: they count into no other figure."""

    overall: Count
    success: Count
    collision: Count
    timeout: Count


class ClosePlacesRecord(ReportPart):
    """What was found at close places, beside the driven states; `reason` says why there are none."""

    states: Count
    verdicts: Verdicts
    unsafe_states: list[UnsafeState]
    reasons: list[ReasonRecord] | None = None
    reasons_left_out: Count = 0
    reason: str = ""


class PoseError(ReportPart):
    """Half-widths of the box around every recorded pose: of x and y in metres, of the heading in radians."""

    position: float
    heading: float


class TubeWidth(ReportPart):
    """Median and 90th percentile of the width of the tubes at the end of each interval; None where all have ended."""

    median: list[float | None]
    p90: list[float | None]
    unit: str


class HorizonRecord(ReportPart):
    """The closed loop over several intervals: from how many states every run keeps the collision distance.

    `safety_rate` has one rate for each interval: of the states that are proved safe up to its end.
    """

    steps: Annotated[int, Field(ge=1)]
    pose_error: PoseError
    states: Count
    verdicts: Verdicts
    safety_rate: list[RateRecord]
    width: dict[str, TubeWidth]
    least_clearance: list[float | None]


class RecordingRecord(ReportPart):
    """How recorded readings of one LiDAR agree with what the map shows at the recorded poses.

    `off` are farther from it than eps, `contradicting` farther than eps and 5 cm; more than one contradicting reading
    in twenty makes the recording `doubtful`.
    """

    channel: str
    states: Count
    readings: Count
    off: Count
    share: Fraction
    contradicting: Count
    median_difference: float
    doubtful: bool
    cause: str


class StateMarginsRecord(PolicyMarginsRecord):
    """How much error the contested states survive, where that was asked, and what varies."""

    varied: VariedRecord


class StatesRecord(VerifiedRecord):
    """The whole report."""

    engine: Any
    states: Count
    verdicts: Verdicts
    not_judged: NotJudgedRecord | None = None
    safety_rate: RateByOutcomeRecord
    sampled_safety_rate: RateByOutcomeRecord
    danger_rate: RateByOutcomeRecord
    contested_rate: RateByOutcomeRecord
    close_rate: RateByOutcomeRecord | None = None
    close: ClosePlacesRecord | None = None
    stake: StakeRecord | None = None
    task: TaskRecord
    reachable_width: dict[str, Width]
    unsafe_states: list[UnsafeState] | None = None
    reasons: list[ReasonRecord] | None = None
    reasons_left_out: Count = 0
    horizon: HorizonRecord | None = None
    recording: list[RecordingRecord] | None = None
    possible: PossibleCommands | None = None
    error_costs: ErrorCostsRecord | None = None
    margins: StateMarginsRecord | None = None

    @model_validator(mode="after")
    def _close_adds_up(self) -> Self:
        rate = None if self.close_rate is None else self.close_rate.overall
        if self.close is None or rate is None:
            return self
        found = self.close.verdicts
        counted = found.safe + found.unsafe + found.unknown
        if counted != self.close.states:
            raise ValueError(f"the verdicts count {counted} close places of {self.close.states}")
        if rate.total - rate.safe != found.unsafe + found.unknown:
            raise ValueError(
                f"close_rate counts {rate.total - rate.safe} close places that are not safe, the verdicts "
                f"{found.unsafe + found.unknown}"
            )
        return self

    @model_validator(mode="after")
    def _adds_up(self) -> Self:
        counted = self.verdicts.safe + self.verdicts.unsafe + self.verdicts.unknown
        if counted != self.states:
            raise ValueError(f"the verdicts count {counted} states of {self.states}")
        for name in ("safety_rate", "sampled_safety_rate", "danger_rate"):
            whole = getattr(self, name).overall
            if whole.total != self.states:
                raise ValueError(f"{name} is over {whole.total} states of {self.states}")
        stake, contested = self.stake, self.contested_rate.overall.total
        if stake is not None and (stake.contested, stake.states) != (contested, self.states):
            raise ValueError(
                f"stake is {stake.contested} of {stake.states} states, contested_rate over {contested} of {self.states}"
            )
        if self.safety_rate.overall.safe != self.verdicts.safe:
            counted = self.safety_rate.overall.safe
            raise ValueError(f"safety_rate counts {counted} safe states, the verdicts {self.verdicts.safe}")
        return self
