"""The horizon of states: tubes, and for those that are not proved a search for a run that fails."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from viatool.arrays import Booleans, Floats, Indices
from viatool.errors import ConfigurationError
from viatool.loop.closed_loop import ClosedLoop
from viatool.loop.horizon import Crashes, Horizon, Tubes
from viatool.loop.runs import search_crashes
from viatool.loop.told import NOTHING, Told
from viatool.loop.tube import TubeFollower
from viatool.motion.carried import farthest
from viatool.policy import Policy
from viatool.safety import ScenePoses
from viatool.setting.setting import Setting
from viatool.simulate import NavigationTask
from viatool.taylor import Arithmetic
from viatool.world import Scenario


@dataclass(frozen=True, eq=False)
class HorizonExamination:
    """What is asked of the intervals after a state; picklable.

    Parameters
    ----------
    policy : Policy
        The program.
    setting : Setting
        Where it drives, the meaning of its numbers, and what is to hold.
    horizon : Horizon
        How far, and from which poses.
    arithmetic : str
        Contract of the bounds.
    """

    policy: Policy
    setting: Setting
    horizon: Horizon
    arithmetic: Arithmetic = "float32"

    def follower(self, scenario: Scenario | None) -> TubeFollower:
        """Return the closed loop in a scenario."""
        if scenario is None:
            raise ConfigurationError(
                "a horizon needs to know the goal, but an episode has none",
                "give the trajectory its scenario, a bag its --goal, or leave out --horizon",
            )
        task = NavigationTask()
        closed_loop = ClosedLoop.of(
            self.policy, self.setting, scenario, self.arithmetic, episode=task.horizon
        )
        return TubeFollower(closed_loop, task.goal_radius, self.horizon)

    def out_of_reach(self, placed: ScenePoses, begun: Floats | None = None) -> Booleans:
        """Tell from which states no command comes too near within the horizon, however often, (B,). **Sound:** yes.

        Of a robot whose motion has a state, begun are the ends (B, 2, S) of that.
        """
        rules, horizon, moving = self.setting.rules, self.horizon, self.setting.uncertainty.obstacles
        if moving.moves_on or any(moving.roams.values()):
            return np.zeros(len(placed), dtype=bool)
        away = placed.still.clearance(placed.poses[:, :2], placed.scene) - rules.footprint.reach
        lower, upper = (np.broadcast_to(end, (len(away), len(end))) for end in (rules.lower, rules.upper))
        known = np.ones(len(away), dtype=bool)
        if (
            rules.kinematics.state
        ):  # later states lie between the robot's limits and those that it begins with
            assert begun is not None
            least, most = rules.kinematics.state_range
            ends = np.stack([np.minimum(least, begun[:, 0]), np.maximum(most, begun[:, 1])], axis=1)
            known = np.isfinite(ends).all(axis=(1, 2))
            lower, upper = rules.begun(lower, upper, np.where(known[:, None, None], ends, 0.0))
        fastest: Floats | float
        longest: Floats | float
        seconds, start = rules.seconds_after(horizon.steps - 1)[1], float(np.hypot(*horizon.pose_error[:2]))
        if rules.over_time is not None:
            fastest, longest = farthest(rules.over_time)
        else:
            fastest = rules.kinematics.rates(lower, upper, rules.interval)[0]
            longest = rules.manoeuvre.longest(lower, upper)
        way = seconds * fastest + start
        return known & (away > rules.clearance.collision + way + longest + 1e-6 * placed.scale)

    def examine(
        self,
        scenarios: Sequence[Scenario | None],
        poses: Floats,
        before: Floats,
        episode: Indices,
        wanted: Booleans,
        told: Told = NOTHING,
        *,
        first: int,
        seed: int,
        commands: Floats | None = None,
    ) -> tuple[Tubes, Crashes]:
        """Follow every run from B states.

        Parameters
        ----------
        scenarios : sequence of Scenario
            Of the episodes.
        poses, before : ndarray
            (B, 3) and (B, 2, K): recorded poses, and ends of what stands behind them (`Kinematics.before`): commands
            before, or states of the motion; NaN where one is not known.
        episode : ndarray
            (B,) index into the scenarios.
        wanted : ndarray
            (B,) bool: the states that are looked at; the others count as safe.
        told : Told
            What else was recorded in the states.
        first : int
            What the first state is called.
        seed : int
            Of the search for runs that fail.
        commands : ndarray, optional
            (B, A) commands before, where these are not what stands behind the poses; NaN where one is not known.

        Returns
        -------
        tuple of Tubes and Crashes
            Of B states.
        """
        steps, rules = self.horizon.steps, self.setting.rules
        none = Crashes.none(steps, len(self.setting.radii), len(rules.lower), len(rules.kinematics.state))
        tubes, crashes = Tubes.none(len(poses), steps), [none]
        middle = before.mean(axis=1)
        apart = np.maximum(before[:, 1] - middle, middle - before[:, 0])
        known = np.isfinite(before).all(axis=(1, 2))
        tubes.steps[wanted & ~known] = 0  # a tube that begins nowhere proves nothing
        wanted = wanted & known
        for index in np.unique(episode[wanted]).tolist():
            follower, rows = self.follower(scenarios[index]), np.flatnonzero(wanted & (episode == index))
            found = follower.follow(poses[rows], middle[rows], apart[rows], told.select(rows))
            for name in Tubes.__dataclass_fields__:
                getattr(tubes, name)[rows] = getattr(found, name)
            rows, sent = rows[~found.safe], None
            if commands is not None:
                rows = rows[np.isfinite(commands[rows]).all(axis=1)]
                sent = commands[rows]
            where = first + rows, poses[rows], middle[rows], sent, told.select(rows)
            if (
                rules.over_time is None and follower.loop.around.moving is None
            ):  # else none could be driven again
                crashes.append(search_crashes(follower, *where, seed=(seed, first, index)))
        return tubes, Crashes.join(crashes)
