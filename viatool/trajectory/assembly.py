"""Observation vectors from measured quantities, by the kinds of the policy's channels.

The one place that knows how a goal is expressed and in which columns values stand: simulations and recordings
share it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Floats

if TYPE_CHECKING:
    from viatool.policy import ObservationChannel


def polar_goals(poses: Floats, goals: Floats) -> dict[str, Floats]:
    """Return distance, cosine and sine of the bearing of goals, by the kind of their channels.

    Parameters
    ----------
    poses : ndarray
        (B, 3) x, y, theta; metres and radians.
    goals : ndarray
        (B, 2) or (2,) metres.

    Returns
    -------
    dict
        (B,) each; cosine and sine are 0 on the goal itself.
    """
    dx, dy = (goals - poses[:, :2]).T
    distance = np.sqrt(dx * dx + dy * dy)
    inverse = 1.0 / np.maximum(distance, 1e-12)
    cosine, sine = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    return {
        "goal_distance": distance,
        "goal_cosine": (dx * cosine + dy * sine) * inverse,
        "goal_sine": (dy * cosine - dx * sine) * inverse,
    }


def assemble(channels: Sequence[ObservationChannel], measured: Mapping[str, NDArray[Any]]) -> Floats:
    """Put measured values into the columns of their channels.

    Parameters
    ----------
    channels : sequence of ObservationChannel
        In the order of the columns, n in all.
    measured : mapping
        For each kind of channel (B, size) or (B,); fixed channels take their `value` instead.

    Returns
    -------
    ndarray
        (B, n) float64 holding float32 numbers: the very values that a float32 policy receives.
    """
    count = len(next(iter(measured.values())))
    columns = np.empty((count, sum(channel.size for channel in channels)), np.float32)
    first = 0
    for channel in channels:
        last = first + channel.size
        if channel.value is not None:
            columns[:, first:last] = channel.value
        else:
            columns[:, first:last] = measured[channel.kind].reshape(count, channel.size)
        first = last
    return columns.astype(np.float64)
