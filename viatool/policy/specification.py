"""What the numbers of a policy mean: observation channels, action channels, limits, scaling of raw actions.

The same layout is JSON in the metadata of an ONNX file (``viatool.spec``) and YAML in a sidecar file for
policies that were exported elsewhere.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Field, FiniteFloat, model_validator

from viatool.arrays import Floats
from viatool.channels import kind_named, kinds
from viatool.channels.channel import Channel, Positive
from viatool.errors import ConfigurationError
from viatool.world.fields import Strict

ActionKind = Literal["linear", "angular", "other"]

METADATA_KEY = "viatool.spec"
"""The entry of ``metadata_props`` that holds the specification as JSON."""


def _known(kind: str) -> str:
    kind_named(kind)
    return kind


def _list_kinds(schema: dict[str, Any]) -> None:
    schema["enum"] = list(kinds())


class ObservationChannel(Channel):
    """One named block of the observation vector.

    Parameters
    ----------
    name : str
        Unique.
    size : int
        How many numbers it takes.
    unit : str
        For people, for example ``m`` or ``rad/s``.
    kind : str
        What fills it, by a name of the registry; ``other`` for a channel that viatool cannot fill.
    value : float, optional
        A constant: the channel is fixed and has no uncertainty.
    eps : float, optional
        The radius of its uncertainty where none is given on the command line, in its unit.
    lidar : LidarSpecification, optional
        For ``kind: lidar``.
    """

    kind: Annotated[str, AfterValidator(_known), Field(json_schema_extra=_list_kinds)] = "other"

    @model_validator(mode="after")
    def _consistent(self) -> ObservationChannel:
        kind_named(self.kind).check(self)
        if self.value is not None and self.eps:
            raise ValueError(f"channel '{self.name}' is fixed to {self.value}, so its eps is 0")
        return self


class ActionChannel(Strict):
    """One action and the limits of the robot for it.

    Parameters
    ----------
    name, unit : str
        For people.
    lower, upper : float
        The range that the robot accepts, in the unit.
    kind : str
        ``linear`` (m/s, forward), ``angular`` (rad/s, counter-clockwise) or ``other``.
    """

    name: Annotated[str, Field(min_length=1)]
    unit: str = ""
    lower: FiniteFloat
    upper: FiniteFloat
    kind: ActionKind = "other"

    @model_validator(mode="after")
    def _ordered(self) -> ActionChannel:
        if self.lower > self.upper:
            raise ValueError(f"action '{self.name}': lower {self.lower} exceeds upper {self.upper}")
        return self


class ActionMap(Strict):
    """What the robot's software does with the raw output: ``scale * output + offset``, then a clip."""

    scale: list[FiniteFloat]
    offset: list[FiniteFloat]
    clip: bool = False


