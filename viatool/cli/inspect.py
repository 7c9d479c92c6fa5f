"""``viatool inspect``: what a policy file holds, and whether viatool can verify it."""

from __future__ import annotations

from pathlib import Path

import click

from viatool.cli import options
from viatool.cli.terminal import open_console


@click.command()
@click.argument("policies", metavar="POLICY...", type=options.READABLE, nargs=-1, required=True)
@options.spec_option
def command(policies: tuple[Path, ...], spec_path: Path | None) -> None:
    """Show the network and the specification of each POLICY, checked against onnxruntime."""
    from viatool.policy import load_policy
    from viatool.report import print_policy

    for policy in policies:
        print_policy(load_policy(policy, spec_path), open_console())
