"""What a robot does beside its command: each number of it is off within bounds, and by another amount at every instant.

Under a command u that is held, what acts at the time t is ``u + d(t)`` with ``|d_i(t)| <= D_i = relative_i |u_i| +
absolute_i``, whatever d is (measurable), also beyond the limits of what a robot may be told. Nobody knows d, and the
next command is not what it was made of.

**How far that leads** from where the robot would be without d, from the same state and under the same command. A
number of the motion that is commanded itself is off by at most D. One that grows at the commanded rate until it is at
a limit has ``x' = u + d`` within the limits: of all d, the largest is always at the top for ``d = D`` and at the bottom
for ``-D`` (the comparison theorem for scalar equations), where ``x(t) = clip(x_0 + (u +- D) t)``, and a clip is no
further from another one than its arguments are. So with ``r_0, r_1, q_0, q_1`` the radii of `MotionSignal.radii`
of a box of half-width D,

    |v_d - v| <= r_0 + r_1 t,   |omega_d - omega| <= q_0 + q_1 t,   |theta_d - theta| <= q_0 t + q_1 t^2 / 2,

and as the place is the integral of ``v e(theta)``, ``|e(a) - e(b)| <= |a - b|``, and V the largest speed without d,

    |p_d - p| <= r_0 t + r_1 t^2 / 2 + V (q_0 t^2 / 2 + q_1 t^3 / 6).

These bounds grow with t. So the states after an interval are those without errors and a rest (`Strayed`), and a robot
that would keep c + |p_d - p| + rim |theta_d - theta| without errors at every instant keeps c with them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from viatool.arrays import Floats, Hull
from viatool.rounding import SLIGHTLY_MORE
from viatool.sets.forms import Forms


@dataclass(frozen=True, eq=False)
class CommandErrors:
    """By how much what acts differs from a command.

    Parameters
    ----------
    relative : ndarray
        (A,) shares of the size of what is commanded.
    absolute : ndarray
        (A,) in the units of the command.
    """

    relative: Floats
    absolute: Floats

    def radii(self, lower: Floats, upper: Floats) -> Floats:
        """Return D of the module for every command of boxes, (C, A) each."""
        largest = np.maximum(np.abs(lower), np.abs(upper))
        return (self.relative * largest + self.absolute) * SLIGHTLY_MORE


@dataclass(frozen=True, eq=False)
class Strayed:
    """How far errors of commands lead at most, by the end of an interval and at any time before, over C boxes.

    Parameters
    ----------
    away, turned : ndarray
        (C,) metres of the place, and radians of the heading.
    changed : ndarray
        (C, S) of each number of the state of the motion.
    """

    away: Floats
    turned: Floats
    changed: Floats

    @property
    def states(self) -> Floats:
        """Return by how much x, y, theta and the state are off, (C, 3 + S)."""
        return np.column_stack([self.away, self.away, self.turned, self.changed])

    def nearer(self, rim: float) -> Floats:
        """Return by how much points within `rim` of the robot's origin come nearer to something, (C,) metres."""
        return (self.away + rim * self.turned) * SLIGHTLY_MORE

    def around(self, states: Forms) -> Forms:
        """Return forms of states (C, 3 + S) with these errors in their rests."""
        return Forms(states.centre, states.slope, (states.rest + self.states) * SLIGHTLY_MORE)

    def widened(self, ends: Hull, errors: Floats) -> Hull:
        """Return ends of states (C, 3 + S), or parts of them, that some of `states` widen."""
        lower, upper = ends[0] - errors, ends[1] + errors
        apart = errors > 0.0  # exact where nothing is added
        return (
            np.where(apart, np.nextafter(lower, -np.inf), ends[0]),
            np.where(apart, np.nextafter(upper, np.inf), ends[1]),
        )