class PolicySpecification(Strict):
    """What goes into a policy and what comes out.

    Parameters
    ----------
    schema_version : int
        1.
    observation, action : list of channels
        In the order of the vectors.
    action_map : ActionMap, optional
        Applied after the network; None when the network gives physical commands.
    input, output : str, optional
        Names of the graph's input and output, where it has several.
    robot : str
        A name, for reports.
    control_interval : float
        Seconds between two actions.
    training : dict
        Free text about the origin of the policy.
    """

    schema_version: Literal[1] = 1
    observation: Annotated[list[ObservationChannel], Field(min_length=1)]
    action: Annotated[list[ActionChannel], Field(min_length=1)]
    action_map: ActionMap | None = None
    input: str | None = None
    output: str | None = None
    robot: str = "turtlebot3"
    control_interval: Positive = 0.1
    training: dict[str, Any] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _consistent(self) -> PolicySpecification:
        checks: list[tuple[str, list[str]]] = [
            ("observation channel", [channel.name for channel in self.observation]),
            ("action", [channel.name for channel in self.action]),
            ("kind of action", [c.kind for c in self.action if c.kind != "other"]),
        ]
        for what, names in checks:
            twice = sorted({name for name in names if names.count(name) > 1})
            if twice:
                raise ValueError(f"{what} {', '.join(map(repr, twice))} is given twice")
        if self.action_map is not None:
            for name, values in (("scale", self.action_map.scale), ("offset", self.action_map.offset)):
                if len(values) != len(self.action):
                    raise ValueError(
                        f"action_map.{name} has {len(values)} numbers for {len(self.action)} actions"
                    )
        return self

    @property
    def observation_size(self) -> int:
        """Return the length of the observation vector."""
        return sum(channel.size for channel in self.observation)

    @property
    def action_size(self) -> int:
        """Return the number of actions."""
        return len(self.action)

    def channel(self, name: str) -> ObservationChannel:
        """Return the observation channel of that name.

        Raises
        ------
        ConfigurationError
            If there is none.
        """
        for channel in self.observation:
            if channel.name == name:
                return channel
        known = ", ".join(channel.name for channel in self.observation)
        raise ConfigurationError(f"there is no observation channel '{name}'", f"choose one of {known}")

    def columns(self, name: str) -> slice:
        """Return the columns of the observation vector that a channel takes."""
        start = 0
        for channel in self.observation:
            if channel.name == name:
                return slice(start, start + channel.size)
            start += channel.size
        return self._no_columns(name)

    def _no_columns(self, name: str) -> slice:
        self.channel(name)
        raise AssertionError("unreachable: `channel` raises for an unknown name")

    def radii(self, eps: float | Mapping[str, float] | None = None) -> Floats:
        """Return the uncertainty of every observation entry.

        Parameters
        ----------
        eps : float or mapping or None
            One radius for all channels; or radii by channel name, where the name ``""`` gives the default of
            the others. A channel that is given no radius takes its own ``eps``. Fixed channels get 0.

        Returns
        -------
        ndarray
            ``(observation_size,)`` float64, in the units of the channels.

        Raises
        ------
        ConfigurationError
            For an unknown channel, a negative or non-finite radius, one for a fixed channel, or none.
        """
        given: Mapping[str, float]
        given = {} if eps is None else (eps if isinstance(eps, Mapping) else {"": float(eps)})
        for name, value in given.items():
            if not (np.isfinite(value) and value >= 0):
                raise ConfigurationError(
                    f"eps {f'of channel {name!r} ' if name else ''}is {value}",
                    "give a finite number that is not negative",
                )
            if name and self.channel(name).value is not None and value > 0:
                raise ConfigurationError(
                    f"channel '{name}' is fixed to {self.channel(name).value} and has no uncertainty",
                    "leave its eps out, or remove its value from the specification",
                )
        return np.concatenate(
            [np.full(channel.size, self._radius(channel, given)) for channel in self.observation]
        )

    @staticmethod
    def _radius(channel: ObservationChannel, given: Mapping[str, float]) -> float:
        if channel.value is not None:
            return 0.0
        radius = given.get(channel.name, given.get("", channel.eps))
        if radius is None:
            raise ConfigurationError(
                f"no eps is given for observation channel '{channel.name}'",
                f"add --eps {channel.name}=RADIUS, a common --eps RADIUS, or `eps:` to the channel",
            )
        return float(radius)

    def fixed_values(self) -> Floats:
        """Return ``(observation_size,)`` with the value of every fixed entry, and NaN where it is free."""
        return np.concatenate(
            [np.full(c.size, np.nan if c.value is None else c.value) for c in self.observation],
            dtype=np.float64,
        )

    def to_json(self) -> str:
        """Return the JSON that stands in the metadata of a model."""
        return self.model_dump_json(exclude_none=True)

    def to_yaml(self) -> str:
        """Return the YAML of a sidecar file."""
        import yaml

        text: str = yaml.safe_dump(
            self.model_dump(mode="json", exclude_none=True), sort_keys=False, allow_unicode=True
        )
        return text
