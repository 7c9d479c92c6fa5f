"""Missions as data: the typed form of their JSON."""

from __future__ import annotations

from typing import Literal

from viatool.report.records import Amount, Count, CountedRecord, Fraction, ReportPart, VerifiedRecord


class MissionShare(CountedRecord):
    """Proved missions among all; `rate` is None when there are none."""

    PART = "safe"

    safe: Count
    rate: Fraction | None


class MissionVerdicts(ReportPart):
    """Missions by verdict."""

    proved: Count
    refuted: Count
    unknown: Count


class MissionLimitsRecord(ReportPart):
    """Parts of a set at most, sides of the first cells in metres and radians, and how often cells were halved."""

    parts: Count
    position: Amount
    heading: Amount
    finer: Count


class FlawlessRun(ReportPart):
    """The run without any error: after how many seconds it arrives, None if it does not, and its least clearance."""

    arrives: Amount | None
    clearance: float | None


class MissionNeedsRecord(ReportPart):
    """Which errors a mission takes that is not proved: its verdict without any, and errors by themselves.

    Without each of those in `alone` it is proved, without those in `others` it is not; about some there may have been
    no time to ask.
    """

    without_errors: Literal["proved", "refuted", "unknown"]
    alone: list[str]
    others: list[str]


class MissionRecord(ReportPart):
    """One mission.

    `starts` is the box of states from which runs begin instead of a pose (empty if there is none), `task` where they
    have to arrive and when, `deadline` the seconds that its scenario gives for that, if it does.
    `steps` are the intervals that were followed, `arrival` the seconds between which every run arrives,
    `driven_arrival` those of the runs that were driven against it, `clearance` the metres that every run keeps in
    the intervals that were followed (of a refuted mission those that its run keeps), `parts` the most that were
    held at once.
    """

    scenario: str
    start: list[float]
    goal: list[float]
    starts: str
    task: str
    deadline: float | None
    verdict: Literal["proved", "refuted", "unknown"]
    steps: Count
    arrival: tuple[Amount, Amount] | None
    driven_arrival: tuple[Amount, Amount] | None
    driven: Count
    seconds: Amount
    clearance: float | None
    parts: Count
    start_parts: Count
    reason: str
    flawless_run: FlawlessRun | None = None
    needs: MissionNeedsRecord | None = None


class NotJudgedMissions(ReportPart):
    """Which missions were left out once the outcome of the gate was certain: they count into no other figure."""

    overall: Count
    scenarios: list[str]


class MissionsRecord(VerifiedRecord):
    """All missions of a run."""

    collision_distance: Amount
    start_error: tuple[Amount, Amount, Amount]
    time_limit: Amount
    goal_radius: Amount
    limits: MissionLimitsRecord
    mission_verdicts: MissionVerdicts
    mission_rate: MissionShare
    not_judged: NotJudgedMissions | None = None
    missions: list[MissionRecord]
    seed: int
