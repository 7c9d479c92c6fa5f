"""The training run: Algorithm 1 with S seeds side by side, evaluation, choice of a policy, and its export."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
import torch

from viatool.errors import ConfigurationError
from viatool.policy import Policy
from viatool.schedule import Progress, ignore
from viatool.train.configuration import TrainingConfiguration, load_configuration
from viatool.train.epoch import run_epoch, stage
from viatool.train.export import export_actor, training_record
from viatool.train.feedback import find_feedback
from viatool.train.health import complaints, largest_return
from viatool.train.maps import TrainingMaps
from viatool.train.observation import make_specification
from viatool.train.records import (
    MetricsLog,
    installed_versions,
    load_checkpoint,
    write_checkpoint,
    write_json,
    write_text,
)
from viatool.train.run import TrainingRun, begin_run, checkpoint, resume_run, run_state
from viatool.train.scoring import score_missions, score_safety
from viatool.train.selection import Candidate, best_candidates, choose, evaluate_policy, validate
from viatool.whole_file import remove_drafts

CONFIGURATION = "configuration.yaml"
BATCHES = "batches.yaml"  # of a run of several batches
STATE = "state.pt"
EVALUATION = "evaluation.json"


@dataclass(frozen=True, eq=False)
class TrainingResult:
    """What a training run gave.

    Parameters
    ----------
    run_directory, policy_path : Path
        Where everything stands, and the exported policy.
    policy : Policy
        The exported policy, loaded.
    seed, epoch : int
        Which candidate was chosen.
    evaluation : dict
        Of the exported program: rates and means on ``fixed`` (the map's scenarios) and ``held_out`` ones.
    seconds : float
        Wall time.
    batch : int, optional
        Which of several batches the seed belongs to.
    """

    run_directory: Path
    policy_path: Path
    policy: Policy
    seed: int
    epoch: int
    evaluation: dict[str, dict[str, float]]
    seconds: float
    batch: int | None = None

    def lines(self) -> list[str]:
        """Return the result for people."""
        batch = "" if self.batch is None else f" of batch {self.batch}"
        lines = [
            f"policy      {self.policy_path}",
            f"chosen      seed {self.seed}{batch} after epoch {self.epoch}",
            f"time        {self.seconds:.0f} s",
        ]
        width = max(11, *map(len, self.evaluation)) if self.evaluation else 11
        for name, metrics in self.evaluation.items():
            lines.append(
                f"{name:<{width}} {metrics['episodes']:.0f} scenarios: success {metrics['success_rate']:.1%}, "
                f"collisions {metrics['collision_rate']:.1%}, timeouts {metrics['timeout_rate']:.1%}, "
                f"cost {metrics['average_cost']:.2f}"
            )
        return lines


def train(
    configuration: TrainingConfiguration,
    run_directory: str | Path,
    progress: Progress | None = None,
    *,
    maps: TrainingMaps | None = None,
) -> TrainingResult:
    """Train, choose and export a policy.

    Parameters
    ----------
    configuration : TrainingConfiguration
        See `make_configuration`.
    run_directory : path
        A new or empty folder; receives ``configuration.yaml``, ``versions.json``, ``metrics.csv``,
        ``tensorboard/``, ``checkpoints/``, ``state.pt`` until it ends, ``policy.onnx`` and
        ``evaluation.json``.
    progress : Progress, optional
        What the run reports to; by default nothing.
    maps : TrainingMaps, optional
        The configuration's maps where they are loaded already, for a process that does not see their files.

    Returns
    -------
    TrainingResult

    Raises
    ------
    ConfigurationError
        If the folder holds an earlier run, or a map cannot be trained on, see `TrainingMaps`.
    ViatoolError
        If the training diverges.
    """
    directory = Path(run_directory)
    if any((directory / name).exists() for name in (CONFIGURATION, BATCHES)):
        raise ConfigurationError(
            f"{directory} holds an earlier run", "choose another run directory, or resume that run"
        )
    with _reproducible_torch():
        run = begin_run(configuration, maps)  # reads the maps: a wrong one leaves no folder behind
        directory.mkdir(parents=True, exist_ok=True)
        write_text(directory / CONFIGURATION, configuration.to_yaml())
        return _train(run, directory, progress or ignore)


def resume(
    run_directory: str | Path, progress: Progress | None = None, *, maps: TrainingMaps | None = None
) -> TrainingResult:
    """Go on with a run that was interrupted at any moment; the result is that of an uninterrupted one.

    Parameters
    ----------
    run_directory : path
        Of the interrupted run. Without a saved state in it, the run begins anew with its configuration.
    progress, maps : optional
        As for `train`.

    Raises
    ------
    ConfigurationError
        If there is no run in the folder, it is finished, or a map has changed.
    """
    directory = Path(run_directory)
    if not (directory / CONFIGURATION).exists():
        raise ConfigurationError(f"there is no training run in {directory}", "give the folder of a run")
    if (directory / EVALUATION).exists():
        raise ConfigurationError(
            f"the run in {directory} is finished", f"use {directory / 'policy.onnx'}, or start another run"
        )
    for folder in (directory, directory / "checkpoints"):
        remove_drafts(folder)  # large ones
    with _reproducible_torch():
        if (directory / STATE).exists():
            run = resume_run(load_checkpoint(directory / STATE), directory, maps)
        else:
            run = begin_run(load_configuration(directory / CONFIGURATION), maps)
            line = f"no state of {directory} was saved before it ended: it begins anew at epoch 1"
            (progress or ignore)(stage(run), 0, run.configuration.epochs, line)
        return _train(run, directory, progress or ignore)


_trainings = 0
_threads_before = 1
_guard = Lock()


@contextmanager
def _reproducible_torch() -> Iterator[None]:
    """Use one thread, whose order of summation is always the same, and treat denormals as zero.

    Threads of one worker may train at the same time: the last one to end restores what holds for the process.
    """
    global _trainings, _threads_before
    with _guard:
        if not _trainings:
            _threads_before = torch.get_num_threads()
        _trainings += 1
        torch.set_num_threads(1)
    torch.set_flush_denormal(True)
    try:
        yield
    finally:
        torch.set_flush_denormal(False)
        with _guard:
            _trainings -= 1
            if not _trainings:
                torch.set_num_threads(_threads_before)


def _train(run: TrainingRun, directory: Path, progress: Progress) -> TrainingResult:
    started = time.perf_counter()
    options = run.configuration
    write_json(directory / "versions.json", installed_versions())
    log = MetricsLog(directory, options.tensorboard, run.epoch)
    try:
        while run.epoch < options.epochs:
            run_epoch(run, progress)
            line = finish_epoch(run, directory)
            log.write(run.rows, options.seeds)
            spent = f"{line}  {time.perf_counter() - started:.0f} s"
            progress(stage(run), run.epoch, options.epochs, spent)
            for complaint in _new_complaints(run):
                progress(stage(run), run.epoch, options.epochs, f"warning: {complaint}")
    finally:
        log.close()
    return _finish(run, directory, progress, started)


def _new_complaints(run: TrainingRun) -> list[str]:
    """Return what goes wrong since this epoch, in words; each is said once."""
    found = complaints(run.rows, run.configuration, largest_return(run.configuration, run.maps.robot))
    fresh = [words for kind, words in found.items() if kind not in run.complained]
    run.complained |= found.keys()
    return fresh


def finish_epoch(run: TrainingRun, directory: Path) -> str:
    """Evaluate and save where the configuration says so; return a line for people."""
    options = run.configuration
    last = run.epoch == options.epochs
    rows = run.rows[-options.seeds :]
    success = [row["success_rate"] for row in rows if "success_rate" in row]
    line = f"epoch {run.epoch:>3}/{options.epochs}  success {np.mean(success) if success else 0.0:6.1%}"
    line += f"  u {run.var.mean():5.2f}  lambda {run.multiplier.mean():6.4f}"
    due = run.epoch % options.evaluation_interval == 0
    if last or (due and run.epoch >= options.evaluation_start * options.epochs):
        line += _evaluate(run, rows)
    if options.mission_feedback and run.epoch % options.mission_interval == 0 and not last:
        line += _feed_back(run, rows)
    if run.epoch % options.checkpoint_interval == 0 or last:
        write_checkpoint(directory / "checkpoints" / f"epoch_{run.epoch:04d}.pt", checkpoint(run))
    if run.epoch % options.state_interval == 0 or last:
        write_checkpoint(directory / STATE, run_state(run))
        run.take_away_robots()
    return line


def _evaluate(run: TrainingRun, rows: list[dict[str, float]]) -> str:
    """Validate all seeds, remember the best candidates, and return the end of the epoch's line."""
    options = run.configuration
    evaluation = validate(run.actor, run.var, run.maps, run.scaling, options)
    fresh = []
    for seed, (row, score) in enumerate(zip(rows, evaluation.score(), strict=True)):
        row.update({f"validation_{name}": value for name, value in evaluation.metrics(seed).items()})
        candidate = Candidate(seed, run.epoch, float(score), float(run.var[seed]), run.actor.one(seed))
        fresh.append(_verified(run, candidate, row))
    run.candidates = best_candidates(
        [*run.candidates, *fresh], options.finalists, options.selection_tolerance
    )
    best = run.candidates[0]
    rates = " ".join(f"{rate:.1%}" for rate in evaluation.success.mean(axis=1))
    return f"  validation {rates} (best: seed {best.seed}, epoch {best.epoch})"


def _feed_back(run: TrainingRun, rows: list[dict[str, float]]) -> str:
    """Let coming episodes begin where missions are not proved; return the end of the epoch's line."""
    options = run.configuration
    counts = run.maps.shares(options.mission_scenarios)
    found = [
        find_feedback(run.actor, run.var, world_map, run.scaling, options, run.epoch, count, number)
        for number, (world_map, count) in enumerate(zip(run.maps.maps, counts, strict=True))
    ]
    run.feedback = [feedback for feedback, _ in found]
    shares = np.average([share for _, share in found], axis=0, weights=counts)
    for row, share in zip(rows, shares, strict=True):
        row["proved_mission_rate"] = float(share)
    if run.fleet is not None:
        run.fleet.feed_back(run.feedback)
    return f"  missions {' '.join(f'{share:.0%}' for share in shares)}"


def _verified(run: TrainingRun, candidate: Candidate, row: dict[str, float]) -> Candidate:
    """Verify a candidate if the configuration says so, and return it with its rates if these decide."""
    options = run.configuration
    if not options.verification_scenarios:
        return candidate
    safety = score_safety(candidate.weights, candidate.var, run.maps, run.scaling, options)
    row.update(safety.metrics())
    decides = options.select_by == "safety"
    return replace(candidate, safety=(safety.collision, safety.danger)) if decides else candidate


def _proved(run: TrainingRun, candidate: Candidate) -> float:
    """Return the share of missions that are proved for a candidate."""
    return score_missions(candidate.weights, candidate.var, run.maps, run.scaling, run.configuration)


def _finish(run: TrainingRun, directory: Path, progress: Progress, started: float) -> TrainingResult:
    """Choose, export and test."""
    options = run.configuration
    progress("choosing", 1, 1)
    proved = partial(_proved, run) if options.select_by == "missions" else None
    chosen = choose(run.candidates, run.maps, run.scaling, options, proved)
    training = training_record(options, chosen.seed, chosen.epoch)
    specification = make_specification(run.maps.robot, chosen.var, training, run.scaling.layout)
    path = directory / "policy.onnx"
    policy = export_actor(chosen.weights, run.scaling, specification, path)
    progress("testing", 1, 1)
    tested = evaluate_policy(policy, run.maps, options)
    seconds = time.perf_counter() - started
    record: dict[str, Any] = {"seed": chosen.seed, "epoch": chosen.epoch, "seconds": round(seconds, 1)}
    record |= {"score": chosen.score, "safety": list(chosen.safety), "failures": tested.failures}
    write_json(directory / EVALUATION, record | tested.metrics)
    (directory / STATE).unlink(missing_ok=True)  # a finished run needs no resuming, and it is large
    return TrainingResult(directory, path, policy, chosen.seed, chosen.epoch, tested.metrics, seconds)
