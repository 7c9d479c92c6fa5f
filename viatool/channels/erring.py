"""How readings err anywhere in sets of states: by themselves, in common, by the believed pose, and as a scan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from viatool.arrays import Floats, Indices
from viatool.channels.missing import Missing
from viatool.channels.views import BoxView
from viatool.rounding import SLIGHTLY_MORE
from viatool.sets.forms import Forms, PoseBoxes
from viatool.sets.observations import Few

_POSE = 3


@dataclass(frozen=True, eq=False)
class ScanErrors:
    """How the scan of one LiDAR errs as a whole.

    Parameters
    ----------
    columns : ndarray
        (E,) the readings of its bins.
    angle : float
        By how much the scan may be turned against the robot, in radians.
    thin : float
        The widest obstacle that a ray may pass without seeing it, in metres.
    """

    columns: Indices
    angle: float = 0.0
    thin: float = 0.0


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
    scans : tuple of ScanErrors
        Of the LiDARs that have any.
    missing : tuple of Missing
        Scans whose rays may return nothing.

    Notes
    -----
    Forms get more symbols behind those of the states: three of the error of the pose, V of the common errors, and one
    for each scan that may be turned.
    """

    absolute: Floats
    relative: Floats
    common: Floats
    pose: Floats
    scans: Sequence[ScanErrors] = ()
    missing: Sequence[Missing] = ()

    @classmethod
    def within(cls, radii: Floats, scans: Sequence[ScanErrors] = ()) -> Erring:
        """Return errors (n,) of which each is by itself, and those of scans."""
        return cls(radii, 0.0 * radii, np.zeros((0, len(radii))), np.zeros(_POSE), scans)

    @property
    def turns(self) -> int:
        """Return how many scans may be turned."""
        return len(self._turned)

    @property
    def _turned(self) -> list[ScanErrors]:
        return [scan for scan in self.scans if scan.angle > 0.0]

    def believed(self, view: BoxView) -> BoxView:
        """Return the poses that robots believe anywhere in sets, with what their errors add in three more symbols."""
        if not self.pose.any():
            return view
        return _widened(view, self.pose, 0)

    def looking(self, view: BoxView, place: slice) -> BoxView:
        """Return sets as the LiDAR sees them whose readings stand in a place: turned, and past thin obstacles.

        The turn is one more symbol, the same for all rays: a LiDAR that is turned sees what it would if the robot were.
        """
        scan = self.scan_at(place)
        if scan is None:
            return view
        view = replace(view, shapes=view.shapes.passing(scan.thin))
        if not scan.angle > 0.0:
            return view
        last = (
            len(self.common) + self._turned.index(scan) + 1
        )  # so that the heading is the symbol of the scan
        return _widened(view, np.array([0.0, 0.0, scan.angle]), last)

    def scan_at(self, place: slice) -> ScanErrors | None:
        """Return how the scan errs whose readings stand in a place; None if it does not, as a whole."""
        return next((scan for scan in self.scans if int(scan.columns[0]) == place.start), None)

    def added(self, seen: Forms, place: slice, symbols: int) -> Forms:
        """Return readings (C, k) with their errors, in all symbols; the states have S."""
        own = self.own(seen, place)
        turned = self.turns
        if not (self.pose.any() or len(self.common) or turned):
            return Forms(seen.centre, seen.slope, seen.rest + own)
        size, kept = symbols + _POSE + len(self.common) + turned, seen.slope.shape[1]
        slope = np.zeros((len(seen.centre), size, seen.slope.shape[2]))
        slope[:, :kept] = seen.slope
        slope[:, symbols + _POSE : size - turned] += self.common[:, place]
        return Forms(seen.centre, slope, seen.rest + own)

    def own(self, seen: Forms, place: slice) -> Floats:
        """Bound by how much each reading (C, k) errs by itself."""
        own = np.broadcast_to(self.absolute[place], seen.centre.shape)
        if not self.relative[place].any():
            return own
        size = np.maximum(np.abs(seen.lower), np.abs(seen.upper)) * SLIGHTLY_MORE
        return np.asarray(own + self.relative[place] * size * SLIGHTLY_MORE)

    def losing(self, place: slice) -> int:
        """Return how many rays may return nothing of the scan whose readings stand in a place."""
        return max((scan.count for scan in self._missing_in(place)), default=0)

    def lost(self, seen: Forms, place: slice, most: Floats) -> list[Few]:
        """Return what readings (C, k), with their errors, may be of which a ray returns nothing.

        Without errors they are `most` (C, k) then at most.

        Notes
        -----
        Sound: yes. The rays that are left may read beyond the limits by as much as they err.
        """
        found = []
        for scan in self._missing_in(place):
            columns, among = scan.columns, scan.columns - place.start
            common = np.abs(self.common[:, columns]).sum(axis=0)
            relative, other = self.relative[columns], self.absolute[columns] + common
            largest = max(scan.lidar.maximum_range, abs(scan.reading))
            beyond = (other + relative * largest) * SLIGHTLY_MORE
            others = most[:, among] + (other + relative * most[:, among]) * SLIGHTLY_MORE
            ends = scan.bounds(seen.lower[:, among], seen.upper[:, among], beyond, others * SLIGHTLY_MORE)
            found.append(Few(scan.count, columns, *ends))
        return found

    def _missing_in(self, place: slice) -> list[Missing]:
        return [scan for scan in self.missing if place.start <= int(scan.columns[0]) < place.stop]


def _widened(view: BoxView, more: Floats, first: int) -> BoxView:
    """Return sets whose poses may be off by (3,) more, in three symbols behind those of the states and some others."""
    start, states = view.start, view.states
    poses = PoseBoxes(start.poses.centre, (start.poses.radius + more) * SLIGHTLY_MORE)
    axes = np.flatnonzero(more)
    behind = np.zeros((len(view), first + _POSE, states.slope.shape[2]))
    behind[:, first + axes, axes] = more[axes]
    wider = Forms(states.centre, np.concatenate([states.slope, behind], axis=1), states.rest)
    return replace(view, start=replace(start, poses=poses), states=wider)
