"""Robots whose velocity changes while a command is held: their motion has a state beyond the pose.

What is held is the command with the state in which it is given. The robot has the speed ``v(t)`` ahead and the turning
speed ``omega(t)``, and is at

    p(t) = p + int_0^t v(r) e(theta(r)) dr,   theta(t) = theta + int_0^t omega(r) dr,   e(a) = (cos a, sin a),

for the interval in which the command acts; afterwards it keeps the velocity which it then has, for as long as the path
goes on (`viatool.motion.manoeuvre` brakes so).

*Where it is.* The heading has a closed form. The place is integrated by ten Gauss points in pieces that turn by at
most a radian and hold no kink. Of a piece of half-width h the error is at most ``64/15 h M 8^-20 / (1 - 8^-2)``, M the
largest size of the integrand in the ellipse with half-axes 4.06 h and 3.94 h around the piece, in which it is analytic.
A speed, linear in time, is there at most 4.06 times its largest, V. The heading is a polynomial of degree two whose
derivative is at most ``1 / (2 h)`` on the piece, so its imaginary part is at most 4.2. Together that is less than
``1e-15 V h``, of which `viatool.rounding.DISTANCE_ROUNDING` holds a thousand times as much. Steered wheels have a pole
where they stand across: their pieces are short against the way to there (`viatool.motion.steered`).

*Other commands and states.* With ``|v - v_c| <= r_0 + r_1 t`` and ``|omega - omega_c| <= q_0 + q_1 t``, growing no more
after the interval, and R, Q, S the integrals of the first, of the second, and of that,

    |theta - theta_c| <= Q(t),   |p - p_c| <= int |v - v_c| + |v_c| |theta - theta_c| <= R(t) + V_c S(t),

as ``|e(a) - e(b)| <= |a - b|``; V_c and W_c are the largest speeds of the centre. Paths last differently long when they
brake from other speeds: equal fractions s of T and T_c are at most ``s |T - T_c|`` apart in time, for which the centre
drives at most V_c and turns at most W_c.

*Other instants.* Between two instants the place leaves the chord by at most ``M span^2 / 8``, M a bound of how fast the
velocity p' changes: ``|v'| + |v| |omega|``; it need not be differentiable.
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from viatool.arrays import Floats, Hull, Plane
from viatool.motion.arcs import cosine_range, drive_arc, wrap_angle
from viatool.motion.law import Directions, Kinematics, Limited, PathDeviation, Timed
from viatool.motion.signals import MotionSignal
from viatool.rounding import SLIGHTLY, SLIGHTLY_MORE
from viatool.sets.forms import Forms, PoseBoxes

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(10)
_AT_ONCE = 8192
"""Paths of one piece that are integrated together, so that the arrays stay small."""
_MOST_PIECES = 4096.0
"""Of a part of a path; where one that turns more leads is not known."""


@dataclass(frozen=True)
class ChangingTwist(Kinematics):
    """A kinematics whose motion has a state.

    Notes
    -----
    A subclass names its axes and its state, and gives speeds, headings and radii. `fitted` gives it the limits of a
    robot, without which it moves as if there were none.
    """

    @property
    @abstractmethod
    def signals(self) -> tuple[MotionSignal, ...]:
        """Return the numbers of the state, in its order: all that may change."""

    @abstractmethod
    def speed(self, held: Floats, time: Floats | float) -> Floats:
        """Return the speed ahead (...) after some seconds (...) of what is held (..., A + S)."""

    @abstractmethod
    def turn(self, held: Floats, time: Floats | float) -> Floats:
        """Return the turning speed (...)."""

    @abstractmethod
    def turned(self, held: Floats, time: Floats | float) -> Floats:
        """Return by how much it has turned, (...) radians."""

    @abstractmethod
    def speeds(self, lower: Floats, upper: Floats, seconds: float) -> tuple[Floats, Floats]:
        """Return the ends (...) of the speed ahead until some time, over boxes."""

    @abstractmethod
    def turns(self, lower: Floats, upper: Floats, seconds: float) -> tuple[Floats, Floats]:
        """Return the ends (...) of the turning speed until some time, over boxes."""

    @abstractmethod
    def spread(self, lower: Floats, upper: Floats, seconds: float) -> tuple[Floats, Floats, Floats, Floats]:
        """Return ``r_0, r_1, q_0, q_1`` of the module, (C,) each, over boxes (C, A + S) until some time."""

    def turning(self, robot: Limited, lower: Floats, upper: Floats) -> tuple[Floats, Floats]:
        """Return the ends (...) of the turning speed that a robot has in boxes of states (..., S), after any command.

        **Sound:** yes, also of states beyond the limits of the robot, in which it was recorded.
        """
        ends = self.limits(robot)
        shape = (*lower.shape[:-1], self.first_of_state)
        least, most = (
            np.concatenate([np.broadcast_to(end, shape), state], axis=-1)
            for end, state in zip(ends, (lower, upper), strict=True)
        )
        return self.turns(least, most, 0.0)

    @abstractmethod
    def neutral(self) -> Floats:
        """Return a command (A,) that the robot carries out and with which it is set down."""

    def _pieces(self, held: Floats, time: Floats) -> Floats:
        """Return into how many pieces (N,) each part of a path has to be cut at least, so that it can be integrated."""
        turn = np.maximum(*np.abs(self.turns(held, held, float(np.fmax.reduce(time, initial=0.0)))))
        return np.asarray(turn * time)

    @property
    def first_of_state(self) -> int:
        """Return A, behind which the state stands."""
        return len(self.axes)

    def after(self, held: Floats, seconds: ArrayLike) -> Floats:
        """See `Kinematics.after`."""
        time = np.asarray(seconds, dtype=np.float64)
        return np.stack([signal.at(held, time) for signal in self.signals], axis=-1)

    def velocity(self, held: Floats) -> Floats:
        """Return the velocity (..., 3) as a command begins: ahead, to the left, turning."""
        ahead = self.speed(held, 0.0)
        return np.stack([ahead, 0.0 * ahead, self.turn(held, 0.0)], axis=-1)

    def recalled(self, before: Floats, command: Floats | None = None) -> tuple[Floats, Floats | None]:
        """See `Kinematics.recalled`; where nothing is known of the command, it is one that the robot carries out."""
        if command is None:
            command = np.broadcast_to(self.neutral(), (len(before), self.first_of_state))
        return command, self.velocity(np.concatenate([command, before], axis=1))

    def advance(self, states: Floats, commands: Floats, seconds: ArrayLike) -> Floats:
        """See `Kinematics.advance`."""
        own = np.broadcast_to(states[..., 3:], (*commands.shape[:-1], len(self.state)))
        held = np.concatenate([commands, own], axis=-1)
        poses = self.drive(states[..., :3], held, seconds, np.inf)
        after = np.broadcast_to(self.after(held, seconds), (*poses.shape[:-1], len(self.state)))
        return np.concatenate([poses, after], axis=-1)

    def drive(self, poses: Floats, commands: Floats, seconds: ArrayLike, until: float) -> Floats:
        """See `Kinematics.drive`."""
        time = np.asarray(seconds, dtype=np.float64)
        shape = np.broadcast_shapes(poses.shape[:-1], commands.shape[:-1], time.shape)
        poses = np.broadcast_to(poses, (*shape, 3)).reshape(-1, 3)
        held = np.broadcast_to(commands, (*shape, commands.shape[-1])).reshape(-1, commands.shape[-1])
        time = np.broadcast_to(time, shape).ravel()
        acting = np.minimum(time, until)
        cuts = self._pieces(held, acting)
        held = np.where((cuts <= _MOST_PIECES)[:, None], held, np.nan)
        most = max(1, int(np.ceil(np.fmin(np.fmax.reduce(cuts, initial=1.0), _MOST_PIECES))))
        size = max(1, _AT_ONCE // most)
        parts = [
            self._driven(poses[some], held[some], time[some], acting[some], most)
            for some in (slice(first, first + size) for first in range(0, len(time), size))
        ]
        return (np.concatenate(parts) if parts else np.zeros((0, 3))).reshape(*shape, 3)

    def _driven(self, poses: Floats, held: Floats, time: Floats, acting: Floats, cuts: int) -> Floats:
        """Return poses (N, 3) after seconds (N,) of what is held (N, A + S), of which the command acts for some."""
        kinks = np.stack([np.fmin(signal.kink(held), acting) for signal in self.signals], axis=1)
        edges = np.sort(np.column_stack([np.zeros_like(acting), kinks, acting]), axis=1)
        fine = np.arange(cuts)[:, None] + 0.5 * (1.0 + _NODES)  # (n, 10) of each part between two kinks
        width = np.diff(edges, axis=1)[:, :, None, None] / cuts
        at = edges[:, :-1, None, None] + width * fine  # (N, parts, n, 10)
        flat, each = at.reshape(len(at), -1), held[:, None]
        heading = poses[:, 2, None] + self.turned(each, flat)
        way = self.speed(each, flat) * (0.5 * width * _WEIGHTS + np.zeros_like(at)).reshape(len(at), -1)
        turned = self.turned(held, acting)
        ends = np.stack(
            [
                poses[:, 0] + (way * np.cos(heading)).sum(axis=1),
                poses[:, 1] + (way * np.sin(heading)).sum(axis=1),
                wrap_angle(poses[:, 2] + turned),
            ],
            axis=1,
        )
        rest = time - acting
        if not rest.any():
            return ends
        return drive_arc(ends, self.speed(held, acting), self.turn(held, acting), rest)

    def rates(self, lower: Floats, upper: Floats, seconds: float) -> tuple[Floats, Floats]:
        """See `Kinematics.rates`."""
        ahead, turn = self.speeds(lower, upper, seconds), self.turns(lower, upper, seconds)
        return np.maximum(*np.abs(ahead)), np.maximum(*np.abs(turn))

    def deviation(
        self, lower: Floats, upper: Floats, until: Floats, rim: float, timed: Timed
    ) -> PathDeviation:
        """See `Kinematics.deviation`, and the module for why."""
        away, turned = self._apart(lower, upper, until, timed)
        centre, shares = 0.5 * (lower + upper), []
        for column in range(lower.shape[1]):
            only = np.arange(lower.shape[1]) == column
            alone = self._apart(np.where(only, lower, centre), np.where(only, upper, centre), until, timed)
            shares.append(alone[0] + rim * alone[1])
        return PathDeviation(away, turned, np.stack(shares, axis=1))

    def _apart(self, lower: Floats, upper: Floats, until: Floats, timed: Timed) -> tuple[Floats, Floats]:
        """Bound how far the members of boxes lead from where their centres lead: metres and radians, (C,)."""
        interval, centre = timed.interval, 0.5 * (lower + upper)
        r0, r1, q0, q1 = self.spread(lower, upper, interval)
        fastest, turning = self.rates(centre, centre, interval)
        speed, turn = self.last_rates(centre, centre, interval)
        by, by_turn = r0 + r1 * interval, q0 + q1 * interval
        lasting, longest = timed.seconds(speed, turn), timed.seconds(speed + by, turn + by_turn)
        shortest = timed.seconds(np.maximum(speed - by, 0.0), np.maximum(turn - by_turn, 0.0))
        other_time = until * np.maximum(longest - lasting, lasting - shortest)
        time = until * longest
        acting = np.minimum(time, interval)
        rest = time - acting
        grown = 0.5 * acting**2 + acting * rest
        twice = acting**3 / 6.0 + 0.5 * acting**2 * rest + 0.5 * acting * rest**2
        away = r0 * time + r1 * grown + fastest * (0.5 * q0 * time**2 + q1 * twice + other_time)
        return away, q0 * time + q1 * grown + turning * other_time

    def loss(self, width: Floats, speed: Floats, seconds: Floats) -> Floats:
        """See `Kinematics.loss`; a second of any change counts as such, and a turn on the way that is driven."""
        turning = np.array([axis.unit.startswith("rad") for axis in (*self.axes, *self.state)])
        return np.where(turning, 0.5 * (speed * np.square(seconds))[:, None], seconds[:, None]) * width

    def sagitta(self, commands: Floats, timed: Timed, span: Floats) -> Floats:
        """See `Kinematics.sagitta`."""
        interval = timed.interval
        speed, turn = self.rates(commands, commands, interval)
        lasting = timed.seconds(*self.last_rates(commands, commands, interval))
        bent = self._faster(commands, commands) + speed * turn
        return np.asarray(0.125 * bent * np.square(lasting * span))

    @abstractmethod
    def _faster(self, lower: Floats, upper: Floats) -> Floats:
        """Bound how fast the speed ahead changes, (C,)."""

    def outline_motion(self, length: Floats, turn: Floats, span: Floats, rim: float) -> Floats:
        """See `Kinematics.outline_motion`; length and turn are those of the largest speeds."""
        return np.asarray(0.5 * (length + rim * turn) * span)

    def displacement(
        self, boxes: PoseBoxes, lower: Floats, upper: Floats, seconds: float
    ) -> tuple[Floats, Floats]:
        """Bound displacements by the speeds and headings on the way; see `Kinematics.displacement`."""
        speeds, turns = self.speeds(lower, upper, seconds), self.turns(lower, upper, seconds)
        first = boxes.centre[:, 2] - boxes.radius[:, 2] + seconds * np.minimum(turns[0], 0.0)
        last = boxes.centre[:, 2] + boxes.radius[:, 2] + seconds * np.maximum(turns[1], 0.0)
        products = []
        for quarter in (0.0, 0.5 * np.pi):
            ends = cosine_range(first - quarter, last - quarter)
            products.append(np.stack([seconds * speed * end for speed in speeds for end in ends]))
        least = np.column_stack([*(product.min(axis=0) for product in products), seconds * turns[0]])
        most = np.column_stack([*(product.max(axis=0) for product in products), seconds * turns[1]])
        return least - SLIGHTLY * np.abs(least), most + SLIGHTLY * np.abs(most)

    def directions(self, lower: Floats, upper: Floats, timed: Timed) -> Directions:
        """See `Kinematics.directions`: a robot that does not back up goes where its headings point, a convex cone."""
        speeds, turns = (
            self.speeds(lower, upper, timed.interval),
            self.turns(lower, upper, timed.interval),
        )
        seconds = timed.seconds(*self.last_rates(lower, upper, timed.interval))
        right, left = seconds * np.minimum(turns[0], 0.0), seconds * np.maximum(turns[1], 0.0)
        held = (speeds[0] >= 0.0) & (left - right < np.pi)
        still = (speeds[0] == 0.0) & (speeds[1] == 0.0)
        return Directions(np.where(held, right, -np.pi), np.where(held, left, np.pi), still)

    def velocities(self, lower: Floats, upper: Floats, seconds: float) -> tuple[Plane, Floats]:
        """Return all combinations of the least and largest speeds on the way; see `Kinematics.velocities`."""
        speeds, turns = self.speeds(lower, upper, seconds), self.turns(lower, upper, seconds)
        ahead = np.stack([speeds[0], speeds[0], speeds[1], speeds[1]], axis=1)
        return np.asarray(ahead + 0j, np.complex128), np.stack(
            [turns[0], turns[1], turns[0], turns[1]], axis=1
        )

    def reached(self, lower: Floats, upper: Floats, seconds: float) -> tuple[Floats, Floats]:
        """See `Kinematics.reached`."""
        ends = [signal.reached(lower, upper, seconds) for signal in self.signals]
        least, most = (np.stack(end, axis=-1) for end in zip(*ends, strict=True))
        return least, most

    def successor(self, states: Forms, seconds: float, slack: Floats, known: Hull | None = None) -> Forms:
        """Move sets of poses, and their state; see `Kinematics.successor`."""
        held = Forms(states.centre[:, 3:], states.slope[:, :, 3:], states.rest[:, 3:])
        radius = (np.abs(held.slope).sum(axis=1) + held.rest) * SLIGHTLY_MORE
        lower, upper = held.centre - radius, held.centre + radius
        if known is not None:
            lower, upper = np.maximum(lower, known[0]), np.minimum(upper, known[1])
            lower, upper = np.minimum(lower, upper), np.maximum(lower, upper)  # crossed by rounding alone
        return Forms.beside(
            self._moved(states, (lower, upper), seconds, slack),
            *(signal.form(held, (lower, upper), seconds) for signal in self.signals),
        )

    def _moved(self, states: Forms, ends: Hull, seconds: float, slack: Floats) -> Forms:
        """Move sets of poses, (C, 3), with the heading of each and the middle of what is held, between ends (C, A + S).

        A heading that is off by d turns the displacement u by d, which differs from ``u + i d u`` by at most
        ``|u| d^2 / 2``; others of what is held lead at most as far from u as `_apart` says, however it is turned.
        """
        swung = (np.abs(states.slope[:, :, 2]).sum(axis=1) + states.rest[:, 2]) * SLIGHTLY_MORE
        middle = 0.5 * (ends[0] + ends[1])
        away, turned = self._apart(*ends, np.ones(len(middle)), _Held(seconds))
        after = self.drive(np.zeros((len(middle), 3)), middle, seconds, np.inf)
        moved = (after[:, 0] + 1j * after[:, 1]) * np.exp(1j * states.centre[:, 2])
        off = (away + 0.5 * np.abs(moved) * np.square(swung)) * SLIGHTLY_MORE
        gradient = np.stack([-moved.imag, moved.real, 0.0 * moved.real], axis=1)  # (C, 3)
        added = np.stack([off, off, turned * SLIGHTLY_MORE], axis=1)
        centre = np.stack([moved.real, moved.imag, self.turned(middle, seconds)], axis=1)
        return Forms(
            states.centre[:, :3] + centre,
            states.slope[:, :, :3] + states.slope[:, :, 2, None] * gradient[:, None],
            states.rest[:, :3] + states.rest[:, 2, None] * np.abs(gradient) + added + slack[:, None],
        )


@dataclass(frozen=True)
class _Held:
    """A command that is held for an interval, and nothing afterwards."""

    interval: float

    def seconds(self, speed: Floats, turn: Floats) -> Floats:
        """See `Timed`."""
        return np.full(np.broadcast_shapes(speed.shape, turn.shape), self.interval)
