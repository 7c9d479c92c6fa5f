"""Options that several commands share, each defined once, and the types that check them."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from glob import escape, glob
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import click
from click.shell_completion import CompletionItem

from viatool.cli.numbers import finite
from viatool.cli.shapes import FootprintType, PoseErrorType
from viatool.samples import ERRORS, MAPS, POLICIES, Shelf

if TYPE_CHECKING:
    from viatool.uncertainty import ErrorModel
    from viatool.world import Scenario, WorldMap

Command = TypeVar("Command", bound=Callable[..., Any])
Eps = tuple[str, float]

_THREAD_VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


class EpsType(click.ParamType):  # type: ignore[type-arg]  # generic only in newer click
    """``0.01`` for every channel, or ``lidar=0.03`` for one; converted to (channel, radius)."""

    name = "eps"

    def get_metavar(self, param: click.Parameter, ctx: click.Context | None = None) -> str:
        """Show what may be written."""
        return "[CHANNEL=]RADIUS"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Eps:
        """Read one radius; it must be finite and not negative."""
        if isinstance(value, tuple):
            return value
        channel, equals, text = value.rpartition("=")
        if equals and not channel:
            self.fail(f"'{value}' names no channel before '='", param, ctx)
        radius = finite(text)
        if radius is None or radius < 0.0:
            self.fail(f"'{value}' is not a finite radius of at least 0, in the channel's unit", param, ctx)
        return channel, radius


class QuantityType(click.ParamType):  # type: ignore[type-arg]  # generic only in newer click
    """A finite number above 0 (or at least 0), in a unit that the metavar names."""

    def __init__(self, unit: str, *, zero: bool = False) -> None:
        self.name = unit
        self.zero = zero

    def get_metavar(self, param: click.Parameter, ctx: click.Context | None = None) -> str:
        """Show the unit."""
        return self.name.upper()

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Read one number."""
        number = value if isinstance(value, float) else finite(str(value))
        if number is None or number < 0.0 or (number == 0.0 and not self.zero):
            self.fail(
                f"'{value}' is not a finite number {'of at least' if self.zero else 'above'} 0", param, ctx
            )
        return number


def collect_eps(ctx: click.Context, param: click.Parameter, values: tuple[Eps, ...]) -> dict[str, float]:
    """Gather the repeated ``--eps`` by channel; the key ``""`` holds the radius of all other channels."""
    radii: dict[str, float] = {}
    for channel, radius in values:
        if channel in radii:
            name = f"channel '{channel}'" if channel else "all channels"
            raise click.BadParameter(f"the radius of {name} is given twice", ctx=ctx, param=param)
        radii[channel] = radius
    return radii


class PreferType(click.ParamType):  # type: ignore[type-arg]  # generic only in newer click
    """``policy`` or ``map`` for every matter, or ``limits=map`` for one; converted to (matter, party)."""

    name = "prefer"

    def get_metavar(self, param: click.Parameter, ctx: click.Context | None = None) -> str:
        """Show what may be written."""
        return "[MATTER=]policy|map"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, str]:
        """Read one preference; what may be named is checked where it is used."""
        if isinstance(value, tuple):
            return value
        matter, _, party = value.rpartition("=")
        return matter, party


def collect_preferences(
    ctx: click.Context, param: click.Parameter, values: tuple[tuple[str, str], ...]
) -> dict[str, str]:
    """Gather the repeated ``--prefer`` by matter; the key ``""`` holds the answer for all others."""
    preferred: dict[str, str] = {}
    for matter, party in values:
        if preferred.setdefault(matter, party) != party:
            raise click.BadParameter("one matter is given both parties", ctx=ctx, param=param)
    return preferred


def plain_eps(radii: Mapping[str, float]) -> float | Mapping[str, float] | None:
    """Return one number where no channel has a radius of its own, None where none is given."""
    return radii[""] if set(radii) == {""} else radii or None


def limit_threads(ctx: click.Context, param: click.Parameter, threads: int | None) -> int | None:
    """Limit the threads of the numeric libraries; this has to happen before numpy is imported.

    Policies are small: on a busy machine, threads that wait for each other are several times slower than one.
    """
    for variable in _THREAD_VARIABLES:
        if threads is not None:
            os.environ[variable] = str(threads)
        else:
            os.environ.setdefault(variable, "1")
    return threads


