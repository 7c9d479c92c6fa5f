"""``viatool completion``: the script that lets a shell complete commands, options, samples and files."""

from __future__ import annotations

import click

from viatool.cli.command import Command


@click.command(cls=Command)
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
@click.pass_context
def command(ctx: click.Context, /, shell: str) -> None:
    """Print the script with which SHELL completes viatool.

    Load it where the shell starts: ``eval "$(viatool completion bash)"`` in ~/.bashrc,
    ``eval "$(viatool completion zsh)"`` in ~/.zshrc, or ``viatool completion fish | source`` in
    ~/.config/fish/config.fish.
    """
    from click.shell_completion import get_completion_class

    complete = get_completion_class(shell)
    assert complete is not None
    group = ctx.find_root().command
    click.echo(complete(group, {}, "viatool", "_VIATOOL_COMPLETE").source())
