"""Single runs of a robot with motors and timing of its own: those at the corners of what its model allows.

Each holds all of its choices: the velocity at the observation, the gains, the responses and the slip push one way,
ahead or back and to the left or the right; commands act as early or as late as they may; and the brake is the slowest
one, with the way of turning kept. They are integrated in steps, by formulas that the bounds do not use: the velocity is
followed through its differential equation, and the pose by the middle of each step. So they are what the model allows,
up to the error of the steps, which `CORNER_MARGIN` is far above.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from viatool.arrays import Floats
from viatool.motion.actuated import ActuatedMotion, Machine
from viatool.motion.arcs import drive_arc

CORNER_MARGIN = 1e-5
"""Metres that the steps of a run do not err by."""

_STEPS = 16
"""Of an interval."""
_STOPPING = 24
_SETTLED = 4.0
"""Lags after which a run that stops is not followed any longer."""
_ENDLESS = 1e9
_SAME = 1e-12
"""Seconds between instants that rounding alone tells apart."""


@dataclass(frozen=True)
class Corner:
    """Which way everything pushes that the model leaves open.

    Parameters
    ----------
    ahead, turn : float
        1 for fast or to the left, -1 for slow or to the right, 0 for the middle.
    late : bool
        Whether commands act as late as they may.
    """

    ahead: float
    turn: float
    late: bool

    @property
    def words(self) -> str:
        """Return it in words."""
        ahead = {1.0: "fast", 0.0: "nominal", -1.0: "slow"}[self.ahead]
        turn = {1.0: "to the left", 0.0: "straight", -1.0: "to the right"}[self.turn]
        return f"{ahead}, {turn}, commands {'late' if self.late else 'early'}"


_PUSHES = ((1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0), (0.0, 0.0))
CORNERS = tuple(Corner(*push, late) for late in (False, True) for push in _PUSHES)


@dataclass(frozen=True, eq=False)
class CornerRuns:
    """Where K commands of each of B states lead in the R runs of `CORNERS`, at N instants.

    Parameters
    ----------
    poses : ndarray
        (B, K, R, N, 3).
    seconds : ndarray
        (B, K, R, N) since the observation.
    """

    poses: Floats
    seconds: Floats


def drive_corners(motion: ActuatedMotion, poses: Floats, commands: Floats) -> CornerRuns:
    """Drive from poses (B, 3) with commands (B, K, A), as each robot carries them out."""
    runs = [_drive(motion, poses, commands, late=late) for late in (False, True)]
    most = max(seconds.shape[3] for _, seconds in runs)
    padded = [(_pad(places, most), _pad(seconds, most)) for places, seconds in runs]
    return CornerRuns(*(np.concatenate(both, axis=2) for both in zip(*padded, strict=True)))


def _pad(values: Floats, most: int) -> Floats:
    """Repeat the last of N instants: a robot stays at the end of its run."""
    last = np.repeat(values[:, :, :, -1:], most - values.shape[3], axis=3)
    return np.concatenate([values, last], axis=3)


def _drive(motion: ActuatedMotion, poses: Floats, commands: Floats, *, late: bool) -> tuple[Floats, Floats]:
    """Return poses (B, K, R, N, 3) and seconds (B, K, R, N) of the runs of one schedule."""
    machine = motion.machine
    push = np.array([(ahead, turn, turn) for ahead, turn in _PUSHES])  # (R, 3)
    shape = (*commands.shape[:2], len(push))
    errors, (low, high) = machine.actuation, machine.reachable
    farthest = 0.5 * (low + high) + 0.5 * push * (high - low)
    velocity = np.broadcast_to(farthest, (*shape, 3))
    place, places, times, end = np.broadcast_to(poses[:, None, None], (*shape, 3)), [], [], 0.0
    for start, end, back in _schedule(machine, motion.before[0].shape[1], late=late):
        if start == 0.0 and motion.velocity is not None:
            velocity = _measured(motion.velocity, velocity, push)
        given = commands if back == 0 else np.broadcast_to(motion.before[0][:, None, -back], commands.shape)
        wanted = machine.velocities(given, given)[0][:, :, None]
        wanted = wanted + push * (errors.of("relative") * np.abs(wanted) + errors.of("absolute"))
        wanted = np.where(np.isfinite(wanted), wanted, farthest)  # of a command that is not known
        if start < 0.0:
            velocity = _approach(machine, velocity, wanted, push, end - start)
            continue
        steps = max(1, int(np.ceil(_STEPS * (end - start) / machine.timing.interval[1])))
        for step in range(steps):
            places.append(place)
            times.append(np.full(shape, start + (end - start) * step / steps))
            middle = _approach(machine, velocity, wanted, push, 0.5 * (end - start) / steps)
            velocity = _approach(machine, middle, wanted, push, 0.5 * (end - start) / steps)
            place = _move(machine, place, middle, push, np.asarray((end - start) / steps))
    places.append(place)
    times.append(np.full(shape, end))
    if machine.deceleration is not None:
        _stop(machine, velocity, push, places, times)
    return np.stack(places, axis=3), np.stack(times, axis=3)


def _schedule(machine: Machine, before: int, *, late: bool) -> list[tuple[float, float, int]]:
    """Return from when to when which command acts, 0 being the new one; one piece begins with the observation, at 0."""
    timing = machine.timing
    act, apart = (timing.latest, timing.interval[0]) if late else (timing.delay[0], timing.interval[1])
    last = timing.last if late else timing.delay[1] + timing.interval[1]
    ends = [*(act - back * apart for back in range(before, -1, -1)), last]
    found = []
    for back, (start, end) in zip(range(before, -1, -1), pairwise(ends), strict=True):
        cuts = [start, 0.0, end] if start < 0.0 < end else [start, end]
        found += [(*piece, back) for piece in pairwise(cuts) if piece[1] - piece[0] > _SAME]
    return found


def _measured(ends: tuple[Floats, Floats], velocity: Floats, push: Floats) -> Floats:
    """Return the velocities (B, K, R, 3) at the observation: where they were measured, at the end where all pushes."""
    low, high = (end[:, None, None] for end in ends)
    measured = 0.5 * (low + high) + 0.5 * push * (high - low)
    return np.where(np.isfinite(measured), measured, velocity)


def _approach(machine: Machine, velocity: Floats, wanted: Floats, push: Floats, seconds: float) -> Floats:
    """Follow ``v' = sign(w - v) min(a, |w - v| / tau)`` with the response that leaves most of what pushes."""
    motors = machine.actuation
    gap, way = np.abs(wanted - velocity), np.sign(wanted - velocity)
    helps = way * push > 0.0  # towards where everything pushes, as fast as may be
    lag = np.where(helps, motors.of("lag")[:, 0], motors.of("lag")[:, 1])
    growing, falling = (
        np.minimum(np.where(helps, motors.of(name)[:, 1], motors.of(name)[:, 0]), _ENDLESS)
        for name in ("acceleration", "deceleration")
    )
    turns = velocity * wanted < 0.0  # it comes to 0 on the way, with the size of both falling until then
    first = np.where(turns, np.minimum(_time_to(gap, np.abs(wanted), falling, lag), seconds), 0.0)
    gap = np.where(turns, _gap_after(gap, first, falling, lag), gap)
    grows = np.where(turns, first < seconds, velocity * way >= 0.0)
    rate = np.where(grows, growing, np.where(turns, _ENDLESS, falling))
    left = np.where(turns & ~grows, gap, _gap_after(gap, seconds - first, rate, lag))
    return np.asarray(wanted - way * left)


