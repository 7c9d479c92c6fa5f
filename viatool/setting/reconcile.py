"""Where policy and map speak of the same thing: they agree, the user decides, or nothing is proved.

Both say how often the policy acts, which commands the robot carries out, and what its LiDAR is. A verdict that rests
on one of them while the robot is the other's is true of a robot that nobody has. So every pair is looked at here, once,
for every job: what contradicts is refused with both values and both files, unless the user said which counts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from viatool.channels import LidarSpecification
from viatool.errors import ConfigurationError
from viatool.motion.kinematics import KINEMATICS, motion_of
from viatool.policy import ActionChannel, PolicySpecification
from viatool.setting.premises import Premise
from viatool.setting.rules import as_footprint
from viatool.setting.wishes import Matter, Wishes
from viatool.world import ROBOTS, Lidar, Robot, WorldMap

_SAME = 1e-9  # relative: two numbers that were written alike
_BEYOND = 1e-6
"""Radians by which rays may lie outside of a field of view that was written with fewer digits."""
_SENSOR = ("field_of_view", "rays", "minimum_range", "maximum_range")


@dataclass(frozen=True)
class Parties:
    """Who speaks: a policy and a map, with the files that a message names.

    Parameters
    ----------
    spec : PolicySpecification
        Of the policy.
    policy : str
        What messages call it: its file, if it has one.
    world_map : WorldMap
        The map.
    wishes : Wishes
        What the user decides.
    """

    spec: PolicySpecification
    policy: str
    world_map: WorldMap
    wishes: Wishes

    @property
    def map_speaks(self) -> bool:
        """Tell whether the map says anything about the robot."""
        return "robot" in self.world_map.stated

    def contradiction(
        self, matter: Matter, policy_says: str, map_says: str, option: str = ""
    ) -> ConfigurationError:
        """Return the refusal of what both parties say differently."""
        files = f"{self.policy} and map '{self.world_map.path}'"
        return ConfigurationError(
            f"{files} contradict each other: {policy_says}, {map_says}",
            f"say which counts with {option}--prefer {matter}=policy or --prefer {matter}=map, or correct one file",
        )


def reconcile(parties: Parties) -> tuple[PolicySpecification, Robot, tuple[Premise, ...]]:
    """Return what counts: the specification, the robot, and where each of its values came from.

    Raises
    ------
    ConfigurationError
        If policy and map contradict each other and the user did not say which counts, or a wish is out of its range.
    """
    robot, source = _base(parties)
    robot, interval = _interval(parties, robot)
    robot, limits = _limits(parties, robot, source)
    spec, lidars = _lidar(parties, robot)
    robot, body = _body(parties, robot, source)
    return spec, robot, (Premise("robot", robot.name, source), interval, *limits, *lidars, *body)


def _base(parties: Parties) -> tuple[Robot, str]:
    """Return the robot that the rest is said of, and who named it."""
    world_map, spec, wished = parties.world_map, parties.spec, parties.wishes.robot
    if wished is not None:
        return with_robot(world_map, wished).robot, "--robot"
    if parties.map_speaks:
        told = f"map '{world_map.path}'"
        return (
            world_map.robot,
            told if spec.robot == world_map.robot.name else f"{told}; the policy names {spec.robot}",
        )
    if spec.robot in ROBOTS:
        return _moved(spec, ROBOTS[spec.robot]), f"{parties.policy} (the map names no robot)"
    unknown = _moved(spec, replace(world_map.robot, name=spec.robot, track=0.0))  # nobody said how wide it is
    return unknown, "default (policy and map name no robot that is known)"


def _moved(spec: PolicySpecification, robot: Robot) -> Robot:
    """Return a robot of which no map says how it moves: as a policy commands it."""
    kinds = spec.command_kinds
    fit = [name for name, one in KINEMATICS.items() if kinds in map(frozenset, one.takes)]
    if robot.kinematics in fit or not fit:
        return robot
    moved = replace(robot, kinematics=fit[0])
    if robot.name in ROBOTS:
        return moved
    unlimited: dict[str, dict[str, Any]] = {
        "v": {"min_linear": -np.inf, "max_linear": np.inf},
        "omega": {"max_angular": np.inf},
    }
    for axis in KINEMATICS[fit[0]].state:  # nobody said how fast it may get
        moved = replace(moved, **unlimited[axis.name])
    return moved


def with_robot(world_map: WorldMap, name: str) -> WorldMap:
    """Return a map with a robot that is known by name: its limits and body.

    It keeps the footprint that a map states, from which its clearances are measured, since one means nothing without
    the other; and the map's LiDAR and control interval, which belong to the policy.

    Raises
    ------
    ConfigurationError
        If there is no such robot.
    """
    if name not in ROBOTS:
        raise ConfigurationError(f"unknown robot '{name}'", f"choose one of {', '.join(ROBOTS)}")
    mine = world_map.robot
    robot = replace(ROBOTS[name], lidar=mine.lidar, control_interval=mine.control_interval)
    if "footprint" in world_map.stated:
        robot = replace(robot, footprint=mine.footprint)
    return world_map.with_robot(robot)


def _interval(parties: Parties, robot: Robot) -> tuple[Robot, Premise]:
    """Return the robot with the control interval that counts."""
    spec, wishes = parties.spec, parties.wishes
    asked, has = spec.control_interval, robot.control_interval
    if wishes.interval is not None:
        counts, source = wishes.interval, "--interval"
    elif not parties.map_speaks:
        counts, source = asked, parties.policy
    elif _same(asked, has):
        counts, source = asked, f"{parties.policy} and map '{parties.world_map.path}'"
    else:
        party = wishes.preferred("interval")
        if party is None:
            raise parties.contradiction(
                "interval",
                f"the policy acts every {asked:g} s",
                f"the robot of the map every {has:g} s",
                f"--interval {asked:g}, ",
            )
        counts, source = (asked if party == "policy" else has), f"--prefer ({party})"
    if not 0.0 < counts < float("inf"):
        raise ConfigurationError(f"the control interval is {counts} s", "give a positive time in seconds")
    return replace(robot, control_interval=counts), Premise("control interval", f"{counts:g} s", source)


def _limits(parties: Parties, robot: Robot, source: str) -> tuple[Robot, tuple[Premise, ...]]:
    """Return the robot with the limits of its commands that count."""
    asked: dict[str, ActionChannel] = {channel.kind: channel for channel in parties.spec.axes}
    kinematics = motion_of(robot)
    if parties.spec.command_kinds not in map(frozenset, kinematics.takes):
        return robot, ()  # refused where the command is put together
    own = _with_limits(robot, _with_rules(parties.spec))
    robot = _accelerating(robot, own)
    if not parties.map_speaks and parties.wishes.robot is None:
        _check_symmetric(parties, asked)
        robot, source = own, f"{parties.policy}"
    elif not _within(own, robot):
        party = parties.wishes.preferred("limits") or ("map" if parties.wishes.robot else None)
        if party is None:
            raise parties.contradiction(
                "limits",
                f"the policy{' or a rule around it' if parties.spec.overrides else ''} commands {_range_of(own)}",
                f"its robot '{robot.name}' carries out {_range_of(robot)}",
                "--robot NAME, ",
            )
        if party == "policy":
            _check_symmetric(parties, asked)
            robot, source = own, f"{parties.policy}, by --prefer"
        else:
            source = f"{source}; commands beyond are clipped, the policy asks for {_range_of(own)}"
    state = motion_of(robot).state_words
    speeds = (Premise("state of the motion", state, f"robot '{robot.name}'"),) if state else ()
    return robot, (Premise("commands", _range_of(robot), source), *speeds)


def _with_rules(spec: PolicySpecification) -> dict[str, ActionChannel]:
    """Return what is commanded by kind, with limits that hold the commands of all rules around the policy as well."""
    asked: dict[str, ActionChannel] = {}
    for number, channel in enumerate(spec.axes):
        sent = [rule.command[number] for rule in spec.overrides]
        ends = {"lower": min(channel.lower, *sent), "upper": max(channel.upper, *sent)} if sent else {}
        asked[channel.kind] = channel.model_copy(update=ends)
    return asked


def _accelerating(robot: Robot, own: Robot) -> Robot:
    """Return a robot of which nobody said how it accelerates: as the policy commands it."""
    if robot.min_acceleration == robot.max_acceleration:
        least, most = own.min_acceleration, own.max_acceleration
        robot = replace(robot, min_acceleration=least, max_acceleration=most)
    if not robot.max_angular_acceleration:
        robot = replace(robot, max_angular_acceleration=own.max_angular_acceleration)
    return robot


def _with_limits(robot: Robot, asked: Mapping[str, ActionChannel]) -> Robot:
    """Return the robot that does what a policy may ask, and no more."""
    limits: dict[str, Any] = {}
    if "left_wheel" in asked:
        left, right = asked["left_wheel"], asked["right_wheel"]
        apart = max(right.upper - left.lower, left.upper - right.lower)
        limits = {
            "min_linear": 0.5 * (left.lower + right.lower),
            "max_linear": 0.5 * (left.upper + right.upper),
            "max_angular": apart / robot.known("track"),
        }
    if "linear" in asked:
        limits |= {"min_linear": asked["linear"].lower, "max_linear": asked["linear"].upper}
    if "linear_acceleration" in asked:
        channel = asked["linear_acceleration"]
        ends = min(channel.lower, 0.0), max(channel.upper, 0.0)
        limits |= {"min_acceleration": ends[0], "max_acceleration": ends[1]}
    limits |= {
        name: max(abs(asked[kind].lower), abs(asked[kind].upper))
        for kind, name in _SYMMETRIC.items()
        if kind in asked
    }
    return replace(robot, **limits)


_SYMMETRIC = {
    "angular": "max_angular",
    "lateral": "max_lateral",
    "steering": "max_steering",
    "angular_acceleration": "max_angular_acceleration",
}
"""Kinds of commands of which a robot does as much to one side as to the other, and its limit of each."""
_WORDS = {
    "angular": ("turns", "rad/s"),
    "lateral": ("steps aside", "m/s"),
    "angular_acceleration": ("the acceleration of turns", "rad/s^2"),
}


def _check_symmetric(parties: Parties, asked: Mapping[str, ActionChannel]) -> None:
    """Refuse limits that no robot of ours has: one that turns faster to one side than to the other."""
    for kind in _WORDS.keys() & asked.keys():
        channel = asked[kind]
        if not _same(-channel.lower, channel.upper):
            what, unit = _WORDS[kind]
            raise ConfigurationError(
                f"{parties.policy} limits '{channel.name}' to {channel.lower:g} to {channel.upper:g} {unit}, "
                f"but a robot limits {what} equally to both sides",
                "name the robot in the map, or choose one with --robot NAME",
            )


def _lidar(parties: Parties, robot: Robot) -> tuple[PolicySpecification, tuple[Premise, ...]]:
    """Return the specification with the LiDARs that count."""
    channels, premises, has = [], [], robot.lidar
    said = [name for name in _SENSOR if f"lidar.{name}" in parties.world_map.stated]
    for channel in parties.spec.observation:
        if channel.lidar is None or channel.value is not None:
            channels.append(channel)
            if channel.kind == "lidar" and channel.value is None:
                of = f"robot '{robot.name}', as the policy does not describe it"
                premises.append(Premise(f"LiDAR '{channel.name}'", _words(has, _SENSOR), of))
            continue
        asked = channel.lidar
        other = _otherwise(asked, has, said)
        source = f"{parties.policy}"
        if other:
            party = parties.wishes.preferred("lidar")
            if party is None:
                raise parties.contradiction(
                    "lidar",
                    f"channel '{channel.name}' has {_words(asked, other)}",
                    f"the LiDAR of the map's robot {_words(has, other)}",
                )
            source = f"--prefer ({party})"
            if party == "map":
                asked = _as_the_robot(asked, has, other)
                channel = channel.model_copy(update={"lidar": asked})
        channels.append(channel)
        premises.append(Premise(f"LiDAR '{channel.name}'", _words(asked, _SENSOR), source))
    return parties.spec.model_copy(update={"observation": channels}), tuple(premises)


def _otherwise(asked: LidarSpecification, has: Lidar, said: Sequence[str]) -> list[str]:
    """Return in what the sensor that a policy reads is not the one of which a map says some things.

    Rays that are given one by one are some of the sensor's: they have to lie within its field of view.
    """
    apart = []
    for name in said:
        wanted, given = getattr(asked, name), getattr(has, name)
        if asked.field_of_view is None and name in ("field_of_view", "rays"):
            beyond = np.abs(asked.lidar().around[0]).max() - 0.5 * given if name == "field_of_view" else 0.0
            differs = beyond > _BEYOND
        else:
            differs = not _same(wanted, given)
        if differs:
            apart.append(name)
    return apart


def _as_the_robot(asked: LidarSpecification, has: Lidar, other: Sequence[str]) -> LidarSpecification:
    """Return what a policy reads of the robot's sensor instead of its own; rays given one by one stay as they are."""
    kept = ("field_of_view", "rays") if asked.field_of_view is None else ()
    changed = {name: getattr(has, name) for name in other if name not in kept}
    return type(asked).model_validate({**asked.model_dump(), **changed})


