"""Options that say which states are verified: recorded ones, or poses all over the map."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, TypeVar

import click

from viatool.cli.numbers import finite
from viatool.cli.options import READABLE, draw_scenarios
from viatool.cli.shapes import PointType

if TYPE_CHECKING:
    from viatool.simulate import Places
    from viatool.trajectory import BagSettings
    from viatool.world import Scenario, WorldMap

Command = TypeVar("Command", bound=Callable[..., Any])

DEFAULT_SPACING = 0.5  # metres
DEFAULT_CLOSE = 300  # places, as of `viatool.verify`


class PosesType(click.ParamType):  # type: ignore[type-arg]  # generic only in newer click
    """``grid``, ``grid:SPACING`` in metres, ``random:N`` or ``near:N``; converted to what `Places` is given."""

    name = "poses"

    def get_metavar(self, param: click.Parameter, ctx: click.Context | None = None) -> str:
        """Show what may be written."""
        return "grid[:SPACING]|random:N|near:N"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> dict[str, Any]:
        """Read one of the four."""
        if isinstance(value, dict):
            return value
        kind, colon, text = str(value).partition(":")
        spacing = finite(text) if colon else DEFAULT_SPACING
        if kind == "grid" and spacing is not None and spacing > 0.0:
            return {"spacing": spacing}
        if kind in ("random", "near") and text.isdecimal() and int(text) > 0:
            return {"count" if kind == "random" else "near": int(text)}
        return self.fail(f"'{value}' is not grid, grid:SPACING in m, random:N or near:N", param, ctx)


def state_options(command: Command) -> Command:
    """Add the options of recorded states and of poses."""
    where = _goal_option(
        "Where the robot was heading in a bag, or heads from --poses (repeatable); m in the map frame."
    )
    for option in reversed((_trajectory_option, _poses_option, where, *_bag_options)):
        command = option(command)
    return command


def recording_options(command: Command) -> Command:
    """Add the options of recorded states."""
    where = _goal_option("Where the robot was heading in a bag; m in the map frame.")
    for option in reversed((_trajectory_option, where, *_bag_options)):
        command = option(command)
    return command


def topic_options(command: Command) -> Command:
    """Add the options that name the topics and the frame of a bag."""
    for option in reversed(_bag_options):
        command = option(command)
    return command


def _goal_option(told: str) -> Callable[[Command], Command]:
    return click.option("--goal", "goals", type=PointType(), multiple=True, help=told)


_trajectory_option = click.option(
    "--trajectory",
    type=READABLE,
    metavar="FILE",
    help="Recorded states instead of simulated ones: npz, csv, or a ROS 1 or 2 bag (.bag, .mcap, .db3, "
    "or the folder of a ROS 2 bag).",
)
_poses_option = click.option(
    "--poses",
    "places",
    type=PosesType(),
    help="Verify poses instead of driven states: a grid all over the free space (0.5 m, 8 headings each) or N random "
    "ones, with the goals of the map's scenarios, or --goal; or N close places beside the driven states alone.",
)
close_option = click.option(
    "--close",
    type=click.IntRange(0, 100_000),
    default=DEFAULT_CLOSE,
    show_default=True,
    metavar="N",
    help="Also examine N close places: free poses beside the driven path at which it is up to the policy whether the "
    "robot comes too near. 0 for none.",
)
_bag_options = (
    click.option("--scan-topic", metavar="NAME", help="Topic of the LaserScan in a bag."),
    click.option("--odom-topic", metavar="NAME", help="Topic of the Odometry in a bag."),
    click.option(
        "--cmd-topic",
        metavar="NAME",
        help="Topic of the commands in a bag: Twist, TwistStamped, or Odometry for the measured velocity.",
    ),
    click.option(
        "--frame",
        metavar="NAME",
        default="map",
        show_default=True,
        help="Frame of a bag that is the map's; 'odom' asserts that the odometry has not drifted.",
    ),
)


def sampled_places(given: Mapping[str, Any]) -> Places | None:
    """Return which poses are asked for, if any."""
    if given["places"] is None:
        return None
    if "near" in given["places"]:
        if given["goals"] and given["trajectory"] is None:
            raise click.UsageError("--poses near:N goes with --scenarios or --trajectory, and without --goal")
    elif given["trajectory"] is not None or (given["scenarios"] is not None and given["goals"]):
        raise click.UsageError("--poses goes with --goal or --scenarios, and without --trajectory")
    from viatool.simulate import Places

    return Places(**given["places"])


def choose_scenarios(given: Mapping[str, Any], world_map: WorldMap) -> tuple[Scenario, ...] | None:
    """Return what is driven or where sampled poses lead; None for recorded states."""
    if given["trajectory"] is not None:
        return None
    if given["places"] is not None and given["goals"]:
        from viatool.world import Scenario

        return tuple(Scenario(f"goal {x:g},{y:g}", (x, y, 0.0), (x, y)) for x, y in given["goals"])
    instead = "--trajectory" if given["places"] is None else "--goal X,Y"
    return draw_scenarios(world_map, given["scenarios"], given["seed"], given["chosen"], instead)


def bag_settings(given: Mapping[str, Any]) -> BagSettings | None:
    """Return what the options tell about a bag; None if the states come from elsewhere.

    Raises
    ------
    UsageError
        If the options contradict each other.
    """
    from viatool.trajectory import BagSettings, Topics, is_bag

    topics = Topics(given["scan_topic"], given["odom_topic"], given["cmd_topic"])
    if given["trajectory"] is None or not is_bag(given["trajectory"]):
        if topics != Topics() or given["frame"] != "map":
            raise click.UsageError("topics and --frame are for a bag that is given with --trajectory")
        if given["goals"] and given.get("places") is None:
            other = ", or for --poses" if "places" in given else ""
            raise click.UsageError(f"--goal is for a bag that is given with --trajectory{other}")
        return None
    if len(given["goals"]) > 1:
        raise click.UsageError("a bag has one --goal, but several were given")
    return BagSettings(next(iter(given["goals"]), None), topics, given["frame"])
