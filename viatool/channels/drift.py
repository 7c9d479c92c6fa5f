"""How readings change when the robot believes another pose of a box than the one that was recorded."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from viatool.arrays import Booleans, Floats, Indices
from viatool.channels.quantities import Quantities
from viatool.channels.quantity import Quantity
from viatool.channels.views import BoxView, View
from viatool.errors import ConfigurationError
from viatool.sets.forms import Forms, PoseBoxes
from viatool.sets.states import StateBoxes
from viatool.sight.shapes import Shapes

_POSE = 3
"""Symbols of a pose: x, y and theta, each in half-widths of its box."""


@dataclass(frozen=True, eq=False)
class Drift:
    """By how much the readings in n inputs change over boxes of believed poses.

    Parameters
    ----------
    forms : Forms
        (B, n) in the three symbols of the believed pose.
    anything : ndarray
        (B, n) bool: an angle that may be on either side of the half turn, of which nothing else is known.
    """

    forms: Forms
    anything: Booleans

    @classmethod
    def of(cls, quantities: Quantities, poses: PoseBoxes, goal: Floats, scale: float, axes: int) -> Drift:
        """Return what B boxes of believed poses change, on a map whose coordinates are below a scale.

        Notes
        -----
        Sound: yes. All channels see the same pose; a LiDAR measures from where the robot is, not from where it believes
        to be.
        """
        around = _view(poses, goal, scale, axes)
        middle = _view(PoseBoxes(poses.centre, 0.0 * poses.radius), goal, scale, axes)
        parts = [_changed(quantity, around, middle) for quantity in quantities]
        reading = quantities.inputs.reading
        centre, rest, anything = (
            np.concatenate([part[k] for part in parts], axis=1)[:, reading] for k in (0, 2, 3)
        )
        slope = np.concatenate([part[1] for part in parts], axis=2)[:, :, reading]
        return cls(Forms(centre, slope, rest), anything.astype(bool))

    @classmethod
    def join(cls, parts: list[Drift], order: Indices) -> Drift:
        """Return several sets of boxes as one, in an order."""
        forms = Forms.concatenate([part.forms for part in parts])
        anything = np.concatenate([part.anything for part in parts])
        return cls(forms, anything).select(order)

    def select(self, which: Indices) -> Drift:
        """Return some of the boxes."""
        forms = self.forms
        return Drift(Forms(forms.centre[which], forms.slope[which], forms.rest[which]), self.anything[which])


def seen_from_elsewhere(quantities: Quantities, view: View) -> Floats:
    """Return by how much readings change, (B, n), where robots believe a pose that is not theirs."""
    honest, parts = replace(view, believed=None), []
    for quantity in quantities:
        if quantity.knows_its_pose and quantity.has("measure"):
            changed = np.asarray(quantity.measure(view)) - np.asarray(quantity.measure(honest))
            parts.append(changed.reshape(len(view), -1))
        else:
            parts.append(np.zeros((len(view), quantity.channel.size)))
    return np.asarray(np.concatenate(parts, axis=1)[:, quantities.inputs.reading])


def observes_its_pose(quantities: Quantities) -> bool:
    """Tell whether anything that is observed may depend on the pose that the robot believes."""
    return any(quantity.knows_its_pose for quantity in quantities)


def require_present(quantities: Quantities, source: str) -> None:
    """Refuse frames of what depends on the pose: where the robot was before is not recorded with a state.

    Raises
    ------
    ConfigurationError
        If there are any.
    """
    if quantities.inputs.memory and observes_its_pose(quantities):
        raise ConfigurationError(
            f"{source}: pose: the policy observes frames of earlier poses, whose errors are not followed",
            "leave the pose error out, or verify a policy that observes the present alone",
        )


def _view(poses: PoseBoxes, goal: Floats, scale: float, axes: int) -> BoxView:
    still = np.zeros((len(poses), axes))
    boxes = StateBoxes(poses, still, still)
    nothing, none = np.zeros(0), np.zeros(0, dtype=complex)
    shapes = Shapes(none, nothing, none, none, scale)
    return BoxView(boxes, boxes.forms, shapes, goal, np.zeros(len(poses), dtype=bool))


def _changed(quantity: Quantity, around: BoxView, middle: BoxView) -> tuple[Floats, Floats, Floats, Booleans]:
    """Return centre, slope and rest of the change of a quantity, and where it may be any angle."""
    count, size = len(around), quantity.channel.size
    still = np.zeros((count, size))
    if not quantity.knows_its_pose:
        return still, np.zeros((count, _POSE, size)), still, still.astype(bool)
    here, there = quantity.enclose(around), quantity.enclose(middle)
    rest = (
        here.rest + there.rest + np.abs(here.slope[:, _POSE:]).sum(axis=1) + np.abs(there.slope).sum(axis=1)
    )
    anything = still.astype(bool)
    if quantity.wraps:
        other = quantity.enclose(replace(around, behind=frozenset({quantity.channel.kind})))
        anything = anything | (other.centre != here.centre)
    return here.centre - there.centre, here.slope[:, :_POSE], rest, anything
