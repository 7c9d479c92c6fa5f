"""``viatool check``: recheck a folder of evidence without the engine that wrote it."""

from __future__ import annotations

from pathlib import Path

import click

from viatool.cli import options
from viatool.cli.command import Command


@click.command(cls=Command)
@click.argument("folder", type=options.READABLE)
@click.option(
    "--expect",
    metavar="SHA256",
    help="Exit 1 if the manifest has another sha256 than the one that was noted when the folder was written.",
)
@options.quiet_option
@click.pass_context
def command(ctx: click.Context, /, folder: Path, expect: str | None, quiet: bool) -> None:
    """Recheck FOLDER, the evidence that ``viatool verify --output evidence:FOLDER`` wrote.

    Compares files with the manifest and inputs with the digests of the report, counts the figures again, runs
    counterexamples again, and bounds where safe states may drive, with nothing of the engine. What is not rechecked is
    named. Exits with 1 if anything contradicts the folder or a safe state is not confirmed, and with 5 if no verdict
    could be rechecked.
    """
    from viatool.errors import ConfigurationError
    from viatool.recheck import UnreadableFolder, recheck
    from viatool.report.foreign import shown

    try:
        found = recheck(folder)
    except UnreadableFolder as error:
        hint = "name a folder that viatool verify --output evidence:DIR wrote"
        raise ConfigurationError(str(error), hint) from error
    if expect is not None:
        same = found.digest == expect.lower()
        found.expect(same, f"manifest.json: its sha256 is {found.digest}, expected {expect}")
    for line in found.lines() if not quiet else []:
        click.echo(shown(line))
    ctx.exit(found.code)
