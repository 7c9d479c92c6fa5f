"""Sets of states of robots that are told how to accelerate: where all of them are after an interval.

Speed and turning speed are *straight*: up to a radius they are linear in time, in the command and in the state,

    v(t) = v_c(t) + dv(t) + rho,   |rho| <= R;   v_c linear in t, dv(t) linear in the deviations of what is held,

and so is omega; R covers what a limit bends. With ``D(t) = dtheta(t) + eta(t)`` the deviation of the heading from the
centre's, linear in what is held up to ``|eta| <= R_omega t``, and e(a) = (cos a, sin a), the place follows

    v e(theta) = e(theta_c) (v_c + dv + i v_c dtheta + A + i B),

where by Taylor's theorem

    A = rho cos D - (v_c + dv) (1 - cos D),      0 <= 1 - cos D <= D^2 / 2,
    B = v_c (sin D - D) + v_c eta + (dv + rho) sin D,      |sin D - D| <= |D|^3 / 6.

The first three parts are the linear form, whose coefficients are integrals along the centre path, by Gauss points as in
`viatool.motion.changing`. A and B are bounded by polynomials in t, with the largest |dv| and |D|; A, which for a robot
that drives forward is negative, moves the centre by its middle. They point along ``e(theta_c(t))``, which is within the
centre's largest turn from its direction halfway, m. So A and B are a symbol each, along and across m, and what their
turn adds is in the rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from viatool.arrays import Floats
from viatool.rounding import SLIGHTLY_MORE, SPARE
from viatool.sets.forms import Forms

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(10)
_MOST_PIECES = 4096.0


@dataclass(frozen=True, eq=False)
class StraightSignal:
    """A number of the motion within a radius of ``share (begin + rate t) + shift``, over C boxes of what is held.

    Parameters
    ----------
    begin : int
        Which entry of what is held it begins with.
    rate : int or None
        Which one is its rate; None for a number that does not change.
    share, shift, radius : ndarray
        (C,) the radius at least 0.
    """

    begin: int
    rate: int | None
    share: Floats
    shift: Floats
    radius: Floats

    def parts(self, held: Floats) -> tuple[Floats, Floats]:
        """Return the begin and the rate of what is held (C, H), times the share; (C,) each."""
        begin = self.share * held[:, self.begin]
        return begin, 0.0 * begin if self.rate is None else self.share * held[:, self.rate]

    def form(self, held: Forms, time: float) -> Forms:
        """Return the number at one time as a form (C, 1) of the symbols of what is held, forms (C, H)."""
        weights = np.zeros_like(held.centre)
        weights[:, self.begin] = self.share
        if self.rate is not None:
            weights[:, self.rate] = self.share * time
        return combined(held, weights, self.shift, self.radius)


def combined(held: Forms, weights: Floats, shift: Floats, radius: Floats) -> Forms:
    """Return what is within radii (C,) of weighted sums of forms (C, H) and shifts (C,); rounding is counted."""
    size = (np.abs(weights) * np.abs(held.centre)).sum(axis=1) + np.abs(shift) + 1.0
    rest = (np.abs(weights) * held.rest).sum(axis=1) + radius
    return Forms(
        ((weights * held.centre).sum(axis=1) + shift)[:, None],
        np.einsum("csh,ch->cs", held.slope, weights)[:, :, None],
        (rest * SLIGHTLY_MORE + SPARE * size)[:, None],
    )


def accelerated(
    states: Forms, ahead: StraightSignal, turning: StraightSignal, seconds: float, slack: Floats
) -> Forms:
    """Move sets of poses under straight speeds.

    Parameters
    ----------
    states : Forms
        (C, 3 + H) x, y, theta and what is held.
    ahead, turning : StraightSignal
        Speed and turning speed over boxes around what is held.
    seconds : float
        For how long.
    slack : ndarray
        (C,) metres, and radians, that cover rounding.

    Returns
    -------
    Forms
        (C, 3) poses in the same symbols, and two for A and B.

    Notes
    -----
    Sound: yes, for each value of the symbols; see the module.
    """
    path = _Centre.of(states.centre, ahead, turning, seconds)
    gradient = path.gradient(ahead, turning)  # (C, 1 + H)
    spread = np.abs(states.slope).sum(axis=1) + states.rest
    forward, aside = left_out(spread, path, ahead, turning, seconds)
    middle, half = 0.5 * (forward[0] + forward[1]), 0.5 * (forward[1] - forward[0])
    unit = np.exp(1j * path.direction)
    moved = path.moved + middle * unit
    swung = path.swing * (half + aside + np.abs(middle))
    own = np.stack([half * unit, 1j * aside * unit], axis=1) * SLIGHTLY_MORE  # (C, 2)
    bent = np.stack([own.real, own.imag, 0.0 * own.real], axis=2)
    shift = np.einsum("csk,ck->cs", states.slope[:, :, 2:], gradient)
    rest = states.rest[:, 2:]
    off = (
        ((rest * np.abs(part)).sum(axis=1) + swung) * SLIGHTLY_MORE for part in (gradient.real, gradient.imag)
    )
    weights = np.zeros_like(states.centre)
    weights[:, 2] = 1.0
    weights[:, 3 + turning.begin] = turning.share * seconds
    if turning.rate is not None:
        weights[:, 3 + turning.rate] = turning.share * (0.5 * seconds**2)
    heading = combined(states, weights, turning.shift * seconds, turning.radius * seconds)
    slope = np.concatenate([states.slope[:, :, :2] + np.stack([shift.real, shift.imag], 2), heading.slope], 2)
    return Forms(
        np.column_stack([states.centre[:, 0] + moved.real, states.centre[:, 1] + moved.imag, heading.centre]),
        np.concatenate([slope, bent], axis=1),
        np.column_stack([states.rest[:, :2] + np.column_stack([*off]), heading.rest]) + slack[:, None],
    )


@dataclass(frozen=True, eq=False)
class _Centre:
    """The paths of C centres at N Gauss points: times, weights, speeds (C, N), and directions e(theta) as numbers."""

    times: Floats
    weights: Floats
    speeds: Floats
    ends: tuple[Floats, Floats]
    along: np.ndarray
    direction: Floats
    swing: Floats
    size: int

    @classmethod
    def of(cls, states: Floats, ahead: StraightSignal, turning: StraightSignal, seconds: float) -> _Centre:
        held = states[:, 3:]
        (v, a), (w, alpha) = ahead.parts(held), turning.parts(held)
        v, w = v + ahead.shift, w + turning.shift
        most = np.abs(w) + seconds * np.abs(alpha)
        pieces = int(np.ceil(np.clip(np.fmax.reduce(most * seconds, initial=1.0), 1.0, _MOST_PIECES)))
        fine = (np.arange(pieces)[:, None] + 0.5 * (1.0 + _NODES)).ravel() * (seconds / pieces)
        times = np.broadcast_to(fine, (len(states), len(fine)))
        weights = np.broadcast_to(np.tile(0.5 * _WEIGHTS * (seconds / pieces), pieces), times.shape)
        turned = w[:, None] * times + 0.5 * alpha[:, None] * times**2
        lost = most * seconds > _MOST_PIECES  # where one that turns more leads is not known
        along = np.where(lost[:, None], np.nan, np.exp(1j * (states[:, 2, None] + turned)))
        speeds = v[:, None] + a[:, None] * times
        half = 0.5 * seconds
        direction = states[:, 2] + w * half + 0.5 * alpha * half**2
        swing = (np.abs(w) + np.abs(alpha) * seconds) * half * SLIGHTLY_MORE
        return cls(times, weights, speeds, (v, v + a * seconds), along, direction, swing, held.shape[1])

    def _sum(self, values: Floats) -> np.ndarray:
        return np.asarray((self.weights * values * self.along).sum(axis=1))

    @property
    def moved(self) -> np.ndarray:
        """Return the displacement, x + iy."""
        return self._sum(self.speeds)

    def gradient(self, ahead: StraightSignal, turning: StraightSignal) -> np.ndarray:
        """Return how the displacement changes with the heading and with what is held, (C, 1 + H) as x + iy."""
        found = np.zeros((len(self.times), 1 + self.size), np.complex128)
        found[:, 0] = 1j * self.moved
        found[:, 1 + ahead.begin] += ahead.share * self._sum(np.ones_like(self.times))
        if ahead.rate is not None:
            found[:, 1 + ahead.rate] += ahead.share * self._sum(self.times)
        found[:, 1 + turning.begin] += 1j * turning.share * self._sum(self.speeds * self.times)
        if turning.rate is not None:
            found[:, 1 + turning.rate] += 1j * turning.share * self._sum(self.speeds * (0.5 * self.times**2))
        return found


def left_out(
    spread: Floats, path: _Centre, ahead: StraightSignal, turning: StraightSignal, seconds: float
) -> tuple[tuple[Floats, Floats], Floats]:
    """Bound what the linear form leaves out: the integrals of A from below and above, and of |B|; (C,) each.

    Parameters
    ----------
    spread : ndarray
        (C, 3 + H) by how much pose and what is held deviate from the centre.
    """
    (v, a), (w, alpha) = ahead.parts(spread[:, 3:]), turning.parts(spread[:, 3:])  # shares are at least 0
    time = 0.5 * (1.0 + _NODES) * seconds  # exact for the polynomials, of degree 9
    weight = 0.5 * _WEIGHTS * seconds
    faster = v[:, None] + a[:, None] * time
    swung = spread[:, 2, None] + w[:, None] * time + 0.5 * alpha[:, None] * time**2
    unknown = turning.radius[:, None] * time
    apart = swung + unknown
    own = ahead.radius[:, None]
    slowest, fastest = np.minimum(*path.ends), np.maximum(*path.ends)
    by = v + a * seconds
    forward, backward = np.maximum(fastest + by, 0.0), np.maximum(by - slowest, 0.0)
    largest = np.maximum(np.abs(slowest), np.abs(fastest))[:, None]
    bent = 0.5 * np.square(apart)
    least = -((own + forward[:, None] * bent) @ weight)
    most = (own + backward[:, None] * bent) @ weight
    aside = (largest * (apart**3 / 6.0 + unknown) + (faster + own) * apart) @ weight
    return (least * SLIGHTLY_MORE, most * SLIGHTLY_MORE), aside * SLIGHTLY_MORE
