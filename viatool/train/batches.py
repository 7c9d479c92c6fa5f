"""Seeds in batches: each batch is a run of its own that any worker may train, and the best policy of all is kept."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from viatool.errors import ConfigurationError
from viatool.policy import load_policy
from viatool.schedule import (
    Message,
    Piece,
    Progress,
    Scheduler,
    Serial,
    Span,
    ignore,
    locked,
    reporter,
    run_in_folder,
)
from viatool.train.configuration import TrainingConfiguration, load_configuration
from viatool.train.maps import TrainingMaps, load_maps, random_scenarios
from viatool.train.records import write_json, write_text
from viatool.train.selection import best_candidates
from viatool.train.trainer import BATCHES, CONFIGURATION, EVALUATION, STATE, TrainingResult, resume, train
from viatool.whole_file import whole_file
from viatool.world import Scenario, WorldMap

POLICY = "policy.onnx"


def complete(
    configuration: TrainingConfiguration,
    run_directory: str | Path,
    progress: Progress | None = None,
    *,
    maps: TrainingMaps | None = None,
) -> None:
    """Train in a folder, unless that is done already: begin, or go on with what was interrupted there.

    Parameters
    ----------
    configuration, run_directory, progress, maps
        As for `train`.

    Raises
    ------
    ConfigurationError
        If the folder holds a run with another configuration.
    """
    directory = Path(run_directory)
    if not (directory / CONFIGURATION).exists():
        train(configuration, directory, progress, maps=maps)
        return
    if load_configuration(directory / CONFIGURATION) != configuration:
        raise ConfigurationError(
            f"the training in {directory} has different settings",
            "choose another --output, or remove that folder",
        )
    if not (directory / EVALUATION).exists():
        resume(directory, progress, maps=maps)


def split_seeds(configuration: TrainingConfiguration, size: int) -> list[TrainingConfiguration]:
    """Return the configurations of batches of at most `size` seeds; the k-th has the run's `seed` plus k.

    Each is a run like any other: what it gives depends on its own seed and size alone, not on the other batches.
    """
    firsts = range(0, configuration.seeds, size)
    return [
        configuration.model_copy(
            update={"seeds": min(size, configuration.seeds - first), "seed": configuration.seed + number}
        )
        for number, first in enumerate(firsts)
    ]


def train_seeds(
    configuration: TrainingConfiguration,
    run_directory: str | Path,
    *,
    batch: int | None = None,
    scheduler: Scheduler | None = None,
    progress: Progress | None = None,
) -> TrainingResult:
    """Train all seeds, in one batch or in several that are trained side by side.

    Parameters
    ----------
    configuration : TrainingConfiguration
        Of the whole run.
    run_directory : path
        A new or empty folder. It becomes the run directory of the only batch, as `train` leaves it; or it gets a
        folder ``batch-K`` for each batch, ``batches.yaml``, and ``policy.onnx`` and ``evaluation.json`` of the best.
    batch : int, optional
        Seeds of a batch, by default all. Another number gives other policies; the scheduler does not.
    scheduler : Scheduler, optional
        Who trains; by default this process.
    progress : Progress, optional
        As for `train`.

    Raises
    ------
    ConfigurationError
        If the folder holds an earlier run, or a map cannot be trained on, see `TrainingMaps`.
    WorkError
        If workers died over a batch, or the cluster was lost.
    ViatoolError
        If a training diverges.
    """
    directory = Path(run_directory)
    if any((directory / name).exists() for name in (CONFIGURATION, BATCHES)):
        raise ConfigurationError(
            f"{directory} holds an earlier run", "choose another run directory, or resume that run"
        )
    maps = load_maps(configuration)  # a wrong one leaves no folder behind
    together = configuration.seeds if batch is None else batch
    if together < configuration.seeds:
        plan = {"batch": together, "configuration": configuration.model_dump(mode="json")}
        write_text(directory / BATCHES, yaml.safe_dump(plan, sort_keys=False))
    return _carry_out(configuration, together, maps, directory, scheduler, progress)


def resume_seeds(
    run_directory: str | Path, *, scheduler: Scheduler | None = None, progress: Progress | None = None
) -> TrainingResult:
    """Go on with a run of `train_seeds` or `train`; the result is that of an uninterrupted one.

    Raises
    ------
    ConfigurationError
        If there is no run in the folder, it is finished, or a map has changed.
    """
    directory = Path(run_directory)
    if (directory / EVALUATION).exists():
        raise ConfigurationError(
            f"the run in {directory} is finished", f"use {directory / POLICY}, or start another run"
        )
    if (directory / BATCHES).exists():
        configuration, together = _read_plan(directory / BATCHES)
    elif (directory / CONFIGURATION).exists():
        configuration = load_configuration(directory / CONFIGURATION)
        together = configuration.seeds
    else:
        raise ConfigurationError(f"there is no training run in {directory}", "give the folder of a run")
    return _carry_out(configuration, together, load_maps(configuration), directory, scheduler, progress)


def holds_progress(run_directory: str | Path) -> bool:
    """Tell whether a run that was interrupted would go on, and not begin anew: a state or a finished batch is there."""
    directory = Path(run_directory)
    folders = [directory, *directory.glob("batch-*")]
    return any((folder / name).exists() for folder in folders for name in (STATE, EVALUATION))


def _read_plan(path: Path) -> tuple[TrainingConfiguration, int]:
    try:
        plan = yaml.safe_load(path.read_text(encoding="utf-8"))
        return TrainingConfiguration.model_validate(plan["configuration"]), int(plan["batch"])
    except (OSError, ValueError, TypeError, KeyError, yaml.YAMLError) as error:
        raise ConfigurationError(
            f"{path} does not say what is trained here ({error})", "start a new run"
        ) from error


def failing_scenarios(run_directory: str | Path) -> list[tuple[WorldMap, tuple[Scenario, ...]]]:
    """Return by map the held-out scenarios in which the policy of a finished run does not arrive."""
    directory = Path(run_directory)
    plan = directory / BATCHES
    configuration = _read_plan(plan)[0] if plan.exists() else load_configuration(directory / CONFIGURATION)
    failures = json.loads((directory / EVALUATION).read_text(encoding="utf-8"))["failures"]
    maps, found = load_maps(configuration), []
    for name, world_map in zip(maps.names, maps.maps, strict=True):
        numbers = [number for where, number in failures if where == name]
        if numbers:
            drawn = random_scenarios(world_map, configuration.test_scenarios, configuration.test_seed)
            found.append((world_map, tuple(drawn[number] for number in numbers)))
    return found


@dataclass(frozen=True)
class _Batch:
    """One run of several seeds: its number, its folder below the whole run's, what is trained, and where."""

    number: int
    folder: str
    configuration: TrainingConfiguration
    maps: TrainingMaps


