"""What is confirmed holds under every command and pose, by an oracle that only samples; and each term is needed."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from viatool.recheck.motion import Motion
from viatool.recheck.scene import Scene, outline, solids

ARENA = shapely.box(-3.0, -3.0, 3.0, 3.0)
PLAIN = {
    "criterion": "swept",
    "interval": 0.5,
    "deceleration": 1.0,
    "footprint": {"kind": "point", "radius": 0.0, "polygon": []},
}
OUTLINE = [[-0.3, -0.1], [0.2, -0.2], [0.2, 0.2], [-0.3, 0.1]]
BOX = {**PLAIN, "footprint": {"kind": "polygon", "radius": 0.0, "polygon": OUTLINE}}
DISC = {**PLAIN, "footprint": {"kind": "circle", "radius": 0.15, "polygon": []}}
V, W, X, Y, H, S = range(6)


class _Everywhere:
    """One scene for every episode."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene

    def of(self, episode: int) -> Scene:
        return self.scene


def scene_of(*shapes: dict) -> Scene:
    circles, polygons = solids(shapes)
    return Scene([ARENA], [shapely.STRtree([ARENA.exterior, *polygons])], circles)


def keeps(motion: Motion, scene: Scene, lower: np.ndarray, upper: np.ndarray, distance: float) -> bool:
    found = motion.keeps(_Everywhere(scene), np.zeros(1, int), lower[None], upper[None], distance)
    return bool(found[0])


def outline_at(rules: dict, poses: np.ndarray) -> np.ndarray:
    """Place the outline with complex numbers of its own, one pose after the other."""
    corners = np.array(rules["footprint"]["polygon"] or [[0.0, 0.0]]) @ np.array([1.0, 1j])
    return poses[:, 0, None] + 1j * poses[:, 1, None] + np.exp(1j * poses[:, 2, None]) * corners


def least_sampled(rules: dict, shapes: tuple[dict, ...], commands_and_poses: np.ndarray) -> float:
    """Return the least clearance of given commands and poses (K, 5), driven in small steps."""
    solid = [
        (shapely.Point(one["center"]), one["radius"]) if one["shape"] == "circle" else (outline(one), 0.0)
        for one in shapes
    ]
    found = np.inf
    for v, w, *pose in commands_and_poses:
        seconds = rules["interval"]
        if rules["criterion"] == "braking":
            rim = max(abs(complex(*corner)) for corner in rules["footprint"]["polygon"] or [[0.0, 0.0]])
            seconds += 0.5 * (abs(v) + rim * abs(w)) / rules["deceleration"]
        count = 100
        headings = pose[2] + w * seconds * (np.arange(count + 1) / count)
        steps = v * seconds / count * np.exp(1j * 0.5 * (headings[1:] + headings[:-1]))
        places = complex(pose[0], pose[1]) + np.concatenate([[0.0], np.cumsum(steps)])
        placed = outline_at(rules, np.column_stack([places.real, places.imag, headings]))
        points = np.stack([placed.real, placed.imag], axis=-1)
        body = shapely.points(points[:, 0]) if points.shape[1] == 1 else shapely.polygons(points)
        apart = [
            shapely.distance(body, shape).min() - radius for shape, radius in [*solid, (ARENA.exterior, 0.0)]
        ]
        found = min(found, float(min(apart)) - rules["footprint"]["radius"])
    return found


def sampled(lower: np.ndarray, upper: np.ndarray, rng: np.random.Generator, count: int = 20) -> np.ndarray:
    corners = np.array(np.meshgrid(*[[0.0, 1.0]] * 5)).reshape(5, -1).T
    shares = np.concatenate([corners, rng.random((count, 5))])
    return lower + shares * (upper - lower)


@pytest.mark.parametrize("footprint", [PLAIN, DISC, BOX], ids=["point", "disc", "polygon"])
@pytest.mark.parametrize("criterion", ["swept", "braking"])
def test_what_is_confirmed_keeps_its_distance_and_what_comes_nearer_is_not_confirmed(
    footprint: dict, criterion: str
) -> None:
    rules, rng = {**footprint, "criterion": criterion}, np.random.default_rng(5)
    motion, confirmed = Motion(rules), 0
    for _ in range(8):
        middle = rng.uniform([-0.3, -1.5, -1.0, -1.0, -3.0], [0.8, 1.5, 1.0, 1.0, 3.0])
        half = rng.uniform(0.0, [0.1, 0.3, 0.03, 0.03, 0.05])
        lower, upper = middle - half, middle + half
        x, y = middle[2:4] + rng.uniform(0.8, 1.4) * np.array([np.cos(a := rng.uniform(-3, 3)), np.sin(a)])
        shapes = (
            {"shape": "circle", "center": [x, y], "radius": 0.2},
            {"shape": "box", "center": [-x, y], "size": [0.3, 0.4], "yaw": 0.4},
        )
        scene, least = scene_of(*shapes), least_sampled(rules, shapes, sampled(lower, upper, rng))
        assert not keeps(motion, scene, lower, upper, least + 1e-4)
        confirmed += keeps(motion, scene, lower, upper, least - 0.03)
    assert confirmed > 5


