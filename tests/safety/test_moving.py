"""Things that move, against adversaries with code of their own: they go straight at the robot, or anywhere.

An adversary drives real runs: it picks a command of the box, an obstacle, an instant, and the way in which the obstacle
goes on from where it was observed, and measures with shapely. `violations` counts the runs that come too near in a
state that is called safe, and every rule of the growth has a mutant for which that is not 0.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import shapely

from tests.safety.brute_force import FOOTPRINTS, drive_all, drive_and_stop, place, random_world, rim_of
from tests.safety.cases import make_cases
from viatool.motion.manoeuvre import Manoeuvre
from viatool.safety import enclosure, find_contested, judge, judged_states, judgement
from viatool.safety.judgement import Contested
from viatool.safety.moving import moving_obstacles
from viatool.safety.scene_poses import Movers
from viatool.setting.rules import Rules
from viatool.uncertainty.error_model import ObstacleTerms
from viatool.world import Capsules

COUNT, RUNS, STEPS = 60, 20_000, 20
SPEEDS = {"box-2": 0.3, "circle-0": 0.0, "circle-1": 0.9}
ROAMS = {"triangle": 0.15}
QUESTIONS = {
    "braking": ("point", {"criterion": "braking"}),
    "swept": ("circle", {"criterion": "swept", "interval": 0.4}),
    "square": ("square", {"criterion": "braking"}),
    "late": ("point", {"criterion": "braking", "delay": 0.45, "interval": 0.2}),
    "late square": ("square", {"criterion": "swept", "delay": 0.15, "interval": 0.3}),
}


@cache
def named_world(footprint):
    world = random_world(7, FOOTPRINTS[footprint])
    names = (*(f"circle-{k}" for k in range(5)), *(f"box-{k}" for k in range(4)), "triangle")
    return replace(world, obstacles=replace(world.obstacles, names=names))


@cache
def asked(name, speed=0.6):
    footprint, options = QUESTIONS[name]
    world = named_world(footprint)
    case, lower, upper = make_cases(world, seed=2, count=COUNT, reach=1.0, **options)
    terms = ObstacleTerms(speed=speed, named=SPEEDS, roams=ROAMS)
    movers = Movers(moving_obstacles(world, [None], terms), np.zeros(COUNT, int))
    return replace(case, observing=case.observing.among([movers])), lower, upper


def timed_paths(case, index, commands):
    """Poses (A, T, 3) and seconds (A, T) since the observation, of A commands in one state, by brute force."""
    rules, count = case.rules, len(commands)
    start, poses, times, spent = np.tile(case.observing.poses[index], (count, 1)), [], [], 0.0
    whole = int(rules.delay / rules.interval + 1e-9)
    pieces = [rules.delay - whole * rules.interval] + [rules.interval] * whole
    for seconds, command in zip([s for s in pieces if s > 1e-9], case.under_way[index], strict=True):
        poses.append(drive_all(start, *np.tile(command, (count, 1)).T, np.linspace(0.0, seconds, 12)[None]))
        times.append(np.tile(spent + np.linspace(0.0, seconds, 12), (count, 1)))
        start, spent = poses[-1][:, -1], spent + seconds
    if rules.criterion == "braking":
        rim = rim_of(rules.footprint)
        poses.append(drive_and_stop(start, *commands.T, rules.interval, rules.deceleration, rim, STEPS))
        stop = (np.abs(commands[:, 0]) + rim * np.abs(commands[:, 1])) / rules.deceleration
        held = np.tile(np.linspace(0.0, rules.interval, STEPS), (count, 1))
        times.append(spent + np.hstack([held, rules.interval + stop[:, None] * np.arange(STEPS + 1) / STEPS]))
    else:
        poses.append(drive_all(start, *commands.T, np.linspace(0.0, rules.interval, 25)[None]))
        times.append(np.tile(spent + np.linspace(0.0, rules.interval, 25), (count, 1)))
    return np.concatenate(poses, axis=1), np.concatenate(times, axis=1)


def movable(world, speed=0.6):
    """The obstacles of the map as shapely geometries, and how far each may get: m/s, and m whenever."""
    circles = [shapely.Point(x, y).buffer(r, quad_segs=64) for x, y, r in world.obstacles.circles]
    shapes = [*circles, *map(shapely.Polygon, world.obstacles.polygons)]
    names = world.obstacles.names
    speeds = np.array([0.0 if name in ROAMS else SPEEDS.get(name, speed) for name in names])
    return np.array(shapes), speeds, np.array([ROAMS.get(name, 0.0) for name in names])


def runs(case, lower, upper, seed):
    """What is left in metres in RUNS runs, and the state of each."""
    world, rules = named_world_of(case), case.rules
    shapes, speeds, roams = movable(world)
    generator = np.random.default_rng(seed)
    poses, seconds, state = [], [], []
    each = RUNS // len(case)
    for index in range(len(case)):
        commands = generator.uniform(0.0, 1.0, (8, 2)).round(generator.integers(0, 2))  # corners as well
        commands = np.clip(lower[index] + commands * (upper[index] - lower[index]), rules.lower, rules.upper)
        path, time = timed_paths(case, index, commands)
        row, at = generator.integers(0, 8, each), generator.integers(0, path.shape[1], each)
        at[::3] = path.shape[1] - 1
        poses.append(path[row, at])
        seconds.append(time[row, at])
        state.append(np.full(each, index))
    poses, seconds, state = map(np.concatenate, (poses, seconds, state))
    distances = np.stack([shapely.distance(place(poses, rules.footprint), shape) for shape in shapes], axis=1)
    left = distances - speeds * seconds[:, None] - roams
    which = np.where(
        generator.random(len(poses)) < 0.8, left.argmin(axis=1), generator.integers(0, len(shapes))
    )
    lines = shapely.shortest_line(shapes[which], place(poses, rules.footprint))
    begin, end = (shapely.get_coordinates(shapely.get_point(lines, k)) for k in (0, 1))
    length = np.hypot(*(end - begin).T)
    straight = (end - begin) / np.where(length > 0.0, length, 1.0)[:, None]
    anywhere = np.exp(1j * generator.uniform(-np.pi, np.pi, len(poses)))
    anywhere = np.column_stack([anywhere.real, anywhere.imag])
    way = np.where(generator.random(len(poses))[:, None] < 0.8, straight, anywhere)
    gone = np.minimum(speeds[which] * seconds + roams[which], length)[:, None] * way
    there = poses - np.hstack(
        [gone, np.zeros((len(poses), 1))]
    )  # the obstacle stays, the robot comes instead
    away = shapely.distance(place(there, rules.footprint), shapes[which])
    return away - (rules.footprint.radius if rules.footprint.kind == "circle" else 0.0), state


def named_world_of(case):
    return next(named_world(name) for name, one in FOOTPRINTS.items() if one is case.rules.footprint)


def violations(name):
    """Runs that come too near in states that are called safe: of a box of commands, and of all commands."""
    case, lower, upper = asked(name)
    contested = find_contested(case)
    safe = judge(case, lower, upper, Contested(np.ones(COUNT, bool), np.ones(COUNT, bool))).safe
    found = []
    whole = (np.broadcast_to(end, (COUNT, 2)) for end in (case.rules.lower, case.rules.upper))
    for ends, proved in (((lower, upper), safe), (whole, ~contested.collision)):
        left, state = runs(case, *ends, seed=5)
        found.append(int((proved[state] & (left <= case.rules.clearance.collision - 1e-9)).sum()))
    return found


@pytest.mark.parametrize("name", QUESTIONS)
def test_no_adversary_comes_too_near_in_a_state_that_is_safe(name):
    case, lower, upper = asked(name)
    contested = find_contested(case)
    judged = judge(case, lower, upper, contested)
    assert 3 < judged.safe.sum() < COUNT - 3
    assert contested.collision.any()
    assert violations(name) == [0, 0]


def test_adversaries_come_nearly_as_near_as_is_allowed():
    """What is called unsafe mostly is: the middle command is refuted by a run of the adversary."""
    case, lower, upper = asked("braking")
    middle = case.rules.clip(0.5 * (lower + upper))
    limit = case.rules.clearance.collision
    bare = replace(case, observing=replace(case.observing, movers=()))
    refuted = judgement.prove(case, middle, middle, limit).refuted
    refuted &= judgement.prove(bare, middle, middle, limit).proved
    left, state = runs(case, middle - 1e-9, middle + 1e-9, seed=6)
    least = np.full(COUNT, np.inf)
    np.minimum.at(least, state, left)
    assert refuted.sum() > 5
    assert (least[refuted] <= limit + 0.02).all()


ORIGINAL = Manoeuvre.counted_between


def _not_while_waiting(self, actions, lower, upper, start, end):
    if self.begins == 0.0:
        return 0.0 * start, 0.0 * end
    return ORIGINAL(self, actions, lower, upper, start, end)


def _not_while_braking(self, actions, lower, upper, start, end):
    earliest, latest = ORIGINAL(self, actions, lower, upper, start, end)
    return earliest, np.minimum(latest, self.begins + self.interval)


def _of_the_centre(self, actions, lower, upper, start, end):
    return ORIGINAL(self, actions, actions, actions, start, end)


def _at_the_start(self, actions, lower, upper, start, end):
    earliest, _ = ORIGINAL(self, actions, lower, upper, start, end)
    return earliest, earliest


def _from_the_command_on(self, actions, lower, upper, start, end):
    earliest, latest = ORIGINAL(self, actions, lower, upper, start, end)
    return earliest - self.begins, latest - self.begins


MUTANTS = {
    "not while braking": ("braking", _not_while_braking),
    "only as long as the centre takes": ("braking", _of_the_centre),
    "only until a part of the path begins": ("swept", _at_the_start),
    "only from the command on": ("late", _from_the_command_on),
}


@pytest.mark.parametrize("name", MUTANTS)
def test_every_rule_of_the_growth_is_needed(monkeypatch, name):
    question, mutant = MUTANTS[name]
    monkeypatch.setattr(Manoeuvre, "counted_between", mutant)
    assert violations(question)[0] > 0


def test_the_growth_is_needed_while_commands_are_on_their_way(monkeypatch):
    world = named_world("point")
    case, *_ = make_cases(world, seed=3, count=COUNT, reach=1.0, criterion="swept", delay=0.15, interval=0.3)
    fast = ObstacleTerms(speed=3.0)
    movers = Movers(moving_obstacles(world, [None], fast), np.zeros(COUNT, int))
    case = replace(case, observing=case.observing.among([movers]))
    before = case.prove_waiting(0.1).proved
    monkeypatch.setattr(Manoeuvre, "counted_between", _not_while_waiting)
    assert case.prove_waiting(0.1).proved.sum() > before.sum()


def test_the_contested_test_needs_the_growth(monkeypatch):
    monkeypatch.setattr(
        judgement, "settle", lambda states, threshold: judged_without_movers(states, threshold)
    )
    assert violations("braking")[1] > 0


SETTLE = judgement.settle


def judged_without_movers(states, threshold):
    return SETTLE(replace(states, observing=replace(states.observing, movers=())), threshold)


@pytest.mark.parametrize("name", ["braking", "late square"])
def test_verdicts_are_monotone_in_the_speed_and_those_of_today_without(name):
    case, lower, upper = asked(name)
    world = named_world_of(case)
    bare = replace(case, observing=replace(case.observing, movers=()))
    before = None
    for speed in (0.0, 0.1, 0.4, 1.5):
        movers = Movers(moving_obstacles(world, [None], ObstacleTerms(speed=speed)), np.zeros(COUNT, int))
        states = replace(bare, observing=bare.observing.among([movers]))
        contested = find_contested(states)
        judged = judge(states, lower, upper, contested)
        found = (judged.safe, judged.danger, judged.sampled, ~contested.collision, ~contested.danger)
        if before is None:
            assert len(movers.capsules) == 0
            contested = find_contested(bare)
            today = judge(bare, lower, upper, contested)
            for one, other in zip(
                found,
                (today.safe, today.danger, today.sampled, ~contested.collision, ~contested.danger),
                strict=True,
            ):
                np.testing.assert_array_equal(one, other)
        else:
            assert all((one <= other).all() for one, other in zip(found, before, strict=True))
        before = found


def test_a_robot_that_stands_is_at_no_fault_where_it_brakes():
    case, lower, _ = asked("braking")
    stop = np.zeros_like(lower)
    free = case.observing.footprint_clearance(case.rules.footprint, np.zeros(COUNT))[0] > 0.1 + 1e-6
    np.testing.assert_array_equal(judgement.prove(case, stop, stop, 0.1).proved, free)
    turning = np.column_stack([0.0 * lower[:, 0], np.ones(COUNT)])
    np.testing.assert_array_equal(judgement.prove(case, turning, turning, 0.1).proved, free)
    swept = replace(case, rules=replace(case.rules, criterion="swept", interval=1.0))
    assert judgement.prove(swept, stop, stop, 0.1).proved.sum() < free.sum()


def test_the_corners_of_a_robot_that_turns_move():
    case, lower, _ = asked("square")
    turning = np.column_stack([0.0 * lower[:, 0], np.ones(COUNT)])
    still = judgement.prove(case, 0.0 * lower, 0.0 * lower, 0.1).proved
    assert judgement.prove(case, turning, turning, 0.1).proved.sum() < still.sum()


def test_the_clock_of_faster_commands_is_never_behind():
    """`counted_between` holds for every command of a box: against instants of random ones."""
    rules = Rules.of(named_world("square"), "braking", delay=0.1)
    generator = np.random.default_rng(0)
    low = generator.uniform(rules.lower, rules.upper, (3000, 2))
    high = np.minimum(low + generator.uniform(0.0, 0.5, (3000, 2)), rules.upper)
    start = generator.uniform(0.0, 1.0, 3000)
    end = np.minimum(start + generator.choice([0.0, 1e-9, 0.3, 1.0], 3000), 1.0)
    middle = 0.5 * (low + high)
    for manoeuvre in (rules.manoeuvre, *rules.waiting):
        earliest, latest = manoeuvre.counted_between(middle, low, high, start, end)
        some = low + generator.random((3000, 2)) * (high - low)
        at = start + generator.random(3000) * (end - start)
        assert (manoeuvre.counted(some, at) <= latest).all()
        assert (manoeuvre.counted(middle, at) >= earliest).all()
        assert (latest - earliest < 5e-7)[(low == high).all(axis=1) & (start == end)].all()


@pytest.mark.parametrize("name", ["braking", pytest.param("late square", marks=pytest.mark.slow)])
def test_what_moves_far_away_changes_nothing(monkeypatch, name):
    case, lower, upper = asked(name)
    few = case.among_near()
    assert sum(len(some.capsules) for some in few.observing.movers) < 0.8 * len(
        case.observing.movers[0].capsules
    )
    every = Contested(np.ones(COUNT, bool), np.ones(COUNT, bool))
    for one, other in (
        (find_contested(few), find_contested(case)),
        (judge(few, lower, upper, every), judge(case, lower, upper, every)),
    ):
        for field in vars(one):
            np.testing.assert_array_equal(getattr(one, field), getattr(other, field))
    commands = case.rules.clip(0.5 * (lower + upper))
    left, *_ = case.closest_approach(commands[:, None])
    near = left[:, 0] < case.rules.clearance.danger
    assert near.any()
    assert (few.nearest_movers(commands).labels[near] == case.nearest_movers(commands).labels[near]).all()
    np.testing.assert_array_equal(few.closest_approach(commands[:, None])[0][near], left[near])
    monkeypatch.setattr(Rules, "longest_way", (0.0, 0.0))
    short = replace(case, rules=replace(case.rules)).among_near()
    monkeypatch.undo()
    assert judge(short, lower, upper, every).safe.sum() > judge(case, lower, upper, every).safe.sum()


def test_nothing_is_proved_of_a_mover_that_is_not_a_number():
    case, lower, upper = asked("braking")
    nowhere = np.full((1, COUNT), np.nan + 0j)
    lost = Capsules(nowhere, nowhere, np.zeros((1, COUNT)), np.ones((1, COUNT)), ("lost",))
    states = replace(case, observing=case.observing.among([Movers(lost, np.arange(COUNT))])).among_near()
    assert not judgement.prove(states, lower, upper, 0.1).proved.any()
    assert find_contested(states).collision.all()


def test_what_is_nearest_goes_straight_at_the_robot():
    case, lower, upper = asked("square")
    commands = case.rules.clip(0.5 * (lower + upper))
    left, seconds, poses = (part[:, 0] for part in case.closest_approach(commands[:, None]))
    found = case.nearest_movers(commands)
    moved = np.flatnonzero((found.labels != "") & (left > 0.01))
    assert len(moved) > 5
    there = found.origin + found.velocity * seconds
    away = shapely.distance(
        place(poses[moved], case.rules.footprint), shapely.points(there.real[moved], there.imag[moved])
    )
    roams = np.array([ROAMS.get(label, 0.0) for label in found.labels[moved]])
    np.testing.assert_allclose(away[roams == 0.0], left[moved][roams == 0.0], atol=1e-6)
    assert set(found.labels) - {""} <= {*named_world("square").obstacles.names}


def test_mutants_are_of_what_the_proof_uses():
    assert enclosure.Manoeuvre is Manoeuvre
    assert judged_states.Manoeuvre is Manoeuvre
