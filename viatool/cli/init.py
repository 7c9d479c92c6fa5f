"""``viatool init``: from what somebody has to a project file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from viatool.cli import options
from viatool.cli.command import Command
from viatool.cli.shapes import PointType, PoseType


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
        write_beginning,
    )

    ask = _Asker(quiet=given["yes"])
    policy = ask.path(given["policy"], "Policy (a zip of Stable-Baselines3, TorchScript or ONNX)", "--policy")
    model = read_model(policy, given["vecnormalize"], given["spec_path"])
    map_path = ask.path(given["map_path"], "Map (YAML, an image, or a sample such as lab)", "--map")
    picture = (
        map_path.suffix.lower() not in ("", ".yaml", ".yml") and not map_path.with_suffix(".yaml").is_file()
    )
    resolution = (
        ask.number(given["resolution"], "Side of a pixel in m", 0.05) if picture else given["resolution"]
    )
    scan = ask.optional(given["scan"], "LaserScan message or bag (empty: none)")
    nav2 = ask.optional(given["nav2"], "nav2_params.yaml (empty: none)")
    scanner = None if scan is None else load_scanner(scan, given["scan_topic"])
    robot = RobotFacts() if nav2 is None else load_nav2(nav2)
    if given["environment"] is not None:
        robot = robot.with_more(load_environment(given["environment"]))
    proposal = described(model, scanner, robot, Preferences(yaw=given["scan_yaw"])).proposal
    seen, done, interval = given["observation"], given["commands"], given["interval"]
    if proposal is not None:
        seen = ask.words(
            seen, "Kinds of the observation, in order", [c["kind"] for c in proposal.observation]
        )
        done = ask.words(done, "Kinds of the commands, in order", [c["kind"] for c in proposal.action])
        if robot.interval is None:
            interval = ask.number(interval, "Time between two commands in s", 0.1)
    eps = given["eps"] or (ask.text("Sensor error (RADIUS, or CHANNEL=RADIUS ...)", "0.01"),)
    if (given["start"] is None) != (given["goal"] is None):
        raise click.UsageError("--start and --goal belong together")
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
    for word in answers.eps:
        options.EpsType().convert(word, None, None)
    beginning = begin(model, map_path, given["output"], scanner, robot, answers)
    write_beginning(beginning, given["output"], force=given["force"])
    if not given["quiet"]:
        for line in beginning.lines(given["output"]):
            click.echo(line)


class _Asker:
    """Asks for what was not given; where nothing may be asked, takes what is proposed."""

    def __init__(self, *, quiet: bool) -> None:
        self.quiet = quiet

    def path(self, given: Path | None, text: str, option: str) -> Path:
        """Return a path that has to be there."""
        if given is None and self.quiet:
            raise click.UsageError(f"Missing option '{option}', which --yes cannot guess.")
        return given or Path(_answer(text))

    def optional(self, given: Path | None, text: str) -> Path | None:
        """Return a path, or none."""
        found = given or ("" if self.quiet else _answer(text, default="", show_default=False))
        return Path(found) if found else None

    def number(self, given: float | None, text: str, default: float) -> float | None:
        """Return a number; none where nothing may be asked."""
        if given is not None or self.quiet:
            return given
        unit = options.QuantityType("number")
        answer: float = _answer(text, default=default, type=unit)
        return answer

    def words(self, given: str | None, text: str, proposed: list[str]) -> tuple[str, ...]:
        """Return words; none where those that are proposed are right."""
        if given is None and not self.quiet:
            given = _answer(text, default=",".join(proposed))
        found = tuple(word.strip() for word in (given or "").split(",") if word.strip())
        return () if found == tuple(proposed) else found

    def text(self, text: str, default: str) -> str:
        """Return a text."""
        return default if self.quiet else str(_answer(text, default=default))


def _answer(text: str, **more: Any) -> Any:
    """Return what is answered; nobody may be there to do so."""
    try:
        return click.prompt(text, **more)
    except click.Abort as error:
        if isinstance(error.__context__, EOFError):
            raise click.UsageError(
                f"nobody answers '{text}': give it as an option, or --yes to take what is proposed."
            ) from error
        raise