class SamplePath(click.Path):
    """A path, or the name of a sample; the shell completes both."""

    def __init__(self, shelf: Shelf) -> None:
        super().__init__(path_type=Path)
        self.shelf = shelf

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Offer the samples, and leave files to the shell.

        In bash the file item of click's script forgets the names before it, and hides files behind names after
        it: so where a file begins like that, bash offers files, else names. Other shells offer both.
        """
        names = [CompletionItem(name) for name in self.shelf.names() if name.startswith(incomplete)]
        files = super().shell_complete(ctx, param, incomplete)
        return [*names, *files] if glob(f"{escape(incomplete)}*") else [*files, *names]


READABLE = click.Path(path_type=Path)
WRITABLE = click.Path(path_type=Path)
POLICY = SamplePath(POLICIES)
MAP = SamplePath(MAPS)
ERROR_MODEL = SamplePath(ERRORS)

policy_argument = click.argument("policy", type=POLICY)
map_option = click.option(
    "--map",
    "map_path",
    type=MAP,
    required=True,
    metavar="FILE",
    help="The map: native YAML, a ROS 2 map_server YAML, or the name of a sample such as lab.",
)
unknown_option = click.option(
    "--unknown",
    type=click.Choice(["free", "obstacle"]),
    help="What unknown cells of a map_server map are; by default what the map says, else obstacles.",
)
spec_option = click.option(
    "--spec",
    "spec_path",
    type=READABLE,
    metavar="FILE",
    help="Specification for a policy that carries none (YAML).",
)


def graph_options(command: Command) -> Command:
    """Add the choice among several inputs and outputs of a model."""
    command = click.option(
        "--graph-output",
        metavar="NAME",
        help="Which output of the model is the action, where it has several.",
    )(command)
    return click.option(
        "--graph-input",
        metavar="NAME",
        multiple=True,
        help="Which input of the model is the observation. Repeatable: several are joined in this order.",
    )(command)


eps_option = click.option(
    "--eps",
    type=EpsType(),
    multiple=True,
    callback=collect_eps,
    help="Sensor error: a radius in each channel's unit, or one channel's, such as lidar=0.03. Repeatable; "
    "needed unless the specification gives radii.",
)
errors_option = click.option(
    "--errors",
    "errors",
    type=ERROR_MODEL,
    metavar="FILE",
    help="Error model (YAML): what is bounded about sensors, pose, motors, time and moving things, see docs/errors.md; "
    "or the name of a robot whose data sheet is known, such as husky.",
)
explain_errors_option = click.option(
    "--explain-errors",
    is_flag=True,
    help="Judge what is not proved again without each error in turn, and rank the errors by the verdicts that they "
    "cost.",
)
pose_error_option = click.option(
    "--pose-error",
    type=PoseErrorType(),
    help="How far x and y, and the heading, that localisation gives may be off in each control interval, such as "
    "0.01,0.01; the same as pose in an error model.",
)
seed_option = click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    metavar="N",
    help="Seed of scenarios and noise.",
)
noise_option = click.option(
    "--noise",
    type=QuantityType("m", zero=True),
    help="Standard deviation of the simulated LiDAR noise; by default the map's.",
)
_chosen_option = click.option(
    "--scenario",
    "chosen",
    multiple=True,
    metavar="NAME|K",
    help="One of the map's scenarios, by name or by number from 0; by default all of them. Repeatable.",
)
_drawn_option = click.option(
    "--scenarios",
    type=click.IntRange(min=1),
    metavar="N",
    help="N scenarios drawn by the map's generator instead of the map's fixed ones.",
)


def scenario_options(command: Command) -> Command:
    """Add the choice among the map's scenarios, and the number of drawn ones."""
    return _chosen_option(_drawn_option(command))


threads_option = click.option(
    "--threads",
    type=click.IntRange(min=1),
    metavar="N",
    callback=limit_threads,
    is_eager=True,
    help="Threads of the numeric libraries; by default 1, or what OMP_NUM_THREADS says.",
)
policy_output_option = click.option(
    "--output",
    "-o",
    type=WRITABLE,
    default=Path("policy.onnx"),
    show_default=True,
    metavar="FILE",
    help="The ONNX file to write.",
)
quiet_option = click.option(
    "--quiet", "-q", is_flag=True, help="Print no report and no progress; of a failed gate one line."
)


clearance_option = click.option(
    "--clearance", type=QuantityType("m"), help="Collision distance d_col instead of the map's."
)
danger_option = click.option(
    "--danger", type=QuantityType("m"), help="Danger distance d_danger instead of the map's."
)
interval_option = click.option(
    "--interval", type=QuantityType("s"), help="Control interval instead of the policy's and the robot's."
)
robot_option = click.option(
    "--robot",
    metavar="NAME",
    help="A robot that is known by name (see the docs on maps), with its limits, instead of the map's.",
)
prefer_option = click.option(
    "--prefer",
    type=PreferType(),
    multiple=True,
    callback=collect_preferences,
    help="Which counts where policy and map contradict each other in interval, limits or lidar; without it they must "
    "agree. With limits=map, commands are clipped to the robot's. Repeatable.",
)
footprint_option = click.option(
    "--footprint",
    type=FootprintType(),
    help="Footprint instead of the robot's: 'point' (the LiDAR origin), a disc's radius in m, the "
    "corners 'x,y x,y x,y ...' of a polygon in m, or a YAML file with them.",
)


