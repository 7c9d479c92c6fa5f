"""Whether bounds contain what the deployed program computes inside the boxes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tests import attacks
from viatool.policy import Policy
from viatool.taylor import reach

_ROUND = 5000
"""Observations of one call of onnxruntime."""


def escapes(policy: Policy, *, samples: int, states: int = 20, eps: float = 0.02, seed: int = 0) -> int:
    """Count the onnxruntime actions outside of the bounds, for random observations and corners of each box.

    Parameters
    ----------
    samples : int
        In all states together.
    states : int
        Boxes, around normally distributed observations.
    """
    generator = np.random.default_rng(seed)
    centres = generator.normal(size=(states, policy.input_size)).astype(np.float32).astype(np.float64)
    sets = reach(policy, centres, eps)
    counted, rows = 0, _ROUND // states
    for _ in range(-(-samples // (states * rows))):
        points = _inside(
            attacks.sample(centres - eps, centres + eps, rows, generator), centres, eps
        )  # (S, B, n)
        actions = policy.run(points.reshape(-1, policy.input_size)).reshape(len(points), states, -1)
        outside = ~((sets.lower <= actions) & (actions <= sets.upper))  # NaN is outside
        counted += int(outside.any(axis=2).sum())
    return counted


def _inside(points: NDArray[np.float64], centres: NDArray[np.float64], eps: float) -> NDArray[np.float64]:
    """Round points to float32 numbers in their boxes."""
    rounded = points.astype(np.float32)
    rounded = np.where(rounded > centres + eps, np.nextafter(rounded, np.float32(-np.inf)), rounded)
    rounded = np.where(rounded < centres - eps, np.nextafter(rounded, np.float32(np.inf)), rounded)
    return rounded.astype(np.float64)
