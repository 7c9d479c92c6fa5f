"""Robots that have the velocity they are told to have: a command is a constant velocity in the robot's frame.

A command of velocity u (a complex number, x ahead and y to the left) and turning speed omega that is held for t seconds
moves the robot along an arc of length ``|l|``, ``l = u t``, that turns it by ``phi = omega t``. With
``e(a) = (cos a, sin a)``, the position after the fraction s of the arc is

    p(s) = p + s l int_0^1 e(theta + s phi w) dw = p + s l * sinc(s phi / 2) * e(theta + s phi / 2).

*Other commands.* ``p(s; l, phi) - p(s; l_c, phi_c)`` is at most

    s |l - l_c| + s |l_c| int_0^1 |e(s phi w) - e(s phi_c w)| dw  <=  s |l - l_c| + s^2 |l_c| |phi - phi_c| / 2,

because ``|e(a) - e(b)| <= |a - b|``, whatever the turns. The extremes of each part of l and of phi over a box are
attained at the ends of that part with the other parts all smallest or all largest, since the time grows with the speed
and the turning speed.

*Other instants.* Between two fractions the position follows the chord linearly up to ``|l phi| span^2 / 8``, the error
of linear interpolation for the second derivative ``|l phi|``.

*Sets.* The displacement is ``F = u int_0^T e^(i (theta + omega s)) ds``. With a, b and c the largest deviations of u,
theta and omega from the middle, Taylor's theorem leaves out, of each component, at most

    a (T b + T^2 c / 2) + |u| (T b^2 + T^2 b c + T^3 c^2 / 3) / 2,

as the second derivatives of F are bounded by ``T`` and ``T^2 / 2`` (u with theta and omega) and ``|u|`` times ``T``,
``T^2 / 2`` and ``T^3 / 3``. The heading ``theta + omega T`` is linear.
"""

from __future__ import annotations

from typing import ClassVar, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from viatool.arrays import Floats, Hull, Plane
from viatool.motion.arcs import cosine_range, drive_arc, least_sinc, sinc, swing
from viatool.motion.law import Directions, Kinematics, PathDeviation, Timed
from viatool.rounding import SLIGHTLY, SLIGHTLY_MORE
from viatool.sets.forms import Forms, PoseBoxes

Part = Literal["ahead", "left", "turn"]
PARTS: tuple[Part, ...] = get_args(Part)


