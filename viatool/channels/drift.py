"""How readings change when the robot believes another pose than the one that was recorded, or its scan is another.

What a LiDAR reads that is turned, or whose rays pass thin obstacles, was not recorded: the recorded scan is taken to
change by as much as that of the map does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from viatool.arrays import Booleans, Floats, Indices
from viatool.channels.erring import Erring
from viatool.channels.quantities import Quantities
from viatool.channels.quantity import Quantity
from viatool.channels.views import BoxView, View
from viatool.errors import ConfigurationError
from viatool.rounding import SLIGHTLY_MORE
from viatool.sets.forms import Forms, PoseBoxes
from viatool.sets.states import StateBoxes
from viatool.sight.shapes import Shapes

_POSE = 3
"""Symbols of a pose: x, y and theta, each in half-widths of its box."""

_Changes = tuple[Floats, Floats, Floats, Booleans]
"""Centre, slope and rest of the change of a quantity, and where it may be any angle."""


@dataclass(frozen=True, eq=False)
class ScanView:
    """What LiDARs see around B poses, and how their scans err.

    Parameters
    ----------
    erring : Erring
        With the errors of scans alone.
    shapes : Shapes
        What there is to be seen.
    submerged : ndarray
        (B,) bool: whether the robot may be in an obstacle or off the map.
    """

    erring: Erring
    shapes: Shapes
    submerged: Booleans


@dataclass(frozen=True, eq=False)
class Drift:
    """By how much the readings in n inputs change over boxes of believed poses, and with scans.

    Parameters
    ----------
    forms : Forms
        (B, n) in the three symbols of the believed pose, and one for each scan that may be turned.
    anything : ndarray
        (B, n) bool: an angle that may be on either side of the half turn, of which nothing else is known.
    """

    forms: Forms
    anything: Booleans

    @classmethod
    def of(
        cls,
        quantities: Quantities,
        poses: PoseBoxes,
        goal: Floats,
        scale: float,
        axes: int,
        scans: ScanView | None = None,
    ) -> Drift:
        """Return what B boxes of poses change, on a map whose coordinates are below a scale.

        The robot may be anywhere in its box, and may believe to be anywhere in it.

        Notes
        -----
        Sound: yes. All channels see the same pose; a LiDAR measures from where the robot is, not from where it believes
        to be.
        """
        around = _view(poses, goal, scale, axes)
        middle = _view(PoseBoxes(poses.centre, 0.0 * poses.radius), goal, scale, axes)
        symbols = _POSE + (0 if scans is None else scans.erring.turns)
        parts = []
        for quantity, place in zip(quantities, quantities.columns, strict=True):
            if quantity.knows_its_pose and poses.radius.any():
                parts.append(_changed(quantity, around, middle, symbols))
            elif scans is not None and scans.erring.scan_at(place) is not None:
                seen = replace(around, shapes=scans.shapes, submerged=scans.submerged)
                parts.append(_rescanned(quantity, place, seen, scans.erring, symbols))
            else:
                parts.append(_unchanged(len(around), quantity.channel.size, symbols))
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
    return BoxView(boxes, boxes.forms, Shapes.nothing(scale), goal, np.zeros(len(poses), dtype=bool))


def _unchanged(count: int, size: int, symbols: int) -> _Changes:
    still = np.zeros((count, size))
    return still, np.zeros((count, symbols, size)), still, still.astype(bool)


def _changed(quantity: Quantity, around: BoxView, middle: BoxView, symbols: int) -> _Changes:
    """Return how a quantity changes with the believed pose."""
    here, there = quantity.enclose(around), quantity.enclose(middle)
    rest = (
        here.rest + there.rest + np.abs(here.slope[:, _POSE:]).sum(axis=1) + np.abs(there.slope).sum(axis=1)
    )
    anything = np.zeros(rest.shape, dtype=bool)
    if quantity.wraps:
        other = quantity.enclose(replace(around, behind=frozenset({quantity.channel.kind})))
        anything = anything | (other.centre != here.centre)
    slope = np.zeros((len(rest), symbols, rest.shape[1]))
    slope[:, :_POSE] = here.slope[:, :_POSE]
    return here.centre - there.centre, slope, rest, anything


def _rescanned(quantity: Quantity, place: slice, view: BoxView, erring: Erring, symbols: int) -> _Changes:
    """Return how a scan changes that is turned or passes thin obstacles, from wherever the robot may be."""
    here, there = quantity.enclose(erring.looking(view, place)), quantity.enclose(view)
    known = view.states.slope.shape[1]
    moved = np.abs(here.slope[:, :known] - there.slope).sum(axis=1)
    rest = (here.rest + there.rest + moved) * SLIGHTLY_MORE
    slope = np.zeros((len(rest), symbols, rest.shape[1]))
    turned = here.slope[:, known + _POSE :]
    slope[:, _POSE : _POSE + turned.shape[1]] = turned
    return here.centre - there.centre, slope, rest, np.zeros(rest.shape, dtype=bool)
