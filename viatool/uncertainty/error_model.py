"""The error model: everything that a verdict bounds about sensors, pose, motors, time and moving things.

Each term may be left out: then the robot is taken to be ideal in it, and every report lists that under *Assumed*. To
add a term, add its field here, with its unit and what it means when it is left out, and name it in `SUPPORTED` for the
jobs that take it into account; a job that does not refuses it by name.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Annotated, Any

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    ValidationError,
    model_validator,
)

from viatool.errors import ConfigurationError


def _ordered(ends: tuple[float, float]) -> tuple[float, float]:
    if not ends[0] <= ends[1]:
        raise ValueError(f"the lower end {ends[0]:g} is above the upper end {ends[1]:g}")
    return ends


def _two(ends: Any) -> Any:
    if not isinstance(ends, list | tuple) or len(ends) != 2:
        raise ValueError("expected two numbers, the least and the largest, such as [0.1, 0.2]")
    return ends


def _number(value: Any) -> Any:
    if isinstance(value, bool):
        raise ValueError(f"{'yes' if value else 'no'} is not a number")
    return value


Bound = Annotated[float, Field(ge=0.0, allow_inf_nan=False), BeforeValidator(_number)]
"""The largest size of an error."""
Share = Annotated[float, Field(ge=0.0, lt=1.0), BeforeValidator(_number)]
"""The largest share of something, below all of it."""
Angle = Annotated[float, Field(ge=0.0, lt=math.pi), BeforeValidator(_number)]
"""The largest size of an angle, below half a turn."""
Limit = Annotated[float, Field(gt=0.0, allow_inf_nan=False), BeforeValidator(_number)]
"""What is never exceeded, or always reached."""
Limits = Annotated[tuple[Limit, Limit], BeforeValidator(_two), AfterValidator(_ordered)]
"""The least and the largest of what is never exceeded or always reached."""
Rate = Annotated[
    Annotated[Limit, Tag("one number")] | Annotated[Limits, Tag("two numbers")],
    Discriminator(lambda value: "two numbers" if isinstance(value, list | tuple) else "one number"),
]
"""The least change of a velocity, or the least and the largest."""
Times = Annotated[tuple[Bound, Bound], BeforeValidator(_two), AfterValidator(_ordered)]
"""The least and the largest time, in seconds."""


GROWING = frozenset(
    {"sensor.absolute", "sensor.relative", "sensor.bias", "sensor.angle", "sensor.thin", "pose.x", "pose.y"}
    | {"pose.theta", "actuation.relative", "actuation.absolute", "actuation.slip", "timing.sensing"}
    | {f"obstacles.{term}" for term in ("speed", "named", "roams", "returns", "people", "hidden")}
)
"""Terms that bound an error by one number: of less, every case is one of more as well, and 0 is none."""


def _term(meaning: str, unit: str, without: str) -> Any:
    """Declare a term: what it bounds, its unit, and what is assumed where it is left out."""
    return Field(None, description=meaning, json_schema_extra={"unit": unit, "without": without})


class ErrorTerms(BaseModel):
    """Terms that belong together."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class SensorTerms(ErrorTerms):
    """How the readings of one observation channel err; all of it at once."""

    absolute: Bound | None = _term("every reading, by itself", "the channel's unit", "as --eps says")
    relative: Share | None = _term(
        "share of the true value, every reading by itself", "share", "no error that grows with the reading"
    )
    bias: Bound | None = _term(
        "one error that all readings of an observation have in common", "the channel's unit", "no common bias"
    )
    angle: Angle | None = _term(
        "a turn of the whole scan against the robot", "rad", "rays point where the specification says"
    )
    missing: Annotated[int, Field(ge=0, le=16), BeforeValidator(_number)] | None = _term(
        "how many rays of a scan, whichever they are, return nothing", "rays", "every ray returns"
    )
    thin: Bound | None = _term(
        "the widest obstacle that a ray may pass without seeing it", "m", "rays see everything in their way"
    )


