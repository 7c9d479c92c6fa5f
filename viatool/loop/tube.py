"""The tube of the closed loop: from boxes of states, where every run may be after each control interval.

A run observes what perfect sensors read at its pose, each entry off by at most eps, does what the policy commands, and
so on. The parts of a tube hold the state of every run at the beginning of an interval; `successor.step` encloses where
they are at its end, whatever the sensors err, and `sectors` cuts and joins that to the parts of the next interval.

A run ends when it reaches its goal, or collides. So a part in which every pose has arrived goes no further, nor does
one without a pose that keeps the collision distance.

*Clearance.* During an interval the runs of a part drive along arcs, from any pose of a box under any command of a box;
how near these come to obstacles is bounded by `safety.enclosure`. Where that does not suffice, `ClosedLoop.holds`
decides whether every pose that keeps the collision distance is followed by an interval that keeps it. The poses at the
beginning of an interval are those at the end of the one before, so by induction all intervals are safe up to the first
that is not proved.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from viatool.arrays import Booleans, Floats, Indices
from viatool.loop.closed_loop import ClosedLoop
from viatool.loop.destination import Destination, NearPlace
from viatool.loop.elapsed import loop_after
from viatool.loop.horizon import Horizon, Tubes
from viatool.loop.keeping import begins_clear, clearance_kept
from viatool.loop.sectors import TubeParts, cut_by_heading
from viatool.loop.successor import LoopStep, states_of, step
from viatool.loop.told import NOTHING, Told
from viatool.rounding import SPARE
from viatool.sets.forms import Forms


@dataclass(frozen=True, eq=False)
class TubeFollower:
    """Follows the closed loop of one scenario.

    Parameters
    ----------
    loop : ClosedLoop
        Policy, sensors, obstacles, and what is to hold.
    goal_radius : float
        A run ends when it is nearer to its goal than this, in metres.
    horizon : Horizon
        How far, and in how many parts.
    elsewhere : Destination, optional
        Where a run arrives instead.
    """

    loop: ClosedLoop
    goal_radius: float
    horizon: Horizon
    elsewhere: Destination | None = None

    @property
    def destination(self) -> Destination:
        """Return where a run arrives."""
        return self.elsewhere or NearPlace(False, self.loop.sensors.goal, self.goal_radius)

    def arrived(self, parts: TubeParts) -> Booleans:
        """Tell in which parts every pose has reached the goal, (P,)."""
        return self.destination.surely(parts.lower, parts.upper)

    def ended(self, states: Floats) -> Booleans:
        """Tell which states (R, 3 + K) are those of runs that go no further, (R,)."""
        destination = self.destination
        return destination.holds(states) & (not destination.deadline_only)

    def beginning(self, poses: Floats, before: Floats, apart: Floats | None = None) -> TubeParts:
        """Return the parts of the tubes of B states; see `follow`."""
        state = np.concatenate([poses, before], axis=1)
        pose_error = np.broadcast_to(self.horizon.pose_error, poses.shape)
        error = np.concatenate([pose_error, np.zeros_like(before) if apart is None else apart], axis=1)
        reach = error + SPARE * (np.abs(state) + 1.0) * (error > 0.0)
        tube = np.arange(len(state))
        parts = TubeParts(tube, state - reach, state + reach)
        return self._cut(tube, states_of(parts.cells), (parts.lower, parts.upper))

    def follow(
        self, poses: Floats, before: Floats, apart: Floats | None = None, told: Told = NOTHING
    ) -> Tubes:
        """Enclose every run from B states.

        Parameters
        ----------
        poses : ndarray
            (B, 3) recorded poses.
        before : ndarray
            (B, K) what stands behind them (`Kinematics.before`): commands of the step before, as the robot carried them
            out, or the state of the motion.
        apart : ndarray, optional
            (B, K) by how much each number of that may be another one.
        told : Told
            What else was recorded in the states.

        Returns
        -------
        Tubes
            Of B states.

        Notes
        -----
        Sound: yes, under what `docs/tubes.md` assumes. Cost: one step of the closed loop for each part and interval.
        """
        count, steps = len(poses), self.horizon.steps
        lower, upper = np.full((2, count, steps, 3), np.nan)
        clearance = np.full((count, steps), np.inf)
        kept = np.zeros((count, steps), dtype=bool)
        parts = self.beginning(poses, before, apart)
        parts = parts.select(~self.arrived(parts))
        begins_clear = self._all_clear(parts, count)
        for k in range(steps):
            here = replace(self, loop=loop_after(self.loop, k))
            after = step(here.loop, states_of(parts.cells), told.after(k).select(parts.tube))
            clearance[:, k], kept[:, k] = here._clearance(parts, after, count)
            bounds = after.bounds(parts.lower[:, :3], parts.upper[:, :3])
            parts = self._cut(parts.tube[after.origin], after.states, bounds)
            ends = parts.hulls(count)
            lower[:, k], upper[:, k] = ends[0][:, :3], ends[1][:, :3]
            parts = parts.select(~self.arrived(parts))
            doubtful = ~kept[parts.tube, k]
            ended = np.zeros(len(parts), dtype=bool)
            ended[doubtful] = here.loop.blocked(parts.select(doubtful).cells.poses)
            parts = parts.select(~ended)
            if not len(parts):
                kept[:, k + 1 :] = True  # of tubes that are proved so far, none had a part that collided
                break
        safe = np.logical_and.accumulate(kept & begins_clear[:, None], axis=1)
        proved = np.maximum(clearance, self.loop.rules.clearance.collision)
        return Tubes(lower, upper, np.where(safe, proved, clearance), safe.sum(axis=1))

    def _cut(self, tube: Indices, states: Forms, bounds: tuple[Floats, Floats]) -> TubeParts:
        return cut_by_heading(tube, states, bounds, self.horizon.sector, self.horizon.parts)

    def _all_clear(self, parts: TubeParts, count: int) -> Booleans:
        """Tell of which tubes (B,) every pose keeps the collision distance at the beginning."""
        return _all_of(parts, begins_clear(self.loop, parts.cells.poses), count)

    def _clearance(self, parts: TubeParts, after: LoopStep, count: int) -> tuple[Floats, Booleans]:
        """Return what runs keep during an interval in metres, (B,), and whether the collision distance is proved."""
        parts = parts.select(after.origin)
        least, proved = clearance_kept(self.loop, parts.cells, after.start, after.lower, after.upper)
        clearance = np.full(count, np.inf)
        np.minimum.at(clearance, parts.tube, least)
        return clearance, _all_of(parts, proved, count)


def _all_of(parts: TubeParts, holds: Booleans, count: int) -> Booleans:
    """Tell of which tubes (B,) something holds in every part."""
    every = np.ones(count, dtype=bool)
    every[parts.tube[~holds]] = False
    return every
