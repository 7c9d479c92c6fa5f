"""The start of a project: from what somebody has, to a specification, a map with a robot, and a project file."""

from __future__ import annotations

import json
import math
import tempfile
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from viatool.arrays import Floats
from viatool.errors import ConfigurationError
from viatool.policy import PolicySpecification, load_specification
from viatool.policy.specification_file import specification_from_json
from viatool.projects.file import PROJECT
from viatool.projects.robot_files import RobotFacts
from viatool.projects.site import EPS, Preferences, check_course, seen_from, site_of
from viatool.proposals import (
    Proposal,
    Scanner,
    describe_with_memory,
    propose,
    with_kinds,
    with_limits,
    with_scanner,
)
from viatool.toml_text import toml_value

RAYS = "rays.png"
SCENARIOS = 10


@dataclass(frozen=True)
class Model:
    """A policy as it was given.

    Parameters
    ----------
    name : str
        What its files are called.
    path : Path
        Where it stands.
    imported : bytes, optional
        The ONNX file that was made of it, where it was none.
    specification : PolicySpecification, optional
        Its own, or the one that was given.
    proposal : Proposal, optional
        What is proposed where it has none.
    words : tuple of str
        What was done.
    """

    name: str
    path: Path
    imported: bytes | None = None
    specification: PolicySpecification | None = None
    proposal: Proposal | None = None
    words: tuple[str, ...] = ()


@dataclass(frozen=True)
class Beginning:
    """The files of a new project, and what is to be said of them.

    Parameters
    ----------
    files : mapping
        Contents by name in the folder.
    told : tuple of str
        What was taken from where.
    guesses : tuple of str
        What has to be checked.
    missing : tuple of str
        What has to be filled in before anything can be verified.
    policy, specification, site : str
        How the project calls the policy, its specification (nothing if it has its own) and the map.
    prefer : str
        Which counts where they contradict each other, as ``--prefer`` takes it; nothing where they do not.
    """

    files: Mapping[str, bytes]
    policy: str
    specification: str
    site: str
    told: tuple[str, ...] = ()
    guesses: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()
    prefer: str = ""

    def lines(self, folder: Path) -> Iterator[str]:
        """Yield what a person reads: what was written, from what, what to check, and what to do next."""
        yield f"written: {', '.join((folder / name).as_posix() for name in self.files)}"
        yield from (f"  {words}" for words in self.told)
        yield from (f"guessed: {words}" for words in self.guesses)
        yield from (f"to fill in: {words}" for words in self.missing)
        if RAYS in self.files:
            yield f"look at {(folder / RAYS).as_posix()}: do the rays point where they do on the robot?"
        policy, spec, site = self.policy, self.specification, self.site
        said = f" --spec {spec}" if spec else ""
        counts = f" --prefer {self.prefer}" if self.prefer else ""
        yield f"next: viatool doctor {policy}{said} --map {site}{counts}, then viatool run" + (
            "" if folder == Path() else f", in {folder.as_posix()}"
        )


def read_model(path: Path, normaliser: Path | None = None, specification: Path | None = None) -> Model:
    """Read a policy: ONNX, or a zip of Stable-Baselines3 or TorchScript, which is imported.

    Raises
    ------
    PolicyError, SelfCheckError
        If it cannot be read or imported.
    """
    given = None if specification is None else load_specification(specification)
    if path.is_file() and zipfile.is_zipfile(path):
        return _imported(path, normaliser, specification, given)
    if normaliser is not None:
        raise ConfigurationError(
            f"'{path}' is no model of Stable-Baselines3, whose --vecnormalize could be put into it",
            "leave it out",
        )
    found = describe_with_memory(path, specification)
    if found.failure is not None:
        raise found.failure
    own = given or found.specification
    return Model(path.stem, path, None, own, None if own else propose(found))


def _imported(
    path: Path, normaliser: Path | None, specification: Path | None, given: PolicySpecification | None
) -> Model:
    from viatool.importing import ImportRequest, import_policy

    with tempfile.TemporaryDirectory(prefix="viatool-") as folder:
        output = Path(folder) / f"{path.stem}.onnx"
        done = import_policy(ImportRequest(path, normaliser, specification), output)
        content = output.read_bytes()
    return Model(path.stem, path, content, given, done.proposal, done.inside)


