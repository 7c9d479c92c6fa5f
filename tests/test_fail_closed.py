"""NaN and crossed bounds prove nothing, wherever something is proved: each place says no, or refuses them by name.

Every place is first asked about three sane rows, all of which it proves. Then the second row of one argument at a time
is spoiled.
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from viatool import load_map, load_policy
from viatool.cli.failures import INTERNAL_ERROR, explain
from viatool.errors import BoundsError
from viatool.loop.closed_loop import ClosedLoop
from viatool.loop.horizon import Horizon
from viatool.loop.outline_retreat import keep_outline_away
from viatool.loop.retreat import keep_away
from viatool.loop.sectors import TubeParts, cut_by_heading
from viatool.loop.successor import states_of, step
from viatool.loop.tube import TubeFollower
from viatool.motion.manoeuvre import Manoeuvre
from viatool.places.mesh import CellSet, Mesh
from viatool.places.over_time import _within
from viatool.places.passages import follow
from viatool.places.search import search
from viatool.places.tree import Lattice
from viatool.safety import JudgedStates, Judgement, ScenePoses, find_contested, judge, prove, sample, settle
from viatool.safety.judgement import Contested
from viatool.safety.proof import prove_clearance
from viatool.sets.bounds import require_ordered
from viatool.sets.forms import Forms, PoseBoxes
from viatool.sets.states import StateBoxes
from viatool.setting.rules import Rules
from viatool.setting.setting import Setting
from viatool.setting.wishes import Wishes
from viatool.sight.glimpses import Rays
from viatool.sight.scan import enclose_scan
from viatool.sight.shapes import Shapes
from viatool.verification.horizon import HorizonExamination
from viatool.world import Footprint, Lidar

POLICY, LAB = load_policy(Path("policies/via.onnx")), load_map(Path("maps/lab.yaml"))
ROOM = load_map(Path("maps/room.yaml"))
SCENARIO = ROOM.scenarios[0]
GOAL = np.array(SCENARIO.goal)
SQUARE = Footprint.rectangle(0.2, 0.2)
FREE = np.array([[-1.2, -1.2, 0.3], [-1.2, -1.0, 1.0], [-1.0, -1.2, 2.0]])
"""Poses with more than half a metre around them."""
CORNER = np.array([[-2.99, -2.99, 0.3], [-2.98, -2.99, 1.0], [2.99, -2.99, 2.0]])
"""Poses within the collision distance of two walls."""
SMALL = np.full((3, 3), 0.001)
SLOW = np.full((3, 2), 0.01)
ROWS = np.zeros(3, np.int64)
ONCE = np.ones(3)
AT_GOAL = np.tile([*GOAL, 0.0, 0.0, 0.0], (2, 3, 1))
ENDS = np.concatenate([FREE - SMALL, 0.0 * SLOW], axis=1), np.concatenate([FREE + SMALL, SLOW], axis=1)


def rules(**changes):
    return Rules.of(ROOM, "swept", **changes)


def setting(**changes):
    return Setting.of(POLICY, ROOM, 0.01, Wishes(**changes))


def question(**changes):
    return ClosedLoop.of(POLICY, setting(**changes), SCENARIO)


def case(poses=FREE, previous=SLOW, **changes):
    asked = rules(**changes)
    return JudgedStates(asked, ScenePoses.of(ROOM, [None], poses, ROWS), asked.queue(previous))


def cells(poses=FREE, radii=SMALL, before_lower=0.0 * SLOW, before_upper=SLOW):
    return StateBoxes(PoseBoxes(poses, radii), before_lower, before_upper)


def loop():
    return TubeFollower(question(), 0.5, Horizon(2))


def clearance(poses=FREE, radii=SMALL, lower=0.0 * SLOW, upper=SLOW, threshold=0.1, footprint=None):
    placed = replace(ScenePoses.of(ROOM, [None], poses, ROWS), radii=radii)
    asked = placed, lower, upper, threshold, Manoeuvre(0.1), footprint or Footprint()
    return prove_clearance(*asked).proved


def away(poses=FREE, radii=SMALL, lower=0.0 * SLOW, upper=SLOW, footprint=None):
    boxes, shapes = PoseBoxes(poses, radii), Shapes.of(ROOM, SCENARIO)
    if footprint is None:
        return keep_away(boxes, shapes, rules(), Manoeuvre(0.1), lower, upper)
    near = np.ones((3, len(shapes)), bool)
    return keep_outline_away(boxes, shapes, near, Manoeuvre(0.1), SQUARE.polygon, 0.1, lower, upper)


def held_cells(lower=0.0 * SLOW, upper=SLOW, delay=0.0, footprint=None, **cell):
    return question(delay=delay, footprint=footprint).holds(cells(**cell), lower, upper)


def judged(lower=0.0 * SLOW, upper=SLOW, criterion="swept", **state):
    asked = case(**state)
    asked = replace(asked, rules=replace(asked.rules, criterion=criterion))
    every = np.ones(3, bool)
    found = judge(asked, lower, upper, Contested(every, every))
    return found.safe | found.danger | found.sampled


def followed(poses=FREE, previous=SLOW):
    return loop().follow(poses, previous).safe


def successors(**cell):
    found = step(question(), states_of(cells(**cell)))
    low, high = found.bounds(FREE - SMALL, FREE + SMALL)
    return (low <= high + 1e-12).all(axis=1)


def arrived(lower=AT_GOAL[0], upper=AT_GOAL[1]):
    return loop().arrived(TubeParts(np.arange(3), lower, upper))


def sectors(lower=ENDS[0], upper=ENDS[1]):
    parts = cut_by_heading(np.arange(3), states_of(cells()), (lower, upper), 0.004, 32)
    found = np.zeros(3, bool)
    found[parts.tube] = True
    return found


def mesh():
    return Mesh.of(Lattice.over(ROOM.bounds, (rules().lower, rules().upper), (0.25, 0.3, 0)))


def covered(lower=ENDS[0], upper=ENDS[1]):
    whole = CellSet(mesh(), np.ones(len(mesh()), bool))
    return whole.covers(mesh().ranges(lower, upper))


def passed(size=ONCE):
    """Cells that are followed, of a mesh that is off by a factor."""
    some = mesh()
    off = replace(some, size=some.size * np.array([*size[1:2], 1.0, 1.0, 1.0, 1.0]))
    found = follow(question(), off, np.flatnonzero(_cells_around(some, FREE)), intervals=1)
    return np.repeat((found.kept > 0).all(), 3)


def _cells_around(some, poses):
    index = ((poses - some.origin[:3]) // some.size[:3]).astype(int)
    mask = np.zeros(tuple(some.count), bool)
    mask[tuple(index.T)] = True
    return mask.ravel()


def searched(origin=ONCE):
    """Whether a few roots have a verdict but unknown, of a lattice whose origin is off by a factor."""
    lattice = Lattice.over(ROOM.bounds, (rules().lower, rules().upper), (0.25, 0.3, 0))
    off = replace(lattice, origin=lattice.origin * np.array([origin[1], 1.0, 1.0, 1.0, 1.0]))
    return np.repeat((search(question(), off, lattice.roots().select(slice(0, 2))).status < 3).any(), 3)


def near_goal(origin=ONCE):
    some = mesh()
    off = replace(some, origin=some.origin * np.array([origin[1], origin[1], 1.0, 1.0, 1.0]))
    return np.repeat(_within(off, SCENARIO.goal, 0.8).any(), 3)


def out_of_reach(poses=FREE):
    asked = HorizonExamination(POLICY, setting(), Horizon(1))
    return asked.out_of_reach(ScenePoses.of(ROOM, [None], poses, ROWS))


def seen(poses=FREE, radii=SMALL):
    forms = enclose_scan(PoseBoxes(poses, radii), Shapes.of(ROOM, SCENARIO), ROOM.robot.lidar)
    return np.isfinite(forms.rest).all(axis=1)


BOX = {"lower": ("nan", "crossed"), "upper": ("nan", "crossed")}
POSES = {"poses": ("nan",), "radii": ("nan", "negative")}
BEFORE = {"before_lower": ("nan", "crossed"), "before_upper": ("nan", "crossed")}
PLACES = {
    "clearance": (clearance, POSES | BOX),
    "clearance of a polygon": (lambda **a: clearance(**a, footprint=SQUARE), POSES | BOX),
    "every command": (lambda **a: prove(case(**_state(a)), *_box(a), 0.1).proved, {"poses": ("nan",), **BOX}),
    "dead time": (
        lambda **a: prove(case(**_state(a), delay=0.1), *_box(a), 0.1).proved,
        {"poses": ("nan",), "previous": ("nan",), **BOX},
    ),
    "any command": (lambda **a: settle(case(**a), 0.1), {"poses": ("nan",)}),
    "any command later": (
        lambda **a: settle(case(**a, delay=0.1), 0.1),
        {"poses": ("nan",), "previous": ("nan",)},
    ),
    "nine commands": (lambda **a: sample(case(**_state(a)), *_box(a), 0.1), {"poses": ("nan",), **BOX}),
    "uncontested": (lambda **a: ~find_contested(case(**a)).collision, {"poses": ("nan",)}),
    "judged": (judged, {"poses": ("nan",), **BOX}),
    "judged by nine": (lambda **a: judged(**a, criterion="sampled"), {"poses": ("nan",), **BOX}),
    "judged by braking": (lambda **a: judged(**a, criterion="braking"), {"poses": ("nan",), **BOX}),
    "blocked": (
        lambda poses=CORNER, radii=SMALL: question().blocked(PoseBoxes(poses, radii)),
        POSES,
    ),
    "settled": (lambda poses=FREE, radii=SMALL: question().settled(PoseBoxes(poses, radii)), POSES),
    "held": (held_cells, POSES | BOX | BEFORE),
    "held later": (lambda **a: held_cells(**a, delay=0.1), POSES | BOX | BEFORE),
    "held by a polygon": (lambda **a: held_cells(**a, footprint=SQUARE), POSES | BOX | BEFORE),
    "retreat": (away, {"poses": ("nan",), "radii": ("nan",), "lower": ("nan",), "upper": ("nan",)}),
    "retreat without speed": (
        lambda poses=FREE: away(poses=poses, lower=0.0 * SLOW, upper=[0.0, 1.0] * SLOW),
        {"poses": ("nan",)},
    ),
    "retreat of an outline": (
        lambda **a: away(**a, footprint=SQUARE),
        {"poses": ("nan",), "radii": ("nan",), "lower": ("nan",), "upper": ("nan",)},
    ),
    "tube": (followed, {"poses": ("nan",), "previous": ("nan",)}),
    "successor": (successors, POSES | BEFORE),
    "arrived": (arrived, {"lower": ("nan",), "upper": ("nan",)}),
    "sectors": (sectors, BOX),
    "cells of a mesh": (covered, BOX),
    "passages": (passed, {"size": ("nan",)}),
    "places": (searched, {"origin": ("nan",)}),
    "cells at the goal": (near_goal, {"origin": ("nan",)}),
    "out of reach": (out_of_reach, {"poses": ("nan",)}),
    "readings": (seen, POSES),
}


def _box(arguments):
    return arguments.get("lower", 0.0 * SLOW), arguments.get("upper", SLOW)


def _state(arguments):
    return {name: value for name, value in arguments.items() if name in ("poses", "previous")}


def default_of(ask, name):
    """The sane value of an argument."""
    known = {"poses": FREE, "radii": SMALL, "previous": SLOW, "lower": 0.0 * SLOW, "upper": SLOW}
    known |= {"before_lower": 0.0 * SLOW, "before_upper": SLOW, "size": ONCE, "origin": ONCE}
    own = {sectors: dict(zip(("lower", "upper"), ENDS, strict=True))}
    own[covered] = own[sectors]
    own[arrived] = dict(zip(("lower", "upper"), AT_GOAL, strict=True))
    own[PLACES["blocked"][0]] = {"poses": CORNER}
    return (known | own.get(ask, {}))[name]


def spoil(array, name, way, entry):
    spoiled = np.array(array, dtype=float)
    row = spoiled[1:2] if spoiled.ndim == 1 else spoiled[1]
    entry = min(entry, len(row) - 1)
    crossed = -1.0 if "upper" in name or name == "radii" else 1.0
    row[entry] = np.nan if way == "nan" else row[entry] + 5.0 * crossed
    return spoiled


SPOILED = [
    pytest.param(place, name, way, entry, id=f"{place}, {name} {entry} {way}")
    for place, (_, arguments) in PLACES.items()
    for name, ways in arguments.items()
    for way in ways
    for entry in ((0,) if name in ("size", "origin") else (0, 1))
]


@pytest.mark.parametrize("place", PLACES)
def test_the_sane_rows_are_proved(place):
    assert PLACES[place][0]().all()


@pytest.mark.parametrize(("place", "name", "way", "entry"), SPOILED)
def test_a_spoiled_row_is_not_proved(place, name, way, entry):
    ask = PLACES[place][0]
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        try:
            found = ask(**{name: spoil(default_of(ask, name), name, way, entry)})
        except BoundsError:
            return
    assert not found[1]


@pytest.mark.parametrize("threshold", [np.nan, np.inf])
@pytest.mark.parametrize("footprint", [None, SQUARE])
def test_no_clearance_is_more_than_what_is_no_number(threshold, footprint):
    assert not clearance(threshold=threshold, footprint=footprint).any()


def test_nan_refutes_nothing():
    """A state is called unsafe only for a number that is too small."""
    placed = ScenePoses.of(ROOM, [None], np.full((3, 3), np.nan), ROWS)
    with np.errstate(invalid="ignore"):
        proof = prove_clearance(placed, 0.0 * SLOW, SLOW, 0.1, Manoeuvre(0.1), Footprint())
    assert not proof.proved.any()
    assert not proof.refuted.any()


def test_bounds_of_states_that_geometry_settles_are_never_read():
    """With --only-contested no action of theirs is bounded."""
    contested = Contested(np.array([True, False, True]), np.array([True, False, True]))
    lower, upper = np.zeros((3, 2)), SLOW.copy()
    lower[1] = upper[1] = np.nan
    assert judge(case(), lower, upper, contested).safe.all()
    with pytest.raises(BoundsError, match="commands are bounded by nan"):
        judge(case(), lower, upper, Contested(~contested.collision, ~contested.danger))


@pytest.mark.parametrize("part", ["centres", "radii", "first", "second"])
def test_a_shape_that_is_nowhere_is_not_overlooked(part):
    """Nothing is concluded from readings among shapes of which one is NaN."""
    shapes = Shapes.of(LAB, LAB.scenarios[0])
    spoiled = getattr(shapes, part).copy()
    spoiled[0] = np.nan
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        forms = enclose_scan(PoseBoxes(FREE, SMALL), replace(shapes, **{part: spoiled}), LAB.robot.lidar)
    assert not np.isfinite(forms.rest).all(axis=1).any()
    with pytest.raises(BoundsError, match="linear forms"):
        forms.checked()


def test_every_ray_may_meet_what_lies_in_no_known_direction():
    lidar = Lidar(np.pi, 10, 5, 0.1, 5.0)
    boxes, near = PoseBoxes(FREE[:1], SMALL[:1]), np.ones((1, 1), bool)
    for low, high in ((np.nan, np.nan), (0.1, np.nan), (0.2, 0.1)):
        rays = Rays.between(boxes, lidar, np.array([[low]]), np.array([[high]]), near)
        assert len(rays.row) == lidar.rays


def test_verdicts_are_booleans():
    """NaN would count as true."""
    yes, unknown = np.ones(3, bool), np.full(3, np.nan)
    for parts in ((unknown, yes, yes), (yes, unknown, yes), (yes, yes, unknown)):
        with pytest.raises(TypeError, match="booleans"):
            Judgement(*parts)


@pytest.mark.parametrize(
    ("lower", "upper"), [(0.2, 0.1), (np.nan, 1.0), (0.0, np.nan), (np.nan, np.nan), (np.inf, -np.inf)]
)
def test_bounds_that_no_program_may_hand_over_are_an_internal_error(lower, upper):
    with pytest.raises(BoundsError, match=f"commands are bounded by {lower:g} and {upper:g}") as caught:
        require_ordered("commands", np.array([[0.0, lower]]), np.array([[0.0, upper]]))
    code, text = explain(caught.value)
    assert code == INTERNAL_ERROR
    assert "internal error" in text
    assert "VIATOOL_TRACEBACK=1" in text


def test_infinite_bounds_are_refused_only_where_they_prove_too_much():
    ends = np.array([-np.inf]), np.array([np.inf])
    require_ordered("commands", *ends)
    with pytest.raises(BoundsError):
        require_ordered("poses", *ends, finite=True)


def test_two_roundings_of_one_number_are_in_order():
    number = np.array([0.1])
    require_ordered("states", number + 1e-16, number, rounding=2.0**-44)
    with pytest.raises(BoundsError):
        require_ordered("states", number + 1e-9, number, rounding=2.0**-44)


@pytest.mark.parametrize("rest", [-1e-3, np.nan, np.inf])
def test_a_form_whose_rest_is_no_width_is_refused(rest):
    with pytest.raises(BoundsError):
        Forms(np.zeros((1, 2)), np.ones((1, 3, 2)), np.array([[0.0, rest]])).checked()
