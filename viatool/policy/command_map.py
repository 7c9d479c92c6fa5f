"""From the actions of a policy to what its robot is commanded with: one door, for proofs and for runs alike.

A policy names what its numbers are, in an order of its own; a kinematics says what a command is. A command map puts
the two together. `CommandMap.follow` extends a network by nodes, so that its outputs are the entries of the command in
the order of the axes: bounds of the extended network are bounds of the command, and what the entries have in common is
kept. Calling a map does the same to numbers that a program gave.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from viatool.arrays import Floats
from viatool.errors import PolicyError
from viatool.motion.kinematics import KINEMATICS
from viatool.motion.law import Kinematics
from viatool.policy.action_channels import ActionChannel
from viatool.policy.action_map import Limits, behind, clipped, joined, picked
from viatool.policy.activations import ActivationFunction, activation
from viatool.policy.assembly import Assembly, Computed, Term
from viatool.policy.network import Network
from viatool.policy.specification import PolicySpecification
from viatool.world import Robot


@dataclass(frozen=True)
class CommandMap(ABC):
    """How A entries of a command come from O actions.

    Parameters
    ----------
    columns : tuple of int
        Which actions it takes.
    channels : tuple of ActionChannel
        What these are.
    actions : int
        O, how many the policy gives.
    """

    columns: tuple[int, ...]
    channels: tuple[ActionChannel, ...]
    actions: int

    @property
    def kinds(self) -> tuple[str, ...]:
        """Return the kinds of the actions that it takes, in the order of `columns`."""
        return tuple(channel.kind for channel in self.channels)

    @property
    def changes_nothing(self) -> bool:
        """Tell whether the actions are the command as they are."""
        return False

    @abstractmethod
    def __call__(self, actions: Floats) -> Floats:
        """Return the commands (..., A) of actions (..., O), in float64."""

    @abstractmethod
    def compute(self, assembly: Assembly, actions: Computed) -> Computed:
        """Add the nodes that compute a command, (A,), from the actions, (O,)."""

    def of_axes(self, numbers: Floats) -> Floats:
        """Return the command (..., A) that numbers in the order of the specification's axes stand for."""
        return self(numbers)

    def follow(self, network: Network) -> Network:
        """Return a network of O outputs followed by the map, in float64."""
        if self.changes_nothing:
            return network
        assembly, actions = behind(network)
        return assembly.network(self.compute(assembly, actions))


@dataclass(frozen=True)
class Picked(CommandMap):
    """Each entry is one of the actions, as it is."""

    @property
    def changes_nothing(self) -> bool:
        """Tell whether they stand in the order of the axes, and nothing else beside them."""
        return self.columns == tuple(range(self.actions))

    def __call__(self, actions: Floats) -> Floats:
        """See `CommandMap`."""
        return np.asarray(actions[..., list(self.columns)])

    def compute(self, assembly: Assembly, actions: Computed) -> Computed:
        """Copy them, which is exact; see `CommandMap`."""
        return picked(assembly, actions, self.columns)


@dataclass(frozen=True)
class Wheels(CommandMap):
    """The speeds of the rims of the left and the right wheels: half their sum ahead, and their difference turns.

    Parameters
    ----------
    track : float
        Metres between the wheels.
    """

    track: float

    @property
    def limits(self) -> Limits:
        """Return the least and the largest speed of each rim, in m/s; faster ones are clipped."""
        return tuple((channel.lower, channel.upper) for channel in self.channels)

    @property
    def matrix(self) -> Floats:
        """Return what makes speed and turning speed of the speeds of the rims, (2, 2)."""
        return np.array([[0.5, 0.5], [-1.0 / self.track, 1.0 / self.track]])

    def __call__(self, actions: Floats) -> Floats:
        """See `CommandMap`."""
        rims = np.clip(actions[..., list(self.columns)], *np.transpose(self.limits))
        return np.asarray(rims @ self.matrix.T)

    def compute(self, assembly: Assembly, actions: Computed) -> Computed:
        """Clip each rim, and add and subtract; the reciprocal of the track is rounded once. See `CommandMap`."""
        rims = clipped(assembly, picked(assembly, actions, self.columns), self.limits)
        return assembly.affine([Term(rims, self.matrix)], np.zeros(2), (2,), "float64", roundings=1)


@dataclass(frozen=True)
class Steered(CommandMap):
    """The speed of the rear axle and the angle of the front wheels: ``omega = v tan(angle) / wheelbase``.

    Parameters
    ----------
    limits : tuple of pairs
        The least and the largest speed in m/s and angle in rad that the robot carries out; others are clipped first,
        so that the turning speed is that of the speed which is driven.
    wheelbase : float
        Metres between the axles.
    """

    limits: Limits
    wheelbase: float

    def __call__(self, actions: Floats) -> Floats:
        """See `CommandMap`."""
        speed, angle = np.moveaxis(actions[..., list(self.columns)], -1, 0)
        speed = np.clip(speed, *self.limits[0])
        return np.stack([speed, speed * self._tangent(angle) * (1.0 / self.wheelbase)], axis=-1)

    def compute(self, assembly: Assembly, actions: Computed) -> Computed:
        """Multiply the clipped speed and the tangent of the clipped angle; see `CommandMap`."""
        speed, angle = (picked(assembly, actions, (column,)) for column in self.columns)
        low, high = self.limits[0]
        speed = assembly.activation(speed, activation("Clip", min=low, max=high))
        bent = assembly.product(speed, assembly.activation(angle, self._tangent))
        return joined(assembly, [speed, assembly.scaled(bent, 1.0 / self.wheelbase, roundings=1)])

    @property
    def _tangent(self) -> ActivationFunction:
        low, high = self.limits[1]
        return activation("ClippedTan", min=low, max=high)


