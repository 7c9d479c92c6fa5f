"""``viatool init``: from what somebody has to a project file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from viatool.cli import options
from viatool.cli.command import Command
from viatool.cli.shapes import FootprintType, PointType, PoseType

Read = TypeVar("Read")


@click.command(cls=Command)
@click.option(
    "--policy",
    type=options.POLICY,
    metavar="FILE",
    help="The policy: a zip of Stable-Baselines3, a TorchScript actor, or ONNX.",
)
@click.option(
    "--vecnormalize",
    type=options.READABLE,
    metavar="FILE",
    help="The VecNormalize that a model of Stable-Baselines3 was trained in.",
)
@options.spec_option
@click.option(
    "--map", "map_path", type=options.MAP, metavar="FILE", help="The map: YAML, an image, or a sample."
)
@click.option(
    "--resolution", type=options.QuantityType("m"), help="Side of a pixel of a map that is an image."
)
@click.option(
    "--origin",
    type=PoseType(),
    default=(0.0, 0.0, 0.0),
    show_default="0,0,0",
    help="Pose of the lower left corner of such an image.",
)
@click.option(
    "--scan",
    type=options.READABLE,
    metavar="FILE",
    help="A LaserScan of the robot: what ros2 topic echo --once prints (YAML), JSON, or a bag.",
)
@click.option("--scan-topic", metavar="NAME", help="Topic of the LaserScan in a bag.")
@click.option(
    "--scan-yaw",
    type=click.FloatRange(-6.3, 6.3),
    default=0.0,
    show_default=True,
    metavar="RAD",
    help="Heading of the LiDAR on the robot, counter-clockwise.",
)
@click.option(
    "--nav2",
    type=options.READABLE,
    metavar="FILE",
    help="nav2_params.yaml: footprint, limits and rate of the robot.",
)
@click.option(
    "--environment",
    metavar="MODULE:ID",
    help="A gymnasium environment, which is made to read limits and control interval from it.",
)
@click.option(
    "--observation",
    metavar="KIND,...",
    help="What the numbers of the observation are, in their order, such as lidar,goal_distance,goal_bearing.",
)
@click.option(
    "--command", "commands", metavar="KIND,...", help="What the outputs command, such as linear,angular."
)
@click.option("--interval", type=options.QuantityType("s"), help="Time between two commands.")
@click.option(
    "--eps", multiple=True, metavar="[CHANNEL=]RADIUS", help="Sensor error, as for verify. Repeatable."
)
@options.clearance_option
@options.footprint_option
@click.option(
    "--start", type=PoseType(), help="Where the robot starts, with --goal; by default ten random courses."
)
@click.option("--goal", type=PointType(), help="Where it heads, with --start.")
@click.option(
    "--output", "-o", type=options.WRITABLE, default=Path(), metavar="DIR", help="Where files are written."
)
@click.option("--yes", "-y", is_flag=True, help="Ask nothing: take what is proposed.")
@click.option("--force", is_flag=True, help="Overwrite files that are there already.")
@options.quiet_option
def command(**given: Any) -> None:
    """Write a project file, and the specification and the map that it needs, from what you have.

    What is not given is asked. The rays of the LiDAR are drawn on the robot, for you to look at; what was guessed is
    said. The files are written whole, and none is overwritten without --force.
    """
    from viatool.projects import (
        Preferences,
        RobotFacts,
        begin,
        described,
        load_environment,
        load_nav2,
        load_scanner,
        read_model,
        require_readable,
        states_its_robot,
        write_beginning,
    )

    if (given["start"] is None) != (given["goal"] is None):
        raise click.UsageError("--start and --goal belong together")
    ask = _Asker(quiet=given["yes"])
    model = ask.read(
        given["policy"],
        "Policy (a zip of Stable-Baselines3, TorchScript or ONNX)",
        "--policy",
        lambda path: read_model(path, given["vecnormalize"], given["spec_path"]),
    )
    map_path = ask.read(
        given["map_path"], "Map (YAML, an image, or a sample such as lab)", "--map", _existing_map
    )
    native = states_its_robot(map_path)
    if native:
        _refuse(
            ("nav2", "footprint", "clearance", "resolution", "origin", "start", "goal"),
            "a native map states its robot, its clearance and its courses, and a sample stays as it is: change the "
            "map, or give an image or a map_server YAML in its place",
        )
    if map_path.suffix.lower() in (".yaml", ".yml"):
        _refuse(
            ("resolution", "origin"), "a map_server YAML states both: leave the option out, or change the map"
        )
    if model.proposal is None:
        _refuse(
            ("scan", "scan_topic", "scan_yaw", "environment", "observation", "commands", "interval"),
            "the policy has its own specification, which says this: leave the option out, or change the specification",
        )
    picture = (
        map_path.suffix.lower() not in ("", ".yaml", ".yml") and not map_path.with_suffix(".yaml").is_file()
    )
    resolution = (
        ask.number(given["resolution"], "Side of a pixel in m", 0.05) if picture else given["resolution"]
    )
    scanner = None
    if model.proposal is not None:
        scanner = ask.optional(
            given["scan"],
            "LaserScan message or bag (empty: none)",
            lambda path: load_scanner(path, given["scan_topic"]),
        )
    robot = RobotFacts()
    if not native:
        robot = ask.optional(given["nav2"], "nav2_params.yaml (empty: none)", load_nav2) or robot
        robot = robot.with_more(
            RobotFacts(ask.footprint(given["footprint"], known=robot.footprint is not None))
        )
    if given["environment"] is not None:
        robot = robot.with_more(load_environment(given["environment"]))
    proposal = described(model, scanner, robot, Preferences(yaw=given["scan_yaw"])).proposal
    seen, done, interval = given["observation"], given["commands"], given["interval"]
    if proposal is not None:

        def with_kinds(seen: tuple[str, ...] = (), done: tuple[str, ...] = ()) -> None:
            answers = Preferences(kinds=seen, commands=done, yaw=given["scan_yaw"])
            require_readable(described(model, scanner, robot, answers))

        seen = ask.words(
            seen, "Kinds of the observation, in order", [c["kind"] for c in proposal.observation], with_kinds
        )
        done = ask.words(
            done,
            "Kinds of the commands, in order",
            [c["kind"] for c in proposal.action],
            lambda words: with_kinds(done=words),
        )
        if robot.interval is None:
            interval = ask.number(interval, "Time between two commands in s", 0.1)
    eps = given["eps"] or ask.text("Sensor error (RADIUS, or CHANNEL=RADIUS ...)", "0.01", _check_eps)
    answers = Preferences(
        kinds=seen,
        commands=done,
        interval=interval,
        eps=tuple(word for text in eps for word in text.split()),
        clearance=given["clearance"],
        resolution=resolution,
        origin=given["origin"],
        yaw=given["scan_yaw"],
        course=None if given["start"] is None else (given["start"], given["goal"]),
    )
    _check_eps(" ".join(answers.eps))
    beginning = begin(model, map_path, given["output"], scanner, robot, answers)
    write_beginning(beginning, given["output"], force=given["force"])
    if not given["quiet"]:
        for line in beginning.lines(given["output"]):
            click.echo(line)


def _refuse(names: tuple[str, ...], why: str) -> None:
    """Refuse options that would have no effect, the first that was given by its name."""
    context = click.get_current_context()
    for parameter in context.command.params:
        given = context.get_parameter_source(parameter.name or "")
        if parameter.name in names and given is not click.core.ParameterSource.DEFAULT:
            raise click.UsageError(f"{parameter.opts[0]} has no effect: {why}.")


def _existing_map(path: Path) -> Path:
    """Return a map that is there, or the name of a sample; ConfigurationError if there is none."""
    from viatool.errors import ConfigurationError
    from viatool.samples import MAPS

    if not path.is_file() and str(path) not in MAPS.names():
        raise ConfigurationError(
            f"the map '{path}': there is no such file",
            f"give a file, or name one of the samples: {', '.join(MAPS.names())}",
        )
    return path


def _check_eps(text: str) -> None:
    for word in text.split():
        options.EpsType().convert(word, None, None)


class _Asker:
    """Asks for what was not given, again until the answer can be used; where nothing may be asked, takes proposals."""

    def __init__(self, *, quiet: bool) -> None:
        self.quiet = quiet

    def read(self, given: Path | None, text: str, option: str, read: Callable[[Path], Read]) -> Read:
        """Return what a path holds that has to be there."""
        if given is not None:
            return read(given)
        if self.quiet:
            raise click.UsageError(f"Missing option '{option}', which --yes cannot guess.")
        found: Read = _answer(text, lambda answer: read(Path(answer)))
        return found

    def optional(self, given: Path | None, text: str, read: Callable[[Path], Read]) -> Read | None:
        """Return what a path holds, or None without one."""
        if given is not None:
            return read(given)
        if self.quiet:
            return None
        found: Read | None = _answer(
            text, lambda answer: read(Path(answer)) if answer else None, default="", show_default=False
        )
        return found

    def footprint(self, given: Any, *, known: bool) -> dict[str, Any] | None:
        """Return a footprint as a map has it; None for a point, and where a file has told it."""
        if given is None and not (known or self.quiet):
            words = "Footprint (point, a radius in m, or corners 'x,y x,y x,y')"
            given = _answer(words, lambda text: FootprintType().convert(text, None, None), default="point")
        if isinstance(given, float):
            return {"shape": "circle", "radius": given}
        return {"shape": "polygon", "points": given} if isinstance(given, list) else None

    def number(self, given: float | None, text: str, default: float) -> float | None:
        """Return a number; none where nothing may be asked."""
        if given is not None or self.quiet:
            return given
        unit = options.QuantityType("number")
        answer: float = _answer(text, lambda answer: unit.convert(answer, None, None), default=default)
        return answer

    def words(
        self, given: str | None, text: str, proposed: list[str], check: Callable[[tuple[str, ...]], None]
    ) -> tuple[str, ...]:
        """Return words; none where those that are proposed are right."""

        def read(answer: str) -> tuple[str, ...]:
            found = tuple(word.strip() for word in answer.split(",") if word.strip())
            found = () if found == tuple(proposed) else found
            check(found)
            return found

        if given is not None:
            return read(given)
        chosen: tuple[str, ...] = () if self.quiet else _answer(text, read, default=",".join(proposed))
        return chosen

    def text(self, text: str, default: str, check: Callable[[str], None]) -> tuple[str, ...]:
        """Return a text; none where nothing may be asked."""

        def read(answer: str) -> str:
            check(answer)
            return answer

        return () if self.quiet else (_answer(text, read, default=default),)


def _answer(text: str, read: Callable[[str], Any], **more: Any) -> Any:
    """Return what is made of an answer, asked until it can be read; nobody may be there to answer."""
    from viatool.errors import ViatoolError

    def understood(answer: str) -> Any:
        try:
            return read(answer)
        except ViatoolError as error:
            hint = f" ({error.hint})" if error.hint else ""
            raise click.BadParameter(f"{error.message}{hint}") from error

    try:
        return click.prompt(text, value_proc=understood, **more)
    except click.Abort as error:
        if isinstance(error.__context__, EOFError):
            raise click.UsageError(
                f"nobody answers '{text}': give it as an option, or --yes to take what is proposed."
            ) from error
        raise
