"""What a specification says of the outputs of a policy: action channels, choices, and the rules around a policy."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, FiniteFloat, model_validator

from viatool.world.fields import Strict

CommandKind = Literal[
    "linear",
    "lateral",
    "angular",
    "linear_acceleration",
    "angular_acceleration",
    "steering",
    "left_wheel",
    "right_wheel",
]
"""Kinds of numbers that robots are commanded with."""

ActionKind = Literal[CommandKind, "choice", "other"]


class ActionChannel(Strict):
    """One action and the limits of the robot for it, or one choice among commands.

    Parameters
    ----------
    name, unit : str
        For people.
    kind : str
        What is commanded: ``linear`` (m/s, forward), ``lateral`` (m/s, to the left), ``angular`` (rad/s,
        counter-clockwise), ``linear_acceleration`` (m/s^2), ``angular_acceleration`` (rad/s^2), ``steering`` (rad, of
        the front wheels), ``left_wheel`` and ``right_wheel`` (m/s at the rim); ``choice``; or ``other``.
    lower, upper : float
        The range that the robot accepts, in the unit. Of a choice, the first and the last number of the table.
    scale, offset : float
        What the robot's software does with the network's output: ``scale * output + offset``; in schema version 2 the
        result is clipped to the range.
    entry : int, optional
        Which number of the output it is, from 0, where others are dropped; else the actions are all of them in order.
    axes : tuple of str, optional
        Of a choice: the kinds of the numbers in each command.
    commands : tuple of tuple of float, optional
        Of a choice: K commands; the network gives K numbers, and the largest of them says which command is sent.
    """

    name: Annotated[str, Field(min_length=1)]
    unit: str = ""
    lower: FiniteFloat
    upper: FiniteFloat
    kind: ActionKind = "other"
    scale: FiniteFloat = 1.0
    offset: FiniteFloat = 0.0
    entry: Annotated[int, Field(ge=0)] | None = None
    axes: tuple[CommandKind, ...] | None = None
    commands: tuple[tuple[FiniteFloat, ...], ...] | None = None

    @model_validator(mode="before")
    @classmethod
    def _numbered(cls, given: Any) -> Any:
        """Give a choice the range of its numbers."""
        if not isinstance(given, dict) or given.get("kind") != "choice":
            return given
        commands = given.get("commands")
        last = len(commands) - 1.0 if isinstance(commands, list | tuple) and commands else 0.0
        return {"lower": 0.0, "upper": last, **given}

    @model_validator(mode="after")
    def _consistent(self) -> ActionChannel:
        if self.lower > self.upper:
            raise ValueError(f"action '{self.name}': lower {self.lower} exceeds upper {self.upper}")
        if self.scale == 0.0:
            raise ValueError(f"action '{self.name}': scale is 0, so that the network would command nothing")
        if self.kind == "choice":
            self._check_table()
        elif self.axes is not None or self.commands is not None:
            raise ValueError(
                f"action '{self.name}' has a table of commands but kind '{self.kind}', not 'choice'"
            )
        return self

    def _check_table(self) -> None:
        if not self.axes or not self.commands or len(self.commands) < 2:
            raise ValueError(
                f"action '{self.name}' of kind 'choice' needs `axes` and at least two `commands`"
            )
        if self.scale != 1.0 or self.offset != 0.0 or self.entry is not None:
            raise ValueError(f"action '{self.name}' of kind 'choice' has no scale, no offset and no entry")
        twice = [axis for axis in self.axes if self.axes.count(axis) > 1]
        if twice:
            raise ValueError(f"action '{self.name}': axis '{twice[0]}' is given twice")
        for number, command in enumerate(self.commands):
            if len(command) != len(self.axes):
                raise ValueError(
                    f"action '{self.name}': command {number} has {len(command)} numbers for {len(self.axes)} axes "
                    f"({', '.join(self.axes)})"
                )

    @property
    def outputs(self) -> int:
        """Return how many numbers of the network it takes."""
        return len(self.commands) if self.commands is not None else 1


class ActionMap(Strict):
    """What the robot's software does with the raw output: ``scale * output + offset``, then a clip."""

    scale: list[FiniteFloat]
    offset: list[FiniteFloat]
    clip: bool = False


class Bound(Strict):
    """Where a rule applies: below or above a number, or between two; in the unit of the sensor.

    Of a channel with several numbers, such as a LiDAR, the rule applies when one of them is there.
    """

    below: FiniteFloat | None = None
    above: FiniteFloat | None = None

    @model_validator(mode="after")
    def _given(self) -> Bound:
        if self.below is None and self.above is None:
            raise ValueError("give `below` or `above`")
        if self.below is not None and self.above is not None and self.above >= self.below:
            raise ValueError(f"nothing is above {self.above} and below {self.below}")
        return self


class Override(Strict):
    """A rule that the robot's software wraps around the policy: a command that counts in its place.

    Parameters
    ----------
    when : mapping
        Observation channels, by name or kind, and where each has to be; all of them must hold.
    command : tuple of float
        What is sent then, in the order and units of the action channels, or of a choice's axes.
    """

    when: Annotated[dict[str, Bound], Field(min_length=1)]
    command: tuple[FiniteFloat, ...]