@dataclass(frozen=True)
class Chosen(CommandMap):
    """The command of a table whose number is that of the largest of O outputs, of equal ones the first.

    Networks keep the outputs that are compared: which commands are possible is for `viatool.reach` to say.

    Parameters
    ----------
    numbers : CommandMap
        Of the numbers in a command.
    table : tuple of tuple of float
        O of them.
    """

    numbers: CommandMap
    table: tuple[tuple[float, ...], ...]

    @property
    def commands(self) -> Floats:
        """Return all commands, (O, A)."""
        return self.numbers(np.array(self.table))

    def __call__(self, actions: Floats) -> Floats:
        """See `CommandMap`; what is not known to be chosen is NaN."""
        known = np.isfinite(actions).all(axis=-1, keepdims=True)
        return np.where(known, self.commands[np.argmax(actions, axis=-1)], np.nan)

    def of_axes(self, numbers: Floats) -> Floats:
        """See `CommandMap`."""
        return self.numbers(numbers)

    def compute(self, assembly: Assembly, actions: Computed) -> Computed:
        """Add nothing: what is compared stays as it is."""
        return actions


def command_map(
    spec: PolicySpecification, kinematics: Kinematics, robot: Robot, name: str = "the policy"
) -> CommandMap:
    """Return how a robot is commanded by a policy.

    Parameters
    ----------
    spec : PolicySpecification
        Its actions.
    kinematics : Kinematics
        Of the robot.
    robot : Robot
        Its wheels.
    name : str
        Of the policy, for messages.

    Raises
    ------
    PolicyError
        If the robot cannot be commanded with what the policy gives.
    ConfigurationError
        If what the command depends on is not known of the robot.
    """
    kinds: list[str] = [channel.kind for channel in spec.axes]
    for taken in kinematics.takes:
        if spec.command_kinds == set(taken):
            columns = tuple(kinds.index(kind) for kind in taken)
            parts = columns, tuple(spec.axes[column] for column in columns), len(kinds)
            own = tuple(axis.kind for axis in kinematics.axes)
            numbers = _picked(parts, robot) if taken == own else _MAPS[taken](parts, robot)
            choice = spec.choice
            if choice is None:
                return numbers
            assert choice.commands is not None  # checked by the channel
            return Chosen(numbers.columns, numbers.channels, choice.outputs, numbers, choice.commands)
    raise _refusal(spec.command_kinds, kinematics, name)


Parts = tuple[tuple[int, ...], tuple[ActionChannel, ...], int]


def _picked(parts: Parts, robot: Robot) -> CommandMap:
    return Picked(*parts)


def _wheels(parts: Parts, robot: Robot) -> CommandMap:
    return Wheels(*parts, track=robot.known("track"))


def _steered(parts: Parts, robot: Robot) -> CommandMap:
    speed, angle = parts[1]
    able = (robot.min_linear, robot.max_linear), (-robot.max_steering, robot.max_steering)
    limits = tuple(
        (max(asked.lower, low), min(asked.upper, high))
        for asked, (low, high) in zip((speed, angle), able, strict=True)
    )
    return Steered(*parts, limits, robot.known("wheelbase"))


_MAPS: dict[tuple[str, ...], Callable[[Parts, Robot], CommandMap]] = {
    ("left_wheel", "right_wheel"): _wheels,
    ("linear", "steering"): _steered,
}
"""How commands come of kinds that are not the axes themselves."""


def _refusal(named: frozenset[str], kinematics: Kinematics, name: str) -> PolicyError:
    """Return why actions of these kinds command no robot of a kinematics."""
    whole = any(named == set(taken) for one in KINEMATICS.values() for taken in one.takes)
    for taken in kinematics.takes:
        missing = [kind for kind in taken if kind not in named]
        if named < set(taken) and not whole:
            return PolicyError(
                f"no action of {name} is of kind '{missing[0]}'",
                "name the kinds of the actions in the specification",
            )
    return PolicyError(
        f"{name} commands {_listed(sorted(named))}, a robot of kinematics '{kinematics.name}' takes "
        f"{' or '.join(_listed(taken) for taken in kinematics.takes)}",
        "correct the kinds of the actions in the specification, or the `kinematics` of the map's robot",
    )


def _listed(kinds: Sequence[str]) -> str:
    return ", ".join(kinds[:-1]) + (" and " if len(kinds) > 1 else "") + kinds[-1]