class HeldTwist(Kinematics):
    """A kinematics whose axes are parts of a velocity in the robot's frame.

    Attributes
    ----------
    velocity : tuple of str
        What each axis is: the speed ahead, the speed to the left, or the turning speed.

    Notes
    -----
    A subclass that names its axes, what they are and their limits is complete.
    """

    velocity: ClassVar[tuple[Part, ...]]

    @property
    def slides(self) -> bool:
        """Tell whether the robot can move to its side."""
        return "left" in self.velocity

    def parts(self, commands: Floats) -> tuple[Floats, Floats, Floats]:
        """Return the speed ahead, to the left, and the turning speed of commands (..., A), each (...)."""
        ahead, left, turn = (self._part(commands, part) for part in PARTS)
        return ahead, left, turn

    def _part(self, commands: Floats, part: Part) -> Floats:
        if part not in self.velocity:
            return np.zeros(commands.shape[:-1])
        return np.asarray(commands[..., self.velocity.index(part)])

    def advance(self, states: Floats, commands: Floats, seconds: ArrayLike) -> Floats:
        """Move along exact arcs, see `Kinematics.advance`."""
        ahead, left, turn = self.parts(commands)
        return drive_arc(states, ahead, turn, seconds, left if self.slides else None)

    def rates(self, lower: Floats, upper: Floats, seconds: float) -> tuple[Floats, Floats]:
        """See `Kinematics.rates`."""
        ahead, left, turn = self.parts(np.maximum(np.abs(lower), np.abs(upper)))
        return _speed(ahead, left), turn

    def deviation(
        self, lower: Floats, upper: Floats, until: Floats, rim: float, timed: Timed
    ) -> PathDeviation:
        """See `Kinematics.deviation`, and the module for why."""
        centre = self.parts(0.5 * (lower + upper))
        length = _speed(*centre[:2])
        time = timed.seconds(length, np.abs(centre[2]))
        length = length * time
        ahead, left, turned = path_radii(self.parts(lower), self.parts(upper), timed)
        heading = until * turned
        away = until * _speed(ahead, left) + sideways(until * length, heading)
        moves = np.array([part != "turn" for part in self.velocity])
        each = until[:, None] * np.where(moves, 1.0, (0.5 * until * length + rim)[:, None])
        return PathDeviation(away, heading, each * (0.5 * (upper - lower) * time[:, None]))

    def loss(self, width: Floats, speed: Floats, seconds: Floats) -> Floats:
        """See `Kinematics.loss`."""
        turning = np.array([part == "turn" for part in self.velocity])
        by_turn = 0.5 * speed[:, None] * width * np.square(seconds)[:, None]
        return np.where(turning, by_turn, width * seconds[:, None])

    def sagitta(self, commands: Floats, timed: Timed, span: Floats) -> Floats:
        """See `Kinematics.sagitta`."""
        speed, turn = self.rates(commands, commands, timed.interval)
        return np.asarray(0.125 * speed * turn * np.square(timed.seconds(speed, turn) * span))

    def outline_motion(self, length: Floats, turn: Floats, span: Floats, rim: float) -> Floats:
        """See `Kinematics.outline_motion`."""
        return np.asarray(0.5 * (length + rim * turn) * span)

    def displacement(
        self, boxes: PoseBoxes, lower: Floats, upper: Floats, seconds: float
    ) -> tuple[Floats, Floats]:
        """Bound displacements by chords, ``u T sinc(omega T / 2)`` turned by ``theta + omega T / 2``.

        See `Kinematics.displacement`. Beside the forms of `successor` it knows that a robot without speed stays exactly
        where it is, and that one which turns by less than a circle does not move backwards.
        """
        (ahead, left, turn), (fastest_ahead, fastest_left, fastest_turn) = (
            self.parts(lower),
            self.parts(upper),
        )
        half = 0.5 * seconds
        first = boxes.centre[:, 2] - boxes.radius[:, 2] + half * turn
        last = boxes.centre[:, 2] + boxes.radius[:, 2] + half * fastest_turn
        least_share = least_sinc(half * np.maximum(np.abs(turn), np.abs(fastest_turn)))
        least, most = _chords(ahead * seconds, fastest_ahead * seconds, least_share, first, last)
        if self.slides:
            quarter = 0.5 * np.pi
            aside = _chords(
                left * seconds, fastest_left * seconds, least_share, first + quarter, last + quarter
            )
            least, most = least + aside[0], most + aside[1]
        least, most = (
            np.column_stack([least, turn * seconds]),
            np.column_stack([most, fastest_turn * seconds]),
        )
        return least - SLIGHTLY * np.abs(least), most + SLIGHTLY * np.abs(most)

    def successor(self, states: Forms, seconds: float, slack: Floats, known: Hull | None = None) -> Forms:
        """Move along the arcs of the commands, linearised at the middle; see `Kinematics.successor`."""
        theta, command = states.centre[:, 2], states.centre[:, 3:]
        ahead, left, turn = self.parts(command)
        velocity = ahead + 1j * left if self.slides else ahead
        spread = np.abs(states.slope).sum(axis=1) + states.rest
        own = self.parts(spread[:, 3:])
        half = 0.5 * turn * seconds
        along = np.exp(1j * (theta + half))
        chord = seconds * sinc(half) * along  # F / u
        moved = velocity * chord
        swung = 0.5 * seconds**2 * velocity * along * (1j * sinc(half) - swing(half))
        left_out = second_order(np.abs(velocity), own[0] + own[1], spread[:, 2], own[2], seconds)
        by_part = {"ahead": chord, "left": 1j * chord, "turn": swung}
        gradient = np.stack([1j * moved, *(by_part[part] for part in self.velocity)], axis=1)  # (C, 1 + A)
        shift = np.einsum("csk,ck->cs", states.slope[:, :, 2:], gradient)
        rest = states.rest[:, 2:]
        own_shift = (rest * np.abs(gradient.real)).sum(axis=1), (rest * np.abs(gradient.imag)).sum(axis=1)
        turned = self.parts(states.slope[:, :, 3:])[2], self.parts(states.rest[:, 3:])[2]
        centre = [states.centre[:, 0] + moved.real, states.centre[:, 1] + moved.imag, theta + turn * seconds]
        slope = [shift.real, shift.imag, seconds * turned[0]]
        added = [own_shift[0] + left_out, own_shift[1] + left_out, seconds * turned[1]]
        return Forms(
            np.stack(centre, axis=1),
            states.slope[:, :, :3] + np.stack(slope, axis=2),
            states.rest[:, :3] + np.stack(added, axis=1) + slack[:, None],
        )

    def directions(self, lower: Floats, upper: Floats, timed: Timed) -> Directions:
        """See `Kinematics.directions`: half of the turn, for a robot that drives ahead and turns by less than a circle.

        Beyond a circle the chord points backwards.
        """
        speed, fastest = self.rates(lower, upper, timed.interval)
        half = 0.5 * timed.seconds(speed, fastest)
        ahead, _, turn = self.parts(lower)
        right, left = half * np.minimum(turn, 0.0), half * np.maximum(self.parts(upper)[2], 0.0)
        held = (ahead >= 0.0) & (left - right < np.pi)
        if self.slides:
            aside = np.maximum(np.abs(self.parts(lower)[1]), np.abs(self.parts(upper)[1]))
            held &= aside == 0.0
        return Directions(np.where(held, right, -np.pi), np.where(held, left, np.pi), speed == 0.0)

    def velocities(self, lower: Floats, upper: Floats, seconds: float) -> tuple[Plane, Floats]:
        """Return those of the corners of the boxes, as they are linear in the command; see `Kinematics.velocities`."""
        axes = len(self.axes)
        corner = (np.arange(2**axes)[:, None] >> np.arange(axes)[::-1]) & 1  # (K, A)
        ahead, left, turn = self.parts(np.where(corner, upper[:, None], lower[:, None]))
        return ahead + 1j * left, turn