WALL_AHEAD = {"shape": "box", "center": [2.0, 0.0], "size": [2.0, 4.0]}
WALL_LEFT = {"shape": "box", "center": [0.0, 2.0], "size": [4.0, 2.0]}
BULGE = {"shape": "box", "center": [0.25, -1.0], "size": [4.0, 1.0]}
ONE_AXIS = {
    "v": (V, PLAIN, WALL_AHEAD, [0.5, 0.0, 0.0, 0.0, 0.0], 0.2),
    "w": (W, PLAIN, WALL_LEFT, [0.5, 0.0, 0.0, 0.0, 0.0], 0.8),
    "w of an outline": (W, BOX, WALL_LEFT, [0.0, 0.0, 0.0, 0.0, 0.0], 0.8),
    "x": (X, PLAIN, WALL_AHEAD, [0.5, 0.0, 0.0, 0.0, 0.0], 0.2),
    "y": (Y, PLAIN, WALL_LEFT, [0.5, 0.0, 0.0, 0.0, 0.0], 0.2),
    "heading": (H, PLAIN, WALL_LEFT, [0.5, 0.0, 0.0, 0.0, 0.0], 0.4),
    "heading of an outline": (H, BOX, WALL_LEFT, [0.0, 0.0, 0.0, 0.0, 0.0], 0.4),
    "instants": (S, PLAIN, BULGE, [0.8, 2.0, 0.0, 0.0, -0.5], 0.0),
}


@pytest.mark.parametrize("case", ONE_AXIS)
def test_each_term_of_the_bound_is_needed(case: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the term of an axis a box is confirmed of which a command comes too near."""
    axis, rules, wall, middle, half = ONE_AXIS[case]
    lower, upper = np.array(middle), np.array(middle)
    if axis != S:
        lower[axis] -= half
        upper[axis] += half
    least = least_sampled(rules, (wall,), sampled(lower, upper, np.random.default_rng(0), 0))
    motion, scene = Motion(rules), scene_of(wall)
    assert not keeps(motion, scene, lower, upper, least + 1e-4)
    assert keeps(motion, scene, lower, upper, least - 1e-2)
    whole = Motion._widening

    def without(self: Motion, *cells: np.ndarray) -> np.ndarray:
        by = whole(self, *cells)
        by[:, axis] = 0.0
        return by

    monkeypatch.setattr(Motion, "_widening", without)
    assert keeps(motion, scene, lower, upper, least + 1e-4)


def test_a_disc_and_braking_count(monkeypatch: pytest.MonkeyPatch) -> None:
    still = np.array([0.5, 0.0, 0.0, 0.0, 0.0])
    scene = scene_of(WALL_AHEAD)
    assert keeps(Motion(PLAIN), scene, still, still, 0.74)
    assert not keeps(Motion(DISC), scene, still, still, 0.74)
    assert keeps(Motion(DISC), scene, still, still, 0.59)
    braking = Motion({**PLAIN, "criterion": "braking"})
    assert not keeps(braking, scene, still, still, 0.74)  # 0.125 m of braking
    assert keeps(braking, scene, still, still, 0.62)


@pytest.mark.parametrize(
    "place", [(3.5, 0.0), (0.0, 0.55)], ids=["outside of the arena", "within an obstacle"]
)
def test_nobody_is_safe_where_nobody_can_be(place: tuple[float, float]) -> None:
    state = np.array([0.0, 0.0, *place, 0.0])
    scene = scene_of(
        {"shape": "circle", "center": [0.0, 0.55], "radius": 0.3}, {**WALL_LEFT, "center": [0.0, 9.0]}
    )
    assert not keeps(Motion(PLAIN), scene, state, state, 0.0)
    assert not keeps(Motion(BOX), scene, state, state, 0.0)


@pytest.mark.parametrize("wrong", [np.nan, np.inf])
def test_what_is_not_a_number_is_not_confirmed(wrong: float) -> None:
    state = np.zeros(5)
    bad = state.copy()
    bad[0] = wrong
    with np.errstate(invalid="ignore"):
        assert not keeps(Motion(PLAIN), scene_of(), state, bad, 0.1)


def test_crossed_ends_are_not_confirmed() -> None:
    assert not keeps(Motion(PLAIN), scene_of(), np.full(5, 0.1), np.zeros(5), 0.1)


def test_walls_are_boxes_that_are_longer_by_half_their_thickness() -> None:
    _, (first, second) = solids([{"shape": "wall", "points": [[0, 0], [1, 0], [1, 2]], "thickness": 0.2}])
    assert first.bounds == pytest.approx((-0.1, -0.1, 1.1, 0.1))
    assert second.bounds == pytest.approx((0.9, -0.1, 1.1, 2.1))
