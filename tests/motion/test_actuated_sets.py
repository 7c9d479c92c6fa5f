"""Sets of robots with motors and clocks: what an oracle drives is in the forms of its symbols, and in the bounds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.loop.motor_runs import Motors, Oracle
from viatool.motion import actuated_sets, seen_velocities
from viatool.motion.actuated import Machine
from viatool.motion.actuated_sets import enclose_next
from viatool.motion.actuation import Actuation, Response
from viatool.motion.carried import carried_axes
from viatool.motion.kinematics import KINEMATICS
from viatool.motion.timing import Timing
from viatool.sets.forms import Forms, PoseBoxes
from viatool.sets.states import StateBoxes

RUNS, SLACK = 3000, 1e-6
COLUMNS = {"differential": [0, 2], "holonomic": [0, 2, 1]}
TERMS = {
    "none": {},
    "gain": {"relative": (0.1, 0.1, 0.15)},
    "bias": {"absolute": (0.03, 0.02, 0.05)},
    "slip": {"slip": 0.1},
    "jitter": {"interval": (0.07, 0.13)},
    "limits": {
        "speeding": ((1.0, 1.5), (1.0, 1.5), (2.0, 3.0)),
        "slowing": ((2.0, 4.0), (1.5, 2.0), (4.0, 8.0)),
    },
    "least limits": {"speeding": ((0.6, np.inf),) * 3, "slowing": ((0.6, np.inf),) * 3},
    "lag": {"lag": ((0.05, 0.1), (0.0, 0.1), (0.02, 0.2))},
    "delay": {"delay": (0.03, 0.06)},
    "long delay": {"delay": (0.12, 0.25)},
    "delay about an interval": {"delay": (0.083, 0.135)},
    "delay of more intervals": {"delay": (0.154, 0.167), "interval": (0.077, 0.1)},
    "sensing": {"sensing": 0.04},
    "sensing for longer than an interval": {"sensing": 0.12, "lag": ((0.1, 0.18), (0.08, 0.2), (0.0, 0.0))},
    "all": {
        "relative": (0.05, 0.05, 0.05),
        "absolute": (0.01, 0.01, 0.02),
        "slip": 0.05,
        "interval": (0.08, 0.12),
        "lag": ((0.02, 0.08),) * 3,
        "speeding": ((1.5, np.inf),) * 3,
        "slowing": ((2.0, np.inf),) * 3,
        "delay": (0.02, 0.09),
        "sensing": 0.03,
    },
}


def machine_of(name, motors):
    parts = [
        Response(motors.speeding[k], motors.slowing[k], motors.lag[k], motors.relative[k], motors.absolute[k])
        for k in range(3)
    ]
    move = KINEMATICS[name]
    if not move.slides:
        parts[1] = Response()
    actuation = Actuation(parts[0], parts[1], parts[2], motors.slip)
    limits = np.array([-0.6, -1.5, -0.6])[: len(move.axes)], np.array([0.6, 1.5, 0.6])[: len(move.axes)]
    return Machine(move, limits, actuation, Timing(motors.interval, motors.delay, motors.sensing))


class Case:
    """A set of states whose symbols are the sides of its box, a command that follows them, and runs from it."""

    def __init__(self, name, motors, seed=0, narrow=1.0):
        self.machine, self.motors = machine_of(name, motors), motors
        if name == "differential":
            mask = np.array([1, 0, 1])
            self.motors = replace(
                motors,
                relative=np.array(motors.relative) * mask,
                absolute=np.array(motors.absolute) * mask,
            )
        generator = np.random.default_rng(seed)
        self.axes = len(self.machine.kinematics.axes)
        size = 3 + len(carried_axes(self.machine))
        self.middle = np.concatenate(
            [[0.4, -0.3, generator.uniform(-3, 3)], generator.uniform(-0.3, 0.4, size - 3)]
        )
        self.half = np.concatenate([[0.02, 0.02, 0.03], generator.uniform(0.01, 0.06, size - 3)])
        own = 0.02 * np.eye(self.axes)
        self.gain = np.concatenate([generator.uniform(-0.08, 0.08, (size, self.axes)), own])
        self.half[3:] *= narrow
        self.gain *= narrow
        self.told = generator.uniform(-0.2, 0.4, self.axes)
        self.columns = COLUMNS[name]

    def enclosed(self):
        """What is found of one set: forms, and bounds."""
        size = len(self.middle)
        states = Forms(self.middle[None], np.diag(self.half)[None], np.zeros((1, size)))
        command = Forms(self.told[None], self.gain[None], np.zeros((1, self.axes)))
        reach = np.abs(self.gain).sum(axis=0)
        held = (self.told - reach)[None], (self.told + reach)[None]
        low, high = (self.middle - self.half)[None], (self.middle + self.half)[None]
        cells = StateBoxes(PoseBoxes(self.middle[None, :3], self.half[None, :3]), low[:, 3:], high[:, 3:])
        return enclose_next(self.machine, states, command, cells, held, np.array([1e-12]))

    def runs(self, seed=1):
        """Symbols (R, S) of states and command, and what the robots are afterwards, (R, 3 + K)."""
        generator = np.random.default_rng(seed)
        size, acting = len(self.middle), self.machine.timing.commands
        z = generator.uniform(-1.0, 1.0, (RUNS, size + self.axes))
        z[::2] = np.sign(z[::2])
        begun = self.middle + z[:, :size] * self.half
        command = self.in_parts(self.told + z @ self.gain)
        older = [self.in_parts(begun[:, 3 + k * self.axes :][:, : self.axes]) for k in range(max(acting, 1))]
        velocity = self.in_parts(begun[:, -self.axes :])
        oracle = Oracle(self.motors, RUNS, seed)
        before = np.stack([*older, older[-1]], axis=1)
        start = oracle.begin(begun[:, :3], velocity, before)
        end = oracle.follow(start, command)
        behind = [command, *older[: max(acting - 1, 0)]]
        behind += [] if self.machine.actuation.at_once else [end.velocity]
        return z, np.concatenate([end.poses, *(part[:, self.columns] for part in behind)], axis=1), begun

    def in_parts(self, commands):
        found = np.zeros((len(commands), 3))
        found[:, self.columns] = commands
        return found

    def escapes(self):
        """By how much runs are beyond the form of their own symbols, and beyond the bounds."""
        found, (z, after, begun) = self.enclosed(), self.runs()
        forms, known = found.states, z.shape[1]
        middle = forms.centre[0] + z @ forms.slope[0, :known]
        own = np.abs(forms.slope[0, known:]).sum(axis=0) + forms.rest[0]
        added = after[:, :3] - begun[:, :3]
        over = np.maximum(added - found.added[1], found.added[0] - added)
        behind = np.maximum(after[:, 3:] - found.before[1], found.before[0] - after[:, 3:])
        return float((np.abs(after - middle) - own).max()), float(over.max()), float(behind.max())


@pytest.mark.parametrize("kinematics", ["differential", "holonomic"])
@pytest.mark.parametrize("name", TERMS)
def test_every_run_is_in_the_form_of_its_symbols_and_in_the_bounds(kinematics, name):
    for seed in range(4):
        for narrow in (1.0, 1e-3):
            assert max(Case(kinematics, Motors(**TERMS[name]), seed, narrow).escapes()) < SLACK


def worst(name, change=lambda some: None, kinematics="holonomic"):
    """By how much runs leave what is found of some sets at most; `change` alters what is followed alone."""
    found = []
    for seed in range(8):
        some = Case(kinematics, Motors(**TERMS[name]), seed, 1.0 if seed % 2 else 1e-3)
        change(some)
        found.append(max(some.escapes()))
    return max(found)


def without(some, name):
    """Follow a robot that is ideal in a term; one that has its velocity nearly at once still carries it."""
    plain = replace(some.motors, **{field: getattr(Motors(), field) for field in TERMS[name]})
    machine = machine_of(some.machine.kinematics.name, plain)
    if not some.machine.actuation.at_once:
        machine = replace(machine, actuation=Actuation(*[Response(lag=(0.0, 1e-6))] * 3))
    some.machine = machine


@pytest.mark.parametrize(
    "name", ["gain", "bias", "slip", "jitter", "limits", "least limits", "lag", "delay", "sensing"]
)
def test_runs_leave_the_sets_of_a_robot_that_is_ideal_in_a_term(name):
    assert worst(name, lambda some: without(some, name)) > 100 * SLACK


def errors_at_the_ends(self, lower, upper):
    return self.of("relative") * np.minimum(np.abs(lower), np.abs(upper)) + self.of("absolute")


def half_of(function):
    def halved(*given):
        first, *rest = function(*given)
        return (0.5 * first, *rest)

    return halved


def without_rests(function):
    def pushed(*given):
        push, place, turn = function(*given)
        return push, 0.0 * place, 0.0 * turn

    return pushed


def the_newest_alone(function):
    def cut(machine):
        for start, end, commands in function(machine):
            yield start, end, (min(commands),)

    return cut


def at_the_middle(function):
    def product(one, other):
        middle = 0.5 * (other[0] + other[1])
        return function(one, (middle, middle))

    return product


MUTANTS = {
    "the error of a gain at the lesser end": (
        "gain",
        (Actuation, "largest_error", lambda _: errors_at_the_ends),
    ),
    "half of what velocities differ by": ("gain", (actuated_sets, "_radii", half_of)),
    "no direction but the middle one": ("gain", (actuated_sets, "_FARTHEST_APART", lambda _: 0.0)),
    "the heading of a late observation": ("jitter", (actuated_sets, "_late", without_rests)),
    "the limit that counts at the start": (
        "limits",
        (Actuation, "either_way", lambda _: property(lambda self: self)),
    ),
    "the newest command alone": ("delay", (seen_velocities, "_cut", the_newest_alone)),
    "older commands alone": ("long delay", (seen_velocities, "_cut", the_newest_alone)),
    "displacements in the middle direction": ("none", (actuated_sets, "_product", at_the_middle)),
}


@pytest.mark.parametrize("mutant", MUTANTS)
def test_runs_catch_a_rule_that_is_left_out(mutant, monkeypatch):
    name, (place, attribute, change) = MUTANTS[mutant]
    assert worst(name) < SLACK
    monkeypatch.setattr(place, attribute, change(vars(place)[attribute]))
    assert worst(name) > 3 * SLACK
