"""What a channel of the observation observes, and the registry of its kinds.

A kind is one class, registered once under the name that specifications use. It gives the parts that it can; a part that
it lacks is refused by the channel's name and kind where that part is needed.
"""

from __future__ import annotations

from abc import ABC
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from typing import ClassVar, Literal, TypeVar

import numpy as np

from viatool.arrays import Floats, Hull, Indices, Reals
from viatool.channels.channel import Channel
from viatool.channels.views import BoxView, Extent, RecordedInstants, View
from viatool.errors import PolicyError
from viatool.sets.forms import Forms
from viatool.world import Robot

Part = Literal["measure", "record", "enclose", "bounds", "mirror"]

_FIX = "give the channel a fixed `value` in the specification"
_LACKING: dict[Part, tuple[str, str]] = {
    "measure": ("cannot be simulated", f"{_FIX}, or a recorded trajectory"),
    "record": ("is not in a bag", f"{_FIX}, or a table of states"),
    "enclose": ("is not known over a set of poses", f"{_FIX}, or verify recorded states alone"),
    "bounds": ("has no natural bounds", _FIX),
    "mirror": ("has no mirror image", f"{_FIX}, or train with `mirror: false`"),
}
"""What is said of a channel whose kind lacks a part, and what helps."""


@dataclass(frozen=True, eq=False)
class Quantity(ABC):
    """What one channel observes.

    Parameters
    ----------
    channel : Channel
        k numbers; its kind is this class.
    robot : Robot
        Whose sensors are meant where the channel does not describe one, and whose limits bound commands.

    Notes
    -----
    A kind overrides the parts that it has: `measure`, `record`, `enclose`, `bounds` and `mirror`.
    """

    channel: Channel
    robot: Robot

    needs: ClassVar[frozenset[str]] = frozenset()
    """What it takes beyond poses: "scan", "goal", "command" of a recording; "outputs" of the network; "time" left."""

    believes: ClassVar[bool] = True
    """Whether it may depend on the pose that the robot believes."""

    placed: ClassVar[bool] = True
    """Whether it follows from where the robot is; else how it came there counts, as for a command before."""

    wraps: ClassVar[bool] = False
    """Whether it is an angle within a half turn, so that a set of states may be observed on both of its sides."""

    @classmethod
    def check(cls, channel: Channel) -> None:
        """Check the specification of a channel of this kind: one number, and no LiDAR, unless overridden.

        Raises
        ------
        ValueError
            Names the channel and what was expected.
        """
        refuse_lidar(channel)
        if channel.size != 1:
            raise ValueError(
                f"channel '{channel.name}' of kind '{channel.kind}' has size 1, not {channel.size}"
            )

    def measure(self, view: View) -> Reals:
        """Return what B robots observe in a simulation, (B, k) or (B,), without what sensors err."""
        raise self.lacks("measure")

    def record(self, recorded: RecordedInstants) -> Floats:
        """Return what was observed at S instants of a recording, (S, k) or (S,)."""
        raise self.lacks("record")

    def enclose(self, view: BoxView) -> Forms:
        """Enclose what perfect sensors observe anywhere in C sets of states, (C, k). Sound: yes."""
        raise self.lacks("enclose")

    def bounds(self, extent: Extent) -> tuple[float, float]:
        """Return the least and the largest number that `measure` gives on a map."""
        raise self.lacks("bounds")

    def told_of(self, axis: int, made: Indices) -> Indices:
        """Return which of its numbers tell of an axis of the command before; outputs make entries (K,) of it."""
        return np.zeros(0, np.int64)

    def require_limits(self, lower: Floats, upper: Floats) -> Hull:
        """Return ends (..., k) of what it takes beyond poses, where they make a difference to the channel.

        Raises
        ------
        PolicyError
            If one of them is infinite.
        """
        raise self.lacks("enclose")

    def mirror(self) -> tuple[Indices, Floats]:
        """Return which numbers, (k,), times which signs, (k,), are observed in the scene's mirror image."""
        raise self.lacks("mirror")

    def has(self, part: Part) -> bool:
        """Tell whether the kind has a part."""
        return getattr(type(self), part) is not getattr(Quantity, part)

    @property
    def knows_its_pose(self) -> bool:
        """Tell whether it is enclosed over poses that the robot believes, instead of its true ones."""
        return self.believes and self.has("enclose")

    def require(self, part: Part) -> None:
        """Refuse a channel whose kind lacks a part, or which does not say enough for it.

        Raises
        ------
        PolicyError
            Names the channel and its kind.
        """
        if not self.has(part):
            raise self.lacks(part)

    def lacks(self, part: Part) -> PolicyError:
        """Return the refusal of a part that the kind does not have."""
        reason, hint = _LACKING[part]
        return PolicyError(f"{self.channel} {reason}", hint)


class Fixed(Quantity):
    """A constant, of whatever kind its channel is."""

    believes = False

    @property
    def _value(self) -> float:
        assert self.channel.value is not None
        return self.channel.value

    def measure(self, view: View) -> Reals:
        """Return the constant."""
        return np.full((len(view), self.channel.size), self._value)

    def record(self, recorded: RecordedInstants) -> Floats:
        """Return the constant."""
        return np.full((len(recorded.poses), self.channel.size), self._value)

    def enclose(self, view: BoxView) -> Forms:
        """Return the constant."""
        return view.constant(self._value, self.channel.size)

    def bounds(self, extent: Extent) -> tuple[float, float]:
        """Return the constant twice."""
        return self._value, self._value

    def mirror(self) -> tuple[Indices, Floats]:
        """Return the channel as it is."""
        return np.arange(self.channel.size), np.ones(self.channel.size)


_KINDS: dict[str, type[Quantity]] = {}
_Kind = TypeVar("_Kind", bound=type[Quantity])


def observes(kind: str) -> Callable[[_Kind], _Kind]:
    """Register a class for a kind of channel.

    Raises
    ------
    ValueError
        If the kind is registered already.
    """

    def register(quantity: _Kind) -> _Kind:
        if kind in _KINDS:
            raise ValueError(f"the kind of observation '{kind}' is registered twice")
        _KINDS[kind] = quantity
        return quantity

    return register


def kinds() -> Mapping[str, type[Quantity]]:
    """Return all kinds of channels by name."""
    return dict(_KINDS)


def kind_named(kind: str) -> type[Quantity]:
    """Return the class of a kind of channel.

    Raises
    ------
    ValueError
        If there is none; names the nearest that there is.
    """
    if kind in _KINDS:
        return _KINDS[kind]
    close = get_close_matches(kind, list(_KINDS), n=1, cutoff=0.0)
    raise ValueError(f"kind '{kind}' is not known, nearest is '{close[0]}'; known: {', '.join(_KINDS)}")


def quantity_of(channel: Channel, robot: Robot | None = None) -> Quantity:
    """Return what a channel observes; a fixed one is a constant, whatever its kind."""
    found = kind_named(channel.kind) if channel.value is None else Fixed
    return found(channel, Robot() if robot is None else robot)


def refuse_lidar(channel: Channel) -> None:
    """Refuse a LiDAR section where it has no meaning."""
    if channel.lidar is not None:
        raise ValueError(f"channel '{channel.name}' has a lidar section but kind '{channel.kind}'")
