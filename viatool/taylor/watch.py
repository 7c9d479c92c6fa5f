"""A net under the proof: the program itself, run where the box is, has to keep to its bounds.

The self-check of a policy looks at plausible observations when the policy is loaded. A fault of the reader or of the
runtime may show elsewhere, so wherever actions are bounded the deployed program is run in the middle of the box and at
the corners where extreme actions were found. That proves nothing; it catches what no proof sees.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from viatool.arrays import Floats, Indices
from viatool.errors import SelfCheckError

_SINGLE_ROWS = 64
"""Observations of one call that a program without batches runs; of more, every fourth."""


def require_program_within(policy: Any, points: Floats, lower: Floats, upper: Floats) -> None:
    """Run the deployed program at points of boxes.

    Parameters
    ----------
    policy : Policy
        Without a method `run` there is no program, and nothing happens.
    points : ndarray
        ``(K, B, n)``: K observations of each of B boxes.
    lower, upper : ndarray
        ``(B, A)``: bounds of the program's actions.

    Raises
    ------
    SelfCheckError
        If an action lies outside its bounds, or is not a number.
    """
    program: Callable[[Floats], Floats] | None = getattr(policy, "run", None)
    if program is None or not points.size:
        return
    count, batch, size = points.shape
    chosen = _chosen(count * batch, batches=policy.runtime.batches)
    box = chosen % batch
    observations = points.reshape(-1, size)[chosen]
    actions = program(observations)
    outside = ~((actions >= lower[box]) & (actions <= upper[box]))
    if outside.any() and policy.runtime.batches:
        policy.runtime.batches = False  # a part that is open here alone may mix the observations of a batch
        actions = program(observations)
        outside = ~((actions >= lower[box]) & (actions <= upper[box]))
    if outside.any():
        row, action = np.argwhere(outside)[0]
        ends = lower[box[row], action], upper[box[row], action]
        raise SelfCheckError(
            f"the loaded network and onnxruntime disagree: the program's action {action} is "
            f"{actions[row, action]:.9g} at an observation where the network's bounds are {ends[0]:.9g} to "
            f"{ends[1]:.9g}: {_shown(observations[row])}",
            "report this model: it was read wrongly, and no verdict may rest on it",
        )


def _chosen(count: int, *, batches: bool) -> Indices:
    if batches or count <= _SINGLE_ROWS:
        return np.arange(count)
    return np.arange(0, count, 4)


def _shown(observation: Floats) -> str:
    shown = ", ".join(f"{number:.9g}" for number in observation[:6])
    return f"[{shown}{', ...' if observation.size > 6 else ''}]"
