"""Where the closed loop goes in one control interval, as linear forms of where it may be now.

A set of states is a linear form of S symbols z in [-1, 1] for each of x, y, theta, and the K numbers that stand behind
them (`Kinematics.before`): the command of the step before or, of a robot whose motion has a state, that state. It has a
rest. What a robot observes, what the policy commands and where it is then are linear forms of
the same symbols, so a policy that steers against an error is seen to reduce it. The sensor errors and the approximation
of the network are in the rest of the command, which becomes A symbols of its own, as it moves the pose and is observed
as the previous command in the next step, or changes the state.

Where a command leads is the kinematics' to say: as forms (`Kinematics.successor`), and, beside them, as plain bounds
(`Kinematics.displacement`), which know what forms do not: that a robot without speed stays exactly where it is. Of a
robot with motors and timing of its own sets hold more, and `viatool.motion.actuated_sets` says where that leads.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from viatool.arrays import Booleans, Floats, Hull, Indices
from viatool.loop.closed_loop import ClosedLoop
from viatool.loop.told import NOTHING, Told
from viatool.motion.actuated_sets import enclose_next
from viatool.rounding import SIGHT_ROUNDING, SLIGHTLY_MORE, SPARE
from viatool.schedule import check_time
from viatool.sets.bounds import require_ordered
from viatool.sets.forms import Forms, PoseBoxes
from viatool.sets.states import StateBoxes
from viatool.setting.rules import Rules

_POSE = slice(0, 3)
_BEFORE = slice(3, None)
_MOST_NUMBERS = 500_000
"""Of coefficients in the arrays of a chunk, so that they stay in the cache."""


@dataclass(frozen=True, eq=False)
class LoopStep:
    """What happens in one control interval from C sets of states, of each piece of what may be commanded: P in all.

    Parameters
    ----------
    origin : ndarray
        (P,) the set from which each piece begins, ascending; every set has one piece at least.
    start : StateBoxes
        P boxes around these sets.
    lower, upper : ndarray
        (P, A) commands, as the robot carries them out.
    least, most : ndarray
        (P, 3) bounds of what is added to x, y and theta.
    before_lower, before_upper : ndarray
        (P, K) bounds of what stands behind the pose afterwards: the command, or the state of the motion.
    states : Forms
        (P, 3 + K) the states afterwards, in the symbols of the start and A for the command. Headings are not
        wrapped: they continue those before, whatever the robot turns by in an interval.
    """

    origin: Indices
    start: StateBoxes
    lower: Floats
    upper: Floats
    least: Floats
    most: Floats
    before_lower: Floats
    before_upper: Floats
    states: Forms

    def select(self, which: Indices | Booleans) -> LoopStep:
        """Return some of the pieces."""
        names = ("origin", "lower", "upper", "least", "most", "before_lower", "before_upper")
        some = {name: getattr(self, name)[which] for name in names}
        return replace(self, start=self.start.select(which), states=select(self.states, which), **some)

    def bounds(self, lower: Floats, upper: Floats) -> tuple[Floats, Floats]:
        """Return lower and upper ends of the states afterwards, (P, 3 + K), from those of the poses before, (C, 3)."""
        lower, upper = lower[self.origin], upper[self.origin]
        forms = self.states.lower, self.states.upper
        first = np.where(self.least == 0.0, lower, np.nextafter(lower + self.least, -np.inf))
        last = np.where(self.most == 0.0, upper, np.nextafter(upper + self.most, np.inf))
        low = np.maximum(forms[0], np.concatenate([first, self.before_lower], axis=1))
        high = np.minimum(forms[1], np.concatenate([last, self.before_upper], axis=1))
        return low, high


def states_of(cells: StateBoxes) -> Forms:
    """Return cells as forms (C, 3 + K) of as many symbols, one for each side."""
    return cells.checked().forms


def step(loop: ClosedLoop, states: Forms, told: Told = NOTHING, *, jumps: int = 2) -> LoopStep:
    """Enclose where the closed loop is after one control interval.

    Parameters
    ----------
    loop : ClosedLoop
        The policy, what it observes, its uncertainty and the robot.
    states : Forms
        (C, 3 + K) in S symbols.
    told : Told
        What else is known of the sets.
    jumps : int
        Of how many readings of a LiDAR that jump, the widest, the sides are pieces of their own; 0 for callers that
        could not follow so many.

    Returns
    -------
    LoopStep
        In S + A symbols, and those that the motion adds; in S + 3 + K + A and those if some of the states have a rest.

    Notes
    -----
    Sound: yes. For every z, every state of that z, and every observation within eps of what perfect sensors read
    there, the command and the next state lie within the rest of the forms of one of the pieces for z and some errors
    of the command.
    Rounding of the proof and, as the arithmetic asks, of the program is counted. With motors and timing of an error
    model the interval is that until the next observation, whenever that is.
    """
    states = name_rests(states.checked())
    count, symbols = states.slope.shape[:2]
    chunk = max(1, _MOST_NUMBERS // ((symbols + len(loop.setting.radii)) * 64))
    firsts = range(0, max(count, 1), chunk)
    chunks = [slice(first, first + chunk) for first in firsts]
    parts = []
    for some in chunks:
        check_time()
        parts.append(_step(loop, select(states, some), told.select(some), jumps))
    return parts[0] if len(parts) == 1 else join_steps(parts, firsts)


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
    return Forms(forms.centre, slope[:, :most], rest * SLIGHTLY_MORE)


def fold_apart(forms: Forms, kept: int, most: int) -> Forms:
    """Return the first symbols as they are, and of the others as many as `fold` does. Sound: yes."""
    others = fold(Forms(forms.centre, forms.slope[:, kept:], forms.rest), most)
    return Forms(forms.centre, np.concatenate([forms.slope[:, :kept], others.slope], axis=1), others.rest)


def select(forms: Forms, which: Indices | Booleans | slice) -> Forms:
    """Return some of the sets."""
    return Forms(forms.centre[which], forms.slope[which], forms.rest[which])


def hull(states: Forms) -> StateBoxes:
    """Return boxes around sets of states, rounded outward."""
    radius = (np.abs(states.slope).sum(axis=1) + states.rest) * SLIGHTLY_MORE + SPARE
    centre = states.centre
    poses = PoseBoxes(centre[:, _POSE], radius[:, _POSE])
    middle, half = centre[:, _BEFORE], radius[:, _BEFORE]
    return StateBoxes(poses, middle - half, middle + half)


def _step(loop: ClosedLoop, states: Forms, told: Told, jumps: int) -> LoopStep:
    """Enclose one chunk of sets without rests."""
    start = hull(states)
    sightings = loop.sensors.enclose(start, states, told, jumps=jumps)
    sent = loop.commands_of_sets(sightings, states.slope.shape[1], len(start), apart=jumps > 0)
    start, states, reached = start.select(sent.cell), select(states, sent.cell), sent.reach
    rules, bounds = loop.rules, (reached.lower, reached.upper)
    require_ordered("commands", *bounds)
    centre, rest = reached.centre, reached.rest
    # A limit moves a command by what it exceeds the limit by: a number between 0 and the most that it may.
    over = np.maximum(bounds[1] - rules.upper, 0.0)
    under = np.maximum(rules.lower - bounds[0], 0.0)
    centre, rest = centre + 0.5 * (under - over), rest + 0.5 * (under + over)
    command = Forms(
        centre,
        np.concatenate([reached.slope, rest[:, :, None] * np.eye(rest.shape[1])], axis=1),  # (P, S + A, A)
        np.zeros_like(rest),
    )
    slack = SIGHT_ROUNDING * (loop.sensors.shapes.scale + np.abs(states.centre).sum(axis=1))
    lower, upper = rules.clip(bounds[0]), rules.clip(bounds[1])
    if rules.over_time is not None:
        found = enclose_next(rules.over_time, states, command, start, (lower, upper), slack)
        return LoopStep(sent.cell, start, lower, upper, *found.added, *found.before, found.states)
    held = loop.given_in(start, lower, upper)
    after = _after(rules, states, command, held, slack)
    added = rules.kinematics.displacement(start.poses, *held, rules.interval)
    before = rules.kinematics.reached(*held, rules.interval) if rules.kinematics.state else (lower, upper)
    strayed = rules.strayed(*held)
    if strayed is not None:
        after = strayed.around(after)
        added = strayed.widened(added, strayed.states[:, _POSE])
        before = strayed.widened(before, strayed.changed)
    return LoopStep(sent.cell, start, lower, upper, *added, *before, after)


def _after(rules: Rules, states: Forms, command: Forms, held: Hull, slack: Floats) -> Forms:
    """Return the states (P, 3 + K) after commands (P, A), in the symbols of these, of states (P, 3 + K) in fewer."""
    more = command.slope.shape[1] - states.slope.shape[1]
    slope = np.concatenate(
        [states.slope, np.zeros((len(command.centre), more, states.slope.shape[2]))], axis=1
    )
    begun = Forms(states.centre, slope, np.zeros_like(states.centre))
    pose, before = _columns(begun, _POSE), _columns(begun, _BEFORE)
    if not rules.kinematics.state:
        moved = rules.kinematics.successor(Forms.beside(pose, command), rules.interval, slack)
        return Forms.beside(moved, command)
    return rules.kinematics.successor(Forms.beside(pose, command, before), rules.interval, slack, held)


def _columns(forms: Forms, which: slice) -> Forms:
    """Return some of the quantities."""
    return Forms(forms.centre[:, which], forms.slope[:, :, which], forms.rest[:, which])


def join_steps(parts: Sequence[LoopStep], firsts: Sequence[int]) -> LoopStep:
    """Return the steps of several batches of sets as one, each of which begins with a set of its own number."""
    return LoopStep(
        origin=np.concatenate([part.origin + first for part, first in zip(parts, firsts, strict=True)]),
        start=StateBoxes.concatenate([part.start for part in parts]),
        lower=_stack(parts, "lower"),
        upper=_stack(parts, "upper"),
        least=_stack(parts, "least"),
        most=_stack(parts, "most"),
        before_lower=_stack(parts, "before_lower"),
        before_upper=_stack(parts, "before_upper"),
        states=Forms.concatenate([part.states for part in parts]),
    )


def _stack(parts: Sequence[object], name: str) -> Floats:
    return np.concatenate([getattr(part, name) for part in parts])
