"""A certificate as data: the typed form of its JSON."""

from __future__ import annotations

from viatool.report.error_costs import CellErrorCostsRecord
from viatool.report.records import Amount, Count, CountedRecord, Fraction, ReportPart, VerifiedRecord


class ScenarioIdentity(ReportPart):
    """Which scenario: its name, and the goal in metres."""

    name: str
    goal: list[float]


class ShareRecord(CountedRecord):
    """A part of a volume, both counted in smallest cells; `rate` is None when there is none."""

    PART = "part"

    part: Count
    rate: Fraction | None


class CommandsRecord(ReportPart):
    """The smallest and the largest v (m/s) and omega (rad/s) of the step before."""

    lower: list[float]
    upper: list[float]


class StateRecord(ReportPart):
    """What the cells hold behind the pose, of a robot whose motion has a state: names with units, least, largest."""

    command: list[str]
    axes: list[str]
    lower: list[float]
    upper: list[float]


class Roots(ReportPart):
    """How much of the map was examined, in cells of the coarsest kind."""

    examined: Count
    total: Count


class NotJudgedRoots(ReportPart):
    """How many roots were left out once the outcome of the gate was certain, and how many smallest cells they hold."""

    overall: Count
    smallest_cells: Count


class CellsRecord(ReportPart):
    """Leaves of the tree by status."""

    blocked: Count
    uncontested: Count
    certified: Count
    refuted: Count
    unknown: Count


class Volume(ReportPart):
    """Volume of the examined roots by status, in m^2 rad; commands count with their share of the range."""

    blocked: Amount
    uncontested: Amount
    certified: Amount
    refuted: Amount
    unknown: Amount


class WorstPlace(ReportPart):
    """A counterexample: pose and previous command (or state of the motion), the policy's command, closest approach.

    `obstacle` is what it comes near to; `saved_by` are the errors of which each would save its cell if it were not,
    None where that was not asked.
    """

    pose: list[float]
    previous: list[float]
    action: list[float]
    clearance: Amount
    seconds: Amount
    obstacle: str | None = None
    saved_by: list[str] | None = None


class StepRecord(ShareRecord):
    """The cells that stay certified for so many control intervals, unless the goal is reached before."""

    steps: Count


class RoundRecord(ReportPart):
    """A round: for how many intervals cells were followed, how many, and how many then held for ever and arrived."""

    intervals: Count
    followed: Count
    forever: Count
    arrive: Count = 0
    seconds: Amount


class LastingVolume(ReportPart):
    """Volumes in m^2 rad: free before the goal, of that for ever, and of the cells in which the goal is reached.

    Of that for ever: what arrives, and of the rest what moves on for ever and what may come to stand.
    """

    free: Amount
    forever: Amount | None
    arrive: Amount | None = None
    moving: Amount | None = None
    standing: Amount | None = None
    goal: Amount


class OverTime(ReportPart):
    """What holds beyond the next action; shares of the free volume outside of the goal, in its cells.

    What is safe for ever arrives for certain, within so many intervals at most, or never stands still, or may: is told
    to drive and to turn no faster than `still`, in m/s and rad/s.
    """

    goal_radius: Amount
    lookahead: Count
    finer: Count = 0
    cell: dict[str, float]
    forever: ShareRecord | None
    arrive: ShareRecord | None = None
    moving: ShareRecord | None = None
    standing: ShareRecord | None = None
    arrive_within: Count | None = None
    still: Amount | None = None
    volume: LastingVolume
    steps: list[StepRecord]
    rounds: list[RoundRecord]


class PlacesRecord(VerifiedRecord):
    """The whole certificate."""

    scenario: ScenarioIdentity
    clearance: Amount
    deceleration: Amount | None
    delay: Amount = 0.0
    previous_command: CommandsRecord
    state: StateRecord | None = None
    smallest_cell: dict[str, float]
    roots: Roots
    not_judged: NotJudgedRoots | None = None
    cells: CellsRecord
    volume: Volume
    contested_rate: ShareRecord
    free_rate: ShareRecord
    decided_rate: ShareRecord
    over_time: OverTime | None = None
    worst: list[WorstPlace]
    error_costs: CellErrorCostsRecord | None = None
