"""The report as data: the typed form of the report JSON, which reporters, gate and comparison read.

Field names are a contract with other programs; the JSON Schema in docs/ is generated from these classes.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from viatool.errors import ConfigurationError

if TYPE_CHECKING:
    from viatool.verification.result import Result

Count = Annotated[int, Field(ge=0)]
Share = Annotated[float, Field(ge=0.0, le=1.0)]


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="allow")


class FileIdentity(_Part):
    """A file that was read, and the digest of what was in it."""

    path: str
    sha256: str


class Verdicts(_Part):
    """How many states have each verdict."""

    safe: Count
    unsafe: Count
    unknown: Count


class Rate(_Part):
    """Safe states among all that count; `rate` is None when there are none."""

    safe: Count
    total: Count
    rate: Share | None

    @model_validator(mode="after")
    def _consistent(self) -> Rate:
        if self.safe > self.total:
            raise ValueError(f"{self.safe} safe states among {self.total}")
        return self


class RateByOutcome(_Part):
    """A rate over all states, and over the states of the episodes with each outcome."""

    overall: Rate
    success: Rate
    collision: Rate
    timeout: Rate


class Task(_Part):
    """How the simulated or recorded episodes ended: measured, not proved."""

    episodes: Count
    success_rate: Share | None
    collision_rate: Share | None
    timeout_rate: Share | None
    average_cost: float | None


class Width(_Part):
    """Width of the reachable set of one action over the states, in the action's unit."""

    mean: float
    std: float
    max: float


class UnsafeState(_Part):
    """Where a state with a counterexample is: seconds since the start of its scenario, and x, y, theta."""

    state: Count
    scenario: str
    time: float
    pose: tuple[float, float, float]


class PoseError(_Part):
    """Half-widths of the box around every recorded pose: of x and y in metres, of the heading in radians."""

    position: float
    heading: float


class TubeWidth(_Part):
    """Median and 90th percentile of the width of the tubes at the end of each interval; None where all have ended."""

    median: list[float | None]
    p90: list[float | None]
    unit: str


class HorizonDocument(_Part):
    """The closed loop over several intervals: from how many states every run keeps the collision distance.

    `safety_rate` has one rate for each interval: of the states that are proved safe up to its end.
    """

    steps: Annotated[int, Field(ge=1)]
    pose_error: PoseError
    states: Count
    verdicts: Verdicts
    safety_rate: list[Rate]
    width: dict[str, TubeWidth]
    least_clearance: list[float | None]


class RecordingDocument(_Part):
    """How recorded readings of one LiDAR agree with what the map shows at the recorded poses.

    `off` are farther from it than eps, `contradicting` farther than eps and 5 cm; more than one contradicting reading
    in twenty makes the recording `doubtful`.
    """

    channel: str
    states: Count
    readings: Count
    off: Count
    share: Share
    contradicting: Count
    median_difference: float
    doubtful: bool
    cause: str


class RunDocument(_Part):
    """What every report says of its run: what was examined, under which assumptions, with which versions."""

    schema_version: Annotated[int, Field(ge=1, le=1)]
    policy: FileIdentity
    map: FileIdentity
    eps: Any
    criterion: str
    arithmetic: str
    seconds: dict[str, float]
    versions: dict[str, str]


class ReportDocument(RunDocument):
    """The whole report."""

    engine: Any
    states: Count
    verdicts: Verdicts
    safety_rate: RateByOutcome
    sampled_safety_rate: RateByOutcome
    danger_rate: RateByOutcome
    contested_rate: RateByOutcome
    task: Task
    reachable_width: dict[str, Width]
    unsafe_states: list[UnsafeState] | None = None
    horizon: HorizonDocument | None = None
    recording: list[RecordingDocument] | None = None


def read_result(result: Result) -> ReportDocument:
    """Return the report of a result; what a stored report of it would be read back as."""
    return ReportDocument.model_validate(result.to_json())


def load_document(path: Path) -> ReportDocument:
    """Read a stored report.

    Raises
    ------
    ConfigurationError
        If the file is missing, is no JSON or is not a report; names the field.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not a text file"
        raise ConfigurationError(f"cannot read the report '{path}': {reason}", "check the path") from error
    try:
        return ReportDocument.model_validate_json(text)
    except ValidationError as error:
        first = error.errors()[0]
        field = ".".join(str(part) for part in first["loc"]) or "the document"
        raise ConfigurationError(
            f"'{path}' is not a viatool report: {field}: {first['msg']}",
            "write one with viatool verify ... --output json:PATH",
        ) from error
