"""``viatool simulate``: drive a policy and record the states."""

from __future__ import annotations

from typing import Any

import click

from viatool.cli import options
from viatool.cli.terminal import open_console


@click.command()
@options.policy_argument
@options.map_option
@options.unknown_option
@options.spec_option
@options.scenarios_option
@options.seed_option
@options.noise_option
@click.option(
    "--horizon",
    type=click.IntRange(min=1),
    metavar="N",
    help="Most steps of an episode; by default the task's 300.",
)
@click.option(
    "--output",
    "-o",
    type=options.WRITABLE,
    metavar="FILE",
    help="Write the trajectory (npz, csv), for verify --trajectory.",
)
@options.threads_option
@options.quiet_option
def command(**given: Any) -> None:
    """Drive POLICY (ONNX) through the scenarios of a map and report how the episodes end."""
    from viatool.policy import load_policy
    from viatool.report import print_episodes
    from viatool.report.files import check_writable
    from viatool.simulate import roll_out
    from viatool.trajectory import write_trajectory

    if given["output"] is not None:
        check_writable(given["output"])
    policy = load_policy(given["policy"], given["spec_path"])
    world_map = options.open_map(given["map_path"], given["unknown"])
    scenarios = options.draw_scenarios(world_map, given["scenarios"], given["seed"])
    trajectory = roll_out(
        policy, world_map, scenarios, noise=given["noise"], horizon=given["horizon"], seed=given["seed"]
    )
    if given["output"] is not None:
        write_trajectory(given["output"], trajectory, policy.spec)
    if not given["quiet"]:
        print_episodes(trajectory, open_console())
