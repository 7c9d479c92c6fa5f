"""Where the closed loop goes in one control interval, as linear forms of where it may be now.

A set of states is a linear form of S symbols z in [-1, 1] for each of x, y, theta, and v and omega of the step
before, with a rest. What a robot observes, what the policy commands and where it is then are linear forms of the same
symbols, so a policy that steers against an error is seen to reduce it. The sensor errors and the approximation of
the network are in the rest of the command, which becomes two symbols of its own, as it moves the pose and is
observed as the previous command in the next step.

*The motion.* A command that is held for T seconds moves the robot by ``F = v int_0^T e^(i (theta + omega s)) ds``. With
a, b and c the largest deviations of v, theta and omega from the middle, Taylor's theorem leaves out, of each
component, at most

    a (T b + T^2 c / 2) + |v| (T b^2 + T^2 b c + T^3 c^2 / 3) / 2,

as the second derivatives of F are bounded by ``T`` and ``T^2 / 2`` (v with theta and omega) and ``|v|`` times ``T``,
``T^2 / 2`` and ``T^3 / 3``. The heading ``theta + omega T`` is linear.

Beside the forms there are the plain bounds of the displacement ``v T sinc(omega T / 2)`` in a direction between
``theta`` and ``theta + omega T``. They know what forms do not: that a robot without speed stays exactly where it is,
and that none moves backwards.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from viatool.arrays import Booleans, Floats, Indices
from viatool.loop.question import Question
from viatool.sets.bounds import require_ordered
from viatool.sets.forms import ROUNDING, Forms, PoseBoxes
from viatool.sets.states import StateBoxes
from viatool.taylor.correlated import input_model, reach_linear

_POSE = slice(0, 3)
_COMMAND = slice(3, 5)
_SERIES = 1e-2
_MOST_NUMBERS = 500_000
"""Of coefficients in the arrays of a chunk, so that they stay in the cache."""


@dataclass(frozen=True, eq=False)
class Step:
    """What happens in one control interval from C sets of states.

    Parameters
    ----------
    start : StateBoxes
        Boxes around the sets; poses and previous commands.
    lower, upper : ndarray
        (C, 2) commands, as the robot carries them out.
    least, most : ndarray
        (C, 3) bounds of what is added to x, y and theta.
    states : Forms
        (C, 5) x, y, theta, v, omega afterwards, in the symbols of the start and two for the command. Headings are not
        wrapped: they lie within a turn of those before.
    """

    start: StateBoxes
    lower: Floats
    upper: Floats
    least: Floats
    most: Floats
    states: Forms

    def bounds(self, lower: Floats, upper: Floats) -> tuple[Floats, Floats]:
        """Return lower and upper ends of the states afterwards, (C, 5), from those of the poses before, (C, 3)."""
        forms = self.states.lower, self.states.upper
        first = np.where(self.least == 0.0, lower, np.nextafter(lower + self.least, -np.inf))
        last = np.where(self.most == 0.0, upper, np.nextafter(upper + self.most, np.inf))
        low = np.maximum(forms[0], np.concatenate([first, self.lower], axis=1))
        high = np.minimum(forms[1], np.concatenate([last, self.upper], axis=1))
        return low, high


def states_of(cells: StateBoxes) -> Forms:
    """Return cells as forms (C, 5) of five symbols, one for each side."""
    return cells.checked().forms


def step(question: Question, states: Forms) -> Step:
    """Enclose where the closed loop is after one control interval.

    Parameters
    ----------
    question : Question
        The policy, what it observes, its uncertainty and the robot.
    states : Forms
        (C, 5) in S symbols.

    Returns
    -------
    Step
        In S + 2 symbols; in S + 7 if some of the states have a rest.

    Notes
    -----
    Sound: yes. For every z, every state of that z, and every observation within eps of what perfect sensors read
    there, the command and the next state lie within the rest of their forms for z and some errors of the command.
    Rounding of the proof and, as the arithmetic asks, of the program is counted. A robot without delay is meant.
    """
    states = name_rests(states.checked())
    count, symbols = states.slope.shape[:2]
    chunk = max(1, _MOST_NUMBERS // ((symbols + len(question.setting.radii)) * 64))
    parts = [_step(question, select(states, slice(first, first + chunk))) for first in range(0, count, chunk)]
    if not parts:
        return _step(question, states)
    return parts[0] if len(parts) == 1 else _join(parts)


def advance_forms(states: Forms, seconds: float, slack: Floats) -> Forms:
    """Move along the arcs of the commands.

    Parameters
    ----------
    states : Forms
        (C, 5) x, y, theta and the command v, omega that is held.
    seconds : float
        For how long.
    slack : ndarray
        (C,) metres that cover rounding.

    Returns
    -------
    Forms
        (C, 3) poses in the same symbols; headings are not wrapped.
    """
    theta, speed, turn = (states.centre[:, k] for k in (2, 3, 4))
    spread = np.abs(states.slope).sum(axis=1) + states.rest
    half = 0.5 * turn * seconds
    along = np.exp(1j * (theta + half))
    chord = seconds * _sinc(half) * along  # F / v
    moved = speed * chord
    swung = 0.5 * seconds**2 * speed * along * (1j * _sinc(half) - _swing(half))
    left_out = second_order(speed, spread[:, 3], spread[:, 2], spread[:, 4], seconds)
    gradient = np.stack([1j * moved, chord, swung], axis=1)  # (C, 3) for theta, v, omega
    shift = np.einsum("csk,ck->cs", states.slope[:, :, 2:], gradient)
    own = (
        (states.rest[:, 2:] * np.abs(gradient.real)).sum(axis=1),
        (states.rest[:, 2:] * np.abs(gradient.imag)).sum(axis=1),
    )
    centre = np.stack(
        [states.centre[:, 0] + moved.real, states.centre[:, 1] + moved.imag, theta + turn * seconds], axis=1
    )
    slope = np.stack(
        [
            states.slope[:, :, 0] + shift.real,
            states.slope[:, :, 1] + shift.imag,
            states.slope[:, :, 2] + seconds * states.slope[:, :, 4],
        ],
        axis=2,
    )
    rest = np.stack(
        [
            states.rest[:, 0] + own[0] + left_out,
            states.rest[:, 1] + own[1] + left_out,
            states.rest[:, 2] + seconds * states.rest[:, 4],
        ],
        axis=1,
    )
    return Forms(centre, slope, rest + slack[:, None])


def second_order(speed: Floats, a: Floats, b: Floats, c: Floats, seconds: float) -> Floats:
    """Bound what the linear form of a displacement leaves out, (C,), as the module says."""
    mixed = a * (seconds * b + 0.5 * seconds**2 * c)
    bent = seconds * b**2 + seconds**2 * b * c + seconds**3 / 3.0 * c**2
    return np.asarray((mixed + 0.5 * np.abs(speed) * bent) * (1.0 + 2.0**-40))


def displacement(boxes: PoseBoxes, lower: Floats, upper: Floats, seconds: float) -> tuple[Floats, Floats]:
    """Bound what commands of boxes (C, 2) add to x, y and theta of poses of boxes, (C, 3) each. **Sound:** yes.

    What is 0 in exact arithmetic is 0; everything else is rounded outward.
    """
    half = 0.5 * seconds
    first = boxes.centre[:, 2] - boxes.radius[:, 2] + half * lower[:, 1]
    last = boxes.centre[:, 2] + boxes.radius[:, 2] + half * upper[:, 1]
    fastest = half * np.maximum(np.abs(lower[:, 1]), np.abs(upper[:, 1]))
    chord = np.stack([lower[:, 0], upper[:, 0]]) * seconds  # (2, C)
    shares = np.stack([np.maximum(_sinc(fastest), 0.0), np.ones_like(fastest)])
    lengths = (chord[:, None] * shares).reshape(4, -1)
    ends = [_cosine_range(first - quarter, last - quarter) for quarter in (0.0, 0.5 * np.pi)]
    products = [np.concatenate([lengths * low, lengths * high]) for low, high in ends]
    turned = np.stack([lower[:, 1], upper[:, 1]]) * seconds
    least = np.stack([*(product.min(axis=0) for product in products), turned[0]], axis=1)
    most = np.stack([*(product.max(axis=0) for product in products), turned[1]], axis=1)
    outward = 2.0**-40
    return least - outward * np.abs(least), most + outward * np.abs(most)


def _cosine_range(first: Floats, last: Floats) -> tuple[Floats, Floats]:
    """Return bounds of the cosine between two angles."""
    rounding = 2.0**-44 * (1.0 + np.abs(first) + np.abs(last))
    first, last = first - rounding, last + rounding
    ends = np.cos(first), np.cos(last)
    top = np.floor(last / (2.0 * np.pi)) * 2.0 * np.pi >= first
    bottom = np.floor((last - np.pi) / (2.0 * np.pi)) * 2.0 * np.pi + np.pi >= first
    low = np.where(bottom, -1.0, np.maximum(np.minimum(*ends) - 2.0**-44, -1.0))
    high = np.where(top, 1.0, np.minimum(np.maximum(*ends) + 2.0**-44, 1.0))
    return low, high


def name_rests(forms: Forms) -> Forms:
    """Turn the rest of every quantity into a symbol of its own, unless there is none."""
    if not forms.rest.any():
        return forms
    own = forms.rest[:, :, None] * np.eye(forms.rest.shape[1])
    return Forms(forms.centre, np.concatenate([forms.slope, own], axis=1), np.zeros_like(forms.rest))


def fold(forms: Forms, most: int) -> Forms:
    """Fold all but the `most` symbols that weigh most into the rests, so that later steps cost no more. Sound: yes."""
    if forms.slope.shape[1] <= most:
        return forms
    weight = np.abs(forms.slope).sum(axis=2)  # (C, S)
    order = np.argsort(-weight, axis=1, kind="stable")[:, :, None]
    slope = np.take_along_axis(forms.slope, order, axis=1)
    rest = forms.rest + np.abs(slope[:, most:]).sum(axis=1)
    return Forms(forms.centre, slope[:, :most], rest * (1.0 + 2.0**-48))


def select(forms: Forms, which: Indices | Booleans | slice) -> Forms:
    """Return some of the sets."""
    return Forms(forms.centre[which], forms.slope[which], forms.rest[which])


def hull(states: Forms) -> StateBoxes:
    """Return boxes around sets of states, rounded outward."""
    radius = (np.abs(states.slope).sum(axis=1) + states.rest) * (1.0 + 2.0**-40) + 2.0**-44
    centre = states.centre
    poses = PoseBoxes(centre[:, _POSE], radius[:, _POSE])
    middle, half = centre[:, _COMMAND], radius[:, _COMMAND]
    return StateBoxes(poses, middle - half, middle + half)


def _step(question: Question, states: Forms) -> Step:
    """Enclose one chunk of sets without rests."""
    start = hull(states)
    seen = question.sensors.enclose(start, states)
    inputs = input_model(seen.centre, seen.slope, seen.rest + question.setting.radii)
    common = states.slope.shape[1]
    reached = reach_linear(question.policy.network, inputs, common, arithmetic=question.arithmetic)
    columns, rules = question.setting.columns, question.rules
    bounds = reached.lower[:, columns], reached.upper[:, columns]
    require_ordered("commands", *bounds)
    centre, rest = reached.centre[:, columns], reached.rest[:, columns]
    # A limit moves a command by what it exceeds the limit by: a number between 0 and the most that it may.
    over = np.maximum(bounds[1] - rules.upper, 0.0)
    under = np.maximum(rules.lower - bounds[0], 0.0)
    centre, rest = centre + 0.5 * (under - over), rest + 0.5 * (under + over)
    own = rest[:, :, None] * np.eye(2)
    command = np.concatenate([reached.slope[:, :, columns], own], axis=1)  # (C, S + 2, 2)
    pose = np.concatenate([states.slope[:, :, _POSE], np.zeros((len(own), 2, 3))], axis=1)
    held = Forms(
        np.concatenate([states.centre[:, _POSE], centre], axis=1),
        np.concatenate([pose, command], axis=2),
        np.zeros_like(states.rest),
    )
    slack = ROUNDING * (question.sensors.shapes.scale + np.abs(states.centre).sum(axis=1))
    moved = advance_forms(held, rules.interval, slack)
    after = Forms(
        np.concatenate([moved.centre, centre], axis=1),
        np.concatenate([moved.slope, command], axis=2),
        np.concatenate([moved.rest, np.zeros_like(centre)], axis=1),
    )
    lower, upper = rules.clip(bounds[0]), rules.clip(bounds[1])
    least, most = displacement(start.poses, lower, upper, rules.interval)
    return Step(start, lower, upper, least, most, after)


def _sinc(half: Floats) -> Floats:
    """Return sin(h) / h."""
    small = np.abs(half) < _SERIES
    safe = np.where(small, 1.0, half)
    square = half * half
    return np.where(small, 1.0 - square / 6.0 * (1.0 - square / 20.0), np.sin(safe) / safe)


def _swing(half: Floats) -> Floats:
    """Return (sin(h) - h cos(h)) / h^2."""
    small = np.abs(half) < _SERIES
    safe = np.where(small, 1.0, half)
    square = half * half
    near = half / 3.0 * (1.0 - square / 10.0 * (1.0 - square / 28.0))
    return np.where(small, near, (np.sin(safe) - safe * np.cos(safe)) / (safe * safe))


def _join(parts: list[Step]) -> Step:
    """Return all parts as one."""
    poses, starts, states = (
        [part.start.poses for part in parts],
        [part.start for part in parts],
        [part.states for part in parts],
    )
    boxes = PoseBoxes(_stack(poses, "centre"), _stack(poses, "radius"))
    return Step(
        start=StateBoxes(boxes, _stack(starts, "previous_lower"), _stack(starts, "previous_upper")),
        lower=_stack(parts, "lower"),
        upper=_stack(parts, "upper"),
        least=_stack(parts, "least"),
        most=_stack(parts, "most"),
        states=Forms(_stack(states, "centre"), _stack(states, "slope"), _stack(states, "rest")),
    )


def _stack(parts: Sequence[object], name: str) -> Floats:
    return np.concatenate([getattr(part, name) for part in parts])