def open_map(path: Path, unknown: Literal["free", "obstacle"] | None = None) -> WorldMap:
    """Load a map; what a user should know about it goes to stderr."""
    import warnings

    from viatool.errors import MapWarning
    from viatool.world import load_map

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MapWarning)
        world_map = load_map(path, unknown=unknown)
    for text in world_map.warnings:
        warn(text)
    return world_map


def warn(text: str) -> None:
    """Say on stderr what is not wrong but odd."""
    from viatool.cli.failures import compose

    click.echo(compose(text).replace("error: ", "warning: ", 1), err=True)


def draw_scenarios(
    world_map: WorldMap,
    scenarios: int | None,
    seed: int,
    chosen: Sequence[str] = (),
    instead: str = "",
) -> tuple[Scenario, ...]:
    """Return the map's fixed scenarios, those of them that are chosen, or as many drawn ones as are asked for.

    The hint names what the command takes `instead` of scenarios, if anything.

    Raises
    ------
    ConfigurationError
        If the map has no generator to draw them, or neither scenarios nor a generator, or one is asked for that it has
        not.
    """
    from viatool.errors import ConfigurationError

    other = f", or give {instead}" if instead else ""
    if chosen and scenarios is not None:
        raise ConfigurationError(
            "--scenario names scenarios of the map, --scenarios draws others", "leave one out"
        )
    if chosen:
        return tuple(world_map.scenario(which) for which in chosen)
    if scenarios is None and world_map.scenarios:
        return world_map.scenarios
    if world_map.generator is None:
        if scenarios is not None:
            fixed = (
                ", or leave the number of scenarios out to drive the map's own" if world_map.scenarios else ""
            )
            raise ConfigurationError(
                f"map '{world_map.path}' has no scenario generator to draw {scenarios} scenarios",
                f"add a 'generator' to the map{fixed}",
            )
        raise ConfigurationError(
            f"map '{world_map.path}' has no scenarios",
            f"add 'scenarios' or a 'generator' to the map{other}",
        )
    if scenarios is None:
        raise ConfigurationError(
            f"map '{world_map.path}' has no scenarios",
            f"draw some with --scenarios N{other}",
        )
    return world_map.generator.draw(scenarios, seed)


arithmetic_option = click.option(
    "--arithmetic",
    type=click.Choice(["float32", "real"]),
    default="float32",
    show_default=True,
    help="Whether bounds cover the rounding of the deployed program or the exact network.",
)
deceleration_option = click.option(
    "--deceleration", type=QuantityType("m/s²"), help="Braking instead of the robot's."
)


def stated_errors(given: Mapping[str, Any]) -> ErrorModel:
    """Return the error model of `--errors` with what `--pose-error` adds."""
    from viatool.uncertainty import as_error_model

    model = as_error_model(given["errors"])
    return model if given["pose_error"] is None else model.with_pose_error(*given["pose_error"])


BOUNDS = ("order", "approximation", "refine", "arithmetic")
"""What `bounds_options` give."""
CLEARANCES = ("clearance", "danger", "interval", "footprint", "delay", "robot", "prefer")
"""What `clearance_options` give."""


def bounds_options(command: Command) -> Command:
    """Add the options of the reachable set."""
    for option in reversed(
        (
            click.option(
                "--order",
                type=click.IntRange(min=1),
                metavar="N",
                default=1,
                show_default=True,
                help="Order of the Taylor models.",
            ),
            click.option(
                "--approximation",
                type=click.Choice(["chebyshev", "bernstein", "taylor"]),
                default="chebyshev",
                show_default=True,
                help="Polynomials that approximate the activations.",
            ),
            click.option(
                "--refine",
                type=click.Choice(["none", "monotone", "split"]),
                default="monotone",
                show_default=True,
                help="Refinement of the bounds.",
            ),
            arithmetic_option,
        )
    ):
        command = option(command)
    return command


delay_option = click.option(
    "--delay",
    type=QuantityType("s", zero=True),
    default=0.0,
    show_default=True,
    help="Dead time until a command acts; the commands before it go on until then.",
)


def clearance_options(command: Command) -> Command:
    """Add the options that override the map's clearances and robot."""
    for option in reversed(
        (
            clearance_option,
            danger_option,
            interval_option,
            footprint_option,
            delay_option,
            robot_option,
            prefer_option,
        )
    ):
        command = option(command)
    return command
