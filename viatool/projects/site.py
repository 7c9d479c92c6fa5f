"""The map of a new project: what was given, with the robot that drives there."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from viatool.errors import ConfigurationError, MapWarning
from viatool.policy import PolicySpecification
from viatool.projects.robot_files import RobotFacts
from viatool.samples import MAPS
from viatool.world import load_map

SITE = "site.yaml"
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
        Sensor errors, as ``--eps`` takes them.
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
    eps: Sequence[str] = ("0.01",)
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
    if str(path) in MAPS.names() and not path.exists():
        return Site(str(path))
    files: dict[str, bytes] = {}
    if path.suffix.lower() in _IMAGES:
        occupancy = _map_server(path, folder, answers, files)
    else:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", MapWarning)
            world_map = load_map(path)
        if world_map.stated or world_map.scenarios or world_map.obstacles.grid is None:
            return Site(seen_from(folder, path))
        occupancy = seen_from(folder, path)
    outline = robot.footprint is not None
    body: dict[str, Any] = {**robot.limits, **({"footprint": dict(robot.footprint or {})} if outline else {})}
    if body:
        interval = spec.control_interval if spec is not None else answers.interval or robot.interval or 0.1
        body["control_interval"] = interval
    clearance = answers.clearance if answers.clearance is not None else 0.05 if outline else 0.4
    content: dict[str, Any] = {
        "schema_version": 1,
        "name": path.stem,
        "occupancy": occupancy,
        **({"robot": body} if body else {}),
        "clearance": {"collision": clearance, "danger": round(clearance + 0.1, 9)},
    }
    if answers.course is None:
        content["generator"] = {"goal_clearance": round(clearance + 0.1, 9), "goal_distance": [1.0, 100.0]}
    else:
        start, goal = answers.course
        content["scenarios"] = [{"name": "first", "start": list(start), "goal": list(goal)}]
    name = _name(path, folder)
    files[name] = _yaml(content, "The map with the robot that drives there; see docs/own-map.md.")
    told = outline or answers.clearance is not None
    known = f"its footprint: --footprint, --nav2, or 'robot' in {name}"
    guess = f"the robot is a point that keeps {clearance:g} m ({known})"
    return Site(name, files, bool(body), () if told else (guess,))


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
