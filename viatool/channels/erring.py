"""How readings err anywhere in sets of states: by themselves, in common, and by the pose that is believed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from viatool.arrays import Floats
from viatool.channels.views import BoxView
from viatool.rounding import SLIGHTLY_MORE
from viatool.sets.forms import Forms, PoseBoxes


@dataclass(frozen=True, eq=False)
class Erring:
    """What bounds the errors of n readings over sets of states.

    Parameters
    ----------
    absolute, relative : ndarray
        (n,) error of each reading, in the unit of its sensor, and share of it.
    common : ndarray
        (V, n) what V errors add that readings have in common.
    pose : ndarray
        (3,) how far the believed pose may be from the true one, metres and radians.

    Notes
    -----
    Forms get 3 + V more symbols, behind those of the states: the error of the pose, and the common errors.
    """

    absolute: Floats
    relative: Floats
    common: Floats
    pose: Floats

    @classmethod
    def within(cls, radii: Floats) -> Erring:
        """Return errors (n,) of which each is by itself."""
        return cls(radii, 0.0 * radii, np.zeros((0, len(radii))), np.zeros(3))

    def believed(self, view: BoxView) -> BoxView:
        """Return the poses that robots believe anywhere in sets, with what their errors add in three more symbols."""
        if not self.pose.any():
            return view
        start, states = view.start, view.states
        poses = PoseBoxes(start.poses.centre, (start.poses.radius + self.pose) * SLIGHTLY_MORE)
        more = np.zeros((len(view), 3, states.slope.shape[2]))
        more[:, range(3), range(3)] = self.pose
        wider = Forms(states.centre, np.concatenate([states.slope, more], axis=1), states.rest)
        return replace(view, start=replace(start, poses=poses), states=wider)

    def added(self, seen: Forms, place: slice, symbols: int) -> Forms:
        """Return readings (C, k) with their errors, in 3 + V symbols more than the S of the states."""
        lacking = np.zeros((len(seen.centre), symbols + 3 - seen.slope.shape[1], seen.slope.shape[2]))
        common = np.broadcast_to(self.common[:, place], (len(lacking), *self.common[:, place].shape))
        own = self.absolute[place]
        if self.relative[place].any():
            size = np.maximum(np.abs(seen.lower), np.abs(seen.upper)) * SLIGHTLY_MORE
            own = own + self.relative[place] * size * SLIGHTLY_MORE
        if not (self.pose.any() or len(self.common)):
            return Forms(seen.centre, seen.slope, seen.rest + own)
        return Forms(seen.centre, np.concatenate([seen.slope, lacking, common], axis=1), seen.rest + own)
