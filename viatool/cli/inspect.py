"""``viatool inspect``: what a policy file holds, and whether viatool can verify it."""

from __future__ import annotations

from pathlib import Path

import click

from viatool.cli import options
from viatool.cli.terminal import open_console


@click.command()
@options.policy_argument
@options.spec_option
def command(policy: Path, spec_path: Path | None) -> None:
    """Show the network and the specification of POLICY, checked against onnxruntime."""
    from viatool.policy import load_policy
    from viatool.report import print_policy

    print_policy(load_policy(policy, spec_path), open_console())