def _train_batch(directory: Path, batch: _Batch) -> dict[str, Any]:
    """Train a batch, or find it trained; return how the policy that it exported fared."""
    complete(batch.configuration, directory / batch.folder, reporter(), maps=batch.maps)
    found: dict[str, Any] = json.loads((directory / batch.folder / EVALUATION).read_text(encoding="utf-8"))
    return found


def _carry_out(
    configuration: TrainingConfiguration,
    together: int,
    maps: TrainingMaps,
    directory: Path,
    scheduler: Scheduler | None,
    progress: Progress | None,
) -> TrainingResult:
    started, scheduler = time.perf_counter(), scheduler or Serial()
    parts = split_seeds(configuration, together)
    folders = ["."] if len(parts) == 1 else [f"batch-{number}" for number in range(len(parts))]
    batches = [
        _Batch(number, folder, part, maps)
        for number, (folder, part) in enumerate(zip(folders, parts, strict=True))
    ]
    show = _Shown(batches, progress or ignore)
    if len(batches) < scheduler.workers:
        line = f"{len(batches)} of {scheduler.workers} workers have a batch of seeds, see --batch"
        show.progress("training", 0, 1, line)
    pieces = [Piece(Span(one.number, one.number + 1), show.name(one), one) for one in batches]
    with locked(directory):
        found = {
            piece.content.number: answer
            for piece, answer in run_in_folder(
                scheduler,
                directory,
                _train_batch,
                pieces,
                reads=lambda batch: [Path(batch.folder)],
                told=show.told,
            )
        }
        return _keep_best(configuration, batches, found, directory, time.perf_counter() - started)


class _Shown:
    """The progress of the whole run, from what its batches tell."""

    def __init__(self, batches: Sequence[_Batch], progress: Progress) -> None:
        self.progress, self.several = progress, len(batches) > 1
        self.shares = [batch.configuration.seeds for batch in batches]
        self.fractions = [0.0] * len(batches)

    def name(self, batch: _Batch) -> str:
        """Return what a batch is called."""
        return f"batch {batch.number}" if self.several else "training"

    def told(self, piece: Piece[_Batch], message: Message) -> None:
        """Show what a batch tells."""
        before = f"{piece.name}: " if self.several else ""
        self.fractions[piece.content.number] = message.fraction
        done = sum(share * part for share, part in zip(self.shares, self.fractions, strict=True))
        line = message.line and before + message.line
        self.progress(before + message.stage, done, sum(self.shares), line)


@dataclass(frozen=True)
class _Best:
    """The policy that a batch exported, by what policies are compared."""

    batch: int
    seed: int
    epoch: int
    score: float
    safety: tuple[float, ...]


def _keep_best(
    configuration: TrainingConfiguration,
    batches: Sequence[_Batch],
    found: dict[int, dict[str, Any]],
    directory: Path,
    seconds: float,
) -> TrainingResult:
    """Choose among the policies of the batches by the rule that chose them, and put the best beside the batches."""
    candidates = [
        _Best(number, one["seed"], one["epoch"], one["score"], tuple(one["safety"]))
        for number, one in sorted(found.items())
    ]
    best = best_candidates(candidates, 1, configuration.selection_tolerance)[0]
    record, path = found[best.batch], directory / POLICY
    several = len(batches) > 1
    if several:
        with whole_file(path) as draft:
            draft.write_bytes((directory / batches[best.batch].folder / POLICY).read_bytes())
        write_json(directory / EVALUATION, {"batch": best.batch, **record, "seconds": round(seconds, 1)})
    evaluation = {name: metrics for name, metrics in record.items() if isinstance(metrics, dict)}
    return TrainingResult(
        directory, path, load_policy(path), best.seed, best.epoch, evaluation, seconds,
        best.batch if several else None,
    )  # fmt: skip
