"""Which rays may meet which shapes somewhere in boxes of poses, and points in the frames of rays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from viatool.arrays import Booleans, Floats, Indices, Plane
from viatool.sets.forms import PoseBoxes
from viatool.world import Lidar

_ROUNDING = 1e-9
"""Radians by which the bearing of a ray or of a shape may be rounded."""


@dataclass(frozen=True, eq=False)
class Glimpses:
    """T rays that may meet a shape somewhere in a box.

    Parameters
    ----------
    row : ndarray
        (T,) ``box * bins + bin``.
    nearest : ndarray
        (T,) range at the middle pose; infinite if the ray misses there.
    slope : ndarray
        (3, T) scaled slopes of the linear form.
    lower, upper : ndarray
        (T,) constants of the forms below and above the range, where the ray meets the shape.
    least, most : ndarray
        (T,) bounds that do not depend on the pose, likewise; `lower` and `least` are infinite where no pose meets it.
    certain : ndarray
        (T,) bool: whether every pose meets it and sees it.
    """

    row: Indices
    nearest: Floats
    slope: Floats
    lower: Floats
    upper: Floats
    least: Floats
    most: Floats
    certain: Booleans

    def select(self, which: Indices | Booleans) -> Glimpses:
        """Return some of them."""
        return Glimpses(**{each.name: getattr(self, each.name)[..., which] for each in fields(self)})

    @classmethod
    def concatenate(cls, parts: Sequence[Glimpses]) -> Glimpses:
        """Return all of several kinds."""
        names = [each.name for each in fields(cls)]
        return cls(*(np.concatenate([getattr(part, name) for part in parts], axis=-1) for name in names))

    @property
    def ends(self) -> tuple[Floats, Floats]:
        """Return bounds of the range where the ray meets the shape, whatever the pose, (T,) each."""
        spread = np.abs(self.slope).sum(axis=0)
        return np.maximum(self.lower - spread, self.least), np.minimum(self.upper + spread, self.most)


@dataclass(frozen=True, eq=False)
class Rays:
    """T rays, each with a shape that it may meet.

    Parameters
    ----------
    row : ndarray
        (T,) ``box * bins + bin``.
    box, shape : ndarray
        (T,) indices.
    along : ndarray
        (T,) directions in the map frame at the middle pose.
    radius : ndarray
        (T, 3) half-widths of the boxes.
    reach, turn : ndarray
        (T,) how far places and headings are from the middle at most.
    """

    row: Indices
    box: Indices
    shape: Indices
    along: Plane
    radius: Floats
    reach: Floats
    turn: Floats

    @classmethod
    def between(cls, boxes: PoseBoxes, lidar: Lidar, low: Floats, high: Floats, near: Booleans) -> Rays:
        """Return all rays between two bearings (C, N) of N shapes, wherever these are near."""
        box, shape, ray = _rays_between(low, high, near, lidar)
        along = np.exp(1j * (boxes.centre[box, 2] + lidar.angles()[ray]))
        row = box * lidar.bins + ray // lidar.each
        radius = boxes.radius[box]
        return cls(row, box, shape, along, radius, boxes.extent[box], radius[:, 2])

    def spread(self, direction: Plane) -> Floats:
        """Return the largest ``|direction . D|``, (T,)."""
        return np.asarray(
            np.abs(direction.real) * self.radius[:, 0] + np.abs(direction.imag) * self.radius[:, 1]
        )

    def slopes(self, factor: Plane, w: Plane) -> Floats:
        """Return the scaled slopes (3, T) of ``Re(factor w)``."""
        moved = factor * np.conj(self.along)
        gradient = np.stack([-moved.real, moved.imag, (factor * w).imag])
        return np.asarray(gradient * self.radius.T)


def turning_error(distance: Floats, rays: Rays) -> Floats:
    """Return E, what the linear form of a point at a distance leaves out in the frame of a ray."""
    return np.asarray(0.5 * distance * np.square(rays.turn) + rays.reach * rays.turn)


def half_angle(radius: Floats, distance: Floats) -> Floats:
    """Return half the angle that a disc fills when seen from a distance; pi from within."""
    outside = distance > radius
    return np.where(outside, np.arcsin(np.minimum(radius / np.where(outside, distance, 1.0), 1.0)), np.pi)


def _rays_between(
    low: Floats, high: Floats, near: Booleans, lidar: Lidar
) -> tuple[Indices, Indices, Indices]:
    """Return box, shape and ray, (T,) each, of all rays between two bearings (C, N), wherever they are near."""
    box, shape = np.nonzero(near)
    low, high = low[box, shape], high[box, shape]
    known = low <= high  # every ray may meet what lies in no known direction
    low, high = np.where(known, low, -np.pi) - _ROUNDING, np.where(known, high, np.pi) + _ROUNDING
    turns = 2.0 * np.pi * np.floor((low + np.pi) / (2.0 * np.pi))  # brings low into [-pi, pi)
    low, high = low - turns, high - turns
    bearing, order = lidar.around
    begin = np.searchsorted(bearing, low)
    end = np.searchsorted(bearing, high, side="right") - 1
    again = (
        np.searchsorted(bearing, high - 2.0 * np.pi, side="right") - 1
    )  # the last of those beyond a full turn
    again = np.minimum(again, begin - 1)
    found = [_expand(box, shape, begin, end), _expand(box, shape, np.zeros_like(begin), again)]
    boxes, shapes, rays = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return boxes, shapes, order[rays]


def _expand(box: Indices, shape: Indices, begin: Indices, end: Indices) -> tuple[Indices, Indices, Indices]:
    """Repeat pairs for every ray from the first to the last, (T,) each."""
    count = np.maximum(end - begin + 1, 0)
    which = np.repeat(np.arange(len(box)), count)
    ray = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count) + begin[which]
    return box[which], shape[which], ray
