"""``viatool inspect``: what a policy file holds, and whether viatool can verify it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from viatool.cli import options
from viatool.cli.command import Command
from viatool.cli.failures import explain
from viatool.cli.terminal import open_console

STDOUT = Path("-")


@click.command(cls=Command)
@click.argument("policies", metavar="POLICY...", type=options.POLICY, nargs=-1, required=True)
@options.spec_option
@options.graph_options
@click.option(
    "--output",
    "-o",
    metavar="json:PATH",
    help="With one policy: write everything about it as JSON; PATH - is stdout.",
)
@click.option(
    "--write-spec",
    type=options.WRITABLE,
    metavar="FILE",
    help="With one policy: write its specification as YAML, or propose one from what its exporter states or from its "
    "sizes, with comments on what was guessed; - is stdout.",
)
@click.option(
    "--from",
    "stated",
    type=options.READABLE,
    metavar="FILE",
    help="With --write-spec: take what a parameter file of a ROS package states (YAML), or a policy contract (JSON; "
    "policy_contract.json beside the policy is found without it).",
)
@click.pass_context
def command(ctx: click.Context, /, policies: tuple[Path, ...], **given: Any) -> None:
    """Show the network and the specification of each POLICY, checked against onnxruntime.

    A policy that cannot be verified is shown as far as it can be read, with everything that prevents it; the
    exit code is then 2, or 3 where the network and onnxruntime disagree.
    """
    json_path = _json_path(given["output"])
    if given["stated"] is not None and given["write_spec"] is None:
        raise click.UsageError("--from says what a specification is made of: give --write-spec FILE as well")
    targets = [path for path in (json_path, given["write_spec"]) if path is not None]
    _check_targets(targets, policies)
    codes = [
        _inspect(path, json_path=json_path, **{name: given[name] for name in given if name != "output"})
        for path in policies
    ]
    ctx.exit(max(codes))


def _inspect(
    path: Path,
    *,
    spec_path: Path | None,
    graph_input: tuple[str, ...],
    graph_output: str | None,
    json_path: Path | None,
    write_spec: Path | None,
    stated: Path | None,
) -> int:
    """Look into one policy; return the exit code that it would have by itself."""
    from viatool.errors import ViatoolError
    from viatool.policy import describe
    from viatool.proposals import describe_with_memory, specification_text
    from viatool.report import print_inspection

    try:
        look = describe if write_spec is None else describe_with_memory
        found = look(path, spec_path, input_name=graph_input, output_name=graph_output)
        if STDOUT not in (json_path, write_spec):
            print_inspection(found, open_console())
        if json_path is not None:
            _write(json_path, found.to_json())
        if found.failure is not None:
            raise found.failure
        if write_spec is not None:
            _write(write_spec, specification_text(found, stated))
    except ViatoolError as error:
        code, message = explain(error)
        click.echo(message, err=True)
        return code
    return 0


def _write(path: Path, text: str) -> None:
    from viatool.report.files import write_whole

    if path == STDOUT:
        click.echo(text, nl=False)
    else:
        write_whole(path, text.encode())


def _check_targets(targets: list[Path], policies: tuple[Path, ...]) -> None:
    """Refuse files that could not be written before anything is read."""
    from viatool.report.files import check_writable

    if targets and len(policies) > 1:
        raise click.UsageError("--output and --write-spec describe one policy, but several were given")
    if len(set(targets)) < len(targets):
        raise click.UsageError(f"--output and --write-spec both go to '{targets[0]}'")
    for path in targets:
        if path != STDOUT:
            check_writable(path)


def _json_path(text: str | None) -> Path | None:
    if text is None:
        return None
    name, colon, path = text.partition(":")
    if name != "json" or not colon or not path:
        raise click.UsageError(f"'{text}' is not json:PATH; inspect writes JSON only")
    return Path(path)
