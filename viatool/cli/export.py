"""``viatool export``: from a training checkpoint to an ONNX policy."""

from __future__ import annotations

from pathlib import Path

import click

from viatool.cli import options
from viatool.cli.command import Command
from viatool.cli.terminal import open_console


@click.command(cls=Command)
@click.argument("checkpoint", type=options.READABLE)
@options.policy_output_option
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    metavar="N",
    help="Which of the seeds trained together; by default the best one.",
)
@click.option(
    "--map", "map_path", type=options.MAP, metavar="FILE", help="The training map, if it has moved."
)
@options.quiet_option
def command(checkpoint: Path, output: Path, seed: int | None, map_path: Path | None, quiet: bool) -> None:
    """Export the policy of CHECKPOINT, a .pt file of a training run, as ONNX.

    The normaliser, the squashing and the scaling are inside the file, and the specification is in its
    metadata. The file is run in onnxruntime and compared with torch.
    """
    from viatool.policy import describe
    from viatool.report import print_inspection
    from viatool.report.files import check_writable
    from viatool.train import export_checkpoint

    check_writable(output)
    export_checkpoint(checkpoint, output, seed=seed, map_path=map_path)
    if not quiet:
        print_inspection(describe(output), open_console())
