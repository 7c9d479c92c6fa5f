"""Where the robot is on the map, and which way it looks, as far as it knows."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar, Literal

import numpy as np

from viatool.arrays import Floats, Reals
from viatool.channels.quantity import Quantity, observes
from viatool.channels.views import BoxView, Extent, RecordedInstants, View
from viatool.motion.arcs import wrap_angle
from viatool.rounding import SPARE
from viatool.sets.forms import Forms


class PoseCoordinate(Quantity):
    """One coordinate of the robot's place in the map's frame."""

    axis: ClassVar[Literal[0, 1]]

    def measure(self, view: View) -> Reals:
        """Return the coordinate of where the robots think they are."""
        return view.known_poses[:, self.axis]

    def record(self, recorded: RecordedInstants) -> Floats:
        """Return the recorded coordinate."""
        return recorded.poses[:, self.axis]

    def enclose(self, view: BoxView) -> Forms:
        """Return the part of the state."""
        return view.state(("x", "y")[self.axis])

    def bounds(self, extent: Extent) -> tuple[float, float]:
        """Return the bounds of the map."""
        return extent.along(self.axis)


@observes("pose_x")
class PoseX(PoseCoordinate):
    """The robot's x coordinate in the map's frame, in metres."""

    axis = 0


@observes("pose_y")
class PoseY(PoseCoordinate):
    """The robot's y coordinate in the map's frame, in metres."""

    axis = 1


class HeadingQuantity(Quantity):
    """The heading, or a function of it."""

    @abstractmethod
    def of(self, headings: Floats) -> Floats:
        """Return it of headings in radians."""

    def measure(self, view: View) -> Reals:
        """Return it of the heading that the robots think they have."""
        return self.of(view.known_poses[:, 2])

    def record(self, recorded: RecordedInstants) -> Floats:
        """Return it of the recorded heading."""
        return self.of(recorded.poses[:, 2])


@observes("heading")
class Heading(HeadingQuantity):
    """The heading in the map's frame, in radians counter-clockwise from x, within a half turn."""

    wraps = True

    def of(self, headings: Floats) -> Floats:
        """Return headings within a half turn."""
        return wrap_angle(headings)

    def enclose(self, view: BoxView) -> Forms:
        """Return the part of the state, on one side of the half turn where both are possible."""
        return view.within_half_turn(view.state("theta"), self.channel.kind)

    def bounds(self, extent: Extent) -> tuple[float, float]:
        """Return a half turn to either side."""
        return -np.pi, np.pi


class HeadingWave(HeadingQuantity):
    """Cosine or sine of the heading."""

    @abstractmethod
    def slope(self, headings: Floats) -> Floats:
        """Return the derivative at headings in radians."""

    def enclose(self, view: BoxView) -> Forms:
        """Enclose it by its tangent at the middle: the second derivative is at most 1."""
        theta = view.state("theta")
        slope = self.slope(theta.centre)
        spread = np.abs(theta.slope).sum(axis=1) + theta.rest
        rest = np.abs(slope) * theta.rest + 0.5 * np.square(spread) + SPARE * (1.0 + np.abs(theta.centre))
        return Forms(self.of(theta.centre), slope[:, None] * theta.slope, rest)

    def bounds(self, extent: Extent) -> tuple[float, float]:
        """Return the range of a cosine or sine."""
        return -1.0, 1.0


@observes("heading_cosine")
class HeadingCosine(HeadingWave):
    """The cosine of the heading: 1 along x."""

    def of(self, headings: Floats) -> Floats:
        """Return the cosine."""
        return np.cos(headings)

    def slope(self, headings: Floats) -> Floats:
        """Return the derivative of the cosine."""
        return -np.sin(headings)


@observes("heading_sine")
class HeadingSine(HeadingWave):
    """The sine of the heading: 1 along y."""

    def of(self, headings: Floats) -> Floats:
        """Return the sine."""
        return np.sin(headings)

    def slope(self, headings: Floats) -> Floats:
        """Return the derivative of the sine."""
        return np.cos(headings)