def described(model: Model, scanner: Scanner | None, robot: RobotFacts, answers: Preferences) -> Model:
    """Return a policy whose proposed specification says what is known; one that has its own stays as it is."""
    proposal = model.proposal
    if proposal is None:
        return model
    if robot.commands is not None:
        proposal = with_limits(proposal, robot.commands)
    if answers.kinds or answers.commands:
        proposal = with_kinds(proposal, answers.kinds, answers.commands)
    if scanner is not None:
        proposal = with_scanner(proposal, scanner, answers.yaw)
    interval = answers.interval or robot.interval
    if interval is not None:
        proposal = replace(proposal, more={**(proposal.more or {}), "control_interval": interval})
    return replace(model, proposal=proposal)


def require_readable(model: Model) -> None:
    """Refuse a policy whose proposed specification cannot be read, as with kinds that do not exist."""
    _specification(model)


def begin(
    model: Model,
    map_path: Path,
    folder: Path,
    scanner: Scanner | None,
    robot: RobotFacts,
    answers: Preferences,
) -> Beginning:
    """Return the files of a project.

    Parameters
    ----------
    model : Model
        The policy.
    map_path : Path
        A map, an image of one, or the name of a sample.
    folder : Path
        Where the files will be.
    scanner : Scanner, optional
        Of the robot.
    robot : RobotFacts
        What else is known of the robot.
    answers : Preferences
        What no file says.

    Raises
    ------
    ConfigurationError, MapError
        If something cannot be read, contradicts itself, or is missing.
    """
    model = described(model, scanner, robot, answers)
    spec, missing = _specification(model)
    files: dict[str, bytes] = {}
    policy: dict[str, Any] = {"file": seen_from(folder, model.path)}
    if model.imported is not None:
        files[f"{model.name}.onnx"] = model.imported
        policy["file"] = f"{model.name}.onnx"
    spec_file = f"{model.name}.spec.yaml"
    if model.proposal is not None:
        files[spec_file] = model.proposal.to_yaml().encode("utf-8")
        policy["spec"] = spec_file
    site = site_of(map_path, folder, robot, answers, spec)
    check_course(map_path, robot, answers, spec)
    clipped = _beyond(spec, robot) if site.limits else ()
    prefer = "limits=map" if clipped else ""
    radii = answers.eps or (EPS,)
    if spec is not None:
        _check_eps(spec, radii)
    files |= site.files
    if spec is not None and (picture := _rays(spec, robot, scanner)) is not None:
        files[RAYS] = picture
    fixed = answers.course is not None or not site.files
    files[PROJECT] = _project(model.name, policy, site.name, radii, prefer, fixed=fixed).encode("utf-8")
    guesses = [str(guess) for guess in (model.proposal.guesses if model.proposal else ())]
    if model.proposal is not None and "control_interval" not in (model.proposal.more or {}):
        guesses.append("the policy acts every 0.1 s (the step of the environment)")
    if not answers.eps:
        guesses.append(
            f"every sensor errs by up to {EPS} in its channel's unit (--eps, see docs/choosing-eps.md)"
        )
    return Beginning(
        files,
        policy["file"],
        policy.get("spec", ""),
        site.name,
        (*model.words, *robot.words),
        (*guesses, *site.guesses, *clipped),
        missing,
        prefer,
    )


def _check_eps(spec: PolicySpecification, radii: Sequence[str]) -> None:
    """Refuse sensor errors of channels that a policy does not have, or not of all that it has."""
    spec.radii({name: float(radius) for name, _, radius in (text.rpartition("=") for text in radii)})


def _specification(model: Model) -> tuple[PolicySpecification | None, tuple[str, ...]]:
    """Return the specification, and what it lacks before states can be verified."""
    if model.specification is not None:
        return model.specification, ()
    assert model.proposal is not None
    if not model.proposal.is_complete:
        return None, (f"every FILL_IN of {model.name}.spec.yaml",)
    spec = specification_from_json(json.dumps(model.proposal.document), f"{model.path}: proposed")
    unknown = [channel.name for channel in spec.observation if channel.kind == "other"]
    unknown += [channel.name for channel in spec.action if channel.kind == "other"]
    if unknown:
        return spec, (
            f"what {', '.join(unknown)} are: give --observation and --command, or edit {model.name}.spec.yaml",
        )
    return spec, ()


