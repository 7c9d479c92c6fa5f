"""A certificate as data: the typed form of its JSON; field names are a contract with other programs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from pydantic import BaseModel, ConfigDict, Field

from viatool.report.document import RunDocument

if TYPE_CHECKING:
    from viatool.places import Certificate

Count = Annotated[int, Field(ge=0)]
Amount = Annotated[float, Field(ge=0.0)]


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="allow")


class ScenarioIdentity(_Part):
    """Which scenario: its name, and the goal in metres."""

    name: str
    goal: list[float]


class Share(_Part):
    """A part of a volume, both counted in smallest cells; `rate` is None when there is none."""

    part: Count
    total: Count
    rate: Annotated[float, Field(ge=0.0, le=1.0)] | None


class Commands(_Part):
    """The smallest and the largest v (m/s) and omega (rad/s) of the step before."""

    lower: list[float]
    upper: list[float]


class Roots(_Part):
    """How much of the map was examined, in cells of the coarsest kind."""

    examined: Count
    total: Count


class Cells(_Part):
    """Leaves of the tree by status."""

    blocked: Count
    uncontested: Count
    certified: Count
    refuted: Count
    unknown: Count


class Volume(_Part):
    """Volume of the examined roots by status, in m^2 rad; commands count with their share of the range."""

    blocked: Amount
    uncontested: Amount
    certified: Amount
    refuted: Amount
    unknown: Amount


class WorstPlace(_Part):
    """A counterexample: pose and previous command, the policy's command, and the closest approach."""

    pose: list[float]
    previous: list[float]
    action: list[float]
    clearance: Amount
    seconds: Amount


class StepShare(Share):
    """The cells that stay certified for so many control intervals, unless the goal is reached before."""

    steps: Count


class Lookahead(_Part):
    """A round: for how many intervals cells were followed, how many, and how many then held for ever."""

    intervals: Count
    followed: Count
    forever: Count
    seconds: Amount


class LastingVolume(_Part):
    """Volumes in m^2 rad: free before the goal, of that for ever, and of the cells in which the goal is reached."""

    free: Amount
    forever: Amount | None
    goal: Amount


class OverTime(_Part):
    """What holds beyond the next action; shares of the free volume outside of the goal, in its cells."""

    goal_radius: Amount
    lookahead: Count
    cell: dict[str, float]
    forever: Share | None
    volume: LastingVolume
    steps: list[StepShare]
    rounds: list[Lookahead]


class CertificateDocument(RunDocument):
    """The whole certificate."""

    scenario: ScenarioIdentity
    clearance: Amount
    deceleration: Amount | None
    delay: Amount = 0.0
    previous_command: Commands
    smallest_cell: dict[str, float]
    roots: Roots
    cells: Cells
    volume: Volume
    contested_rate: Share
    free_rate: Share
    decided_rate: Share
    over_time: OverTime | None = None
    worst: list[WorstPlace]


def read_certificate(certificate: Certificate) -> CertificateDocument:
    """Return the document of a certificate."""
    return CertificateDocument.model_validate(certificate.to_json())