class PoseTerms(ErrorTerms):
    """How far the pose that localisation gives may be from the true one."""

    x: Bound | None = _term("along x of the map", "m", "exact")
    y: Bound | None = _term("along y of the map", "m", "exact")
    theta: Angle | None = _term("of the heading", "rad", "exact")


class CommandTerms(ErrorTerms):
    """How one acceleration follows its command; every error may change from instant to instant within its bounds."""

    relative: Share | None = _term("share of the acceleration that was commanded", "share", "no gain error")
    absolute: Bound | None = _term("acceleration beside the commanded one", "m/s^2 or rad/s^2", "no bias")


class AxisTerms(ErrorTerms):
    """How one velocity follows its command; every error may change from instant to instant within its bounds."""

    acceleration: Rate | None = _term(
        "how fast the size of the velocity grows towards its command, at least; or from and to",
        "m/s^2 or rad/s^2",
        "commands are reached at once",
    )
    deceleration: Rate | None = _term(
        "how fast the size of the velocity falls towards its command, at least; or from and to",
        "m/s^2 or rad/s^2",
        "as the acceleration",
    )
    lag: Times | None = _term("time constant of a first-order lag, from and to", "s", "no lag")
    relative: Share | None = _term("share of the velocity that was commanded", "share", "no gain error")
    absolute: Bound | None = _term("velocity beside the commanded one", "m/s or rad/s", "no bias")


class ActuationTerms(ErrorTerms):
    """How the robot follows its commands."""

    linear: AxisTerms = AxisTerms()
    lateral: AxisTerms = AxisTerms()
    angular: AxisTerms = AxisTerms()
    linear_acceleration: CommandTerms = CommandTerms()
    angular_acceleration: CommandTerms = CommandTerms()

    @property
    def each(self) -> tuple[AxisTerms, AxisTerms, AxisTerms]:
        """Return the terms of the velocities."""
        return self.linear, self.lateral, self.angular

    slip: Bound | None = _term(
        "velocity to the side that nobody commanded, at most this share of the speed", "share", "no slip"
    )


class TimingTerms(ErrorTerms):
    """When the policy acts, and on what."""

    interval: Limits | None = _term(
        "time between two commands, from and to", "s", "exactly the control interval"
    )
    delay: Times | None = _term("time until a command acts, from and to", "s", "as --delay says")
    sensing: Bound | None = _term(
        "largest age of a reading when the policy gets it", "s", "readings are of the instant"
    )


class ObstacleTerms(ErrorTerms):
    """What moves, with no other promise than how fast: see docs/errors.md."""

    speed: Bound | None = _term(
        "every obstacle of map and scenario, not the arena, moves at most so fast from where it was observed",
        "m/s",
        "obstacles do not move",
    )
    named: Mapping[str, Bound] = Field(
        default_factory=dict,
        description="obstacles of the map, by name, and how fast each may move, in m/s, whatever `speed` says",
    )
    roams: Mapping[str, Bound] = Field(
        default_factory=dict,
        description="obstacles of the map, by name, that are somewhere within so many metres of their place, always",
    )
    returns: Bound | None = _term(
        "whatever the LiDAR sees where it was recorded, walls as well, moves at most so fast from there",
        "m/s",
        "what the sensors see and the map lacks is not there",
    )
    people: Bound | None = _term(
        "people that are given with the states go in any direction, at their speed and at least at this one",
        "m/s",
        "nobody walks about",
    )
    hidden: Bound | None = _term(
        "what the LiDAR cannot see, behind what it sees and beyond its range, comes out at most so fast",
        "m/s",
        "nothing comes out from where the robot cannot see",
    )
    behind: Bound | None = _term(
        "of what is hidden where the LiDAR does not look, nothing was nearer than this when it was observed",
        "m",
        "nothing is where the LiDAR does not look",
    )

    @property
    def moves_on(self) -> bool:
        """Tell whether obstacles of the map move without a bound of how far."""
        return bool(self.speed) or any(self.named.values())

    def freedom(self, name: str) -> tuple[float, float]:
        """Return how far an obstacle of the map may be from its place at any time, in m, or how fast it moves, in m/s.

        One of both is 0; both are for what stays.
        """
        roams = self.roams.get(name, 0.0) if name else 0.0
        speed = self.speed or 0.0
        return roams, 0.0 if roams else self.named.get(name, speed) if name else speed


