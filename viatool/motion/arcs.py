"""How a differential-drive robot moves while it holds one command."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from viatool.arrays import Floats


def advance(poses: Floats, actions: Floats, seconds: ArrayLike) -> Floats:
    """Move along exact arcs of the unicycle model.

    Parameters
    ----------
    poses : ndarray
        (..., 3) x, y, theta; metres and radians.
    actions : ndarray
        (..., 2) v in m/s and omega in rad/s, constant over the time.
    seconds : array_like
        (...) time.

    Returns
    -------
    ndarray
        (..., 3) with theta in (-pi, pi].

    Notes
    -----
    The chord of an arc of length v t and angle omega t is v t sin(h)/h, h = omega t / 2, in the direction
    theta + h; sin(h)/h has no cancellation, so the formula holds for any omega, 0 included.
    """
    time = np.asarray(seconds, dtype=np.float64)
    half = 0.5 * actions[..., 1] * time
    small = np.abs(half) < 1e-4
    ratio = np.where(small, 1.0 - half * half / 6.0, np.sin(half) / np.where(small, 1.0, half))
    chord = actions[..., 0] * time * ratio
    heading = poses[..., 2] + half
    return np.stack(
        [
            poses[..., 0] + chord * np.cos(heading),
            poses[..., 1] + chord * np.sin(heading),
            wrap_angle(heading + half),
        ],
        axis=-1,
    )


def wrap_angle(angles: Floats) -> Floats:
    """Return angles in (-pi, pi], in radians."""
    turns = np.ceil((angles - np.pi) / (2.0 * np.pi))
    return np.asarray(angles - turns * (2.0 * np.pi))
