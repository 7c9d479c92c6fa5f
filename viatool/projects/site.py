"""The map of a new project: what was given, with the robot that drives there."""

from __future__ import annotations

import os
import tempfile
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from viatool.errors import ConfigurationError, MapWarning
from viatool.policy import PolicySpecification
from viatool.projects.robot_files import RobotFacts
from viatool.samples import MAPS
from viatool.world import Scenario, Scenes, load_map

SITE = "site.yaml"
EPS = "0.01"
_IMAGES = (".png", ".pgm", ".ppm", ".pbm", ".bmp", ".jpg", ".jpeg", ".tif", ".tiff", ".gif")
_THRESHOLDS = {"negate": 0, "occupied_thresh": 0.65, "free_thresh": 0.196}
"""As map_saver writes them; what is grey 205 stays unknown."""


@dataclass(frozen=True)
class Preferences:
    """What the files do not say.

    Parameters
    ----------
    kinds, commands : sequence of str
        Of observations and commands, in their order; empty for what is proposed.
    interval : float, optional
        Between two commands, in seconds.
    eps : sequence of str
        Sensor errors, as ``--eps`` takes them; by default `EPS`, which is said to be guessed.
    clearance : float, optional
        Collision distance in metres; by default 0.05 from a footprint, else that of the map.
    resolution : float, optional
        Metres of a pixel of a map that is an image.
    origin : tuple
        Pose of its lower left corner.
    yaw : float
        Heading of the LiDAR on the robot, in radians.
    course : tuple, optional
        A start (x, y, theta) and a goal (x, y); by default ten random ones.
    """

    kinds: Sequence[str] = ()
    commands: Sequence[str] = ()
    interval: float | None = None
    eps: Sequence[str] = ()
    clearance: float | None = None
    resolution: float | None = None
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    yaw: float = 0.0
    course: tuple[tuple[float, float, float], tuple[float, float]] | None = None


@dataclass(frozen=True)
class Site:
    """The map of a project.

    Parameters
    ----------
    name : str
        As the project calls it.
    files : mapping
        What is written for it; nothing if it stays as it is.
    limits : bool
        Whether it was written with the limits of a robot.
    guesses : tuple of str
        What has to be checked.
    """

    name: str
    files: Mapping[str, bytes] = field(default_factory=dict)
    limits: bool = False
    guesses: tuple[str, ...] = ()


def states_its_robot(path: Path) -> bool:
    """Tell whether a map says itself what drives there, or where: it stays as it is.

    Raises
    ------
    MapError
        If it cannot be read.
    """
    if str(path) in MAPS.names() and not path.exists():
        return True
    if path.suffix.lower() in _IMAGES:
        return False
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MapWarning)
        world_map = load_map(path)
    return bool(world_map.stated or world_map.scenarios) or world_map.obstacles.grid is None


def site_of(
    path: Path,
    folder: Path,
    robot: RobotFacts,
    answers: Preferences,
    spec: PolicySpecification | None,
) -> Site:
    """Return the map of a project; one that tells of scenarios, a robot or shapes stays as it is.

    Raises
    ------
    ConfigurationError, MapError
        If it cannot be read, or is an image of unknown size.
    """
    if states_its_robot(path):
        return Site(seen_from(folder, path))
    files: dict[str, bytes] = {}
    image = path.suffix.lower() in _IMAGES
    occupancy = _map_server(path, folder, answers, files) if image else seen_from(folder, path)
    outline = robot.footprint is not None
    body: dict[str, Any] = {**robot.limits, **({"footprint": dict(robot.footprint or {})} if outline else {})}
    if body:
        body = {**_commanded(spec), **body}
        interval = spec.control_interval if spec is not None else answers.interval or robot.interval or 0.1
        body["control_interval"] = interval
    clearance = answers.clearance if answers.clearance is not None else 0.05 if outline else 0.4
    danger = round(clearance + 0.1, 9)
    content: dict[str, Any] = {
        "schema_version": 1,
        "name": path.stem,
        "occupancy": occupancy,
        **({"robot": body} if body else {}),
        "clearance": {"collision": clearance, "danger": danger},
    }
    if answers.course is None:
        content["generator"] = {"goal_clearance": danger, "goal_distance": [1.0, 100.0]}
    else:
        start, goal = answers.course
        content["scenarios"] = [{"name": "first", "start": list(start), "goal": list(goal)}]
    name = _name(path, folder)
    files[name] = _yaml(content, "The map with the robot that drives there; see docs/own-map.md.")
    known = f"its footprint: --footprint, --nav2, or 'robot' in {name}"
    guess = f"the robot is a point that keeps {clearance:g} m ({known})"
    if outline:
        guess = (
            f"the footprint keeps {clearance:g} m, and is in danger below {danger:g} m "
            f"(--clearance, or 'clearance' in {name})"
        )
    return Site(name, files, bool(body), () if answers.clearance is not None else (guess,))