def path_radii(
    lower: tuple[Floats, Floats, Floats], upper: tuple[Floats, Floats, Floats], timed: Timed
) -> tuple[Floats, Floats, Floats]:
    """Bound by how much the parts of a path differ from those of the centre: metres ahead, to the left, and radians.

    Parameters
    ----------
    lower, upper : tuple of ndarray
        (C,) each: ends of the speeds ahead and to the left in m/s, and of the turning speed in rad/s.
    timed : Timed
        For how long a command is held.
    """
    centre = tuple(0.5 * (low + high) for low, high in zip(lower, upper, strict=True))
    middle = path(centre, centre, timed)
    largest = tuple(np.maximum(np.abs(low), np.abs(high)) for low, high in zip(lower, upper, strict=True))
    smallest = tuple(
        np.where(low * high > 0.0, np.minimum(np.abs(low), np.abs(high)), 0.0)
        for low, high in zip(lower, upper, strict=True)
    )
    radii = [np.zeros_like(part) for part in middle]
    for end in (lower, upper):
        for other in (smallest, largest):
            apart = [np.abs(at - mid) for at, mid in zip(path(end, other, timed), middle, strict=True)]
            radii = [np.maximum(*both) for both in zip(radii, apart, strict=True)]
    return radii[0], radii[1], radii[2]


def path(part: tuple[Floats, ...], others: tuple[Floats, ...], timed: Timed) -> tuple[Floats, Floats, Floats]:
    """Return each part of a path, signed, that goes with the sizes of the other parts; metres and radians."""
    ahead, left, turn = part
    speeds = _speed(ahead, others[1]), _speed(others[0], left), _speed(others[0], others[1])
    turning = np.abs(others[2])
    return (
        ahead * timed.seconds(speeds[0], turning),
        left * timed.seconds(speeds[1], turning),
        turn * timed.seconds(speeds[2], np.abs(turn)),
    )


def sideways(length: Floats, heading: Floats) -> Floats:
    """Bound how far apart two arcs of one length end whose turns differ by `heading`."""
    return np.asarray(0.5 * length * heading)


def second_order(speed: Floats, a: Floats, b: Floats, c: Floats, seconds: float) -> Floats:
    """Bound what the linear form of a displacement leaves out, (C,), as the module says."""
    mixed = a * (seconds * b + 0.5 * seconds**2 * c)
    bent = seconds * b**2 + seconds**2 * b * c + seconds**3 / 3.0 * c**2
    return np.asarray((mixed + 0.5 * speed * bent) * SLIGHTLY_MORE)


def _chords(
    shortest: Floats, longest: Floats, least_share: Floats, first: Floats, last: Floats
) -> tuple[Floats, Floats]:
    """Bound x and y, (C, 2), of chords between a share and the whole of arcs, in directions between two angles."""
    shares = np.stack([least_share, np.ones_like(least_share)])
    lengths = (np.stack([shortest, longest])[:, None] * shares).reshape(4, -1)
    ends = [cosine_range(first - quarter, last - quarter) for quarter in (0.0, 0.5 * np.pi)]
    products = [np.concatenate([lengths * low, lengths * high]) for low, high in ends]
    return (
        np.stack([product.min(axis=0) for product in products], axis=1),
        np.stack([product.max(axis=0) for product in products], axis=1),
    )


def _speed(ahead: Floats, left: Floats) -> Floats:
    return np.hypot(ahead, left)
