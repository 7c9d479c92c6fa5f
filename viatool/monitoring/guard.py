"""Which commands robots may be given, and what they are told instead: the rule of the monitor, for many robots at once.

*What is kept.* In every control interval: **if the brakes take hold now, the robot keeps its clearance at every instant
until it stands, from every pose that localisation leaves open.** A command passes if the same is proved of the command
held for one interval and the brakes after it (`Guard.proves`: the criterion `braking` for one command). So

- at the beginning the robot stands, and that it is clear where it stands is proved before anything is promised;
- while a command that passed is held the clearance is kept, as that is what was proved, and when the interval ends the
  brakes may take hold, as that was proved with it;
- a robot that brakes is on the path that was proved when its last command passed, and stays on it until it stands.

Each step asks nothing of later observations: if localisation, policy or monitor fail, the brakes alone suffice.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from viatool.arrays import Booleans, Floats, Indices
from viatool.errors import ConfigurationError
from viatool.motion.twists import HeldTwist
from viatool.safety import JudgedStates, ScenePoses, prove
from viatool.safety.moving import moving_obstacles
from viatool.safety.proof import ProofEffort
from viatool.safety.scene_poses import Movers
from viatool.setting.setting import Setting
from viatool.world import Scenario

EFFORT = ProofEffort(cells=64, tolerance=1e-3)
"""What is not proved within a millimetre does not pass: a decision is to take a few milliseconds at most."""
BRAKE, POLICY, FALLBACK = range(3)
"""Whose command a robot is given."""

Alternative = Callable[[Indices], Floats]
"""Gives other commands (W, A) for some of the robots, (W,)."""


@dataclass(frozen=True, eq=False)
class Guard:
    """What is proved of commands in some scenarios.

    Parameters
    ----------
    setting : Setting
        Asked for the job ``monitor``, with the criterion ``braking``.
    scenarios : tuple of Scenario
        What they add to the map; None for nothing.

    Raises
    ------
    ConfigurationError
        If no stop is asked for, the robot is not commanded with velocities, or it cannot stand.
    """

    setting: Setting
    scenarios: tuple[Scenario | None, ...] = (None,)

    def __post_init__(self) -> None:
        rules = self.setting.rules
        if rules.manoeuvre.deceleration is None:
            raise ConfigurationError(
                f"a monitor is asked for criterion '{rules.criterion}', which says nothing of a stop",
                "ask for braking",
            )
        if not isinstance(rules.kinematics, HeldTwist):
            raise ConfigurationError(
                f"a robot of kinematics '{rules.kinematics.name}' is not told velocities, by which the monitor brakes",
                "monitor robots that are commanded with speeds and turning speeds",
            )
        if not ((rules.lower <= 0.0) & (rules.upper >= 0.0)).all():
            raise ConfigurationError(
                f"the robot cannot stand: it carries out {rules.kinematics.range_words(rules.lower, rules.upper)}",
                "give it limits that contain 0, or leave out the monitor",
            )

    @cached_property
    def _around(self) -> tuple[ScenePoses, Movers | None]:
        count, world_map = len(self.scenarios), self.setting.world_map
        placed = ScenePoses.of(world_map, self.scenarios, np.zeros((count, 3)), np.arange(count))
        roaming = moving_obstacles(world_map, self.scenarios, self.setting.uncertainty.obstacles)
        return placed, Movers(roaming, np.arange(count)) if len(roaming) else None

    def carried_out(self, asked: Floats) -> Floats:
        """Return commands (E, A) as robots carry them out: within their limits, and no harder than cars steer."""
        rules = self.setting.rules
        return rules.kinematics.carried_out(self.setting.world_map.robot, rules.clip(asked))

    def placed(self, poses: Floats, scene: Indices) -> ScenePoses:
        """Return where robots may be that localisation puts at poses (E, 3) of scenes (E,)."""
        still, roaming = self._around
        radii = self.setting.pose_radii
        wide = np.broadcast_to(radii, poses.shape) if radii.any() else None
        found = replace(still, poses=poses, scene=scene, radii=wide)
        return found if roaming is None else found.among([roaming.select(scene)])

    def proves(self, poses: Floats, scene: Indices, commands: Floats, under_way: Floats) -> Booleans:
        """Tell after which commands robots certainly can stop.

        Parameters
        ----------
        poses, scene : ndarray
            (E, 3) and (E,), as for `placed`.
        commands : ndarray
            (E, A) as robots carry them out.
        under_way : ndarray
            (E, W, A) commands before, which act first, the oldest first.

        Returns
        -------
        ndarray
            (E,) bool: held for one interval, and braked for after it, the command keeps the footprint farther than
            d_col from everything, at every instant and from every pose that is left open.

        Notes
        -----
        Sound: yes, see `prove`. What is not a number is never proved.
        """
        rules = self.setting.rules
        known = np.isfinite(poses).all(axis=1) & np.isfinite(commands).all(axis=1)
        states = JudgedStates(rules, self.placed(poses, scene), under_way)
        proved = known & states.out_of_reach
        rows = np.flatnonzero(known & ~proved)
        if rows.size:
            some, held, limit = states.select(rows), commands[rows], rules.clearance.collision
            proved[rows] = prove(some, held, held, limit, EFFORT).proved
        return proved


@dataclass(frozen=True, eq=False)
class Decisions:
    """What E robots are told.

    Parameters
    ----------
    commands : ndarray
        (E, A) to be held for the next interval.
    source : ndarray
        (E,) `POLICY`, `FALLBACK` or `BRAKE`.
    proved : ndarray
        (E,) bool: the clearance is kept from now on, until the robot stands.
    """

    commands: Floats
    source: Indices
    proved: Booleans


@dataclass(eq=False)
class Watch:
    """E robots under a guard: what each was told, and whether its brakes suffice.

    Parameters
    ----------
    guard : Guard
        What is proved.
    robots : int
        E, all of them at rest.

    Attributes
    ----------
    under_way : ndarray
        (E, W, A) commands on their way to the motors, the oldest first.
    kept : ndarray
        (E,) bool: it is proved that the brakes suffice.
    """

    guard: Guard
    robots: int
    under_way: Floats = field(init=False)
    kept: Booleans = field(init=False)

    def __post_init__(self) -> None:
        rules = self.guard.setting.rules
        axes = len(rules.lower)
        self.under_way = np.zeros((self.robots, rules.commands_before, axes))
        self.kept = np.zeros(self.robots, dtype=bool)
        self._given_up = np.zeros((self.robots, axes))  # the last command that passed
        self._intervals = np.zeros(self.robots, np.int64)  # for which it has been told to brake since

    def begin(self, which: Indices | slice = slice(None)) -> None:
        """Begin anew with some robots, which stand and have nothing on its way."""
        self.under_way[which] = self._given_up[which] = 0.0
        self._intervals[which], self.kept[which] = 0, False

    def keep(self, which: Booleans) -> None:
        """Go on with some of the robots only, (E,) bool."""
        self.under_way, self.kept = self.under_way[which], self.kept[which]
        self._given_up, self._intervals = self._given_up[which], self._intervals[which]
        self.robots = len(self.kept)

    def decide(
        self, poses: Floats, scene: Indices, asked: Floats, alternative: Alternative | None = None
    ) -> Decisions:
        """Decide what robots are told for the next interval.

        Parameters
        ----------
        poses, scene : ndarray
            (E, 3) where localisation says that they are, and (E,) of which scenario of the guard.
        asked : ndarray
            (E, A) what their policies command; anything that is not a number does not pass.
        alternative : callable, optional
            Gives the commands of a fallback for those that do not pass.

        Notes
        -----
        Sound: yes; the robots have to be told what is decided, see the top of this module.
        """
        rules, guard = self.guard.setting.rules, self.guard
        commands, source = guard.carried_out(asked), np.full(len(asked), POLICY)
        passed = guard.proves(poses, scene, commands, self.under_way)
        if alternative is not None and not passed.all():
            rows = np.flatnonzero(~passed)
            commands[rows], source[rows] = guard.carried_out(alternative(rows)), FALLBACK
            passed[rows] = guard.proves(poses[rows], scene[rows], commands[rows], self.under_way[rows])
        brakes = rules.manoeuvre.braked(self._given_up, self._intervals)
        commands = np.where(passed[:, None], commands, brakes)
        self.kept = self.kept | passed | self._stands_clear(poses, scene, commands, self.kept | passed)
        self._given_up = np.where(passed[:, None], commands, self._given_up)
        self._intervals = np.where(passed, 0, self._intervals + 1)
        self.under_way = np.concatenate([self.under_way, commands[:, None]], axis=1)[:, 1:]
        return Decisions(commands, np.where(passed, source, BRAKE), self.kept.copy())

    def _stands_clear(self, poses: Floats, scene: Indices, commands: Floats, known: Booleans) -> Booleans:
        """Tell which robots are told to stand, and are proved to be clear there, of those that are not known to be."""
        rows = np.flatnonzero(~known & (commands == 0.0).all(axis=1))
        clear = np.zeros(len(known), dtype=bool)
        if rows.size:
            clear[rows] = self.guard.proves(poses[rows], scene[rows], commands[rows], self.under_way[rows])
        return clear
