"""``viatool replay``: run counterexamples again through onnxruntime."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from viatool.cli import options
from viatool.cli.command import Command
from viatool.cli.failures import GATE_FAILED
from viatool.cli.terminal import open_console

if TYPE_CHECKING:
    from viatool.verification.witness_file import WitnessFile


@click.command(cls=Command)
@click.argument("witnesses", metavar="FILE", type=options.READABLE)
@click.option("--policy", type=options.POLICY, metavar="FILE", help="A policy other than the file's.")
@click.option("--map", "map_path", type=options.MAP, metavar="FILE", help="A map other than the file's.")
@options.unknown_option
@options.spec_option
@click.option(
    "--output",
    "-o",
    type=options.WRITABLE,
    metavar="FILE",
    help="Draw the closest ones: path, obstacle and what has to be free (png, svg, pdf).",
)
@options.threads_option
@options.quiet_option
@click.pass_context
def command(ctx: click.Context, /, **given: Any) -> None:
    """Run every counterexample of FILE again, and say whether it still violates, when and at which obstacle.

    FILE comes from ``viatool verify`` or ``viatool mission`` with ``--output witnesses:FILE``; of a run that did not
    arrive, every interval is driven again. Exits with 1 if one no longer violates, as after a repaired policy that is
    given with --policy.
    """
    from viatool.policy import load_policy
    from viatool.report.files import check_writable
    from viatool.report.replay_summary import print_replay
    from viatool.verification.witness_file import load_witnesses, replay

    if given["output"] is not None:
        from viatool.report.replay_figure import check_replay_figure

        check_replay_figure(given["output"])
        check_writable(given["output"])
    file = load_witnesses(given["witnesses"])
    policy = load_policy(given["policy"] or _named(file.policy["path"], given), given["spec_path"])
    world_map = options.open_map(given["map_path"] or _named(file.world_map["path"], given), given["unknown"])
    _tell_changes(file, policy.sha256, world_map.sha256)
    found = replay(policy, world_map, file)
    if given["output"] is not None:
        from viatool.report.replay_figure import write_replay_figure

        write_replay_figure(given["output"], world_map, file, found)
    if not given["quiet"]:
        print_replay(file, found, open_console())
    if not found.violates.all():
        ctx.exit(GATE_FAILED)


def _named(path: str, given: dict[str, Any]) -> Path:
    """Return a file that the witness file names, from here or else from where the witness file stands."""
    beside = Path(given["witnesses"]).parent / path
    return beside if beside.is_file() and not Path(path).is_file() else Path(path)


def _tell_changes(file: WitnessFile, policy: str, world_map: str) -> None:
    """Say on stderr when a file is another one than that for which the witnesses were found."""
    for name, was, now in (("policy", file.policy, policy), ("map", file.world_map, world_map)):
        if was["sha256"] != now:
            click.echo(f"note: the {name} is not the one that the witnesses were found for", err=True)
