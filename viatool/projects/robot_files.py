"""What files of a robot say of it: a LaserScan message or a bag, nav2's parameters, a gymnasium environment."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeGuard

from viatool.errors import ConfigurationError
from viatool.proposals import Scanner
from viatool.trajectory.bag import is_bag, open_parts

Limits = tuple[tuple[float, float], ...]


def load_scanner(path: Path, topic: str | None = None) -> Scanner:
    """Read the geometry of a scan.

    Parameters
    ----------
    path : Path
        A message as ``ros2 topic echo --once`` prints it, as JSON, or a bag.
    topic : str, optional
        Of the scan in a bag.

    Raises
    ------
    ConfigurationError, TrajectoryError
        If it cannot be read, or is no scan; names the field.
    """
    return (
        _first_of_bag(path, topic)
        if is_bag(path)
        else _of_message(path, _mapping(path, "a LaserScan message"))
    )


def _first_of_bag(path: Path, topic: str | None) -> Scanner:
    from viatool.trajectory import Topics

    with open_parts(path, Topics(topic, None, None)) as parts:
        scans = None if parts.scans is None else next(parts.scans, None)
        if scans is None:
            raise ConfigurationError(
                f"the bag '{path}' has no scan", "record the LaserScan, or name --scan-topic"
            )
        first, step, least, most = scans.geometry[0].tolist()
        ranges = scans.ranges[0].tolist()
        return Scanner(first, step, len(ranges), least, most, scans.frame, tuple(ranges))


def _of_message(path: Path, message: Mapping[str, Any]) -> Scanner:
    names = ("angle_min", "angle_max", "angle_increment", "range_min", "range_max")
    numbers = [message.get(name) for name in names]
    for name, number in zip(names, numbers, strict=True):
        if isinstance(number, bool) or not isinstance(number, int | float) or not math.isfinite(number):
            raise ConfigurationError(
                f"'{path}' is no LaserScan message: {name} is {number!r}, expected a finite number",
                "save one with ros2 topic echo --once --full-length /scan > scan.yaml",
            )
    first, last, step, least, most = map(float, numbers)  # type: ignore[arg-type]  # checked above
    if step == 0.0 or (last - first) / step < 0.0 or not 0.0 <= least < most:
        raise ConfigurationError(
            f"'{path}' is no LaserScan message: from {first:g} to {last:g} rad in steps of {step:g} rad, "
            f"{least:g} to {most:g} m",
            "check the LiDAR's driver",
        )
    ranges = message.get("ranges") or []
    whole = all(isinstance(number, int | float) for number in ranges)  # echo cuts long lists with '...'
    count = len(ranges) if ranges and whole else round((last - first) / step) + 1
    header = message.get("header")
    frame = str(header.get("frame_id", "")) if isinstance(header, Mapping) else ""
    return Scanner(first, step, count, least, most, frame, tuple(map(float, ranges)) if whole else ())


@dataclass(frozen=True)
class RobotFacts:
    """What is known of a robot; what is not is None.

    Parameters
    ----------
    footprint : mapping, optional
        As a map has it.
    limits : mapping
        Of the robot, by the names that a map has for them.
    interval : float, optional
        Between two commands, in seconds.
    commands : tuple of (float, float), optional
        The least and the largest of each command.
    words : tuple of str
        What was taken, and from where.
    """

    footprint: Mapping[str, Any] | None = None
    limits: Mapping[str, float] = field(default_factory=dict)
    interval: float | None = None
    commands: Limits | None = None
    words: tuple[str, ...] = ()

    def with_more(self, other: RobotFacts) -> RobotFacts:
        """Return this with what another knows; where both know, the other counts."""
        return RobotFacts(
            other.footprint or self.footprint,
            {**self.limits, **other.limits},
            other.interval or self.interval,
            other.commands or self.commands,
            (*self.words, *other.words),
        )


def load_nav2(path: Path) -> RobotFacts:
    """Read footprint, limits and rate of a robot from ``nav2_params.yaml``.

    Raises
    ------
    ConfigurationError
        If it cannot be read, or says nothing of the robot.
    """
    leaves = list(_leaves(_mapping(path, "parameters of nav2")))
    footprint = _footprint(path, leaves)
    limits = _limits(leaves)
    rate = _number(leaves, "controller_frequency")
    interval = None if rate is None or rate <= 0.0 else round(1.0 / rate, 9)
    if footprint is None and not limits and interval is None:
        raise ConfigurationError(
            f"'{path}' says nothing of a robot: there is neither footprint, robot_radius, max_velocity, max_vel_x nor "
            "controller_frequency",
            "give the file that nav2 is started with",
        )
    words = [
        *([f"footprint from {path.name}"] if footprint else []),
        *(f"{name} {value:g} from {path.name}" for name, value in limits.items()),
        *([f"control interval {interval:g} s, the controller_frequency of {path.name}"] if interval else []),
    ]
    return RobotFacts(footprint, limits, interval, words=tuple(words))


def _footprint(path: Path, leaves: list[tuple[str, Any]]) -> dict[str, Any] | None:
    import yaml

    outlines = [value for name, value in leaves if name == "footprint" and value not in ("", "[]", [])]
    if outlines:
        text: Any = outlines[0]
        try:
            corners = yaml.safe_load(text) if isinstance(text, str) else text
            points = [[float(x), float(y)] for x, y in corners]
        except (yaml.YAMLError, TypeError, ValueError):
            points = []
        if len(points) < 3:
            raise ConfigurationError(
                f"'{path}': footprint is {outlines[0]!r}, expected corners [[x, y], ...] in metres",
                "correct it",
            )
        return {"shape": "polygon", "points": points}
    radius = _number(leaves, "robot_radius")
    return None if radius is None else {"shape": "circle", "radius": radius}


def _limits(leaves: list[tuple[str, Any]]) -> dict[str, float]:
    """Return what the smoother of velocities lets pass, or else what the controller gives."""
    found: dict[str, float] = {}
    named = dict(reversed(leaves))
    most, least = named.get("max_velocity"), named.get("min_velocity")
    if _are_numbers(most) and _are_numbers(least):
        found = {"min_linear": least[0], "max_linear": most[0], "max_angular": max(most[-1], -least[-1])}
    else:
        for name, key in (
            ("min_linear", "min_vel_x"),
            ("max_linear", "max_vel_x"),
            ("max_angular", "max_vel_theta"),
        ):
            if (number := _number(leaves, key)) is not None:
                found[name] = number
    slowest = named.get("max_decel")
    if _are_numbers(slowest) and slowest[0] < 0.0:
        found["deceleration"] = -slowest[0]
    return {name: float(value) for name, value in found.items()}


def _are_numbers(value: Any) -> TypeGuard[list[float]]:
    return isinstance(value, list) and len(value) >= 2 and all(isinstance(one, int | float) for one in value)


def _number(leaves: list[tuple[str, Any]], wanted: str) -> float | None:
    numbers = (value for name, value in leaves if name == wanted)
    return next((float(n) for n in numbers if isinstance(n, int | float) and not isinstance(n, bool)), None)


def _leaves(content: Mapping[Any, Any]) -> Iterator[tuple[str, Any]]:
    for name, value in content.items():
        if isinstance(value, Mapping):
            yield from _leaves(value)
        else:
            yield str(name), value


def load_environment(name: str) -> RobotFacts:
    """Read the limits of commands and the control interval of a gymnasium environment, which is made for that.

    Parameters
    ----------
    name : str
        As `gymnasium.make` takes it, such as ``my_package:MyRobot-v0``.

    Raises
    ------
    ConfigurationError
        If it cannot be made.
    """
    import gymnasium

    if "" not in sys.path:
        sys.path.append("")  # a module beside the user's files is found, as python -m finds it
    try:
        environment = gymnasium.make(name)
    except Exception as error:  # whatever the user's own code raises
        raise ConfigurationError(
            f"the environment '{name}' cannot be made: {error}",
            "name it as gymnasium.make takes it, MODULE:ID",
        ) from error
    space, inner = environment.action_space, environment.unwrapped
    commands, words = None, []
    if isinstance(space, gymnasium.spaces.Box) and space.is_bounded():
        commands = tuple(zip(space.low.ravel().tolist(), space.high.ravel().tolist(), strict=True))
        words.append(f"limits of commands from the action space of {name}")
    interval = next(
        (
            float(found)
            for found in (getattr(inner, a, None) for a in ("control_interval", "dt"))
            if _is_time(found)
        ),
        None,
    )
    rate = environment.metadata.get("render_fps")
    if interval is None and _is_time(rate):
        interval = 1.0 / rate
    words += [f"control interval {interval:g} s from {name}"] if interval else []
    environment.close()
    return RobotFacts(interval=interval, commands=commands, words=tuple(words))


def _is_time(value: Any) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool) and 0.0 < value < math.inf


def _mapping(path: Path, what: str) -> dict[str, Any]:
    """Read the first document of a YAML or JSON file."""
    import yaml

    try:
        text = path.read_text(encoding="utf-8")
        content = json.loads(text) if path.suffix == ".json" else next(iter(yaml.safe_load_all(text)), None)
    except (OSError, UnicodeDecodeError, ValueError, yaml.YAMLError, RecursionError) as error:
        reason = error.strerror if isinstance(error, OSError) else str(error).splitlines()[0]
        raise ConfigurationError(f"cannot read '{path}': {reason}", f"give {what} as YAML or JSON") from error
    if not isinstance(content, dict):
        raise ConfigurationError(f"'{path}' holds no {what.partition(' ')[2] or what}", f"give {what}")
    return content
