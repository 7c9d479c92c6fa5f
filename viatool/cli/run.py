"""``viatool run``: all that a project file asks for."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from viatool.cli import options
from viatool.cli.command import Command
from viatool.cli.terminal import open_console, show_progress
from viatool.cli.work import keeping, worker_options

if TYPE_CHECKING:
    from viatool.projects import Catalogue

KINDS = ("verify", "certify", "mission", "margin")
"""Commands that a check may be."""


@click.command(cls=Command, context_settings={"ignore_unknown_options": True})
@click.argument("overrides", nargs=-1, type=click.UNPROCESSED, metavar="[OPTIONS OF THE CHECKS]")
@click.option(
    "--project",
    type=options.READABLE,
    metavar="FILE",
    help="The project file; by default the nearest viatool.toml, or pyproject.toml with [tool.viatool], here or above.",
)
@click.option(
    "--keyword",
    "-k",
    default="",
    metavar="EXPRESSION",
    help="Run the cells whose names have these words, such as 'lab and not td3'.",
)
@click.option(
    "--last-failed",
    is_flag=True,
    help="Run only the cells that have not passed with their present inputs; all of them if there is none.",
)
@click.option("--list", "listing", is_flag=True, help="Name the cells, and run none.")
@click.option(
    "--resume",
    is_flag=True,
    help="Keep cells that are finished with the same inputs, and go on with what was begun.",
)
@worker_options("cells")
@click.option(
    "--output",
    "-o",
    type=options.WRITABLE,
    metavar="DIR",
    help="The folder of all that is written, instead of the file's.",
)
@options.threads_option
@options.quiet_option
@click.pass_context
def command(ctx: click.Context, /, overrides: tuple[str, ...], **given: Any) -> None:
    """Run all that a project file asks for: policies x maps x checks, with one page and one exit code.

    Options of the checks' commands, such as --eps 0.02 or --fail-under 0.9, win over the file. The exit code is the
    worst of all cells that were asked for, in the order 3, 2, 5, 1, 0.
    """
    from viatool.projects import (
        Request,
        Selection,
        choose_cells,
        expand,
        find_project,
        load_project,
        print_cells,
        print_summary,
        read_overrides,
        run_cells,
    )
    from viatool.schedule import open_scheduler

    catalogue = commands_of_checks()
    won = read_overrides(overrides, catalogue)
    project = load_project(given["project"] or find_project(Path.cwd()))
    cells = expand(project, catalogue, won)
    request = Request(Selection(given["keyword"]), given["last_failed"], given["resume"], given["output"])
    folder = request.folder(project)
    if given["listing"]:
        print_cells(choose_cells(project, cells, catalogue, request), open_console())
        return
    scheduler = open_scheduler(given["workers"], given["scheduler"])
    with keeping(folder, "finished cells are"), show_progress(quiet=given["quiet"]) as progress:
        summary = run_cells(project, cells, catalogue, carry_out, scheduler, request, progress)
    if not given["quiet"]:
        print_summary(summary, folder / "index.html", open_console())
    ctx.exit(summary.exit_code)


def commands_of_checks() -> Catalogue:
    """Return the commands that a check may be, and which of their options make the gate."""
    from viatool.cli.gating import contested_option, gate_options
    from viatool.cli.group import main
    from viatool.projects import Catalogue

    root = click.Context(main)
    commands = {kind: main.get_command(root, kind) for kind in KINDS}
    gate = gate_options(contested_option(click.command()(lambda: None)))
    names = frozenset(name.removeprefix("--") for option in gate.params for name in option.opts)
    return Catalogue({kind: found for kind, found in commands.items() if found is not None}, names)


def carry_out(words: Sequence[str]) -> tuple[int, str]:
    """Run one command line of viatool in this process; return its exit code and what it said on stderr."""
    import io
    from contextlib import redirect_stderr, redirect_stdout

    from viatool.cli.group import main

    said = io.StringIO()
    with redirect_stdout(io.StringIO()), redirect_stderr(said):
        try:
            main(list(words))
        except SystemExit as leaving:
            return int(leaving.code or 0), said.getvalue()
    return 0, said.getvalue()
