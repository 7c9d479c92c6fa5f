"""``viatool reproduce``: run the paper's experiments and write their pages."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import click

from viatool.cli import options
from viatool.cli.command import Command
from viatool.cli.terminal import open_console
from viatool.cli.work import keeping, worker_options
from viatool.studies import STUDIES


@click.command(cls=Command)
@click.argument("studies", nargs=-1, required=True, type=click.Choice([*STUDIES, "all"]), metavar="STUDY...")
@click.option(
    "--preset",
    default="study",
    show_default=True,
    metavar="NAME",
    help="Training preset from which every training starts.",
)
@click.option(
    "--epochs",
    type=click.IntRange(min=1),
    metavar="N",
    help="Epochs of every training; by default the preset's.",
)
@click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="KEY=VALUE",
    help="One option for every training, on top of the preset and the study. Repeatable.",
)
@click.option(
    "--seeds",
    type=click.IntRange(min=2),
    default=5,
    show_default=True,
    metavar="N",
    help="Policies of each method.",
)
@options.seed_option
@click.option(
    "--scenarios",
    type=click.IntRange(min=1),
    default=500,
    show_default=True,
    metavar="N",
    help="Held-out random scenarios on which every policy is evaluated.",
)
@click.option(
    "--footprint",
    type=click.FloatRange(min=0.0),
    default=0.0,
    metavar="M",
    help="Radius in metres of a disc from which the verification measures; by default the map's footprint.",
)
@click.option(
    "--output",
    "-o",
    type=options.WRITABLE,
    default=Path("runs/reproduce"),
    show_default=True,
    metavar="DIRECTORY",
    help="Folder of the trainings and records. The same command continues where an earlier one ended.",
)
@click.option(
    "--results",
    type=options.WRITABLE,
    metavar="DIRECTORY",
    help="Folder of the pages and their data; by default OUTPUT/results.",
)
@worker_options("tasks")
@click.option(
    "--render-only", is_flag=True, help="Write the pages from the data that are there; run nothing."
)
@options.threads_option
@options.quiet_option
def command(
    studies: tuple[str, ...],
    preset: str,
    epochs: int | None,
    settings: tuple[str, ...],
    seeds: int,
    seed: int,
    scenarios: int,
    footprint: float,
    output: Path,
    results: Path | None,
    workers: int | Literal["auto"],
    scheduler: str | None,
    render_only: bool,
    threads: int | None,
    quiet: bool,
) -> None:
    """Run the paper's experiments, STUDY by STUDY, and write their pages.

    Every method is trained with several seeds, evaluated on fixed and on held-out random scenarios, and
    verified. Finished work is kept and interrupted trainings are resumed: the same command, given again at any
    time, ends in the same results. See docs/reproduce.md.
    """
    from viatool.schedule import open_scheduler
    from viatool.studies.progress import open_board
    from viatool.studies.reproduction import render, reproduce
    from viatool.studies.study import Options

    names = STUDIES if "all" in studies else tuple(dict.fromkeys(studies))
    target = results if results is not None else output / "results"
    if render_only:
        pages = render(names, target)
    else:
        chosen = Options(
            preset=preset,
            settings=settings if epochs is None else (*settings, f"epochs={epochs}"),
            seeds=seeds,
            seed=seed,
            scenarios=scenarios,
            footprint=footprint,
        )
        who = open_scheduler(workers, scheduler)
        kept = keeping(output, "finished tasks and begun trainings are", "the same command")
        with kept, open_board(open_console(stderr=True), quiet=quiet) as board:
            pages = reproduce(names, chosen, output, target, board, scheduler=who)
    if not quiet:
        for page in pages:
            click.echo(page)
