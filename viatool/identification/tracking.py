"""How velocities follow commands: delay, lag and acceleration of isolated steps, and how far off they settle.

A *step* is a change of one part of the command (ahead, to the left, turning) between two times in which it is held. To
the velocity after it the response of viatool's model is fitted: nothing happens for the delay d; then the velocity
approaches what it settles at, ``v' = min(a, |w - v| / tau)`` of the distance. Where the velocity is limited by a, the
term is told; where no step reaches the limit, it is not. Bounds are those over all steps, so what differs from step to
step is in them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from viatool.arrays import Booleans, Floats
from viatool.identification.findings import Bounding, Finding, MeasuredTerm, UnmeasuredTerm, spread_of
from viatool.identification.response import Responses, fit_responses

_AXES = (("linear", 0, "m/s"), ("lateral", 1, "m/s"), ("angular", 2, "rad/s"))
_HELD = 0.4  # s for which a command is held before and after a step
_LONGEST = 3.0  # s of a response that are looked at
_SAME = 0.02  # of the largest command: changes that are none
_STEP = 0.2  # of the largest command: the smallest step
_LEAST_STEPS = 5
_MOST_STEPS = 200
_RESOLVED = 0.5  # of the time between two measured velocities: shorter times are not told
_SETTLING = 5.0  # time constants


@dataclass(frozen=True, eq=False)
class Signal:
    """One part of a velocity over time.

    Parameters
    ----------
    axis, unit : str
        Of the error model.
    given, commands : ndarray
        (C,) seconds and commands.
    measured, velocities : ndarray
        (M,) seconds and measured velocities.
    """

    axis: str
    unit: str
    given: Floats
    commands: Floats
    measured: Floats
    velocities: Floats

    @property
    def largest(self) -> float:
        """Return the size of the largest command."""
        return float(np.abs(self.commands).max(initial=0.0))

    @property
    def spacing(self) -> float:
        """Return the usual time between two measured velocities, in seconds."""
        return float(np.median(np.diff(self.measured)))


def signals_of(given: Floats, commands: Floats, measured: Floats, velocities: Floats) -> tuple[Signal, ...]:
    """Return the parts of commands (C, 3) and velocities (M, 3) at seconds (C,) and (M,)."""
    return tuple(
        Signal(axis, unit, given, commands[:, number], measured, velocities[:, number])
        for axis, number, unit in _AXES
    )


def tracking_findings(signals: tuple[Signal, ...], bounding: Bounding) -> Iterator[Finding]:
    """Yield what commands and velocities tell of the motors, and of the delay, which they share."""
    delays = []
    for signal in signals:
        place = f"actuation.{signal.axis}"
        if signal.largest < 1e-3:
            yield UnmeasuredTerm(place, "no such command was given")
            continue
        steps = _steps(signal)
        responses = _responses(signal, steps)
        if len(responses) >= _LEAST_STEPS:
            delays.append(responses.delay)
            yield from _response_findings(signal, responses, bounding)
        else:
            delay, match = correlated_delay(signal)
            yield UnmeasuredTerm(
                f"{place}.acceleration, deceleration, lag",
                f"{len(responses)} steps between commands that are held for {_HELD:g} s, {_LEAST_STEPS} are needed; "
                f"velocity follows the command after {delay:.3g} s on average (correlation {match:.2f})",
            )
        yield from _settled_findings(signal, responses, bounding)
    yield UnmeasuredTerm("actuation.slip", "wheels do not measure it")
    if delays:
        each = np.concatenate(delays)
        told = f"{spread_of(each, 's')}, of steps; from the command to the velocity"
        yield MeasuredTerm("timing.delay", bounding.span(each, least=0.0), len(each), told)
    else:
        yield UnmeasuredTerm(
            "timing.delay",
            "too few steps between commands that are held; drive some as docs/choosing-eps.md says",
        )


def correlated_delay(signal: Signal) -> tuple[float, float]:
    """Return the shift in seconds at which changes of command and velocity correlate most, and how much."""
    grid = np.arange(signal.measured[0], signal.measured[-1], 0.02)
    if len(grid) < 100:
        return 0.0, 0.0
    last = np.clip(np.searchsorted(signal.given, grid, side="right") - 1, 0, len(signal.given) - 1)
    command = signal.commands[last] - signal.commands[last].mean()
    velocity = np.interp(grid, signal.measured, signal.velocities)
    velocity = velocity - velocity.mean()
    best = (0.0, 0.0)
    for shift in range(50):
        first, second = command[: len(grid) - shift], velocity[shift:]
        size = float(np.linalg.norm(first) * np.linalg.norm(second))
        match = float(first @ second) / size if size > 0.0 else 0.0
        if match > best[1]:
            best = (0.02 * shift, match)
    return best


@dataclass(frozen=True)
class _Step:
    """A command that goes from one held value to another at a time, and is held until another."""

    at: float
    until: float
    before: float
    after: float


def _steps(signal: Signal) -> list[_Step]:
    """Return the steps of a command."""
    same = _SAME * signal.largest
    holds = [[float(signal.given[0]), float(signal.commands[0])]]
    for at, command in zip(signal.given.tolist(), signal.commands.tolist(), strict=True):
        if abs(command - holds[-1][1]) > same:
            holds.append([at, command])
    ends = [at for at, _ in holds[1:]] + [float(signal.given[-1])]
    steps = []
    for (begin, before), (at, after), until in zip(holds, holds[1:], ends[1:], strict=False):
        held = at - begin >= _HELD and until - at >= _HELD
        if held and abs(after - before) >= _STEP * signal.largest and before * after >= 0.0:
            steps.append(_Step(at, until, before, after))
    return steps


def _responses(signal: Signal, steps: list[_Step]) -> Responses:
    """Fit what follows steps that settle."""
    every = max(1, len(steps) // _MOST_STEPS)
    found = [fit for step in steps[::every] if (fit := _response(signal, step)) is not None]
    return Responses.join(found)


def _response(signal: Signal, step: _Step) -> Responses | None:
    """Fit what follows one step; None where the velocity has not settled before it or after it."""
    end = min(step.until, step.at + _LONGEST)
    rest = (signal.measured > step.at - 0.15) & (signal.measured <= step.at + 1e-9)
    within = (signal.measured >= step.at) & (signal.measured < end)
    late = within & (signal.measured >= end - 0.2 * (end - step.at))
    if rest.sum() < 2 or within.sum() < 8 or late.sum() < 2:
        return None
    before, after = signal.velocities[rest], signal.velocities[late]
    change = float(after.mean() - before.mean())
    unsettled = max(np.ptp(before), np.ptp(after)) > 0.25 * abs(change)
    if unsettled or abs(change) < 0.5 * abs(step.after - step.before):
        return None
    seconds = signal.measured[within] - step.at
    share = (signal.velocities[within] - before.mean()) / change
    return fit_responses(seconds, share, abs(change), grows=abs(step.after) > abs(step.before))


def _response_findings(signal: Signal, found: Responses, bounding: Bounding) -> Iterator[Finding]:
    place, shortest = f"actuation.{signal.axis}", _RESOLVED * signal.spacing
    for name, which in (("acceleration", found.grows), ("deceleration", ~found.grows)):
        yield _rate_finding(f"{place}.{name}", found.rate[which], found.limited[which], signal.unit, bounding)
    if np.quantile(found.lag, bounding.quantile) < shortest:
        yield UnmeasuredTerm(
            f"{place}.lag", f"it is shorter than {shortest:.2g} s, half of the time between velocities"
        )
    else:
        told = f"{spread_of(found.lag, 's')}, of steps"
        yield MeasuredTerm(f"{place}.lag", bounding.span(found.lag, least=0.0), len(found), told)


def _rate_finding(place: str, rates: Floats, limited: Booleans, unit: str, bounding: Bounding) -> Finding:
    if limited.sum() < _LEAST_STEPS or limited.mean() < 0.5:
        return UnmeasuredTerm(place, f"{int(limited.sum())} of {len(limited)} steps show a limit")
    rates = rates[limited]
    return MeasuredTerm(
        place,
        bounding.slowest(rates),
        len(rates),
        f"{spread_of(rates, f'{unit}^2')}, of steps",
    )


def _settled_findings(signal: Signal, found: Responses, bounding: Bounding) -> Iterator[Finding]:
    """Yield how far velocities are from commands that were held for long."""
    place = f"actuation.{signal.axis}"
    wait = found.settled_after(_SETTLING) if len(found) else 1.0
    last = np.searchsorted(signal.given, signal.measured, side="right") - 1
    changed = np.abs(np.diff(signal.commands, prepend=np.inf)) > 1e-9 + 0.1 * _SAME * signal.largest
    since = np.maximum.accumulate(np.where(changed, signal.given, -np.inf))
    held = (last >= 0) & (signal.measured - since[last] > wait) & (signal.measured <= signal.given[-1])
    if held.sum() < 20:
        reason = f"{int(held.sum())} velocities after commands that were held for {wait:.2g} s, 20 are needed"
        yield UnmeasuredTerm(f"{place}.relative, absolute", reason)
        return
    commands = signal.commands[last[held]]
    errors = signal.velocities[held] - commands
    absolute, relative = bounding.envelope(commands, errors)
    told = f"{spread_of(errors, signal.unit)}, as odometry measures them"
    yield MeasuredTerm(f"{place}.absolute", absolute, len(errors), told)
    if relative > 0.0:
        ends = f"commands of {np.abs(commands).min():.2g} to {np.abs(commands).max():.2g} {signal.unit}"
        yield MeasuredTerm(f"{place}.relative", relative, len(errors), ends)
    else:
        yield UnmeasuredTerm(
            f"{place}.relative", "errors do not grow with the command; all of them are in `absolute`"
        )
