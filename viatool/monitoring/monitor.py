"""The monitor of one robot: in each control interval a policy's command passes, or the robot brakes."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from viatool.arrays import Floats, Indices
from viatool.errors import ConfigurationError
from viatool.monitoring.guard import BRAKE, FALLBACK, POLICY, Guard, Watch
from viatool.motion.kinematics import motion_of
from viatool.policy import ActionChannel, ObservationChannel, Policy, PolicySpecification, as_policy
from viatool.policy.given import row
from viatool.setting.premises import Premise
from viatool.setting.reconcile import with_robot
from viatool.setting.setting import Setting
from viatool.setting.wishes import Wishes
from viatool.uncertainty import ErrorModel, as_error_model
from viatool.world import Footprint, Scenario, WorldMap, as_map

StrPath = str | os.PathLike[str]
Commander = Callable[[Floats], ArrayLike]
"""Gives a command (A,) for an observation (n,)."""
Source = Literal["policy", "fallback", "brake"]
_SOURCES: dict[int, Source] = {POLICY: "policy", FALLBACK: "fallback", BRAKE: "brake"}
_SCENE: Indices = np.zeros(1, np.int64)


@dataclass(frozen=True, eq=False)
class Decision:
    """What the robot is told for the next control interval.

    Parameters
    ----------
    command : ndarray
        (A,) the velocities to be held, in the order of the robot's axes: for a differential drive v in m/s and omega in
        rad/s.
    source : str
        ``policy`` where its command passes, else ``fallback`` or ``brake``.
    proved : bool
        Whether it is proved that the robot keeps its clearance from now on until it stands. False before anything is
        proved: as long as the robot stands where localisation does not tell that it is clear.
    asked : ndarray
        (A,) what the policy commanded.
    """

    command: Floats
    source: Source
    proved: bool
    asked: Floats

    @property
    def passed(self) -> bool:
        """Tell whether the robot does what the policy commands."""
        return self.source == "policy"


class Monitor:
    """A monitor between a policy and its robot, which lets nothing pass after which the robot may not be able to stop.

    A command passes if it is proved that, held for one control interval and braked for after it, it keeps the footprint
    farther than d_col from every obstacle, at every instant and from every pose within the error of localisation. Else
    the fallback's command passes on the same terms, or the robot brakes, on the path that was proved before.

    Parameters
    ----------
    policy : Policy, path or None
        An ONNX policy; what it observes and computes is of no consequence for the guarantee. None if commands come from
        elsewhere (`decide`).
    world_map : WorldMap or path
        The map, its robot and clearances.
    scenario : Scenario, optional
        What the episode adds to the map.
    errors : ErrorModel or path, optional
        The error of the pose; other terms are accepted where they change nothing, and refused by name where they would.
    fallback : Policy, path or callable, optional
        What takes over where the policy's command does not pass: another policy of the same observation, or a function
        that gives a command (A,) for an observation (n,). Where it fails the robot brakes, with a RuntimeWarning.
    spec, clearance, interval, footprint, delay, robot, prefer
        As for `viatool.verify`.
    deceleration : float, optional
        m/s^2 of the brakes, instead of the robot's.

    Raises
    ------
    PolicyError, MapError, ConfigurationError
        As `viatool.verify`; and if the robot cannot stand, or is not commanded with velocities.

    Notes
    -----
    Sound: yes, under the premises of docs/monitor.md: the robot is told what is decided in every interval, moves
    and brakes as its kinematics says, and when a command passes is within the error of where it is said to be.
    """

    def __init__(
        self,
        policy: Policy | StrPath | None,
        world_map: WorldMap | StrPath,
        *,
        scenario: Scenario | None = None,
        errors: ErrorModel | StrPath | None = None,
        fallback: Policy | StrPath | Commander | None = None,
        spec: PolicySpecification | StrPath | None = None,
        clearance: float | None = None,
        interval: float | None = None,
        footprint: Footprint | str | float | Sequence[Sequence[float]] | None = None,
        delay: float = 0.0,
        deceleration: float | None = None,
        robot: str | None = None,
        prefer: Mapping[str, str] | None = None,
    ) -> None:
        wishes = Wishes(
            "braking",
            clearance,
            None,
            interval,
            footprint,
            delay,
            deceleration,
            robot=robot,
            prefer=prefer or {},
            errors=as_error_model(errors),
        )
        world_map = as_map(world_map)
        if policy is None:
            self._setting = setting_of_commands(world_map, wishes)
            self._policy: Commander | None = None
        else:
            loaded = as_policy(policy, spec)
            self._setting = Setting.of(loaded, world_map, 0.0, wishes, (), job="monitor")
            self._policy = commander_of(loaded, self._setting)
        self._fallback = self._commander(fallback, world_map, wishes)
        self.reset(scenario)

    def _commander(
        self, given: Policy | StrPath | Commander | None, world_map: WorldMap, wishes: Wishes
    ) -> Commander | None:
        if given is None or (callable(given) and not isinstance(given, Policy)):
            return given
        policy = as_policy(given)
        return commander_of(policy, Setting.of(policy, world_map, 0.0, wishes, (), job="monitor"))

    def reset(self, scenario: Scenario | None = None) -> None:
        """Begin anew: the robot stands, nothing is on its way to its motors, and this is what is around it."""
        self._guard = Guard(self._setting, (scenario,))
        self._watch = Watch(self._guard, 1)

    @property
    def setting(self) -> Setting:
        """Return what is asked, as it took effect."""
        return self._setting

    @property
    def premises(self) -> tuple[Premise, ...]:
        """Return everything that took effect, and who said so."""
        return self._setting.driving_premises

    def __call__(self, pose: ArrayLike, observation: ArrayLike) -> Decision:
        """Run the policy on an observation, and decide about its command.

        Parameters
        ----------
        pose : array_like
            (3,) where localisation says that the robot is: x, y, theta in the map frame.
        observation : array_like
            (n,) what the policy receives, its memory behind it if it has one.

        Returns
        -------
        Decision
            Call it once in every control interval, and tell the robot what it says.
        """
        if self._policy is None:
            raise ConfigurationError(
                "the monitor was made without a policy", "give its commands to `decide`, or make it with one"
            )
        observation = np.asarray(observation, dtype=np.float64)
        return self.decide(pose, self._policy(observation), observation)

    def decide(self, pose: ArrayLike, command: ArrayLike, observation: ArrayLike | None = None) -> Decision:
        """Decide about a command, whoever gave it.

        Parameters
        ----------
        pose : array_like
            (3,) as for `__call__`. Where it is not finite nothing passes.
        command : array_like
            (A,) velocities in the order of the robot's axes.
        observation : array_like, optional
            (n,) for the fallback, which does not take over without one.
        """
        poses, asked = row("a pose", pose, 3), row("a command", command, len(self._setting.rules.lower))
        fallback, alternative = self._fallback, None
        if fallback is not None and observation is not None:
            seen = np.asarray(observation, dtype=np.float64)

            def alternative(_: Indices) -> Floats:
                return _answer_of(fallback, seen, asked.shape[1])

        found = self._watch.decide(poses, _SCENE, asked, alternative)
        return Decision(found.commands[0], _SOURCES[int(found.source[0])], bool(found.proved[0]), asked[0])


def commander_of(policy: Policy, setting: Setting) -> Commander:
    """Return what gives the robot's command for an observation: the deployed program, and what its software adds."""

    def command(observation: Floats) -> Floats:
        rows = np.asarray(observation, dtype=np.float64)[None]
        return np.asarray(setting.sent(rows, policy.run(rows))[0])

    return command


