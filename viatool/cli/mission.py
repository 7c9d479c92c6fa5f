"""``viatool mission``: whole runs, from a box of starts to the goal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import click

from viatool.cli import options
from viatool.cli.command import Command
from viatool.cli.gating import build_gate, gate_options, leave_by_gate, stop_early_option
from viatool.cli.reporting import read_outputs, tell
from viatool.cli.shapes import PointType, PoseErrorType, PoseType
from viatool.cli.stopping import certain, require_stoppable
from viatool.cli.terminal import show_progress
from viatool.cli.work import keeping, work_options
from viatool.setting.criteria import PROVING

if TYPE_CHECKING:
    from viatool.world import Scenario, WorldMap


@click.command(cls=Command)
@options.policy_argument
@options.map_option
@options.unknown_option
@options.scenario_options
@click.option(
    "--start", type=PoseType(), help="Where the robot stands, instead of the scenario's start: m, m, rad."
)
@click.option("--goal", type=PointType(), help="Where it heads, instead of the scenario's goal.")
@options.eps_option
@options.errors_option
@options.pose_error_option
@options.explain_errors_option
@click.option(
    "--start-error",
    type=PoseErrorType(),
    default=(0.0, 0.0),
    help="How far x and y, and the heading, of a start may be off, such as 0.02,0.02.",
)
@options.spec_option
@click.option(
    "--criterion",
    type=click.Choice(PROVING),
    default="swept",
    show_default=True,
    help="What has to hold at every instant of every run.",
)
@click.option(
    "--time-limit",
    type=options.QuantityType("s"),
    help="Simulated time within which every run has to arrive; by default that of an episode.",
)
@click.option(
    "--goal-radius",
    type=options.QuantityType("m"),
    help="Within this distance the goal is reached; by default as in simulation.",
)
@click.option(
    "--parts",
    type=click.IntRange(min=1),
    default=4000,
    show_default=True,
    metavar="N",
    help="Most parts of a set.",
)
@click.option(
    "--cell",
    type=PoseErrorType(),
    default=(0.075, 0.025),
    show_default="0.075,0.025",
    help="Sides of the largest cells, in metres and radians; smaller ones are chosen as sets allow.",
)
@click.option(
    "--finer",
    type=click.IntRange(0, 4),
    default=2,
    show_default=True,
    metavar="N",
    help="How often a mission that is not proved, or whose sets are wide of what runs attain, is begun again in cells "
    "for four times as many parts.",
)
@click.option(
    "--budget-seconds",
    type=options.QuantityType("s"),
    help="Give up missions that are not done so long after the start, or a tenth later.",
)
@options.clearance_option
@options.deceleration_option
@options.interval_option
@options.footprint_option
@options.robot_option
@options.prefer_option
@options.arithmetic_option
@options.seed_option
@click.option(
    "--output",
    "-o",
    multiple=True,
    metavar="FORMAT:PATH",
    help="Write a report: json, figure (png, svg, pdf), html (a page that opens offline), tube (npz), witnesses "
    "(json, for viatool replay), mcap (ROS messages, for Foxglove and RViz), csv (a row for each mission), markdown, "
    "junit, sarif or github; PATH - is stdout. Repeatable.",
)
@gate_options
@stop_early_option
@work_options
@options.threads_option
@options.quiet_option
@click.pass_context
def command(ctx: click.Context, /, **given: Any) -> None:
    """Prove that every run of POLICY (ONNX) reaches its goal and keeps its clearance on the way.

    Runs begin anywhere in a box of starts, and sensors err within their bounds in each control interval anew. Each
    scenario becomes proved, refuted (a run that collides, or is still on its way at the time limit) or unknown.
    """
    from viatool.missions import MissionLimits, mission
    from viatool.policy import load_policy
    from viatool.report import evaluate
    from viatool.report.missions.run import MissionsRun
    from viatool.report.missions.so_far import MissionsSoFar
    from viatool.schedule import NEVER, Campaign, Deadline, open_scheduler

    if given["stop_early"]:
        require_stoppable(given)
    budget = given["budget_seconds"]
    until = NEVER if budget is None else Deadline.after(budget)
    outputs = read_outputs(given["output"], MissionsRun)
    gate = build_gate(given, MissionsRun)
    world_map = options.open_map(given["map_path"], given["unknown"])
    scenarios = _scenarios(given, world_map)
    policy = load_policy(given["policy"], given["spec_path"])
    position, heading = given["cell"]
    limits = MissionLimits(0, given["parts"], position, heading, given["finer"])
    scheduler = open_scheduler(given["workers"], given["scheduler"])
    with (
        keeping(given["checkpoint"], "finished missions are"),
        show_progress(quiet=given["quiet"]) as progress,
    ):
        missions = mission(
            policy,
            world_map,
            eps=options.plain_eps(given["eps"]),
            errors=options.stated_errors(given),
            scenarios=scenarios,
            limits=limits,
            campaign=Campaign(scheduler, given["checkpoint"], given["resume"]),
            until=until,
            progress=progress,
            keep_interrupted=True,
            enough=certain(gate, MissionsSoFar) if given["stop_early"] else None,
            **{name: given[name] for name in _PASSED_ON},
        )
    document = MissionsRun(missions)
    checks = evaluate(gate, document)
    tell(document, outputs, checks, quiet=given["quiet"])
    if missions.interrupted:
        if given["checkpoint"] is not None:
            click.echo(
                f"finished missions are kept in '{given['checkpoint']}'; continue with --resume", err=True
            )
        raise KeyboardInterrupt
    leave_by_gate(ctx, checks, quiet=given["quiet"])


_PASSED_ON = (
    "start_error",
    "criterion",
    "arithmetic",
    "time_limit",
    "goal_radius",
    "explain_errors",
    "clearance",
    "deceleration",
    "interval",
    "footprint",
    "robot",
    "prefer",
    "seed",
)


def _scenarios(given: Mapping[str, Any], world_map: WorldMap) -> tuple[Scenario, ...]:
    """Return what is to be driven: some of the map's scenarios, drawn ones, or one from --start to --goal."""
    from dataclasses import replace

    from viatool.world import Scenario

    named, start, goal = given["chosen"], given["start"], given["goal"]
    if start is not None and goal is not None and not named and given["scenarios"] is None:
        return (Scenario(f"{start[0]:g},{start[1]:g} to {goal[0]:g},{goal[1]:g}", start, goal),)
    chosen = options.draw_scenarios(world_map, given["scenarios"], given["seed"], named)
    changes: dict[str, Any] = {}
    if start is not None:
        changes |= {"start": start, "starts": None}
    if goal is not None:
        changes |= {"goal": goal, "region": None}
    return tuple(replace(one, **changes) for one in chosen)
