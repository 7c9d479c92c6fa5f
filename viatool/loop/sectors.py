"""Sets of states as parts by heading: cut along theta, and joined again wherever parts overlap.

What a LiDAR reads depends above all on the heading: it jumps where an edge crosses a ray, and that takes a turn of less
than a ray's spacing. So the set of a tube is kept as boxes of pose and command, each a narrow sector of headings.

*The cut.* A step turns a box into a set ``q = c + G s + r e``, s and e in [-1, 1]. Of its states with a heading theta
in [a, b], for any number k,

    q_i = k theta + (q_i - k theta)  lies in  k [a, b] + c_i - k c_t +- (|G_i - k G_t| + r_i + |k| r_t),

``|.|`` the sum of absolute values. With k the regression of q_i on theta most symbols cancel; with k = 0 it is the
whole set. Both bounds hold, so the tighter one counts. The parts that fall into one sector are replaced by the box
around them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Floats, Indices
from viatool.rounding import SLIGHTLY_MORE, SPARE
from viatool.sets.bounds import require_ordered
from viatool.sets.forms import Forms, PoseBoxes
from viatool.sets.states import StateBoxes

HEADING = 2


@dataclass(frozen=True, eq=False)
class TubeParts:
    """P boxes of states, each a part of one of B tubes.

    Parameters
    ----------
    tube : ndarray
        (P,) index of the tube, ascending.
    lower, upper : ndarray
        (P, 3 + A) ends of x, y, theta, and of the command of the step before.
    """

    tube: Indices
    lower: Floats
    upper: Floats

    def __len__(self) -> int:
        """Return P."""
        return len(self.tube)

    def select(self, which: NDArray[Any]) -> TubeParts:
        """Return some of the parts."""
        return TubeParts(self.tube[which], self.lower[which], self.upper[which])

    @property
    def cells(self) -> StateBoxes:
        """Return the boxes as cells of poses and previous commands, rounded outward."""
        centre = 0.5 * (self.lower + self.upper)
        radius = np.maximum(self.upper - centre, centre - self.lower)
        return StateBoxes(PoseBoxes(centre[:, :3], radius[:, :3]), self.lower[:, 3:], self.upper[:, 3:])

    def hulls(self, tubes: int) -> tuple[Floats, Floats]:
        """Return boxes (B, 3 + A) around the parts of each tube; NaN for one without parts."""
        lower, upper = np.full((2, tubes, self.lower.shape[1]), np.nan)
        there, first = np.unique(self.tube, return_index=True)
        if len(there):
            lower[there], upper[there] = join(self.lower, self.upper, first)
        return lower, upper


def cut_by_heading(
    tube: Indices, states: Forms, bounds: tuple[Floats, Floats], sector: float, most: int
) -> TubeParts:
    """Cut sets of states into sectors and join what falls into the same one.

    Parameters
    ----------
    tube : ndarray
        (C,) the tube of each set, ascending.
    states : Forms
        (C, 3 + A) pose and command.
    bounds : tuple of ndarray
        (C, 3 + A) twice: what else is known of the sets.
    sector : float
        Radians.
    most : int
        Parts of a tube; where it would have more, sectors are wider.

    Returns
    -------
    TubeParts
        Every state of every set is in a part of its tube.

    Notes
    -----
    Sound: yes. Every set is covered from its first heading to its last one, whatever the rounding of the sectors' ends.
    """
    low, high = bounds
    require_ordered("states after an interval", low, high, finite=True, rounding=SPARE)
    there, first, which = np.unique(tube, return_index=True, return_inverse=True)
    if not len(there):
        return TubeParts(tube, low, high)
    begin = np.minimum.reduceat(low[:, HEADING], first)[which]
    span = np.maximum.reduceat(high[:, HEADING], first)[which] - begin
    count = np.clip(np.ceil(span / sector), 1, most)
    width = np.where(span > 0.0, span / count, 1.0)
    start, end = (
        np.clip(np.floor((side[:, HEADING] - begin) / width), 0, count - 1).astype(np.int64)
        for side in bounds
    )
    pieces = end - start + 1
    of = np.repeat(np.arange(len(tube)), pieces)
    nth = np.arange(len(of)) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    index = start[of] + nth
    a = np.where(nth == 0, low[of, HEADING], begin[of] + index * width[of])
    b = np.where(nth == pieces[of] - 1, high[of, HEADING], begin[of] + (index + 1) * width[of])
    lower, upper = _within(states, bounds, of, np.minimum(a, b), b)
    key = which[of] * most + index
    order = np.argsort(key, kind="stable")
    sectors, first = np.unique(key[order], return_index=True)
    return TubeParts(there[sectors // most], *join(lower[order], upper[order], first))


def _within(
    states: Forms, bounds: tuple[Floats, Floats], of: Indices, a: Floats, b: Floats
) -> tuple[Floats, Floats]:
    """Return boxes (P, 3 + A) around the states of sets (P,) whose headings lie between a and b."""
    heading = states.slope[:, :, HEADING]
    variance = np.maximum(np.square(heading).sum(axis=1), 1e-300)[:, None]
    k = np.einsum("cs,csi->ci", heading, states.slope) / variance
    k = np.where(np.abs(k) < 1e6, k, 0.0)  # where the heading hardly varies nothing follows from it
    middle = states.centre - k * states.centre[:, HEADING, None]
    rest = left_over(states, k)
    size = np.abs(states.centre) + np.abs(k) * (np.abs(states.centre[:, HEADING, None]) + 1.0)
    rest = rest * SLIGHTLY_MORE + SPARE * (size + 1.0)
    ends = np.stack([k[of] * a[:, None], k[of] * b[:, None]])
    lower = np.maximum(middle[of] + ends.min(axis=0) - rest[of], bounds[0][of])
    upper = np.minimum(middle[of] + ends.max(axis=0) + rest[of], bounds[1][of])
    crossed = lower > upper  # only by rounding, of a set without extent
    lower, upper = np.where(crossed, bounds[0][of], lower), np.where(crossed, bounds[1][of], upper)
    lower[:, HEADING], upper[:, HEADING] = a, b
    return lower, upper


def left_over(states: Forms, k: Floats) -> Floats:
    """Bound by how much ``q_i - k theta`` varies over sets, (C, 3 + A)."""
    apart = np.abs(states.slope - k[:, None] * states.slope[:, :, HEADING, None]).sum(axis=1)
    return np.asarray(apart + states.rest + np.abs(k) * states.rest[:, HEADING, None])


def join(lower: Floats, upper: Floats, first: Indices) -> tuple[Floats, Floats]:
    """Return the boxes around consecutive boxes (P, 3 + A), from each first one to the next."""
    return np.minimum.reduceat(lower, first, axis=0), np.maximum.reduceat(upper, first, axis=0)
