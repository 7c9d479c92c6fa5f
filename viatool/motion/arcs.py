"""Arcs: where a constant velocity in the robot's frame leads, and how far the chord of an arc reaches."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from viatool.arrays import Floats
from viatool.rounding import SLIGHTLY, SPARE

_SERIES = 1e-2
_LONGEST_BACK = 4.493409457909064
"""Half of the turn whose chord points backwards the farthest: the first positive solution of tan h = h."""


def drive_arc(
    poses: Floats, forward: Floats, turn: Floats, seconds: ArrayLike, left: Floats | None = None
) -> Floats:
    """Move along exact arcs.

    Parameters
    ----------
    poses : ndarray
        (..., 3) x, y, theta; metres and radians.
    forward, turn : ndarray
        (...) m/s and rad/s in the robot's frame, constant over the time.
    seconds : array_like
        (...) time.
    left : ndarray, optional
        (...) m/s to the left; None for a robot that cannot.

    Returns
    -------
    ndarray
        (..., 3) with theta in (-pi, pi].

    Notes
    -----
    The chord of an arc of length v t and angle omega t is v t sin(h)/h, h = omega t / 2, in the direction
    theta + h; sin(h)/h has no cancellation, so the formula holds for any omega, 0 included. Beyond a circle sin(h)/h
    may be negative: the chord points backwards.
    """
    time = np.asarray(seconds, dtype=np.float64)
    half = 0.5 * turn * time
    small = np.abs(half) < 1e-4
    ratio = np.where(small, 1.0 - half * half / 6.0, np.sin(half) / np.where(small, 1.0, half))
    chord = forward * time * ratio
    heading = poses[..., 2] + half
    cosine, sine = np.cos(heading), np.sin(heading)
    x, y = poses[..., 0] + chord * cosine, poses[..., 1] + chord * sine
    if left is not None:
        aside = left * time * ratio
        x, y = x - aside * sine, y + aside * cosine
    return np.stack([x, y, wrap_angle(heading + half)], axis=-1)


def wrap_angle(angles: Floats) -> Floats:
    """Return angles in (-pi, pi], in radians."""
    turns = np.ceil((angles - np.pi) / (2.0 * np.pi))
    return np.asarray(angles - turns * (2.0 * np.pi))


def sinc(half: Floats) -> Floats:
    """Return sin(h) / h."""
    small = np.abs(half) < _SERIES
    safe = np.where(small, 1.0, half)
    square = half * half
    return np.where(small, 1.0 - square / 6.0 * (1.0 - square / 20.0), np.sin(safe) / safe)


def swing(half: Floats) -> Floats:
    """Return (sin(h) - h cos(h)) / h^2, by which sin(h) / h falls."""
    small = np.abs(half) < _SERIES
    safe = np.where(small, 1.0, half)
    square = half * half
    near = half / 3.0 * (1.0 - square / 10.0 * (1.0 - square / 28.0))
    return np.where(small, near, (np.sin(safe) - safe * np.cos(safe)) / (safe * safe))


def least_sinc(half: Floats) -> Floats:
    """Return a lower bound of sin(h) / h over ``|h| <= half``: the chord's share of an arc that turns by 2 h.

    It falls until h = 4.4934, where the chord points backwards the farthest.
    """
    return sinc(np.minimum(half, _LONGEST_BACK)) - SLIGHTLY


def cosine_range(first: Floats, last: Floats) -> tuple[Floats, Floats]:
    """Return bounds of the cosine between two angles, rounded outward."""
    rounding = SPARE * (1.0 + np.abs(first) + np.abs(last))
    first, last = first - rounding, last + rounding
    ends = np.cos(first), np.cos(last)
    top = np.floor(last / (2.0 * np.pi)) * 2.0 * np.pi >= first
    bottom = np.floor((last - np.pi) / (2.0 * np.pi)) * 2.0 * np.pi + np.pi >= first
    low = np.where(bottom, -1.0, np.maximum(np.minimum(*ends) - SPARE, -1.0))
    high = np.where(top, 1.0, np.minimum(np.maximum(*ends) + SPARE, 1.0))
    return low, high
