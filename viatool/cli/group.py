"""The command group: commands are imported when they are asked for, errors become exit codes in one place."""

from __future__ import annotations

import io
import sys
import warnings
from collections.abc import Sequence
from difflib import get_close_matches
from importlib import import_module
from typing import Any, NoReturn

import click

from viatool.cli.failures import compose, explain, reader_may_go
from viatool.cli.interrupts import terminated_as_interrupted
from viatool.cli.started import begin
from viatool.errors import PolicyWarning

COMMANDS = (
    "init",
    "verify",
    "certify",
    "mission",
    "margin",
    "run",
    "replay",
    "explain",
    "gate",
    "compare",
    "report",
    "check",
    "train",
    "export",
    "import",
    "bounds",
    "simulate",
    "inspect",
    "doctor",
    "measure-errors",
    "map",
    "reproduce",
    "completion",
)


class CommandGroup(click.Group):
    """A click group whose commands live in modules of the same name in this package."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """List the commands in the order in which a user meets them."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import one command; None if there is no such command."""
        if cmd_name not in COMMANDS:
            return None
        command = import_module(f"viatool.cli.{cmd_name.replace('-', '_')}").command
        assert isinstance(command, click.Command)
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command; one that does not exist is refused with those that are written nearly like it."""
        name = click.utils.make_str(args[0])
        if name not in COMMANDS and not name.startswith("-"):
            near = " or ".join(f"'{one}'" for one in get_close_matches(name, COMMANDS, n=3))
            meant = f" (did you mean {near}?)" if near else ""
            raise click.UsageError(f"there is no command '{name}'{meant}", ctx)
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands, each with its summary as a whole."""
        whole = 10**4
        commands = ((name, self.get_command(ctx, name)) for name in self.list_commands(ctx))
        lines = [(name, command.get_short_help_str(whole)) for name, command in commands if command]
        with formatter.section("Commands"):
            formatter.write_dl(lines)

    def make_context(self, *args: Any, **extra: Any) -> click.Context:
        """Read the arguments, which may print a help that nobody reads to its end."""
        with reader_may_go():
            return super().make_context(*args, **extra)

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command, whose output somebody may not read to its end."""
        with reader_may_go():
            return super().invoke(ctx)

    def main(self, args: Sequence[str] | None = None, *rest: Any, **extra: Any) -> NoReturn:
        """Run a command and leave the process with an exit code of the contract.

        Parameters
        ----------
        args : sequence of str, optional
            The arguments after the program's name; those of the process by default.
        *rest, **extra
            As for `click.Group.main`; ``standalone_mode`` is always off.
        """
        begin()
        extra["standalone_mode"] = False
        extra.setdefault("prog_name", "viatool")
        _accept_any_text()
        _warn_in_own_words()
        try:
            with terminated_as_interrupted():
                code = super().main(args, *rest, **extra)
        except SystemExit:  # shell completion leaves on its own
            raise
        except BaseException as error:  # every exception must become one exit code
            code, message = explain(error)
            if message:
                click.echo(message, err=True)
        sys.exit(code if isinstance(code, int) else 0)


def _warn_in_own_words() -> None:
    """Show what viatool warns of as its other messages, and other warnings as Python does."""
    as_python_does = warnings.formatwarning

    def formatted(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> str:
        if issubclass(category, PolicyWarning):
            return compose(str(message)).replace("error: ", "warning: ", 1) + "\n"
        return as_python_does(message, category, *where, **more)

    warnings.formatwarning = formatted


def _accept_any_text() -> None:
    """Let stdout and stderr replace what their encoding lacks, such as the bars of a report in a Windows pipe."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


def _print_versions(ctx: click.Context, param: click.Parameter, wanted: bool) -> None:
    """Print a line for each version and leave."""
    if wanted and not ctx.resilient_parsing:
        from viatool.versions import installed_versions

        for name, version in installed_versions().items():
            click.echo(f"{name} {version}")
        ctx.exit()


@click.group(
    cls=CommandGroup,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog=(
        "Exit codes: 0 passed, 1 gate failed, 2 usage or unreadable input, 3 internal error or self-check "
        "mismatch, 5 nothing was evaluated, 130 interrupted, 141 the output was not read to its end."
    ),
)
@click.option(
    "--version",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_print_versions,
    help="Show the versions of viatool and of what it runs on.",
)
@click.pass_context
def main(ctx: click.Context) -> None:
    """Tell whether a navigation policy can be made to drive too close to something.

    viatool proves, for every visited state, that no sensor error up to the given bound can do it; or it hands
    out an observation that does; or it says that it does not know.
    """
    if ctx.invoked_subcommand is None:
        click.echo(ctx.get_help())
