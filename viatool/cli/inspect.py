"""``viatool inspect``: what a policy file holds, and whether viatool can verify it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from viatool.cli import options
from viatool.cli.terminal import open_console

if TYPE_CHECKING:
    from viatool.policy import Policy


@click.command()
@click.argument("policies", metavar="POLICY...", type=options.POLICY, nargs=-1, required=True)
@options.spec_option
@click.option(
    "--write-spec",
    type=options.WRITABLE,
    metavar="FILE",
    help="Write the specification of the one policy as YAML, or a template of one to fill in.",
)
def command(policies: tuple[Path, ...], spec_path: Path | None, write_spec: Path | None) -> None:
    """Show the network and the specification of each POLICY, checked against onnxruntime."""
    from viatool.policy import load_policy
    from viatool.report import print_policy
    from viatool.report.files import check_writable, write_whole

    if write_spec is not None:
        if len(policies) > 1:
            raise click.UsageError("--write-spec describes one policy, and several were given")
        check_writable(write_spec)
    for path in policies:
        policy = load_policy(path, spec_path)
        if write_spec is not None:
            write_whole(write_spec, _specification(policy).encode())
        print_policy(policy, open_console())


def _specification(policy: Policy) -> str:
    from viatool.policy import ActionChannel, ObservationChannel, PolicySpecification

    if policy.spec is not None:
        return policy.spec.to_yaml()
    template = PolicySpecification(
        observation=[ObservationChannel(name="observation", size=policy.input_size)],
        action=[ActionChannel(name=f"action_{i}", lower=-1.0, upper=1.0) for i in range(policy.output_size)],
    )
    return f"# A template: name the channels, their units and kinds; see docs/specification.md.\n{template.to_yaml()}"
