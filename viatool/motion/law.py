"""What a kinematics declares: the door through which every other room takes the law of motion.

A command has A entries, the *axes*. It is held, and moves the robot along a path; the *fraction* s of the path runs
from 0 to 1 and the pose at s is what holding the command for s of the time gives. Rooms ask a kinematics

- where one command leads (`advance`), which commands a robot carries out (`limits`), how fast they are (`rates`);
- how far the path of any command of a box is from that of its centre (`deviation`), and one instant from another
  (`sagitta`, `outline_motion`), which is what clearances are proved with;
- where a whole set of states leads (`successor`, `displacement`), which is what tubes are made of;
- which way displacements and points of the body go (`directions`, `velocities`), for what retreats.

All laws are the same wherever the robot is and however it is turned. A *state* of the motion beyond the pose (the speed
that an acceleration changes, the angle of steered wheels) is declared in `state`; the previous command is not one:
it is only observed. What moves a robot is then the command together with the state in which it is given: wherever a law
takes commands (..., A), it takes (..., A + S), the state behind the command, and a box of them is a box of both.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np
from numpy.typing import ArrayLike

from viatool.arrays import Booleans, Floats, Hull, Plane
from viatool.sets.forms import Forms, PoseBoxes


class Timed(Protocol):
    """For how long a command is held, and how long its path lasts."""

    @property
    def interval(self) -> float:
        """Seconds for which the command acts; afterwards the robot keeps its velocity."""

    def seconds(self, speed: Floats, turn: Floats) -> Floats:
        """Return how long the path lasts, of the speed and turn at the end of the interval; grows with both."""


class Limited(Protocol):
    """What a kinematics reads of a robot."""

    @property
    def min_linear(self) -> float:
        """Smallest speed along x, in m/s."""

    @property
    def max_linear(self) -> float:
        """Largest speed along x, in m/s."""

    @property
    def max_angular(self) -> float:
        """Largest turning speed to either side, in rad/s."""

    @property
    def max_lateral(self) -> float:
        """Largest speed to either side, in m/s."""

    @property
    def wheelbase(self) -> float:
        """Distance between the axles, in metres."""

    @property
    def max_steering(self) -> float:
        """Largest angle of the steered wheels to either side, in rad."""

    @property
    def max_steering_rate(self) -> float:
        """How fast they turn, in rad/s; 0 for at once."""

    @property
    def min_acceleration(self) -> float:
        """Smallest acceleration along x, in m/s^2."""

    @property
    def max_acceleration(self) -> float:
        """Largest acceleration along x, in m/s^2."""

    @property
    def max_angular_acceleration(self) -> float:
        """Largest acceleration of the turn to either side, in rad/s^2."""


@dataclass(frozen=True)
class Axis:
    """One entry of a command, or of a state.

    Parameters
    ----------
    name, unit : str
        As reports write them.
    kind : str
        That of the action channel which holds it: "linear", "angular". A policy that observes its previous command
        has channels of the kinds ``previous_linear`` and so on.
    """

    name: str
    unit: str
    kind: str


@dataclass(frozen=True, eq=False)
class PathDeviation:
    """How far the commands of C boxes lead from where those of their centres lead, at equal fractions.

    Parameters
    ----------
    away, turned : ndarray
        (C,) metres for the robot's origin, radians for its heading.
    shares : ndarray
        (C, A) metres that the extent along each axis adds, roughly: which one to cut.
    """

    away: Floats
    turned: Floats
    shares: Floats


@dataclass(frozen=True, eq=False)
class Directions:
    """Where the displacements of commands point, relative to the heading they begin with.

    Parameters
    ----------
    right, left : ndarray
        (C,) radians; the displacement at every instant is 0 or points between them. Where it may point anywhere they
        are -pi and pi.
    still : ndarray
        (C,) bool: no command of the box moves the robot's origin at all.
    """

    right: Floats
    left: Floats
    still: Booleans


def _words(axes: tuple[Axis, ...], lower: Floats, upper: Floats) -> str:
    return ", ".join(
        f"{axis.name} {low:g} to {high:g} {axis.unit}"
        if low > -np.inf or high < np.inf
        else f"{axis.name} unlimited"
        for axis, low, high in zip(axes, lower, upper, strict=True)
    )


class Kinematics(ABC):
    """How a robot moves while it holds a command.

    Attributes
    ----------
    name : str
        As a map file names it.
    description : str
        In a few words, for reports.
    axes : tuple of Axis
        A of them: what a command is.
    state : tuple of Axis
        What the motion depends on beyond the pose; none for a robot that has the speed it is told to have.
    """

    name: ClassVar[str]
    description: ClassVar[str]
    axes: ClassVar[tuple[Axis, ...]]
    state: ClassVar[tuple[Axis, ...]] = ()

    @property
    def takes(self) -> tuple[tuple[str, ...], ...]:
        """Return the kinds of actions that make up a command: one set of them, or one of several, the usual first."""
        return (tuple(axis.kind for axis in self.axes),)

    @property
    def before(self) -> tuple[Axis, ...]:
        """Return what sets of states hold beside poses: the state of the motion; without one, the command before."""
        return self.state or self.axes

    def fitted(self, robot: Limited) -> Kinematics:
        """Return the kinematics with what it has to know of a robot: itself, unless its motion has a state."""
        return self

    def carried_out(self, robot: Limited, commands: Floats) -> Floats:
        """Return commands (..., A) within `limits` as a robot carries them out, if one axis limits another."""
        return commands

    @property
    def parameters(self) -> dict[str, float]:
        """Return the numbers that it knows of its robot by name; none of a kinematics without a state."""
        return {}

    @property
    def state_range(self) -> tuple[Floats, Floats]:
        """Return the ends of the state of a fitted kinematics, (S,) each; infinite where nothing limits it."""
        return np.zeros(0), np.zeros(0)

    def after(self, held: Floats, seconds: ArrayLike) -> Floats:
        """Return the state (..., S) after commands with their state (..., A + S) were held."""
        return np.zeros((*held.shape[:-1], 0))

    def reached(self, lower: Floats, upper: Floats, seconds: float) -> tuple[Floats, Floats]:
        """Return the ends (C, S) of the state after commands of boxes with theirs (C, A + S). **Sound:** yes."""
        nothing = np.zeros((len(lower), 0))
        return nothing, nothing

    def recalled(self, before: Floats, command: Floats | None = None) -> tuple[Floats, Floats | None]:
        """Return the command before (B, A), and the velocity (B, 3) if that is another one, of states (B, K).

        Of a state of the motion it does not follow which command led there, unless that (B, A) is given.
        """
        return before, None

    def axis(self, kind: str) -> int | None:
        """Return the number of the axis of a kind; None if there is none."""
        return next((number for number, axis in enumerate(self.axes) if axis.kind == kind), None)

    def clip(self, commands: Floats, robot: Limited) -> Floats:
        """Return commands (..., A) as a robot carries them out; monotone, so ends of a box map to ends."""
        return np.clip(commands, *self.limits(robot))

    def range_words(self, lower: Floats, upper: Floats) -> str:
        """Return the ends (A,) of commands in words."""
        return _words(self.axes, lower, upper)

    @property
    def state_words(self) -> str:
        """Return the ends of the state in words; nothing without one."""
        return _words(self.state, *self.state_range)

    @abstractmethod
    def limits(self, robot: Limited) -> tuple[Floats, Floats]:
        """Return the smallest and the largest command that a robot carries out, (A,) each."""

    @abstractmethod
    def advance(self, states: Floats, commands: Floats, seconds: ArrayLike) -> Floats:
        """Move while commands are held.

        Parameters
        ----------
        states : ndarray
            (..., 3 + S) x, y, theta, and the state of its own; metres and radians.
        commands : ndarray
            (..., A).
        seconds : array_like
            (...) time.

        Returns
        -------
        ndarray
            (..., 3 + S) with theta in (-pi, pi].
        """

    @abstractmethod
    def rates(self, lower: Floats, upper: Floats, seconds: float) -> tuple[Floats, Floats]:
        """Bound the speed in m/s and the turning speed in rad/s, (...) each, of commands of boxes (..., A).

        They hold at every instant until `seconds`. Without a state, and for boxes of one command, these are what it
        drives and turns at, not only bounds.
        """

    def last_rates(self, lower: Floats, upper: Floats, seconds: float) -> tuple[Floats, Floats]:
        """Bound the same after `seconds`; for boxes of one command these are what it then drives and turns at."""
        return self.rates(lower, upper, seconds)

    def drive(self, poses: Floats, commands: Floats, seconds: ArrayLike, until: float) -> Floats:
        """Return poses (..., 3) after commands acted for up to `until` seconds, and the velocity stayed after it."""
        return self.advance(poses, commands, seconds)

    @abstractmethod
    def deviation(
        self, lower: Floats, upper: Floats, until: Floats, rim: float, timed: Timed
    ) -> PathDeviation:
        """Bound how far any command of a box leads from where its centre leads.

        Parameters
        ----------
        lower, upper : ndarray
            (C, A) ends of commands.
        until : ndarray
            (C,) the last fraction of the path that counts.
        rim : float
            Metres to the outermost point that turns with the robot; only for the shares.
        timed : Timed
            For how long a command is held.

        Notes
        -----
        Sound: yes, up to rounding in proportion to the path and the turn.
        """

    @abstractmethod
    def loss(self, width: Floats, speed: Floats, seconds: Floats) -> Floats:
        """Return how far widths of commands (C, A) spread the place after some seconds, roughly: (C, A) metres.

        Nothing is proved with it; it says which axis to cut.
        """

    @abstractmethod
    def sagitta(self, commands: Floats, timed: Timed, span: Floats) -> Floats:
        """Bound how far the path of commands (C, A) leaves its chord between fractions that are `span` (C,) apart."""

    @abstractmethod
    def outline_motion(self, length: Floats, turn: Floats, span: Floats, rim: float) -> Floats:
        """Bound how far an outline within `rim` moves from the middle of a `span` of fractions to its ends, (C,)."""

    @abstractmethod
    def displacement(
        self, boxes: PoseBoxes, lower: Floats, upper: Floats, seconds: float
    ) -> tuple[Floats, Floats]:
        """Bound what commands of boxes (C, A) add to x, y and theta of poses of boxes, (C, 3) each. **Sound:** yes.

        A robot without speed adds exactly 0 to its place; everything else is rounded outward.
        """

    @abstractmethod
    def successor(self, states: Forms, seconds: float, slack: Floats, known: Hull | None = None) -> Forms:
        """Move sets of poses along the paths of sets of commands.

        Parameters
        ----------
        states : Forms
            (C, 3 + A + S) x, y, theta, the command that is held, and the state in which it is given.
        seconds : float
            For how long.
        slack : ndarray
            (C,) metres that cover rounding.
        known : tuple of ndarray, optional
            (C, A + S) ends of what is held, where more is known of it than the forms say.

        Returns
        -------
        Forms
            (C, 3 + S) poses, and states of the motion, in the same symbols; headings are not wrapped.

        Notes
        -----
        Sound: yes, for each value of the symbols.
        """

    @abstractmethod
    def directions(self, lower: Floats, upper: Floats, timed: Timed) -> Directions:
        """Bound where the displacements of commands of boxes (C, A) point, up to any instant of the path."""

    @abstractmethod
    def velocities(self, lower: Floats, upper: Floats, seconds: float) -> tuple[Plane, Floats]:
        """Return velocities of the body whose convex hull holds those of all commands of boxes (C, A) until `seconds`.

        Returns
        -------
        tuple of ndarray
            (C, K) velocity of the origin in the robot's frame, as complex numbers in m/s, and (C, K) rad/s.
        """

    def from_elsewhere(self, radii: Floats, way: Floats, rim: float) -> tuple[Floats, Floats]:
        """Bound how far other poses of boxes bring a point from where the centre pose brings it.

        Parameters
        ----------
        radii : ndarray
            (C, 3) half-widths of the boxes of poses.
        way : ndarray
            (C,) metres that the command drives at most.
        rim : float
            Metres from the robot's origin to the point.

        Returns
        -------
        tuple of ndarray
            (C,) metres for other places, and for other headings.

        Notes
        -----
        Sound: yes. From a pose that is D away and turned by delta a command leads at most ``|D| + |way| |delta|`` away
        from where it leads from the centre, as the way turns with the heading; the point adds ``rim |delta|``.
        """
        return np.hypot(radii[:, 0], radii[:, 1]), np.asarray((way + rim) * radii[:, 2])
