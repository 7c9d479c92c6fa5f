"""Where a graph is attacked: boxes of all sizes and places, and points in them."""

from __future__ import annotations

import numpy as np

from tests.attack.building import Array
from tests.attack.graphs import RandomGraph


def draw_boxes(graph: RandomGraph, count: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Draw centres and half-widths, (B, n) each; half of them where a gate is open, if there is one."""
    size = int(np.prod(graph.shape))
    centres = np.array([_centre(size, rng) for _ in range(count)])
    for gate in graph.gates:
        beyond = np.sign(gate.threshold) * rng.choice([0.0, 0.3, 2.0, 5.0, 20.0], count)
        behind = rng.random(count) < 0.6
        centres[behind] = rng.normal(size=(int(behind.sum()), size))
        centres[behind, gate.channel] = gate.threshold + beyond[behind]
    representable = rng.random(count) < 0.5
    centres[representable] = centres[representable].astype(np.dtype(graph.kind))
    widths = np.array([_widths(centre, graph.kind, rng) for centre in centres])
    return centres, widths


def _centre(size: int, rng: np.random.Generator) -> Array:
    match rng.integers(6):
        case 0:
            return np.zeros(size)
        case 1:
            return rng.normal(size=size) * 10.0 ** rng.uniform(-3, 1, size)
        case 2:
            return np.round(2 * rng.normal(size=size)) / 2
        case 3:  # saturating
            return rng.choice([-1.0, 1.0], size) * 10.0 ** rng.uniform(0.5, 2.5, size)
    return np.asarray(rng.uniform(-1, 1, size))


def _widths(centre: Array, kind: str, rng: np.random.Generator) -> Array:
    size = len(centre)
    widths = np.full(size, rng.choice([0.0, 1e-6, 1e-3, 0.01, 0.1, 0.5, 1.0]))
    match rng.integers(5):
        case 0:  # thin
            widths[rng.random(size) < 0.5] = 0.0
        case 1:
            widths = widths * 10.0 ** rng.uniform(-3, 0, size)
        case 2:  # a few places of the last digit
            widths = np.spacing(np.abs(centre).astype(np.dtype(kind))).astype(np.float64) * rng.integers(
                0, 5, size
            )
    return widths


def sample(lower: Array, upper: Array, count: int, rng: np.random.Generator) -> Array:
    """Draw points (B, count, n): the middle, corners, faces and the inside of boxes (B, n)."""
    shape = (len(lower), count, lower.shape[1])
    fraction = rng.uniform(size=shape)
    corners = rng.integers(0, 2, shape).astype(np.float64)
    at_end = rng.uniform(size=shape) < rng.choice([0.0, 0.5, 0.9, 1.0], size=(*shape[:2], 1))
    fraction = np.where(at_end, corners, fraction)
    fraction[:, 0] = 0.5
    points = lower[:, None] + (upper - lower)[:, None] * fraction
    return inside(np.where(fraction == 1.0, upper[:, None], points), lower[:, None], upper[:, None])


def neighbours(points: Array, lower: Array, upper: Array, kind: str, rng: np.random.Generator) -> Array:
    """Move points (P, n) of boxes (P, n) by one or two places of the last digit of a type."""
    with np.errstate(all="ignore"):
        typed = points.astype(np.dtype(kind))
        for _ in range(int(rng.integers(1, 3))):
            up = np.nextafter(typed, np.inf, dtype=typed.dtype)
            down = np.nextafter(typed, -np.inf, dtype=typed.dtype)
            drawn = rng.integers(0, 3, typed.shape)
            typed = np.where(drawn == 0, typed, np.where(drawn == 1, up, down))
    return inside(typed.astype(np.float64), lower, upper)


def inside(points: Array, lower: Array, upper: Array) -> Array:
    """Return the nearest points of the boxes."""
    return np.clip(points, lower, upper)