def _gap_after(gap: Floats, seconds: ArrayLike, rate: Floats, lag: Floats) -> Floats:
    """Return what is left of a gap that closes at ``min(rate, gap / lag)``."""
    ramp = np.clip(gap / rate - lag, 0.0, seconds)
    left = np.maximum(gap - rate * ramp, 0.0)
    past = np.asarray(seconds, np.float64) - ramp
    with np.errstate(divide="ignore", invalid="ignore"):
        fade = np.where(lag > 0.0, np.exp(-past / lag), np.where(past > 0.0, 0.0, 1.0))
    return np.asarray(left * fade)


def _time_to(gap: Floats, until: Floats, rate: Floats, lag: Floats) -> Floats:
    """Return after how many seconds a smaller gap, above 0, is left."""
    soft = rate * lag
    ramp = np.maximum(gap - np.maximum(soft, until), 0.0) / rate
    rest = np.where(
        until > 0.0, np.minimum(gap, np.maximum(soft, until)) / np.where(until > 0.0, until, 1.0), 1.0
    )
    return np.asarray(ramp + lag * np.log(np.maximum(rest, 1.0)))


def _move(machine: Machine, place: Floats, velocity: Floats, push: Floats, seconds: Floats) -> Floats:
    """Move along the arc of the velocity in the middle of a step, with the slip of the run."""
    slip = machine.actuation.slip * np.hypot(velocity[..., 0], velocity[..., 1])
    left = velocity[..., 1] + push[:, 2] * slip
    return drive_arc(place, velocity[..., 0], velocity[..., 2], seconds, left)


def _stop(
    machine: Machine, velocity: Floats, push: Floats, places: list[Floats], times: list[Floats]
) -> None:
    """Add the slowest stop, all speeds in proportion."""
    lag = float(machine.actuation.of("lag")[:, 1].max())
    stop = machine.stopping(velocity)
    step = (stop + _SETTLED * lag) / _STOPPING
    share, began = np.ones(stop.shape), times[-1]
    for count in range(1, _STOPPING + 1):
        halves = []
        for _ in range(2):
            share = _falling(share, stop, lag, 0.5 * step)
            halves.append(share)
        places.append(_move(machine, places[-1], halves[0][..., None] * velocity, push, step))
        times.append(began + count * step)


def _falling(share: Floats, stop: Floats, lag: float, seconds: Floats) -> Floats:
    """Follow ``q' = -min(1 / S, q / tau)``."""
    rate = 1.0 / np.maximum(stop, 1.0 / _ENDLESS)
    ramp = np.clip(share / rate - lag, 0.0, seconds)
    left = np.maximum(share - rate * ramp, 0.0)
    if lag == 0.0:
        return np.asarray(np.where(ramp < seconds, 0.0, left))
    return np.asarray(left * np.exp(-(seconds - ramp) / lag))