def setting_of_commands(world_map: WorldMap, wishes: Wishes) -> Setting:
    """Return what is asked where commands come from nobody knows where: the map and its robot say all."""
    if wishes.robot is not None:
        world_map = with_robot(world_map, wishes.robot)
    kinematics = motion_of(world_map.robot)
    ends = zip(kinematics.axes, *(end.tolist() for end in kinematics.limits(world_map.robot)), strict=True)
    known = {
        axis.kind: ActionChannel(name=axis.name, unit=axis.unit, lower=low, upper=high, kind=axis.kind)
        for axis, low, high in ends
    }
    taken = kinematics.takes[0]
    if "steering" in taken:
        angle = world_map.robot.max_steering
        known["steering"] = ActionChannel(
            name="steering", unit="rad", lower=-angle, upper=angle, kind="steering"
        )
    actions = [known[kind] for kind in taken]
    nothing = ObservationChannel(name="nothing", kind="constant", value=0.0)
    spec = PolicySpecification(observation=[nothing], action=actions)
    return Setting.of_specification(
        spec, world_map, 0.0, wishes, (), name="a source of commands", job="monitor"
    )


def _answer_of(fallback: Commander, observation: Floats, size: int) -> Floats:
    """Return a fallback's command, (1, size); NaN, so that the robot brakes, where it fails."""
    try:
        return row("the fallback's command", fallback(observation), size)
    except Exception as problem:  # whatever it raises, the robot has to be told something now
        warnings.warn(f"the fallback failed, the robot brakes: {problem!r}", RuntimeWarning, stacklevel=2)
        return np.full((1, size), np.nan)
