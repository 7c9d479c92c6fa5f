"""``viatool train``: from a map to an exported policy."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Literal

import click
from click.core import ParameterSource

from viatool.cli import options
from viatool.cli.command import Command
from viatool.cli.terminal import open_console, show_progress
from viatool.cli.work import keeping, worker_options

_WITH_RESUME = ("interrupted", "workers", "scheduler", "watch", "quiet")


@click.command(cls=Command)
@click.option(
    "--preset",
    type=click.Choice(["quick", "paper", "release", "study", "best"]),
    default="quick",
    show_default=True,
    help="A policy in minutes, the paper's schedule (by its text, or as its released code runs it), five seeds to "
    "compare methods, or the best policy.",
)
@click.option(
    "--config", "file", type=options.READABLE, metavar="FILE", help="YAML with any training option."
)
@click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="KEY=VALUE",
    help="One training option, on top of the preset and the file. Repeatable.",
)
@click.option(
    "--map",
    "map_paths",
    type=options.MAP,
    multiple=True,
    metavar="FILE",
    help="A map to train on; by default lab. Repeatable: the robots are shared out among the maps.",
)
@click.option(
    "--robot", metavar="NAME", help="A known robot that drives on every map instead of the map's own."
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
    "--batch",
    type=click.IntRange(min=1),
    metavar="N",
    help="Seeds that train as one batch, in a run of its own, so that several workers can train; by default all. "
    "Another N gives other policies.",
)
@worker_options("batches")
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
    help="Continue an interrupted run, with its own options; only --workers, --scheduler, --watch and --quiet go with "
    "it.",
)
@click.option(
    "--watch",
    is_flag=True,
    help="Draw the learning curves after every epoch: success, collisions, cost, lambda, u.",
)
@options.quiet_option
@click.pass_context
def command(
    ctx: click.Context,
    /,
    preset: str,
    file: Path | None,
    settings: tuple[str, ...],
    map_paths: tuple[Path, ...],
    robot: str | None,
    engine: str | None,
    seed: int | None,
    seeds: int | None,
    batch: int | None,
    workers: int | Literal["auto"],
    scheduler: str | None,
    output: Path | None,
    interrupted: Path | None,
    watch: bool,
    quiet: bool,
) -> None:
    """Train a policy with a CVaR constraint and export it, ready to verify.

    Options and metrics are explained in docs/training.md, methods in docs/methods.md. Two runs with the same
    seed on the same machine give the same policy, also when one was interrupted and resumed, and whoever trains.
    """
    if interrupted is not None:
        _refuse_options_of_a_new_run(ctx)
    from viatool.report.simulations.failures import draw_failures
    from viatool.schedule import Progress, open_scheduler
    from viatool.train import (
        TrainingResult,
        failing_scenarios,
        holds_progress,
        make_configuration,
        resume_seeds,
        train_seeds,
    )
    from viatool.train.curves import watching

    directory = output or Path("runs") / f"{preset}-{time.strftime('%Y%m%d-%H%M%S')}"

    def run(progress: Progress) -> TrainingResult:
        if interrupted is not None:
            return resume_seeds(interrupted, scheduler=open_scheduler(workers, scheduler), progress=progress)
        names = tuple(str(path) for path in map_paths)
        chosen = {
            "map": names[0] if len(names) == 1 else names or None,
            "robot": robot,
            "engine": engine,
            "seed": seed,
            "seeds": seeds,
        }
        configuration = make_configuration(preset, file, settings, **chosen)
        who = open_scheduler(workers, scheduler)
        return train_seeds(configuration, directory, batch=batch, scheduler=who, progress=progress)

    kept = interrupted or directory
    told = keeping(kept, "what is trained is", f"--resume {kept}", holds_progress)
    with told, show_progress(quiet=quiet, whole="training") as progress:
        result = run(watching(progress, kept) if watch else progress)
    drawn = draw_failures(result.policy, failing_scenarios(kept), kept)
    if quiet:
        return
    console = open_console()
    for line in [*result.lines(), *(f"failures    {path}" for path in drawn)]:
        console.print(line, markup=False, soft_wrap=True)


def _refuse_options_of_a_new_run(ctx: click.Context) -> None:
    """Refuse by name what a run that goes on would silently do without."""
    given = [
        param.opts[0]
        for param in ctx.command.params
        if param.name not in _WITH_RESUME
        and param.expose_value
        and ctx.get_parameter_source(param.name or "") is ParameterSource.COMMANDLINE
    ]
    if given:
        raise click.UsageError(
            f"{', '.join(given)}: a run that goes on with --resume keeps the options with which it began", ctx
        )