def _commanded(spec: PolicySpecification | None) -> dict[str, float]:
    """Return the limits of a robot that does what a policy and the rules around it command, as a map has them."""
    limits: dict[str, float] = {}
    if spec is None:
        return limits
    for number, channel in enumerate(spec.axes):
        sent = [channel.lower, channel.upper, *(rule.command[number] for rule in spec.overrides)]
        if channel.kind == "linear":
            limits |= {"min_linear": min(sent), "max_linear": max(sent)}
        elif channel.kind == "angular":
            limits["max_angular"] = max(map(abs, sent))
    return limits


def check_course(
    path: Path, robot: RobotFacts, answers: Preferences, spec: PolicySpecification | None
) -> None:
    """Refuse a course that begins in collision, or whose goal lies in an obstacle, as the new map would be refused.

    Raises
    ------
    ConfigurationError, MapError
        If it does; or as `site_of`.
    """
    if answers.course is None:
        return
    start, goal = answers.course
    with tempfile.TemporaryDirectory(prefix="viatool-") as scratch, warnings.catch_warnings():
        warnings.simplefilter("ignore", MapWarning)
        folder = Path(scratch).resolve()
        site = site_of(path, folder, robot, replace(answers, course=None), spec)
        if not site.files:
            return
        for name, content in site.files.items():
            (folder / name).write_bytes(content)
        world = load_map(folder / site.name)
        scenes = Scenes.of(world, (Scenario("first", start, goal),))
        alone = np.zeros(1, dtype=np.int64)
        room = float(scenes.footprint_clearance(np.array([start]), world.robot.footprint, alone)[0])
        blocked = bool(scenes.blocked(np.array([goal]), alone)[0])
    least = world.clearance.collision
    if not (room >= least and room > 0.0):
        raise ConfigurationError(
            f"--start {_words(start)}: the robot is {room:.3f} m from the nearest obstacle, "
            f"expected at least {least:g} m",
            "move the start into free space, or check --origin, --resolution and --clearance",
        )
    if blocked:
        raise ConfigurationError(
            f"--goal {_words(goal)} lies in an obstacle or outside the map",
            "move the goal into free space, or check --origin and --resolution",
        )


def _words(numbers: Sequence[float]) -> str:
    return ",".join(f"{number:g}" for number in numbers)


def _name(given: Path, folder: Path) -> str:
    """Return what the new map is called: not as the one that it is made of, in whose place it would be written."""
    taken = given.resolve() == (folder / SITE).resolve()
    return f"robot-{SITE}" if taken else SITE


def _map_server(image: Path, folder: Path, answers: Preferences, files: dict[str, bytes]) -> str:
    """Return the map_server file of an image: the one beside it, or a new one."""
    beside = image.with_suffix(".yaml")
    if beside.is_file() and answers.resolution is None:
        return seen_from(folder, beside)
    if not image.is_file():
        raise ConfigurationError(f"cannot read the map '{image}': there is no such file", "check the path")
    if answers.resolution is None:
        raise ConfigurationError(
            f"'{image}' is an image, and nothing says how large its pixels are", "give --resolution METRES"
        )
    name = f"{image.stem}.ros.yaml"
    content = {
        "image": seen_from(folder, image),
        "resolution": answers.resolution,
        "origin": list(answers.origin),
        **_THRESHOLDS,
    }
    files[name] = _yaml(content, "As map_saver writes it.")
    return name


def _yaml(content: Mapping[str, Any], head: str) -> bytes:
    import yaml

    body: str = yaml.safe_dump(dict(content), sort_keys=False, allow_unicode=True, default_flow_style=None)
    return f"# {head}\n{body}".encode()


def seen_from(folder: Path, path: Path) -> str:
    """Return a path as files in a folder name it."""
    if path.is_absolute():
        return path.as_posix()
    if not path.exists():
        return path.as_posix()  # a sample
    return Path(os.path.relpath(path, folder)).as_posix()
