"""What a specification says of one channel of the observation."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, FiniteFloat, model_validator

from viatool.channels.encoding import PLAIN, Encoding
from viatool.errors import ConfigurationError, EnclosureError
from viatool.world import Lidar
from viatool.world.fields import Strict

Positive = Annotated[FiniteFloat, Field(gt=0)]
NonNegative = Annotated[FiniteFloat, Field(ge=0)]
_UP_TO_A_TURN: dict[str, Any] = {"exclusiveMinimum": 0, "maximum": 2 * np.pi + 1e-9}
Order = Literal["counter_clockwise", "clockwise"]
Reduce = Literal["minimum", "mean", "first"]


class LidarSpecification(Strict):
    """How the LiDAR channel was made: in which directions rays are cast, and how they are reduced to bins.

    Parameters
    ----------
    field_of_view : float, optional
        Total opening in radians, symmetric about forward, both ends included; in schema version 2 a full circle has no
        ray twice.
    start, step : float, optional
        Instead of it: the direction of the first ray and the angle to the next, in radians, counter-clockwise from
        straight ahead.
    angles : tuple of float, optional
        Instead of both: the direction of every ray, in the order in which they are observed.
    rays : int, optional
        That are cast; of `angles`, their number.
    bins : int, optional
        Numbers that are left after reducing consecutive rays; as many as rays if it is left out.
    order : str
        Which way the rays follow each other from the first on. "clockwise" reverses the order of a field of view, and
        the sign of `step`; `angles` are in their own order.
    reduce : str
        What is left of the rays of a bin: their "minimum", their "mean", or the "first" of them.
    minimum_range, maximum_range : float
        In metres. What is nearer reads ``minimum_range``.
    no_return : "maximum" or float
        What a ray reads that meets nothing within ``maximum_range``: that range, or a number.
    """

    field_of_view: Annotated[FiniteFloat, Field(json_schema_extra=_UP_TO_A_TURN)] | None = None
    start: FiniteFloat | None = None
    step: FiniteFloat | None = None
    angles: Annotated[tuple[FiniteFloat, ...], Field(min_length=1)] | None = None
    rays: Annotated[int, Field(ge=1)]
    bins: Annotated[int, Field(ge=1)]
    order: Order = "counter_clockwise"
    reduce: Reduce = "minimum"
    minimum_range: NonNegative = 0.0
    maximum_range: Positive
    no_return: Literal["maximum"] | FiniteFloat = "maximum"

    @model_validator(mode="before")
    @classmethod
    def _counted(cls, given: Any) -> Any:
        """Take as many rays as there are angles, and as many bins as rays, where it is not said."""
        if not isinstance(given, dict):
            return given
        full = dict(given)
        if isinstance(full.get("angles"), (list, tuple)):
            full.setdefault("rays", len(full["angles"]))
        if "rays" in full:
            full.setdefault("bins", full["rays"])
        return full

    @model_validator(mode="after")
    def _consistent(self) -> LidarSpecification:
        ways = {
            "`field_of_view`": self.field_of_view is not None,
            "`start` and `step`": self.start is not None or self.step is not None,
            "`angles`": self.angles is not None,
        }
        given = [way for way, is_given in ways.items() if is_given]
        if len(given) != 1:
            raise ValueError(f"give one of {', '.join(ways)}, not {' and '.join(given) or 'none'}")
        if (self.start is None) != (self.step is None):
            raise ValueError("`start` and `step` belong together")
        if self.angles is not None and len(self.angles) != self.rays:
            raise ValueError(f"there are {len(self.angles)} angles for {self.rays} rays")
        try:
            sensor = self.lidar()
            if self.field_of_view is None:
                sensor.require_apart()
        except ConfigurationError as error:
            raise ValueError(f"{error.message}: {error.hint}") from None
        return self

    def lidar(self, noise: float = 0.0) -> Lidar:
        """Return the sensor, whose rays err by Gaussian noise of a standard deviation in metres."""
        return Lidar(
            field_of_view=self.field_of_view,
            start=self.start,
            step=self.step,
            listed=self.angles,
            rays=self.rays,
            bins=self.bins,
            order=self.order,
            reduce=self.reduce,
            minimum_range=self.minimum_range,
            maximum_range=self.maximum_range,
            no_return=None if self.no_return == "maximum" else self.no_return,
            noise=noise,
        )


class Frames(Strict):
    """How many readings of a channel, or of everything, stand one after the other in an observation.

    Parameters
    ----------
    count : int
        Of frames; 1 for the newest alone.
    stride : int
        Control intervals from one frame to the next.
    order : str
        Which frame comes first.
    """

    count: Annotated[int, Field(ge=1)]
    stride: Annotated[int, Field(ge=1)] = 1
    order: Literal["oldest_first", "newest_first"] = "oldest_first"

    @property
    def words(self) -> str:
        """Return the frames in words; nothing for the newest alone."""
        if self.count == 1:
            return ""
        apart = f", {self.stride} steps apart" if self.stride > 1 else ""
        return f"{self.count} frames{apart}, {self.order.replace('_', ' ')}"

    @property
    def ages(self) -> tuple[int, ...]:
        """Return how many control intervals ago each frame was read, in their order."""
        newest_first = tuple(range(0, self.count * self.stride, self.stride))
        return newest_first if self.order == "newest_first" else newest_first[::-1]


NOW = Frames(count=1)
"""The newest reading alone."""


class Channel(Strict):
    """What stands in a specification; `viatool.policy.ObservationChannel` says what it means, and checks it."""

    name: Annotated[str, Field(min_length=1)]
    size: Annotated[int, Field(ge=1)] = 1
    unit: str = ""
    kind: str = "other"
    value: FiniteFloat | None = None
    eps: NonNegative | None = None
    scale: FiniteFloat = 1.0
    offset: FiniteFloat = 0.0
    clip: tuple[FiniteFloat, FiniteFloat] | None = None
    reciprocal: bool = False
    frames: Frames | None = None
    lidar: LidarSpecification | None = None
    initial: FiniteFloat | tuple[FiniteFloat, ...] | None = None

    def __str__(self) -> str:
        """Return how messages name the channel."""
        return f"observation channel '{self.name}' of kind '{self.kind}'"

    @model_validator(mode="before")
    @classmethod
    def _sized(cls, given: Any) -> Any:
        """Take the size of a LiDAR from its bins, and that of a memory from its first numbers, where it is not said."""
        if not isinstance(given, dict) or "size" in given:
            return given
        if isinstance(given.get("initial"), (list, tuple)):
            return {**given, "size": len(given["initial"])}
        lidar = given.get("lidar")
        if isinstance(lidar, LidarSpecification):
            return {**given, "size": lidar.bins}
        if isinstance(lidar, dict):
            angles = lidar.get("angles")
            rays = len(angles) if isinstance(angles, (list, tuple)) else lidar.get("rays")
            size = lidar.get("bins", rays)
            return given if size is None else {**given, "size": size}
        return given

    @property
    def encoding(self) -> Encoding:
        """Return what the robot's software makes of a reading before the network takes it."""
        plain = (self.scale, self.offset, self.clip, self.reciprocal) == (1.0, 0.0, None, False)
        return PLAIN if plain else Encoding(self.scale, self.offset, self.clip, self.reciprocal)

    @property
    def told_apart(self) -> tuple[float, float]:
        """Return the ends of the readings that are told apart: one beyond is encoded as the end; infinite if any is."""
        if self.clip is None or self.reciprocal:
            return -np.inf, np.inf
        ends = [(end - self.offset) / self.scale for end in self.clip]
        spare = 1.0 + max(abs(end) for end in ends)
        return min(ends) - spare, max(ends) + spare

    @contextmanager
    def named_in_errors(self) -> Iterator[None]:
        """Say of which channel there is no enclosure."""
        try:
            yield
        except EnclosureError as error:
            raise EnclosureError(f"{self}: {error.message}", error.hint) from None

    @model_validator(mode="after")
    def _encodes(self) -> Channel:
        if self.scale == 0.0:
            raise ValueError(
                f"channel '{self.name}' has scale 0, so that the network would observe a constant"
            )
        if self.clip is not None and not self.clip[0] < self.clip[1]:
            raise ValueError(
                f"channel '{self.name}' is clipped to [{self.clip[0]}, {self.clip[1]}], which is no range"
            )
        if self.initial is not None and self.kind != "memory":
            raise ValueError(
                f"channel '{self.name}' has `initial` numbers, which only a channel of kind 'memory' begins with"
            )
        if self.reciprocal and self.value == 0.0:
            raise ValueError(f"channel '{self.name}' has the value 0, which has no reciprocal")
        return self
