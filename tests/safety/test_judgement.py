"""Judgement against brute force: nine commands as the paper takes them, dense commands for all others.

`disagreements` counts what is found of a judgement that brute force contradicts, and every rule of the judgement has a
mutant for which it is not 0.
"""

from __future__ import annotations

import ast
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from tests.safety import brute_force
from tests.safety.brute_force import FOOTPRINTS, clearance, drive_all, random_world
from tests.safety.cases import make_cases, worst_found
from viatool.motion.manoeuvre import Manoeuvre
from viatool.safety import JudgedStates, find_contested, judge, judgement, settle
from viatool.safety.judgement import Contested
from viatool.safety.proof import Proof
from viatool.setting.criteria import Criterion
from viatool.setting.rules import Rules

COUNT = 60
NEAR = 0.02
"""Metres that the grid of brute force misses of the command that comes nearest, at most."""
QUESTIONS = {
    "swept": ("point", {"criterion": "swept"}),
    "braking": ("point", {"criterion": "braking"}),
    "braking square": ("square", {"criterion": "braking"}),
    "later": ("circle", {"criterion": "swept", "delay": 0.1}),
    "later than the interval": ("circle", {"criterion": "swept", "delay": 0.15}),
    "longer": ("point", {"criterion": "swept", "interval": 0.3}),
    "sampled": ("wedge", {"criterion": "sampled", "interval": 0.5}),
}


@cache
def asked(name, reach=0.25):
    """The states of a question, and boxes of commands that reach beyond the limits of the robot."""
    footprint, options = QUESTIONS[name]
    world = random_world(7, FOOTPRINTS[footprint])
    return world, *make_cases(world, seed=2, count=COUNT, reach=reach, **options)


@cache
def found(name):
    """What brute force finds in a box of commands, and in all commands that the robot carries out: metres, (B,)."""
    world, case, lower, upper = asked(name)
    whole = (np.broadcast_to(end, (COUNT, 2)) for end in (case.rules.lower, case.rules.upper))
    return worst_found(world, case, lower, upper)[0], worst_found(world, case, *whole)[0]


@cache
def nine(name):
    """The least clearance of nine commands at eleven instants of the interval, (B,) metres."""
    world, case, lower, upper = asked(name)
    rules, worst = case.rules, []
    low, high = (np.clip(end, rules.lower, rules.upper) for end in (lower, upper))
    for index in range(COUNT):
        v, w = ([low[index, k], 0.5 * (low[index, k] + high[index, k]), high[index, k]] for k in (0, 1))
        commands = np.array([(a, b) for a in v for b in w])
        start = np.tile(case.observing.poses[index], (9, 1))
        poses = drive_all(start, *commands.T, rules.interval * np.arange(11)[None] / 10)
        worst.append(clearance(world, poses.reshape(-1, 3), rules.footprint).min())
    return np.array(worst)


def disagreements(name):
    """Verdicts that brute force contradicts: of contested states, of safe ones, and of nine commands."""
    _, case, lower, upper = asked(name)
    limits, (in_box, in_any) = case.rules.clearance, found(name)
    contested = find_contested(case)
    judged = judge(case, lower, upper, Contested(np.ones(COUNT, bool), np.ones(COUNT, bool)))
    skipped = judge(case, lower, upper, contested)
    wrong = _contradicted(~contested.collision, in_any, limits.collision, 0.05)
    wrong += _contradicted(~contested.danger, in_any, limits.danger, 0.05)
    for verdicts in (judged, skipped):
        if case.rules.criterion == "sampled":
            wrong += int((verdicts.safe != (nine(name) > limits.collision)).sum())
            wrong += int((verdicts.danger != (nine(name) > limits.danger)).sum())
        else:
            wrong += _contradicted(verdicts.safe, in_box, limits.collision, NEAR)
            wrong += _contradicted(verdicts.danger, in_box, limits.danger, NEAR)
        if not case.rules.delay:
            wrong += int((verdicts.sampled != (nine(name) > limits.collision)).sum())
    return wrong


def _contradicted(holds, worst, limit, near):
    return int((holds & (worst <= limit)).sum() + (~holds & (worst > limit + near)).sum())


@pytest.mark.parametrize("name", QUESTIONS)
def test_brute_force_agrees_with_every_verdict(name):
    assert disagreements(name) == 0


@pytest.mark.slow
@pytest.mark.parametrize("criterion", ["swept", "braking"])
@pytest.mark.parametrize("name", FOOTPRINTS)
def test_brute_force_agrees_in_many_rooms(name, criterion):
    """Finer grids of commands, more delays, and boxes of commands from a point to the whole range."""
    proved = 0
    for seed, delay in enumerate((0.0, 0.03, 0.1, 0.17, 0.3), start=100):
        world = random_world(seed, FOOTPRINTS[name])
        case, lower, upper = make_cases(world, criterion, seed, count=COUNT, reach=0.3, delay=delay)
        worst, _ = worst_found(world, case, lower, upper, commands=13)
        judged = judge(case, lower, upper, find_contested(case))
        for holds, limit in (
            (judged.safe, world.clearance.collision),
            (judged.danger, world.clearance.danger),
        ):
            assert (worst[holds] > limit).all()
            assert (~holds & (worst > limit + NEAR)).sum() <= 1  # given up, or missed by the grid
        proved += int(judged.safe.sum())
    assert 20 <= proved <= 5 * COUNT - 20


