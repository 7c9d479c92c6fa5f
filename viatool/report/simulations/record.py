"""A simulation as data: the typed form of its JSON."""

from __future__ import annotations

from typing import Any

from pydantic import model_validator

from viatool.report.records import Amount, Count, CountedRecord, Fraction, ReportPart, RunRecord


class EpisodeCount(CountedRecord):
    """How many of all episodes ended so, with a 95 % interval of the rate."""

    PART = "count"

    count: Count
    rate: Fraction
    interval: tuple[Fraction, Fraction]


class SpreadRecord(ReportPart):
    """Some numbers in short; None if there are none."""

    count: Count
    mean: float | None
    least: float | None
    median: float | None
    largest: float | None


class Histogram(ReportPart):
    """How many steps ended with a clearance from each left edge (m) on; the last bin has no end."""

    edges: list[float]
    counts: list[Count]

    @model_validator(mode="after")
    def _consistent(self) -> Histogram:
        if len(self.edges) != len(self.counts):
            raise ValueError(f"{len(self.edges)} edges for {len(self.counts)} counts")
        return self


class ClearanceRecord(ReportPart):
    """Collision and danger distance, the smallest clearance of each episode, and the clearances after all steps."""

    collision: Amount
    danger: Amount
    least_of_an_episode: SpreadRecord
    histogram: Histogram


class RobotRecord(ReportPart):
    """The robot that drove, in m/s and rad/s; what it does in words."""

    name: str
    min_linear: float
    max_linear: float
    max_angular: float
    speeds: str = ""


class CommandCount(CountedRecord):
    """Commands that the robot cannot follow, among all."""

    PART = "count"

    count: Count


class EpisodeRecord(ReportPart):
    """One episode: how it ended, after how many seconds, and how near it came to something."""

    scenario: str
    outcome: str
    cost: float
    seconds: Amount
    least_clearance: float
    path_length_ratio: float


class DrawnErrors(ReportPart):
    """The error model within which errors were drawn: its file, its terms, and who drew them."""

    source: str
    chosen_by: str
    terms: dict[str, str]


class MonitoredRecord(ReportPart):
    """The same scenarios under the monitor: what it did, how the episodes ended, and which end otherwise."""

    intervals: Count
    interventions: Count
    intervened_episodes: Count
    unproved: Count
    success: EpisodeCount
    collision: EpisodeCount
    timeout: EpisodeCount
    lost_success: Count
    gained_success: Count
    prevented_collisions: Count
    least_clearance: float
    time_to_goal: SpreadRecord
    seconds: Amount

    @model_validator(mode="after")
    def _consistent(self) -> MonitoredRecord:
        if max(self.interventions, self.unproved) > self.intervals:
            raise ValueError(f"{self.interventions} interventions in {self.intervals} intervals")
        return self


class SimulationRecord(RunRecord):
    """The whole simulation."""

    engine: str
    lidar: str
    robot: RobotRecord
    conditions: dict[str, Any]
    errors: DrawnErrors | None = None
    seed: int
    success: EpisodeCount
    collision: EpisodeCount
    timeout: EpisodeCount
    average_cost: float
    clearance: ClearanceRecord
    time_to_goal: SpreadRecord
    path_length_ratio: SpreadRecord
    clipped_commands: CommandCount
    beyond_limits: list[str]
    episodes: list[EpisodeRecord]
    monitor: MonitoredRecord | None = None
    seconds: Amount

    @property
    def stages(self) -> dict[str, float]:
        """Return nothing: a simulation has one stage."""
        return {}

    @property
    def total_seconds(self) -> float:
        """Return the wall time."""
        return self.seconds
