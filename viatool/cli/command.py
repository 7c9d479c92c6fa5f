"""A command that takes each option once, unless the option says that it is repeatable."""

from __future__ import annotations

from collections import Counter
from typing import Any

import click

from viatool.cli.sections import write_options
from viatool.cli.verbosity import verbose_option


class Command(click.Command):
    """A click command that refuses an option which is given twice, of which click would silently keep the last.

    Its help shows many options in sections, and is asked for by -h as well, wherever the command is made. Each has
    ``--verbose``.
    """

    def __init__(self, *args: Any, **settings: Any) -> None:
        super().__init__(*args, **settings)
        self.params.append(verbose_option())

    def get_help_option_names(self, ctx: click.Context) -> list[str]:
        """Return both names: click keeps the option that it makes of those of the first context."""
        return ["-h", "--help"]

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the options into the help."""
        write_options(self.get_params(ctx), ctx, formatter)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Read the arguments; what is repeated is refused before anything else is checked."""
        if not ctx.resilient_parsing:
            _, _, order = self.make_parser(ctx).parse_args(args=list(args))
            for param, times in Counter(order).items():
                if times > 1 and isinstance(param, click.Option) and _takes_one_value(param):
                    raise click.BadParameter(
                        f"it is given {'twice' if times == 2 else f'{times} times'}, and takes one value; "
                        "leave all but one of them out",
                        ctx=ctx,
                        param=param,
                    )
        return super().parse_args(ctx, args)


def _takes_one_value(option: click.Option) -> bool:
    return not (option.multiple or option.is_flag or option.count)