def _beyond(spec: PolicySpecification | None, robot: RobotFacts) -> tuple[str, ...]:
    """Say which commands of a policy its robot does not carry out."""
    if spec is None:
        return ()
    told = []
    for channel in spec.axes:
        ends = {
            "linear": (robot.limits.get("min_linear", -math.inf), robot.limits.get("max_linear", math.inf)),
            "angular": (
                -robot.limits.get("max_angular", math.inf),
                robot.limits.get("max_angular", math.inf),
            ),
        }.get(channel.kind, (-math.inf, math.inf))
        if channel.lower < ends[0] or channel.upper > ends[1]:
            told.append(
                f"commands of {channel.name} from {channel.lower:g} to {channel.upper:g} are clipped to the robot's "
                f"{ends[0]:g} to {ends[1]:g} (what the driver does with them)"
            )
    return tuple(told)


def _rays(spec: PolicySpecification, robot: RobotFacts, scanner: Scanner | None) -> bytes | None:
    """Return a picture of the rays on the robot; None if the policy describes no LiDAR."""
    from viatool.report.rays_figure import rays_picture

    lidars = [channel.lidar for channel in spec.observation if channel.lidar is not None]
    if not lidars:
        return None
    lidar = lidars[0].lidar()
    seen = scanner.ranges if scanner is not None and len(scanner.ranges) == lidar.rays else ()
    return rays_picture(
        lidar, _outline(robot), seen, f"{lidar.rays} rays in {lidar.bins} numbers, {lidar.words}"
    )


def _outline(robot: RobotFacts) -> Floats:
    footprint = robot.footprint or {"shape": "circle", "radius": 0.1}
    if footprint["shape"] == "polygon":
        return np.array(footprint["points"], dtype=np.float64)
    angle = np.linspace(0.0, 2.0 * np.pi, 32, endpoint=False)
    return max(float(footprint["radius"]), 1e-3) * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _project(
    name: str, policy: Mapping[str, Any], site: str, radii: Sequence[str], prefer: str, *, fixed: bool
) -> str:
    """Return the project file."""
    entry = policy["file"] if len(policy) == 1 else policy
    numbers = [text if "=" in text else float(text) for text in radii]
    eps = numbers[0] if len(numbers) == 1 else numbers
    lines = [
        "# Made by viatool init; docs/project.md says what may stand here.",
        f"policies = {toml_value({name: entry})}",
        f"maps = {toml_value([site])}",
        "",
        "[defaults] # options of every check",
        f"eps = {toml_value(eps)} # sensor error in each channel's unit, see docs/choosing-eps.md",
        *(
            [f"prefer = {toml_value([prefer])} # the robot clips what the policy asks beyond its limits"]
            if prefer
            else []
        ),
        "",
        "[[check]]",
        'name = "drive"',
        'kind = "verify"',
        *([] if fixed else [f"scenarios = {SCENARIOS} # drawn by the map's generator"]),
        "gate = { max-unsafe = 0, min-contested = 1 } # no counterexample, and something was put to the test",
    ]
    return "\n".join(lines) + "\n"


def write_beginning(beginning: Beginning, folder: Path, *, force: bool = False) -> None:
    """Write the files of a project; without `force` none, if one of them is there already.

    Raises
    ------
    ConfigurationError
        If a file is there already, or cannot be written.
    """
    from viatool.report.files import check_writable, write_whole

    there = [name for name in beginning.files if (folder / name).exists()]
    if there and not force:
        raise ConfigurationError(
            f"'{folder / there[0]}' is there already, and is not overwritten",
            "choose another folder with --output DIR, or give --force",
        )
    for name in beginning.files:
        check_writable(folder / name)
    for name, content in beginning.files.items():
        write_whole(folder / name, content)