class ErrorModel(ErrorTerms):
    """What is bounded about a real robot.

    Attributes
    ----------
    source : str
        What messages and premises call it: the file that it was read from.
    """

    version: Annotated[int, Field(ge=1, le=1)] = 1
    sensor: Mapping[str, SensorTerms] = Field(
        default_factory=dict, description="by the name of the observation channel"
    )
    pose: PoseTerms = PoseTerms()
    start: PoseTerms = PoseTerms()
    actuation: ActuationTerms = ActuationTerms()
    timing: TimingTerms = TimingTerms()
    obstacles: ObstacleTerms = ObstacleTerms()
    source: Annotated[str, Field(exclude=True)] = "the error model"

    @model_validator(mode="before")
    @classmethod
    def _sections(cls, content: Any) -> Any:
        """Read a section that is there and empty as one without terms."""
        if not isinstance(content, dict):
            return content
        return {key: value for key, value in content.items() if value is not None}

    def __bool__(self) -> bool:
        """Tell whether any term is stated."""
        return any(True for _ in self.stated())

    def stated(self) -> Iterator[tuple[str, str, Any, str]]:
        """Yield what is stated: place in the file, term as in `SUPPORTED`, value, unit."""
        for name, terms in self.sensor.items():
            yield from _stated(terms, f"sensor.{name}", "sensor")
        for section in ("pose", "start", "timing"):
            yield from _stated(getattr(self, section), section, section)
        for axis in ("linear", "lateral", "angular", "linear_acceleration", "angular_acceleration"):
            for place, term, value, unit in _stated(
                getattr(self.actuation, axis), f"actuation.{axis}", "actuation"
            ):
                straight, _, turning = unit.partition(" or ")
                yield place, term, value, turning if turning and axis.startswith("angular") else straight
        yield from _stated(self.actuation, "actuation", "actuation")
        for name, speed in self.obstacles.named.items():
            yield f"obstacles.named.{name}", "obstacles.named", speed, "m/s"
        for name, radius in self.obstacles.roams.items():
            yield f"obstacles.roams.{name}", "obstacles.roams", radius, "m"
        yield from _stated(self.obstacles, "obstacles", "obstacles")

    def require(self, job: str, supported: frozenset[str]) -> None:
        """Refuse terms that a job does not take into account.

        Raises
        ------
        ConfigurationError
            Names the term, where it stands, and the job.
        """
        left = [place for place, term, _, _ in self.stated() if term not in supported]
        if left:
            these, them = ("this", "it") if len(left) == 1 else ("these", "them")
            raise ConfigurationError(
                f"{self.source}: {', '.join(left)}: {job} does not take {these} into account, so what it says would "
                "not hold for such a robot",
                f"leave {them} out, if a robot that is ideal in {them} says what you need; docs/errors.md lists which "
                "job takes what",
            )

    def with_pose_error(self, position: float, heading: float) -> ErrorModel:
        """Return the model with an error of the pose that localisation gives: of x and y each, and of the heading.

        Raises
        ------
        ConfigurationError
            If it states one already, or nothing is known of the heading.
        """
        if self.pose != PoseTerms():
            raise ConfigurationError(
                f"{self.source} states a pose error, and so does --pose-error", "leave one of them out"
            )
        if not heading < math.pi:
            raise ConfigurationError(
                f"--pose-error has a heading that errs by {heading:g} rad, expected less than half a turn",
                f"state it in radians; {heading:g} degrees are {math.radians(heading):.4g} rad",
            )
        source = "--pose-error" if not self else f"{self.source} and --pose-error"
        pose = PoseTerms(x=position, y=position, theta=heading)
        return self.model_copy(update={"pose": pose, "source": source})

    def only(self, *sections: str) -> ErrorModel:
        """Return the model with some of its sections alone."""
        return type(self)(**{name: getattr(self, name) for name in ("source", *sections)})

    def without(self, place: str) -> ErrorModel:
        """Return the model without the term that stands at a place, as `stated` names it; the same if there is none."""
        content = self.model_dump(exclude_none=True)
        if place in {where for where, _, _, _ in self.stated()}:
            section, key = _entry(content, place)
            del section[key]
        return type(self).model_validate(content).model_copy(update={"source": self.source})

    def at(self, place: str, value: float) -> ErrorModel:
        """Return the model in which the term at a place says something else: the largest size of an error.

        Raises
        ------
        ConfigurationError
            If no term stands there, it is no bound of which less is a smaller error, or the value is out of its range.
        """
        stated = {where: term for where, term, _, _ in self.stated()}
        if place not in stated:
            told = f"it states {', '.join(stated)}" if stated else "it states nothing"
            raise ConfigurationError(
                f"{self.source} states no term '{place}'", f"name a term that it states; {told}"
            )
        if stated[place] not in GROWING:
            growing = [where for where, term in stated.items() if term in GROWING]
            others = f"; of those in {self.source} choose {', '.join(growing)}" if growing else ""
            raise ConfigurationError(
                f"{self.source}: {place} is no largest size of an error, so less of it is not a smaller error",
                f"name a term that bounds an error by one number{others}",
            )
        content = self.model_dump(exclude_none=True)
        section, key = _entry(content, place)
        section[key] = value
        try:
            return type(self).model_validate(content).model_copy(update={"source": self.source})
        except ValidationError as error:
            raise ConfigurationError(
                f"{self.source}: {place} cannot be {value:g}: {error.errors()[0]['msg']}",
                "try errors within the range of the term",
            ) from error

    def premises(self) -> tuple[tuple[str, str], ...]:
        """Return what is stated, in words: place, and value with unit."""
        return tuple((place, f"{_words(value)} {unit}".rstrip()) for place, _, value, unit in self.stated())

    def exactly(self) -> dict[str, str]:
        """Return what is stated to the last digit, by place: by it stored work is told from that of another model."""
        return {place: repr(value) for place, _, value, _ in self.stated()}

    def assumed(self) -> dict[str, str]:
        """Return what the terms that are left out assume, by section, each in words."""
        parts: dict[str, ErrorTerms] = {
            "pose": self.pose,
            "actuation": self.actuation.linear,
            "timing": self.timing,
            "moving things": self.obstacles,
        }
        told = {}
        for name, terms in parts.items():
            without = dict.fromkeys(text for field, text in _without(terms) if getattr(terms, field) is None)
            if without:
                told[name] = "; ".join(without)
        return told


def _stated(terms: ErrorTerms, place: str, section: str) -> Iterator[tuple[str, str, Any, str]]:
    for field, declared in type(terms).model_fields.items():
        value, extra = getattr(terms, field), declared.json_schema_extra
        if value is not None and isinstance(extra, dict):
            yield f"{place}.{field}", f"{section}.{field}", value, str(extra["unit"])


def _entry(content: dict[str, Any], place: str) -> tuple[dict[str, Any], str]:
    """Return the section and the key of what stands at a place; the names of channels and obstacles may hold dots."""
    if place in content:
        return content, place
    for key, value in content.items():
        if place.startswith(f"{key}.") and isinstance(value, dict):
            try:
                return _entry(value, place[len(key) + 1 :])
            except KeyError:
                continue
    raise KeyError(place)


def _without(terms: ErrorTerms) -> Iterator[tuple[str, str]]:
    for field, declared in type(terms).model_fields.items():
        if isinstance(declared.json_schema_extra, dict):
            yield field, str(declared.json_schema_extra["without"])


def _words(value: Any) -> str:
    if isinstance(value, tuple):
        return f"{value[0]:g} to {value[1]:g}"
    return f"{value:g}"