def _body(parties: Parties, robot: Robot, source: str) -> tuple[Robot, tuple[Premise, ...]]:
    """Return the robot with the footprint and the braking that count."""
    wishes = parties.wishes
    stated = "footprint" in parties.world_map.stated
    outline, braking = f"map '{parties.world_map.path}'" if stated else source, source
    if wishes.footprint is not None:
        robot, outline = replace(robot, footprint=as_footprint(wishes.footprint)), "--footprint"
    if wishes.deceleration is not None:
        robot, braking = replace(robot, deceleration=wishes.deceleration), "--deceleration"
    return robot, (
        Premise("footprint", robot.footprint.words, outline),
        Premise("deceleration", f"{robot.deceleration:g} m/s^2", braking),
    )


def _same(first: float, second: float) -> bool:
    return abs(first - second) <= _SAME * max(abs(first), abs(second))


def _within(asked: Robot, has: Robot) -> bool:
    """Tell whether a robot carries out every command of another one."""
    slack = _SAME * (1.0 + abs(has.max_linear) + has.max_angular)
    lower = ("min_linear", "min_acceleration")
    upper = ("max_linear", "max_acceleration", *_SYMMETRIC.values())
    return all(getattr(asked, name) >= getattr(has, name) - slack for name in lower) and all(
        getattr(asked, name) <= getattr(has, name) + slack for name in upper
    )


def _range_of(robot: Robot) -> str:
    kinematics = motion_of(robot)
    return kinematics.range_words(*kinematics.limits(robot))


def _words(lidar: LidarSpecification | Lidar, names: Sequence[str]) -> str:
    """Return some of what makes a sensor; its rays where it has no field of view."""
    sensor = lidar if isinstance(lidar, Lidar) else lidar.lidar()
    if sensor.field_of_view is None:
        told = [sensor.words] if {"field_of_view", "rays"} & set(names) else []
        names = [name for name in names if name not in ("field_of_view", "rays")]
    else:
        told = []
    return ", ".join([*told, *(f"{name} {getattr(sensor, name):g}" for name in names)])
