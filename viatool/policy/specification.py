"""What the numbers of a policy mean: observation channels, action channels, limits, scaling of raw actions.

The same layout is JSON in the metadata of an ONNX file (``viatool.spec``) and YAML in a sidecar file for
policies that were exported elsewhere.
"""

from __future__ import annotations

from collections.abc import Mapping
from difflib import get_close_matches
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from viatool.arrays import Floats, Indices
from viatool.channels import kind_named, kinds
from viatool.channels.channel import Channel, Frames, Positive
from viatool.channels.inputs import Inputs
from viatool.channels.memory import check_memory, first_numbers
from viatool.errors import ConfigurationError
from viatool.policy.action_channels import ActionChannel, ActionMap, Override
from viatool.world.fields import Strict, misplaced

_FULL = 1e-3
"""Radians by which a full circle may be rounded, as in 6.283."""

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
    initial : float or tuple of float, optional
        For ``kind: memory``: what an episode begins with; zeros where it is not said.
    """

    kind: Annotated[str, AfterValidator(_known), Field(json_schema_extra=_list_kinds)] = "other"

    @model_validator(mode="after")
    def _consistent(self) -> ObservationChannel:
        kind_named(self.kind).check(self)
        if self.value is not None and self.eps:
            raise ValueError(f"channel '{self.name}' is fixed to {self.value}, so its eps is 0")
        return self


class PolicySpecification(Strict):
    """What goes into a policy and what comes out.

    Parameters
    ----------
    schema_version : int
        1 or 2. Version 1 has no frames, overrides and memory, and its channels no scales.
    observation, action : list of channels
        In the order of the vectors.
    action_map : ActionMap, optional
        Applied after the network; None when the network gives physical commands. Version 2 gives each action its own
        scale and offset instead.
    frames : Frames, optional
        How many whole observations are stacked.
    overrides : list of Override
        Rules around the policy; the first that applies counts.
    memory : mapping
        Inputs of the graph that take what an output gave in the step before, by name. Each is a channel of kind
        ``memory`` of that name, behind all others; those that are not described are added when the policy is read.
    input : str or list of str, optional
        The graph's input that is the observation; of several (version 2) all, in the order in which the channels
        describe them: the numbers of one after those of another.
    output : str, optional
        The graph's output that is the action, where it has several.
    robot : str
        A name, for reports.
    control_interval : float
        Seconds between two actions.
    training : dict
        Free text about the origin of the policy.
    """

    schema_version: Literal[1, 2] = 1
    observation: Annotated[list[ObservationChannel], Field(min_length=1)]
    action: Annotated[list[ActionChannel], Field(min_length=1)]
    action_map: ActionMap | None = None
    frames: Frames | None = None
    overrides: list[Override] = Field(default_factory=list)
    memory: dict[str, str] = Field(default_factory=dict)
    input: str | Annotated[list[str], Field(min_length=1)] | None = None
    output: str | None = None
    robot: str = "turtlebot3"
    control_interval: Positive = 0.1
    training: dict[str, Any] = Field(default_factory=dict)

    @model_validator(mode="before")
    @classmethod
    def _once_around(cls, given: Any) -> Any:
        """Give a full circle of version 2 no ray twice."""
        if not isinstance(given, dict) or given.get("schema_version") != 2:
            return given
        observation = given.get("observation")
        if not isinstance(observation, list):
            return given
        return {**given, "observation": [_once_around(channel) for channel in observation]}

    @model_validator(mode="after")
    def _consistent(self) -> PolicySpecification:
        checks: list[tuple[str, str, list[str]]] = [
            ("observation", "observation channel", [channel.name for channel in self.observation]),
            ("action", "action", [channel.name for channel in self.action]),
            ("input", "input", self.input if isinstance(self.input, list) else []),
            ("action", "kind of action", ["" if c.kind == "other" else c.kind for c in self.action]),
        ]
        for key, what, names in checks:
            twice = sorted({name for name in names if name and names.count(name) > 1})
            if twice:
                second = names.index(twice[0], names.index(twice[0]) + 1)
                raise misplaced(f"{what} {', '.join(map(repr, twice))} is given twice", key, second)
        if self.action_map is not None:
            for name, values in (("scale", self.action_map.scale), ("offset", self.action_map.offset)):
                if len(values) != len(self.action):
                    raise misplaced(
                        f"action_map.{name} has {len(values)} numbers for {len(self.action)} actions",
                        *("action_map", name),
                    )
        self._check_version()
        check_memory(self.memory, self.observation, self.frames, self.output)
        self._check_choice()
        self._check_entries()
        self._check_overrides()
        return self

    def _check_version(self) -> None:
        """Refuse what version 1 does not have, and what is said twice."""
        newer = self._newer() if self.schema_version == 1 else {}
        if newer:
            place = next(iter(newer.values()))
            raise misplaced(f"{', '.join(newer)}: this needs `schema_version: 2`", *place)
        own = [channel.name for channel in self.observation if channel.frames]
        if own and self.frames:
            raise misplaced(
                f"frames are given for everything and for {', '.join(own)}: give one of them", "frames"
            )
        if self.action_map is not None and self.schema_version == 2:
            raise misplaced(
                "action_map is of version 1: give each action its own `scale` and `offset`", "action_map"
            )

    def _newer(self) -> dict[str, tuple[str | int, ...]]:
        """Return what version 1 does not have, by names, and where it stands."""
        newer: dict[str, tuple[str | int, ...]] = {}
        for number, channel in enumerate(self.observation):
            if channel.encoding or channel.frames:
                newer.setdefault(channel.name, ("observation", number))
        for number, action in enumerate(self.action):
            if (action.scale, action.offset) != (1.0, 0.0) or action.entry is not None:
                newer.setdefault(action.name, ("action", number))
        for name in ("frames", "overrides", "memory"):
            if getattr(self, name):
                newer.setdefault(name, (name,))
        for number, channel in enumerate(self.observation):
            if channel.lidar is not None and channel.lidar.field_of_view is None:
                newer.setdefault(channel.name, ("observation", number, "lidar"))
        if isinstance(self.input, list):
            newer.setdefault("input", ("input",))
        return newer

    def _check_choice(self) -> None:
        """Refuse another action beside a choice."""
        choices = [action.name for action in self.action if action.kind == "choice"]
        if choices and len(self.action) > 1:
            raise misplaced(
                f"action '{choices[0]}' is a choice, so it is the only one, but there are {len(self.action)}",
                "action",
            )

    def _check_entries(self) -> None:
        """Refuse actions of which some say which number of the output they are and others do not, or two the same."""
        entries = {action.name: action.entry for action in self.action if action.entry is not None}
        silent = [action.name for action in self.action if action.entry is None]
        if entries and silent:
            raise misplaced(
                f"action '{silent[0]}' has no `entry`, but '{next(iter(entries))}' has one: give all of them",
                *("action", [action.name for action in self.action].index(silent[0])),
            )
        given = list(entries.values())
        twice = [name for name, entry in entries.items() if given.count(entry) > 1]
        if twice:
            raise misplaced(
                f"actions {' and '.join(map(repr, twice))} take the same entry, {entries[twice[0]]}",
                *("action", [action.name for action in self.action].index(twice[1]), "entry"),
            )

    def _check_overrides(self) -> None:
        """Refuse rules about what is not observed, and commands of another length."""
        known = {name for channel in self.observation for name in (channel.name, channel.kind)}
        for number, rule in enumerate(self.overrides):
            unknown = [name for name in rule.when if name not in known]
            if unknown:
                close = get_close_matches(unknown[0], sorted(known), n=1, cutoff=0.0)
                raise misplaced(
                    f"no channel is called '{unknown[0]}' or of that kind, nearest is '{close[0]}'",
                    *("overrides", number, "when", unknown[0]),
                )
            if len(rule.command) != len(self.axes):
                raise misplaced(
                    f"{len(rule.command)} numbers for {len(self.axes)} "
                    f"({', '.join(axis.name for axis in self.axes)})",
                    *("overrides", number, "command"),
                )

    @property
    def inputs(self) -> Inputs:
        """Return where the readings of the channels stand in the observation, and how they are encoded."""
        return Inputs.of(self.observation, self.frames)

    @property
    def sensed(self) -> list[ObservationChannel]:
        """Return the channels that come from outside of the policy: all but its memory."""
        return [channel for channel in self.observation if channel.kind != "memory"]

    @property
    def remembered(self) -> list[ObservationChannel]:
        """Return the channels that hold the policy's memory, behind all others."""
        return [channel for channel in self.observation if channel.kind == "memory"]

    @property
    def initial_memory(self) -> Floats:
        """Return the M numbers with which the memory begins an episode."""
        return first_numbers(self.remembered)

    @property
    def choice(self) -> ActionChannel | None:
        """Return the choice among commands; None where the policy gives the numbers of a command."""
        return self.action[0] if self.action[0].kind == "choice" else None

    @property
    def axes(self) -> list[ActionChannel]:
        """Return the numbers of a command: the actions, or one for each axis of a choice with the ends of its table."""
        choice = self.choice
        if choice is None:
            return self.action
        assert choice.axes is not None  # checked by the channel
        assert choice.commands is not None
        columns = zip(*choice.commands, strict=True)
        return [
            ActionChannel(name=axis, kind=axis, lower=min(column), upper=max(column))
            for axis, column in zip(choice.axes, columns, strict=True)
        ]

    @property
    def command_kinds(self) -> frozenset[str]:
        """Return what a command consists of, by kind."""
        return frozenset(axis.kind for axis in self.axes if axis.kind != "other")

    @property
    def observation_size(self) -> int:
        """Return the length of the observation vector, all frames included."""
        return self.inputs.size

    @property
    def action_size(self) -> int:
        """Return the number of outputs: one for each action, or for each command of a choice."""
        return sum(action.outputs for action in self.action)

    @property
    def observation_sum(self) -> str:
        """Return how the size of the observation comes about, channel by channel, for messages."""
        parts = [_size_in_words(c.name, c.size, c.frames.count if c.frames else 1) for c in self.observation]
        if self.frames is None or self.frames.count == 1:
            return f"{', '.join(parts)} = {self.observation_size}"
        return f"({', '.join(parts)}) x {self.frames.count} frames = {self.observation_size}"

    @property
    def action_sum(self) -> str:
        """Return how the number of outputs comes about, action by action, for messages."""
        parts = [_size_in_words(action.name, action.outputs) for action in self.action]
        return f"{', '.join(parts)} = {self.action_size}"

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

    def columns(self, name: str) -> Indices:
        """Return the columns of the observation vector that a channel takes, in all its frames.

        Raises
        ------
        ConfigurationError
            If there is no such channel.
        """
        return self.inputs.columns(self.channel(name).name)

    def radii(self, eps: float | Mapping[str, float] | None = None) -> Floats:
        """Return the uncertainty of every observation entry.

        Parameters
        ----------
        eps : float or mapping or None
            One radius for all channels; or radii by channel name, where the name ``""`` gives the default of
            the others. A channel that is given no radius takes its own ``eps``. Fixed channels get 0, and so does a
            memory that is not named, since it is as it was recorded.

        Returns
        -------
        ndarray
            ``(observation_size,)`` float64, in the units of the sensors.

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
        return np.array([self._radius(channel, given) for channel in self.observation])[self.inputs.channel]

    @staticmethod
    def _radius(channel: ObservationChannel, given: Mapping[str, float]) -> float:
        if channel.value is not None:
            return 0.0
        if channel.kind == "memory":
            return float(given.get(channel.name, channel.eps or 0.0))
        radius = given.get(channel.name, given.get("", channel.eps))
        if radius is None:
            raise ConfigurationError(
                f"no eps is given for observation channel '{channel.name}'",
                f"add --eps {channel.name}=RADIUS, a common --eps RADIUS, or `eps:` to the channel",
            )
        return float(radius)

    def fixed_values(self) -> Floats:
        """Return ``(observation_size,)`` with what the network takes of every fixed entry, and NaN where it is free."""
        values = [
            np.nan if c.value is None else float(c.encoding.apply(np.array(c.value)))
            for c in self.observation
        ]
        return np.array(values, dtype=np.float64)[self.inputs.channel]

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


def _size_in_words(name: str, size: int, frames: int = 1) -> str:
    return f"{name} {size}" if frames == 1 else f"{name} {size} x {frames} frames = {size * frames}"


def _once_around(channel: Any) -> Any:
    """Return a channel whose field of view of 2 pi is told by its start and step."""
    lidar = channel.get("lidar") if isinstance(channel, dict) else None
    if not isinstance(lidar, dict):
        return channel
    view, rays = lidar.get("field_of_view"), lidar.get("rays")
    if (
        not isinstance(view, float | int)
        or not isinstance(rays, int)
        or rays < 1
        or abs(view - 2.0 * np.pi) > _FULL
    ):
        return channel
    rest = {key: value for key, value in lidar.items() if key != "field_of_view"}
    side = -1.0 if lidar.get("order") == "clockwise" else 1.0
    return {**channel, "lidar": {**rest, "start": -side * np.pi, "step": 2.0 * np.pi / rays}}
