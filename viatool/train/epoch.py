"""One epoch of a training run: the robots drive, the networks learn, then u and lambda are updated."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import torch

from viatool.arrays import Floats, Indices
from viatool.errors import ViatoolError
from viatool.schedule import Progress
from viatool.train.collection import Episodes
from viatool.train.configuration import TrainingConfiguration
from viatool.train.constraint import update_multiplier, update_var
from viatool.train.fleet import Fleet
from viatool.train.methods.method import EpochCosts
from viatool.train.run import TrainingRun, var_ceiling

MEASURED_EVERY = 100  # updates between two of which the metrics are recorded


def run_epoch(run: TrainingRun, progress: Progress) -> None:
    """Collect and learn for one epoch, then update u and lambda and record the metrics."""
    options = run.configuration
    fleet, returns = run.robots()
    _set_curriculum(run, fleet)
    run.epoch += 1
    finished: list[Episodes] = []
    measured: list[dict[str, torch.Tensor]] = []
    counts = np.zeros(options.seeds, dtype=np.int64)
    steps, part = 0, 0.0
    while part < 1.0:
        transition, episodes = fleet.step(run.learner.agent.actor.weights, run.var)
        batch = returns.push(transition)
        if batch is not None:
            run.learner.replay.add(batch)
        finished.append(episodes)
        counts += np.bincount(episodes.seed, minlength=options.seeds)
        steps += 1
        _learn(run, (run.epoch - 1 + part) / options.epochs, len(episodes), measured)
        part = _part_of_epoch(options, steps, counts)
        progress(stage(run), run.epoch - 1 + min(part, 1.0), options.epochs)
    run.steps += steps
    _record(run, Episodes.joined(finished), _average(measured), fleet)


def stage(run: TrainingRun) -> str:
    """Return what a run is at, for people."""
    return f"epoch {run.epoch}/{run.configuration.epochs}"


def _part_of_epoch(options: TrainingConfiguration, steps: int, counts: Indices) -> float:
    """Return the part of the epoch that is done, 1 or more at its end."""
    if options.epoch_steps is not None:
        return steps / options.epoch_steps
    assert options.epoch_episodes is not None
    return float(counts.min()) / options.epoch_episodes


def _set_curriculum(run: TrainingRun, fleet: Fleet) -> None:
    options = run.configuration
    if options.curriculum_epochs:
        grown = min(1.0, run.epoch / options.curriculum_epochs)
        start = options.curriculum_start
        fleet.limit_goal_distance(start + grown * (options.curriculum_end - start))


def _learn(run: TrainingRun, fraction: float, episodes: int, measured: list[dict[str, torch.Tensor]]) -> None:
    """Take the updates that belong to one step of the robots, in which so many episodes ended."""
    options = run.configuration
    if run.learner.replay.size < options.learning_starts:
        return
    run.due += _updates_due(options, episodes)
    rate = options.learning_rate * (1.0 - (1.0 - options.final_learning_rate) * fraction)
    run.learner.progress = fraction
    multiplier = torch.from_numpy(run.multiplier).to(torch.float32)
    while run.due >= 1:
        run.due -= 1
        measure = (run.learner.updates + 1) % MEASURED_EVERY == 0
        metrics = run.learner.update(multiplier, rate, measure=measure)
        if measure:
            measured.append(metrics)


def _updates_due(options: TrainingConfiguration, episodes: int) -> Fraction:
    """Return the updates of all seeds that a step of the robots brings."""
    if options.updates_per_episode is None:
        return Fraction(options.updates_per_step)
    return Fraction(options.updates_per_episode * episodes, options.seeds)


def _average(measured: list[dict[str, torch.Tensor]]) -> dict[str, Floats]:
    """Return the mean over the measured updates of every metric, ``(S,)`` each."""
    names = dict.fromkeys(name for metrics in measured for name in metrics)
    return {
        name: np.mean(
            [metrics[name].numpy() for metrics in measured if name in metrics], axis=0, dtype=np.float64
        )
        for name in names
    }


def _record(run: TrainingRun, episodes: Episodes, losses: dict[str, Floats], fleet: Fleet) -> None:
    """Update u and lambda of every seed and write down the epoch.

    Raises
    ------
    ViatoolError
        If a loss is not finite.
    """
    options = run.configuration
    start = run.learner.start_cost(fleet.start_observation)
    for seed in range(options.seeds):
        metrics: dict[str, float] = {"epoch": run.epoch, "seed": seed}
        metrics |= {"steps": run.steps * options.robots, "updates": run.learner.updates}
        metrics |= _episode_metrics(episodes.where(episodes.seed == seed))
        steady = episodes.where((episodes.seed == seed) & episodes.steady).cost
        metrics |= _update_constraint(run, seed, steady, float(start[seed]))
        metrics |= {name: float(values[seed]) for name, values in losses.items()}
        run.rows.append(metrics)
    diverged = [name for name, values in losses.items() if not np.isfinite(values).all()]
    if diverged:
        raise ViatoolError(
            f"the training diverged in epoch {run.epoch}: {', '.join(diverged)} is not finite",
            "lower learning_rate or target_rate, see docs/training.md",
        )


def _episode_metrics(episodes: Episodes) -> dict[str, float]:
    if len(episodes) == 0:
        return {"episodes": 0}
    return {
        "episodes": len(episodes),
        "success_rate": float(episodes.success.mean()),
        "collision_rate": float(episodes.collision.mean()),
        "episode_cost": float(episodes.cost.mean()),
        "episode_reward": float(episodes.reward.mean()),
        "episode_length": float(episodes.length.mean()),
    }


def _update_constraint(run: TrainingRun, seed: int, costs: Floats, start: float) -> dict[str, float]:
    """Update u by the costs of the epoch, and lambda by these costs and the u that they were driven with."""
    options, method = run.configuration, run.learner.method
    metrics: dict[str, float] = {}
    if costs.size:
        judged = EpochCosts(float(run.var[seed]), costs, start)
        slack = method.slack(judged)
        run.multiplier[seed] = update_multiplier(
            float(run.multiplier[seed]),
            slack,
            step=options.multiplier_step,
            maximum=options.multiplier_maximum,
        )
        var, metrics = update_var(
            judged.var,
            costs,
            alpha=options.alpha,
            step=options.var_step,
            ceiling=var_ceiling(options),
            rule=options.var_rule,
        )
        run.var[seed] = var if method.budgeted else 0.0
        metrics |= {} if slack is None else {"slack": slack}
    return {"var": float(run.var[seed]), "multiplier": float(run.multiplier[seed])} | metrics
