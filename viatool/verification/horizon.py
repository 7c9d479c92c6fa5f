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
from viatool.loop.tube import TubeFollower
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

    def __post_init__(self) -> None:
        kinematics = self.setting.rules.kinematics
        if kinematics.state:
            raise ConfigurationError(
                f"what a {kinematics.description} does over several intervals is not enclosed",
                "leave out --horizon; each recorded state is judged from the motion that it has",
            )
        if self.setting.rules.delay:
            raise ConfigurationError(
                f"a horizon with a delay of {self.setting.rules.delay:g} s is not supported",
                "leave out --delay or --horizon",
            )

    def follower(self, scenario: Scenario | None) -> TubeFollower:
        """Return the closed loop in a scenario."""
        if scenario is None:
            raise ConfigurationError(
                "a horizon needs to know the goal, but an episode has none",
                "give the trajectory its scenario, a bag its --goal, or leave out --horizon",
            )
        closed_loop = ClosedLoop.of(self.policy, self.setting, scenario, self.arithmetic)
        return TubeFollower(closed_loop, NavigationTask().goal_radius, self.horizon)

    def out_of_reach(self, placed: ScenePoses) -> Booleans:
        """Tell from which states no command comes too near within the horizon, however often, (B,). **Sound:** yes."""
        rules, horizon = self.setting.rules, self.horizon
        away = placed.still.clearance(placed.poses[:, :2], placed.scene) - rules.footprint.reach
        fastest = float(rules.kinematics.rates(rules.lower, rules.upper, rules.interval)[0])
        way = (horizon.steps - 1) * rules.interval * fastest + float(np.hypot(*horizon.pose_error[:2]))
        longest = rules.manoeuvre.longest(rules.lower, rules.upper)
        return np.asarray(away > rules.clearance.collision + way + longest + 1e-6 * placed.scale)

    def examine(
        self,
        scenarios: Sequence[Scenario | None],
        poses: Floats,
        previous: Floats,
        episode: Indices,
        wanted: Booleans,
        *,
        first: int,
        seed: int,
    ) -> tuple[Tubes, Crashes]:
        """Follow every run from B states.

        Parameters
        ----------
        scenarios : sequence of Scenario
            Of the episodes.
        poses, previous : ndarray
            (B, 3) and (B, 2): recorded poses, and commands before; NaN where one is not known.
        episode : ndarray
            (B,) index into the scenarios.
        wanted : ndarray
            (B,) bool: the states that are looked at; the others count as safe.
        first : int
            What the first state is called.
        seed : int
            Of the search for runs that fail.

        Returns
        -------
        tuple of Tubes and Crashes
            Of B states.
        """
        steps, size = self.horizon.steps, len(self.setting.radii)
        tubes, crashes = Tubes.none(len(poses), steps), [Crashes.none(steps, size, previous.shape[1])]
        known = np.isfinite(previous).all(axis=1)
        tubes.steps[wanted & ~known] = 0  # a tube that begins nowhere proves nothing
        wanted = wanted & known
        for index in np.unique(episode[wanted]).tolist():
            follower, rows = self.follower(scenarios[index]), np.flatnonzero(wanted & (episode == index))
            found = follower.follow(poses[rows], previous[rows])
            for name in Tubes.__dataclass_fields__:
                getattr(tubes, name)[rows] = getattr(found, name)
            rows = rows[~found.safe]
            crashes.append(
                search_crashes(follower, first + rows, poses[rows], previous[rows], seed=(seed, first, index))
            )
        return tubes, Crashes.join(crashes)
