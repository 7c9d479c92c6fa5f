"""How motors follow commands: limited acceleration, lag, gains and biases, slip; each within bounds, varying in time.

A part v of the velocity (ahead, to the left, turning) is drawn to a *target* w, the command u with its errors,
``|w - u| <= relative |u| + absolute``, which may be another one at every instant. It follows

    v' = sign(w - v) min(a, |w - v| / tau),

where tau lies within the *lag*, and a within the *acceleration* if ``|v|`` grows and within the *deceleration* if it
falls; they too may change at every instant. Without a lag and a limit the velocity is its target at once. A limit of
one number says that the robot changes its velocity at least as fast as that, and perhaps faster, so that smaller
numbers allow more; who knows that it is not faster either says it with two numbers.

**Reachable velocities.** The right-hand side grows with w; it falls with v. Over all w in ``[w-, w+]``, tau and a it
is largest for ``w+``: if v is below, with the fastest response (least tau, largest a), else with the slowest. Let V+
be the solution of this largest right-hand side G+ from the largest v. Any other solution v has ``v' <= G+(v)``; where
it met V+ from below it could not pass, because G+ does not increase in v (the comparison theorem for scalar
equations; the right-hand side is one-sided Lipschitz with the constant 0). The smallest velocities are the mirror
image. Both are monotone in time, so over a stage they lie between their values at its ends.

From the distance ``D = |w - v|`` the response leaves, after t seconds (`remaining`),

    D - a t                                          until only ``a tau`` is left, and
    min(D, a tau) e^(-(t - t_a) / tau)               from then on, at t_a = max(0, D / a - tau).

It grows with D and tau and falls with a and t. Where the velocity changes its sign on the way both limits count in
turn; the smaller of both is then taken for the slowest response, and the larger for the fastest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np

from viatool.arrays import Floats
from viatool.errors import ConfigurationError
from viatool.rounding import SLIGHTLY_MORE

Bounds = tuple[float, float]


@dataclass(frozen=True)
class Response:
    """How one part of the velocity follows its command. What is left out is ideal.

    Parameters
    ----------
    acceleration, deceleration : tuple of float
        Least and largest change of the velocity while it grows and while it falls, in m/s^2 (rad/s^2).
    lag : tuple of float
        Least and largest time constant, in seconds.
    relative : float
        Largest error of the gain, below 1.
    absolute : float
        Largest bias, in m/s (rad/s).

    Raises
    ------
    ConfigurationError
        If a bound is negative, not a number or above the other one, a least acceleration is 0, or a gain may vanish.
    """

    acceleration: Bounds = (math.inf, math.inf)
    deceleration: Bounds = (math.inf, math.inf)
    lag: Bounds = (0.0, 0.0)
    relative: float = 0.0
    absolute: float = 0.0

    def __post_init__(self) -> None:
        for name in ("acceleration", "deceleration", "lag"):
            least, most = getattr(self, name)
            positive = least > 0.0 or name == "lag"
            if not (0.0 <= least <= most and positive and (most < math.inf or name != "lag")):
                raise ConfigurationError(
                    f"the {name} of a motor is {least:g} to {most:g}, expected "
                    f"{'positive numbers' if name != 'lag' else 'finite times of 0 or more'}, the least first",
                    f"correct the {name}",
                )
        if not 0.0 <= self.relative < 1.0:
            raise ConfigurationError(
                f"the relative error of a velocity is {self.relative:g}, expected a share from 0 to below 1",
                "give 0.05 for 5 %",
            )
        if not 0.0 <= self.absolute < math.inf:
            raise ConfigurationError(
                f"the absolute error of a velocity is {self.absolute:g}, expected a finite number of 0 or more",
                "give it in m/s or rad/s",
            )

    @property
    def at_once(self) -> bool:
        """Tell whether the velocity is its target at every instant, whatever it was before."""
        return self.lag[1] == 0.0 and self.acceleration[0] == self.deceleration[0] == math.inf

    @property
    def either_way(self) -> Response:
        """Return the response that allows what this one does, while the velocity grows and while it falls."""
        both = (
            min(self.acceleration[0], self.deceleration[0]),
            max(self.acceleration[1], self.deceleration[1]),
        )
        return replace(self, acceleration=both, deceleration=both)


IDEAL = Response()


@dataclass(frozen=True)
class Actuation:
    """How a robot's motors follow commands.

    Parameters
    ----------
    linear, lateral, angular : Response
        Of the speeds ahead and to the left, and of the turning speed.
    slip : float
        Largest speed to either side that nobody commands, as a share of the speed.

    Raises
    ------
    ConfigurationError
        If the slip is negative or not finite.
    """

    linear: Response = IDEAL
    lateral: Response = IDEAL
    angular: Response = IDEAL
    slip: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.slip < math.inf:
            raise ConfigurationError(
                f"the slip of the robot is {self.slip:g}, expected a finite share of 0 or more",
                "give 0.05 for 5 % of the speed",
            )

    @property
    def responses(self) -> tuple[Response, Response, Response]:
        """Return those of the speed ahead, to the left, and of the turning speed: the order of all velocities."""
        return self.linear, self.lateral, self.angular

    @property
    def at_once(self) -> bool:
        """Tell whether the velocity depends on nothing but the command that acts."""
        return all(response.at_once for response in self.responses)

    @property
    def is_ideal(self) -> bool:
        """Tell whether nothing differs from a robot that has the velocity it is told to have."""
        return self == IDEAL_MOTORS

    def of(self, name: str) -> Floats:
        """Return a number (3,) or a pair of bounds (3, 2) of the three responses."""
        return self._stacked[name]

    @cached_property
    def _stacked(self) -> dict[str, Floats]:
        names = [field.name for field in fields(Response)]
        return {name: np.array([getattr(one, name) for one in self.responses]) for name in names}

    def targets(self, lower: Floats, upper: Floats) -> tuple[Floats, Floats]:
        """Return what velocities (..., 3) that are commanded between two ends are drawn to; rounded outward."""
        relative, absolute = self.of("relative"), self.of("absolute")
        least = lower - (relative * np.abs(lower) + absolute) * SLIGHTLY_MORE
        return least, upper + (relative * np.abs(upper) + absolute) * SLIGHTLY_MORE

    def largest_error(self, lower: Floats, upper: Floats) -> Floats:
        """Return by how much a target is off at most, (..., 3), of any velocity between two ends; rounded outward."""
        largest = np.maximum(np.abs(lower), np.abs(upper))
        return np.asarray((self.of("relative") * largest + self.of("absolute")) * SLIGHTLY_MORE)

    @cached_property
    def either_way(self) -> Actuation:
        """Motors that allow what these do whether the velocity grows or falls: for velocities seen from another one."""
        linear, lateral, angular = (response.either_way for response in self.responses)
        return Actuation(linear, lateral, angular, self.slip)

    def highest(self, begin: Floats, target: Floats, seconds: Floats) -> Floats:
        """Return the largest velocities after some time, (..., 3), from the largest ones and the largest targets.

        Those right after the begin are meant where the time is 0: a robot without a limit has jumped by then.
        """
        speeding, braking, lag = self.of("acceleration"), self.of("deceleration"), self.of("lag")
        outward = np.where(begin >= 0.0, speeding[:, 1], np.maximum(speeding[:, 1], braking[:, 1]))
        fastest = np.where(target <= 0.0, braking[:, 1], outward)
        inward = np.where(target >= 0.0, braking[:, 0], np.minimum(speeding[:, 0], braking[:, 0]))
        slowest = np.where(begin <= 0.0, speeding[:, 0], inward)
        rises, distance = begin <= target, np.abs(target - begin)
        rate, tau = np.where(rises, fastest, slowest), np.where(rises, lag[:, 0], lag[:, 1])
        left = remaining(distance, seconds, rate, tau)
        return np.where(rises, target - left / SLIGHTLY_MORE, target + left * SLIGHTLY_MORE)

    def extremes(
        self, begin: tuple[Floats, Floats], target: tuple[Floats, Floats], seconds: Floats
    ) -> tuple[Floats, Floats]:
        """Return the smallest and the largest velocities after some time, (..., 3), as `highest`."""
        begins, targets = np.stack([-begin[0], begin[1]]), np.stack([-target[0], target[1]])
        shape = (2, *(1,) * (seconds.ndim - begins[0].ndim), *begins[0].shape)
        low, high = self.highest(begins.reshape(shape), targets.reshape(shape), seconds)
        return -low, high

    def settling(self, begin: tuple[Floats, Floats], target: tuple[Floats, Floats]) -> Floats:
        """Return after how many seconds little changes between boxes of velocities (..., 3), roughly; (...)."""
        farthest = np.maximum(np.abs(target[1] - begin[0]), np.abs(begin[1] - target[0]))
        rate = np.minimum(self.of("acceleration")[:, 0], self.of("deceleration")[:, 0])
        return np.asarray((farthest / rate + 3.0 * self.of("lag")[:, 1]).max(axis=-1))


IDEAL_MOTORS = Actuation()


def remaining(distance: Floats, seconds: Floats, rate: Floats, lag: Floats) -> Floats:
    """Return which distance from its target a velocity still has, see the module; infinite rates are none.

    Parameters
    ----------
    distance : ndarray
        (...) at the beginning, at least 0.
    seconds : ndarray
        (...) since then.
    rate : ndarray
        (...) largest change, positive.
    lag : ndarray
        (...) time constant.
    """
    limited = np.where(np.isinf(rate), 0.0, rate)
    ramp = np.where(limited > 0.0, np.maximum(distance / np.where(limited > 0.0, rate, 1.0) - lag, 0.0), 0.0)
    left = np.maximum(distance - limited * np.minimum(seconds, ramp), 0.0)
    past = np.maximum(seconds - ramp, 0.0)
    decayed = np.where(lag > 0.0, np.exp(-past / np.where(lag > 0.0, lag, 1.0)), 0.0)
    return np.asarray(np.where(seconds < ramp, left, left * decayed))
