"""``viatool import``: from a saved model of another framework to an ONNX policy."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from viatool.cli import options
from viatool.cli.command import Command
from viatool.cli.numbers import finite
from viatool.cli.terminal import open_console

if TYPE_CHECKING:
    from viatool.importing import Imported


class NumbersType(click.ParamType):  # type: ignore[type-arg]  # generic only in newer click
    """Numbers between commas, such as ``0,-1``."""

    name = "numbers"

    def get_metavar(self, param: click.Parameter, ctx: click.Context | None = None) -> str:
        """Show what may be written."""
        return "NUMBER,..."

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float, ...]:
        """Read them."""
        if isinstance(value, tuple):
            return value
        numbers = [finite(part.strip()) for part in str(value).split(",")]
        if any(number is None for number in numbers):
            self.fail(f"'{value}' is no list of finite numbers between commas", param, ctx)
        return tuple(number for number in numbers if number is not None)


@click.command(cls=Command)
@click.argument("model", type=options.READABLE)
@options.policy_output_option
@click.option(
    "--vecnormalize",
    type=options.READABLE,
    metavar="FILE",
    help="The VecNormalize that the model was trained in, as VecNormalize.save wrote it.",
)
@click.option(
    "--spec",
    "spec_path",
    type=options.READABLE,
    metavar="FILE",
    help="Put this specification into the policy; without it one is proposed.",
)
@click.option(
    "--write-spec",
    type=options.WRITABLE,
    metavar="FILE",
    help="Where to write the proposed specification; by default beside the policy, as .yaml.",
)
@click.option(
    "--activation",
    metavar="NAME",
    help="The torch.nn class between the layers, such as ReLU, where the model's own cannot be read.",
)
@click.option("--low", type=NumbersType(), help="TorchScript: the commands for which its outputs are -1.")
@click.option("--high", type=NumbersType(), help="TorchScript: the commands for which its outputs are 1.")
@click.option(
    "--input-size",
    type=click.IntRange(min=1),
    metavar="N",
    help="TorchScript: the length of the observation.",
)
@click.option(
    "--trust",
    is_flag=True,
    help="Run the pickles in the files, and whatever they say: for models with classes of their own, from someone "
    "whom you trust.",
)
@options.quiet_option
def command(
    model: Path,
    output: Path,
    spec_path: Path | None,
    write_spec: Path | None,
    quiet: bool,
    **given: Any,
) -> None:
    """Write MODEL, a zip of Stable-Baselines3 or a TorchScript actor, as ONNX.

    The normaliser, the squashing, the scaling and the clip of the actions are inside the file; it is run in
    onnxruntime and compared with torch. A specification is proposed beside it, with comments on what was guessed.
    Nothing of a pickle is run without --trust.
    """
    from viatool.importing import ImportRequest, import_policy
    from viatool.policy import describe
    from viatool.report import print_inspection
    from viatool.report.files import check_writable, write_whole

    check_writable(output)
    sidecar = None
    if spec_path is None:
        sidecar = write_spec or output.with_suffix(".yaml")
        check_writable(sidecar)
        if write_spec is None and sidecar.exists():
            raise click.UsageError(
                f"'{sidecar}' is there already: give it with --spec to put it into the policy, or another file with "
                "--write-spec"
            )
    elif write_spec is not None:
        raise click.UsageError("--write-spec writes a proposal, but --spec gives a specification")
    request = ImportRequest(
        model,
        given["vecnormalize"],
        spec_path,
        given["activation"],
        _limits(given["low"], given["high"]),
        given["input_size"],
        given["trust"],
    )
    imported = import_policy(request, output)
    if sidecar is not None and imported.proposal is not None:
        write_whole(sidecar, imported.proposal.to_yaml().encode())
    if not quiet:
        print_inspection(describe(output), open_console())
        _print_import(imported, output, sidecar)


def _limits(
    low: tuple[float, ...] | None, high: tuple[float, ...] | None
) -> tuple[tuple[float, float], ...] | None:
    if low is None and high is None:
        return None
    if low is None or high is None or len(low) != len(high):
        raise click.UsageError("--low and --high belong together, with a number for each output")
    return tuple(zip(low, high, strict=True))


def _print_import(imported: Imported, output: Path, sidecar: Path | None) -> None:
    click.echo("imported")
    for words in imported.inside:
        click.echo(f"  {words}")
    if sidecar is None or imported.proposal is None:
        return
    click.echo(f"proposed specification: {sidecar}, from {imported.proposal.source}")
    for guess in imported.proposal.guesses:
        click.echo(f"  guessed: {guess}")
    if not imported.proposal.is_complete:
        click.echo(f"  to fill in: every FILL_IN of {sidecar}; it is refused until then")
    click.echo(f"next: viatool doctor {output} --spec {sidecar} --map MAP")
