"""``viatool certify``: proofs for every pose of a map, not only for visited states."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import click

from viatool.cli import options
from viatool.cli.command import Command
from viatool.cli.gating import build_gate, gate_options, leave_by_gate, stop_early_option
from viatool.cli.reporting import read_outputs, tell
from viatool.cli.shapes import FootprintType, PointType
from viatool.cli.stopping import certain, require_stoppable
from viatool.cli.terminal import show_progress
from viatool.cli.work import keeping, work_options
from viatool.errors import ConfigurationError
from viatool.setting.criteria import PROVING

if TYPE_CHECKING:
    from viatool.report import Gate
    from viatool.world import Scenario, WorldMap


@click.command(cls=Command)
@options.policy_argument
@options.map_option
@options.unknown_option
@click.option(
    "--goal",
    type=PointType(),
    help="Where the robot heads, m in the map frame; by default the scenario's goal.",
)
@click.option(
    "--scenario",
    metavar="NAME|K",
    help="Among the obstacles of this scenario of the map, by name or by number from 0; by default the map alone with "
    "--goal, else the first.",
)
@options.eps_option
@options.errors_option
@options.pose_error_option
@options.spec_option
@click.option(
    "--criterion",
    type=click.Choice(PROVING),
    default="braking",
    show_default=True,
    help="What has to hold from every pose.",
)
@options.deceleration_option
@click.option(
    "--clearance", type=options.QuantityType("m"), help="Collision distance d_col instead of the map's."
)
@options.interval_option
@options.delay_option
@options.robot_option
@options.prefer_option
@click.option(
    "--footprint",
    type=FootprintType(),
    help="Footprint instead of the robot's: 'point', a radius in m, corners 'x,y x,y x,y ...' in m, or a YAML file.",
)
@options.arithmetic_option
@click.option(
    "--smallest",
    type=options.QuantityType("m"),
    default=0.02,
    show_default=True,
    help="Side of the smallest cells; their headings span as many radians.",
)
@click.option(
    "--halvings",
    type=click.IntRange(0, 8),
    default=1,
    show_default=True,
    metavar="N",
    help="How often the ranges of the previous v and omega may be halved.",
)
@click.option(
    "--budget-seconds",
    type=options.QuantityType("s"),
    help="Stop this long after the start, with what was examined until then.",
)
@click.option("--budget-cells", type=click.IntRange(min=1), metavar="N", help="Stop after this many cells.")
@click.option(
    "--sample",
    type=click.FloatRange(0.0, 1.0, min_open=True),
    default=1.0,
    metavar="SHARE",
    help="Examine a random share of the map only: an unbiased estimate in less time.",
)
@click.option(
    "--steps",
    type=click.IntRange(1, 10_000),
    metavar="K",
    help="Also count the cells from which the closed loop stays certified for 1, 2, ... K control intervals.",
)
@click.option(
    "--forever",
    is_flag=True,
    help="Also find the cells that the closed loop leaves only towards the goal: safe for ever.",
)
@click.option(
    "--arrive",
    is_flag=True,
    help="Also find the cells from which every run reaches the goal, those that are safe for ever and never stand "
    "still, and those that are safe for ever.",
)
@click.option(
    "--lookahead",
    type=click.IntRange(1, 64),
    default=4,
    show_default=True,
    metavar="N",
    help="With --steps, --forever or --arrive: intervals for which a cell is followed before it has to lie in other "
    "cells.",
)
@click.option(
    "--coarser",
    type=click.IntRange(0, 3),
    default=0,
    show_default=True,
    metavar="N",
    help="With --steps, --forever or --arrive: by how many halvings the cells of these sets are coarser than the "
    "smallest.",
)
@click.option(
    "--finer",
    type=click.IntRange(0, 3),
    default=0,
    show_default=True,
    metavar="N",
    help="With --arrive: how often those of these cells are halved that lead nearly into cells that arrive.",
)
@click.option(
    "--goal-radius",
    type=options.QuantityType("m"),
    help="With --steps, --forever or --arrive: within this distance the goal is reached and the run is over; by "
    "default as in simulation.",
)
@options.explain_errors_option
@options.seed_option
@click.option(
    "--output",
    "-o",
    multiple=True,
    metavar="FORMAT:PATH",
    help="Write a report: json, figure (png, svg, pdf), html (a page that opens offline), csv (a row for each place), "
    "cells (npz), witnesses (json, for viatool replay), markdown, junit, sarif or github; PATH - is stdout. "
    "Repeatable.",
)
@gate_options
@stop_early_option
@work_options
@options.threads_option
@options.quiet_option
@click.pass_context
def command(ctx: click.Context, /, **given: Any) -> None:
    """Certify POLICY (ONNX) for every pose of a map, every command before it, and bounded sensor error.

    The free space is cut into cells of x, y, heading and previous command. Each becomes uncontested (no command
    could endanger it), certified (proved for all of it), refuted (with a replayable counterexample) or unknown.
    """
    from viatool.places import Campaign, Lookahead, Resolution, SearchBudget, certify
    from viatool.policy import load_policy
    from viatool.report import evaluate
    from viatool.report.places.run import PlacesRun
    from viatool.report.places.so_far import PlacesSoFar
    from viatool.schedule import Deadline, open_scheduler

    if given["stop_early"]:
        require_stoppable(given)
    until = Deadline.after(given["budget_seconds"])
    outputs = read_outputs(given["output"], PlacesRun)
    gate = build_gate(given, PlacesRun)
    require_asked(gate, given)
    world_map = options.open_map(given["map_path"], given["unknown"])
    scenario = choose_scenario(given, world_map)
    policy = load_policy(given["policy"], given["spec_path"])
    with keeping(given["checkpoint"]), show_progress(quiet=given["quiet"]) as progress:
        certificate = certify(
            policy,
            world_map,
            scenario,
            eps=options.plain_eps(given["eps"]),
            errors=options.stated_errors(given),
            resolution=Resolution(given["smallest"], given["halvings"]),
            budget=SearchBudget(until, given["budget_cells"] or 2**62, given["sample"]),
            lookahead=Lookahead(
                for_ever=given["forever"],
                arrive=given["arrive"],
                intervals=given["lookahead"],
                coarser=given["coarser"],
                finer=given["finer"],
                **{name: given[name] for name in ("steps", "goal_radius") if given[name] is not None},
            ),
            campaign=Campaign(
                open_scheduler(given["workers"], given["scheduler"]), given["checkpoint"], given["resume"]
            ),
            tell=progress,
            enough=certain(gate, PlacesSoFar) if given["stop_early"] else None,
            **{name: given[name] for name in _PASSED_ON},
        )
    document = PlacesRun(certificate)
    checks = evaluate(gate, document)
    tell(document, outputs, checks, quiet=given["quiet"])
    leave_by_gate(ctx, checks, quiet=given["quiet"])


def require_asked(gate: Gate, given: Mapping[str, Any]) -> None:
    """Refuse a gate on what is not looked for.

    Raises
    ------
    ConfigurationError
        Names the rate and the option that finds it.
    """
    found_by = {"arrive": ("arrive",), "forever": ("forever", "arrive")}
    for name in (threshold.name for threshold in gate.thresholds):
        options_of = found_by.get(name, ())
        if options_of and not any(given[option] for option in options_of):
            raise ConfigurationError(
                f"--fail-under {name}=... is about what is not looked for", f"add --{options_of[0]}"
            )


_PASSED_ON = (
    "criterion",
    "clearance",
    "deceleration",
    "interval",
    "delay",
    "robot",
    "prefer",
    "footprint",
    "arithmetic",
    "explain_errors",
    "seed",
)


def choose_scenario(given: Mapping[str, Any], world_map: WorldMap) -> Scenario:
    """Return the obstacles and the goal that are asked for.

    Raises
    ------
    ConfigurationError
        If the map has no such scenario, or no goal is given and it has none.
    """
    from dataclasses import replace

    from viatool.world import Scenario

    goal, which = given["goal"], given["scenario"]
    if which is None and goal is not None:
        return Scenario(f"goal {goal[0]:g},{goal[1]:g}", (*goal, 0.0), goal)
    scenario = world_map.scenario(which or 0)
    return scenario if goal is None else replace(scenario, goal=goal)