@pytest.mark.parametrize("name", QUESTIONS)
def test_there_are_states_of_every_verdict(name):
    _, case, lower, upper = asked(name)
    contested = find_contested(case)
    judged = judge(case, lower, upper, contested)
    assert 1 <= contested.collision.sum() <= contested.danger.sum() <= COUNT
    for holds in (judged.safe, judged.danger, judged.sampled):
        assert 1 <= holds.sum() < COUNT
    assert (contested.collision <= contested.danger).all()
    assert (judged.danger <= judged.safe).all()
    np.testing.assert_array_equal(contested.either, contested.collision | contested.danger)


def without_danger(right):
    return lambda test, case, lower, upper, distance, contested: right(
        test, case, lower, upper, case.rules.clearance.collision, contested
    )


def without_collision(right):
    return lambda test, case, lower, upper, distance, contested: right(
        test, case, lower, upper, case.rules.clearance.danger, contested
    )


def all_proved(case, threshold):
    return Proof(np.ones(len(case), bool), np.zeros(len(case), bool))


MUTANTS = {
    "no dead time": ("later", JudgedStates, "prove_waiting", lambda right: all_proved),
    "acting at once": ("later", JudgedStates, "acting", lambda right: property(lambda case: case.observing)),
    "clipped to less": (
        "swept", Rules, "clip", lambda right: lambda rules, actions: 0.5 * right(rules, actions),
    ),
    "no braking": (
        "braking", Rules, "manoeuvre", lambda right: property(lambda rules: Manoeuvre(rules.interval)),
    ),
    "braking of the centre alone": (
        "braking square", Rules, "manoeuvre",
        lambda right: property(lambda rules: replace(right.__get__(rules), rim=0.0)),
    ),
    "half the interval": (
        "longer", Rules, "manoeuvre", lambda right: property(lambda rules: Manoeuvre(0.5 * rules.interval)),
    ),
    "danger at the collision distance": ("swept", judgement, "_hold", without_danger),
    "collision at the danger distance": ("swept", judgement, "_hold", without_collision),
    "danger at the collision distance, of nine": ("sampled", judgement, "_hold", without_danger),
    "begin alone": ("sampled", Criterion, "instants", lambda right: right[:1]),
    "end alone": ("sampled", Criterion, "instants", lambda right: right[-1:]),
    "contested at another distance": (
        "swept", judgement, "_contested", lambda right: lambda case, distance: right(case, distance - 0.1),
    ),
    "contested within reach of one interval less": (
        "swept", Manoeuvre, "longest", lambda right: lambda *a: 0.0 * right(*a),
    ),
    "nothing is contested": (
        "swept", judgement, "settle", lambda right: lambda case, threshold: np.ones(len(case), bool),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", MUTANTS)
def test_brute_force_catches_a_judgement_without_one_of_its_rules(monkeypatch, name):
    question, owner, attribute, mutate = MUTANTS[name]
    right = vars(owner)[attribute]
    asked(question), found(question), nine(question)  # of the program as it is
    _forget(asked(question)[1])
    monkeypatch.setattr(owner, attribute, mutate(right))
    wrong = disagreements(question)
    _forget(asked(question)[1])
    assert wrong > 0


def _forget(case):
    """Drop what a case has worked out already."""
    vars(case).pop("acting", None)


@pytest.mark.parametrize("name", ["point", "square"])
def test_a_disc_and_an_outline_are_settled_as_far_out_as_they_reach(name):
    """The distance that settles most states is from the middle of the robot, not from its rim."""
    footprint = FOOTPRINTS[name]
    world = random_world(4, footprint)
    case, _, _ = make_cases(world, "swept", 4, count=200, reach=0.3)
    whole = (np.broadcast_to(end, (200, 2)) for end in (case.rules.lower, case.rules.upper))
    worst, _ = worst_found(world, case, *whole, commands=5)
    settled = settle(case, world.clearance.collision)
    assert (worst[settled] > world.clearance.collision).all()
    assert settled.sum() > 20


def test_commands_beyond_the_limits_count_as_the_limits():
    _, case, _, _ = asked("longer")
    most, every = np.broadcast_to(case.rules.upper, (COUNT, 2)), Contested(*[np.ones(COUNT, bool)] * 2)
    at, beyond = judge(case, most, most, every), judge(case, most + 3.0, most + 5.0, every)
    np.testing.assert_array_equal(beyond.safe, at.safe)
    np.testing.assert_array_equal(beyond.sampled, at.sampled)
    assert 1 <= at.safe.sum() < COUNT


def test_chunks_change_nothing(monkeypatch):
    _, case, lower, upper = asked("later")
    contested = find_contested(case)
    judged = judge(case, lower, upper, contested)
    monkeypatch.setattr(judgement, "_CHUNK", 7)
    again = find_contested(case)
    for part in ("collision", "danger"):
        np.testing.assert_array_equal(getattr(again, part), getattr(contested, part))
    for part in ("safe", "danger", "sampled"):
        np.testing.assert_array_equal(getattr(judge(case, lower, upper, again), part), getattr(judged, part))


def test_what_is_not_contested_holds_whatever_is_commanded():
    _, case, lower, upper = asked("swept")
    none = np.zeros(COUNT, bool)
    judged = judge(case, np.full_like(lower, np.nan), np.full_like(upper, np.nan), Contested(none, none))
    assert judged.safe.all()
    assert judged.danger.all()
    assert judged.sampled.all()


def test_brute_force_shares_no_code_with_what_it_judges():
    """It knows the map and the footprint as plain data."""
    tree = ast.parse(Path(brute_force.__file__).read_text(encoding="utf-8"))
    names = {
        (node.module, alias.name)
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("viatool")
        for alias in node.names
    }
    data = ("Clearance", "Footprint", "Obstacles", "Robot", "WorldMap")
    assert names == {("viatool.world", name) for name in data}
