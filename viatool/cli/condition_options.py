"""Options of the commands that simulate: the engine, and what makes the robot less than ideal."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import click

from viatool.cli.options import QuantityType
from viatool.cli.work import WorkersType

Command = TypeVar("Command", bound=Callable[..., Any])


def engine_options(command: Command) -> Command:
    """Add the choice of the engine, its robot, its LiDAR and its processes."""
    for option in reversed(
        (
            click.option(
                "--engine",
                metavar="NAME",
                default="kinematic",
                show_default=True,
                help="kinematic (exact arcs, fast) or bullet (wheels, motors, friction; needs the extra 'sim').",
            ),
            click.option(
                "--robot",
                metavar="NAME",
                help="A known robot instead of the map's (turtlebot3, turtlebot3_burger, turtlebot3_waffle, "
                "turtlebot4, jackal, husky, scout, mir100, spot or f1tenth): its limits and body; footprint, "
                "clearances and LiDAR stay the map's.",
            ),
            click.option(
                "--lidar",
                type=click.Choice(["rays", "analytic"]),
                help="How the bullet engine measures ranges: ray tests of the engine (default), or exact geometry, "
                "which is faster.",
            ),
            click.option(
                "--workers",
                type=WorkersType(),
                default=1,
                show_default=True,
                help="Processes of the bullet engine; auto takes one for each core. The result is the same.",
            ),
        )
    ):
        command = option(command)
    return command


def condition_options(command: Command) -> Command:
    """Add what makes the simulated robot less than ideal, besides the noise of its LiDAR."""
    for option in reversed(
        (
            click.option(
                "--dropout",
                type=click.FloatRange(0.0, 1.0, max_open=True),
                default=0.0,
                show_default=True,
                metavar="SHARE",
                help="Share of the LiDAR's rays that return nothing.",
            ),
            click.option(
                "--lidar-rate",
                type=QuantityType("hz"),
                help="Scans per second; by default a new scan for every command.",
            ),
            click.option(
                "--delay",
                type=QuantityType("s", zero=True),
                default=0.0,
                show_default=True,
                help="Time until a command reaches the motors; until then the previous ones go on.",
            ),
            click.option(
                "--drift",
                type=QuantityType("share", zero=True),
                default=0.0,
                show_default=True,
                help="Relative error of each wheel's odometry, from which the goal is observed: its standard "
                "deviation, constant over an episode.",
            ),
            click.option(
                "--acceleration",
                type=QuantityType("m/s2"),
                help="Largest acceleration of a wheel's rim; by default unlimited (kinematic) or the robot's "
                "(bullet).",
            ),
            click.option(
                "--people",
                type=click.IntRange(min=0),
                default=0,
                show_default=True,
                metavar="N",
                help="People who walk about in each episode, as fast as obstacles.people of --errors says.",
            ),
        )
    ):
        command = option(command)
    return command
