"""``viatool train``: from a map to an exported policy."""

from __future__ import annotations

import time
from pathlib import Path

import click

from viatool.cli import options
from viatool.cli.terminal import open_console


@click.command()
@click.option(
    "--preset",
    type=click.Choice(["quick", "paper", "study", "best"]),
    default="quick",
    show_default=True,
    help="A policy in minutes, the paper's schedule, five seeds to compare methods, or the best policy.",
)
@click.option(
    "--config", "file", type=options.READABLE, metavar="FILE", help="YAML with any training option."
)
@click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="KEY=VALUE",
    help="One training option, over the preset and the file. Repeatable.",
)
@click.option(
    "--map", "map_path", type=options.MAP, metavar="FILE", help="The map to train on; by default lab."
)
@click.option(
    "--engine",
    type=click.Choice(["kinematic", "bullet"]),
    help="The simulator to train in; by default kinematic.",
)
@click.option("--seed", type=click.IntRange(min=0), metavar="N", help="Seed of the run.")
@click.option(
    "--seeds",
    type=click.IntRange(min=1),
    metavar="N",
    help="Policies trained side by side; the best is kept.",
)
@click.option(
    "--output",
    "-o",
    type=options.WRITABLE,
    metavar="DIRECTORY",
    help="A new or empty run directory; by default runs/PRESET-TIME.",
)
@click.option(
    "--resume",
    "interrupted",
    type=options.READABLE,
    metavar="DIRECTORY",
    help="Go on with an interrupted run, with its own options.",
)
@options.quiet_option
def command(
    preset: str,
    file: Path | None,
    settings: tuple[str, ...],
    map_path: Path | None,
    engine: str | None,
    seed: int | None,
    seeds: int | None,
    output: Path | None,
    interrupted: Path | None,
    quiet: bool,
) -> None:
    """Train a policy with a CVaR constraint and export it, ready to verify.

    Options and metrics are explained in docs/training.md, methods in docs/methods.md. Two runs with the same
    seed on the same machine give the same policy, also when one was interrupted and resumed.
    """
    from viatool.train import Silence, TrainingResult, console_progress, make_configuration, resume, train
    from viatool.train.progress import Progress

    directory = output or Path("runs") / f"{preset}-{time.strftime('%Y%m%d-%H%M%S')}"

    def run(progress: Progress) -> TrainingResult:
        if interrupted is not None:
            return resume(interrupted, progress)
        map_name = None if map_path is None else str(map_path)
        chosen = {"map": map_name, "engine": engine, "seed": seed, "seeds": seeds}
        configuration = make_configuration(preset, file, settings, **chosen)
        return train(configuration, directory, progress)

    if quiet:
        run(Silence())
        return
    with console_progress() as progress:
        result = run(progress)
    console = open_console()
    for line in result.lines():
        console.print(line, markup=False, soft_wrap=True)
