"""Velocities that vary as badly as they may, driven in fine steps. Shares no code with the bounds."""

from __future__ import annotations

import numpy as np


def integrate(poses, velocities, steps):
    """Poses (R, N + 1, 3) of runs (R, 3) with velocities (R, N, 3), each held for a step of (N,) or (R, N) seconds.

    Midpoint rule: second order, unlike the arcs and closed forms that are tested with it.
    """
    steps = np.broadcast_to(steps, velocities.shape[:2])
    turns = velocities[..., 2] * steps
    theta = poses[:, None, 2] + np.concatenate([0.0 * turns[:, :1], np.cumsum(turns, axis=1)], axis=1)
    middle = theta[:, :-1] + 0.5 * turns
    ahead, left = velocities[..., 0] * steps, velocities[..., 1] * steps
    dx = ahead * np.cos(middle) - left * np.sin(middle)
    dy = ahead * np.sin(middle) + left * np.cos(middle)
    x, y = (
        start[:, None] + np.concatenate([0.0 * way[:, :1], np.cumsum(way, axis=1)], axis=1)
        for start, way in ((poses[:, 0], dx), (poses[:, 1], dy))
    )
    return np.stack([x, y, theta], axis=-1)


def signs(generator, runs, count):
    """Shares (R, N, 3) in [-1, 1] of half-widths: corners that are kept, corners that switch, and anything."""
    kept = np.broadcast_to(generator.choice([-1.0, 1.0], (runs, 1, 3)), (runs, count, 3))
    switch = generator.integers(0, count + 1, (runs, 1, 3))
    once = np.where(np.arange(count)[:, None] < switch, 1.0, -1.0) * generator.choice(
        [-1.0, 1.0], (runs, 1, 3)
    )
    bang = generator.choice([-1.0, 1.0], (runs, count, 3))
    free = generator.uniform(-1.0, 1.0, (runs, count, 3))
    kinds = np.stack([kept, once, bang, free])
    return kinds[generator.integers(0, 4, runs), np.arange(runs)]
