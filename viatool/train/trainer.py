"""The training run: Algorithm 1 with S seeds side by side, evaluation, choice of a policy, and its export."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from viatool.errors import ConfigurationError, ViatoolError
from viatool.policy import Policy
from viatool.train.agent import Learner, make_agent
from viatool.train.collection import Collector, Episodes
from viatool.train.configuration import TrainingConfiguration
from viatool.train.constraint import initial_var, update_multiplier, update_var
from viatool.train.evaluation import Evaluation, actor_command, drive, policy_command
from viatool.train.export import export_actor, select_seed, training_record
from viatool.train.networks import Weights
from viatool.train.observation import make_scaling, make_specification
from viatool.train.progress import Progress, Silence
from viatool.train.records import MetricsLog, installed_versions, write_checkpoint, write_json, write_text
from viatool.train.replay import ReplayBuffer
from viatool.train.returns import NStepReturns
from viatool.world import Scenario, WorldMap, load_map

Floats = NDArray[np.float64]

FARTHEST_GOAL = 20.0  # metres, beyond any goal: the curriculum's end
MEASURED_EVERY = 100  # updates between two of which the metrics are recorded


@dataclass(frozen=True, eq=False)
class Candidate:
    """The policy of one seed after one epoch."""

    seed: int
    epoch: int
    score: float
    var: float
    weights: Weights


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
    """

    run_directory: Path
    policy_path: Path
    policy: Policy
    seed: int
    epoch: int
    evaluation: dict[str, dict[str, float]]
    seconds: float

    def lines(self) -> list[str]:
        """Return the result for people."""
        lines = [
            f"policy      {self.policy_path}",
            f"chosen      seed {self.seed} after epoch {self.epoch}",
            f"time        {self.seconds:.0f} s",
        ]
        for name, metrics in self.evaluation.items():
            lines.append(
                f"{name:<11} {metrics['episodes']:.0f} scenarios: success {metrics['success_rate']:.1%}, "
                f"collisions {metrics['collision_rate']:.1%}, timeouts {metrics['timeout_rate']:.1%}, "
                f"cost {metrics['average_cost']:.2f}"
            )
        return lines


@dataclass(eq=False)
class TrainingRun:
    """All that changes while a run goes on."""

    configuration: TrainingConfiguration
    world_map: WorldMap
    learner: Learner
    collector: Collector
    returns: NStepReturns
    var: Floats  # (S,) u
    multiplier: Floats  # (S,) lambda
    log: MetricsLog
    epoch: int = 0
    steps: int = 0  # of every robot
    candidates: list[Candidate] = field(default_factory=list)

    @property
    def actor(self) -> Weights:
        """Return the policies that are evaluated and exported: the slowly moving target of the actor."""
        return self.learner.agent.actor.target


def train(
    configuration: TrainingConfiguration,
    run_directory: str | Path,
    progress: Progress | None = None,
) -> TrainingResult:
    """Train, choose and export a policy.

    Parameters
    ----------
    configuration : TrainingConfiguration
        See `make_configuration`.
    run_directory : path
        A new or empty folder; receives ``configuration.yaml``, ``versions.json``, ``metrics.csv``,
        ``tensorboard/``, ``checkpoints/``, ``policy.onnx`` and ``evaluation.json``.
    progress : Progress, optional
        What the run reports to; by default nothing. See `console_progress`.

    Returns
    -------
    TrainingResult

    Raises
    ------
    ConfigurationError
        If the folder holds an earlier run, or the map has neither scenarios nor a generator.
    ViatoolError
        If the training diverges.
    """
    started = time.perf_counter()
    progress = progress or Silence()
    directory = Path(run_directory)
    if (directory / "metrics.csv").exists():
        raise ConfigurationError(f"{directory} holds an earlier run", "choose another run directory")
    directory.mkdir(parents=True, exist_ok=True)
    with _reproducible_torch():
        run = begin_run(configuration, directory)
        write_text(directory / "configuration.yaml", configuration.to_yaml())
        write_json(directory / "versions.json", installed_versions())
        try:
            while run.epoch < configuration.epochs:
                run_epoch(run, progress)
                finish_epoch(run, directory, progress, started)
        finally:
            run.log.close()
        return _finish(run, directory, progress, started)


@contextmanager
def _reproducible_torch() -> Iterator[None]:
    """Use one thread, whose order of summation is always the same, and treat denormals as zero."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    torch.set_flush_denormal(True)
    try:
        yield
    finally:
        torch.set_num_threads(threads)
        torch.set_flush_denormal(False)


def begin_run(configuration: TrainingConfiguration, directory: Path) -> TrainingRun:
    """Draw the networks, measure u0 with the initial policies, and set the robots down."""
    world_map = load_map(configuration.map)
    if world_map.generator is None and not world_map.scenarios:
        raise ConfigurationError(
            f"map {configuration.map} has neither scenarios nor a generator", "add one of them to train on it"
        )
    robot = world_map.robot
    scaling = make_scaling(robot, configuration.budget_limit)
    generator = torch.Generator().manual_seed(configuration.seed)
    size, bins = len(scaling.offset), robot.lidar.bins
    agent = make_agent(configuration, size, bins, generator)
    replay = ReplayBuffer(configuration.seeds, configuration.replay_capacity, size, 2)
    var = _warm_up(configuration, world_map, agent.actor.weights)
    return TrainingRun(
        configuration=configuration,
        world_map=world_map,
        learner=Learner(configuration, agent, replay, bins, generator),
        collector=Collector(configuration, world_map, scaling, var),
        returns=NStepReturns(configuration.return_steps, configuration.discount),
        var=var,
        multiplier=np.full(configuration.seeds, configuration.multiplier_initial),
        log=MetricsLog(directory, configuration.tensorboard),
    )


def _warm_up(configuration: TrainingConfiguration, world_map: WorldMap, actor: Weights) -> Floats:
    """Return u0 ``(S,)``: the alpha-quantile of episode costs of the initial policies, kept below b."""
    seeds = configuration.seeds
    if configuration.warmup_episodes == 0:
        return np.zeros(seeds)
    scenarios = random_scenarios(world_map, configuration.warmup_episodes, configuration.seed)
    command = actor_command(actor, make_scaling(world_map.robot, configuration.budget_limit), np.zeros(seeds))
    costs = drive(command, world_map, scenarios, policies=seeds, horizon=configuration.horizon).cost
    return np.minimum(initial_var(costs, configuration.alpha), _var_ceiling(configuration))


def _var_ceiling(configuration: TrainingConfiguration) -> float:
    return min(configuration.var_ceiling * configuration.cost_limit, configuration.budget_limit)


def random_scenarios(world_map: WorldMap, count: int, seed: int) -> tuple[Scenario, ...]:
    """Return `count` scenarios of the map's generator, or its own ones over and over if it has none."""
    if world_map.generator is not None:
        return world_map.generator.draw(count, seed)
    own = world_map.scenarios
    return tuple(own[index % len(own)] for index in range(count))


def run_epoch(run: TrainingRun, progress: Progress) -> None:
    """Collect and learn for one epoch, then update u and lambda and record the metrics."""
    options = run.configuration
    _set_curriculum(run)
    run.epoch += 1
    finished: list[Episodes] = []
    measured: list[dict[str, torch.Tensor]] = []
    counts = np.zeros(options.seeds, dtype=np.int64)
    steps = 0
    part = 0.0
    while part < 1.0:
        transition, episodes = run.collector.step(run.learner.agent.actor.weights, run.var)
        batch = run.returns.push(transition)
        if batch is not None:
            run.learner.replay.add(batch)
        finished.append(episodes)
        counts += np.bincount(episodes.seed, minlength=options.seeds)
        steps += 1
        _learn(run, (run.epoch - 1 + part) / options.epochs, measured)
        part = _part_of_epoch(options, steps, counts)
        progress.advance(
            (run.epoch - 1 + min(part, 1.0)) / options.epochs, f"epoch {run.epoch}/{options.epochs}"
        )
    run.steps += steps
    _record(run, Episodes.joined(finished), _average(measured))


def _part_of_epoch(options: TrainingConfiguration, steps: int, counts: NDArray[np.int64]) -> float:
    """Return the part of the epoch that is done, 1 or more at its end."""
    if options.epoch_steps is not None:
        return steps / options.epoch_steps
    assert options.epoch_episodes is not None
    return float(counts.min()) / options.epoch_episodes


def _set_curriculum(run: TrainingRun) -> None:
    options = run.configuration
    if options.curriculum_epochs:
        grown = min(1.0, run.epoch / options.curriculum_epochs)
        run.collector.limit_goal_distance(
            options.curriculum_start + grown * (FARTHEST_GOAL - options.curriculum_start)
        )


def _learn(run: TrainingRun, fraction: float, measured: list[dict[str, torch.Tensor]]) -> None:
    """Take the updates that belong to one step of the robots; `fraction` of the run is done."""
    options = run.configuration
    if run.learner.replay.size < options.learning_starts:
        return
    rate = options.learning_rate * (1.0 - (1.0 - options.final_learning_rate) * fraction)
    multiplier = torch.from_numpy(run.multiplier).to(torch.float32)
    for _ in range(options.updates_per_step):
        measure = (run.learner.updates + 1) % MEASURED_EVERY == 0
        metrics = run.learner.update(multiplier, rate, measure=measure)
        if measure:
            measured.append(metrics)


def _average(measured: list[dict[str, torch.Tensor]]) -> dict[str, Floats]:
    """Return the mean over the measured updates of every metric, ``(S,)`` each."""
    names = dict.fromkeys(name for metrics in measured for name in metrics)
    return {
        name: np.mean(
            [metrics[name].numpy() for metrics in measured if name in metrics], axis=0, dtype=np.float64
        )
        for name in names
    }


def _record(run: TrainingRun, episodes: Episodes, losses: dict[str, Floats]) -> None:
    """Update u and lambda of every seed and write down the epoch."""
    options = run.configuration
    for seed in range(options.seeds):
        metrics: dict[str, float] = {"steps": run.steps * options.robots, "updates": run.learner.updates}
        metrics |= _episode_metrics(episodes.of_seed(seed))
        steady = episodes.where((episodes.seed == seed) & episodes.steady).cost
        metrics |= _update_constraint(run, seed, steady)
        metrics |= {name: float(values[seed]) for name, values in losses.items()}
        run.log.add(run.epoch, seed, metrics)
    for values in losses.values():
        if not np.isfinite(values).all():
            raise ViatoolError(
                f"the training diverged in epoch {run.epoch}: {', '.join(losses)} are not all finite",
                "lower learning_rate, or raise target_rate's inverse: see docs/training.md",
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


def _update_constraint(run: TrainingRun, seed: int, costs: Floats) -> dict[str, float]:
    """Update u by the costs of the epoch, and lambda by these costs and the u that they were driven with."""
    options = run.configuration
    var = float(run.var[seed])
    run.var[seed], var_metrics = update_var(
        var,
        costs,
        alpha=options.alpha,
        step=options.var_step,
        ceiling=_var_ceiling(options),
        rule=options.var_rule,
    )
    run.multiplier[seed], multiplier_metrics = update_multiplier(
        float(run.multiplier[seed]),
        var,
        costs,
        alpha=options.alpha,
        step=options.multiplier_step,
        cost_limit=options.cost_limit,
        maximum=options.multiplier_maximum,
        rule=options.multiplier_rule,
    )
    state = {"var": float(run.var[seed]), "multiplier": float(run.multiplier[seed])}
    return state | var_metrics | multiplier_metrics


def finish_epoch(run: TrainingRun, directory: Path, progress: Progress, started: float) -> None:
    """Evaluate and save where the configuration says so, and report."""
    options = run.configuration
    last = run.epoch == options.epochs
    rows = run.log.rows[-options.seeds :]
    line = f"epoch {run.epoch:>3}/{options.epochs}  {time.perf_counter() - started:6.0f} s"
    line += f"  success {np.nanmean([row.get('success_rate', np.nan) for row in rows]):6.1%}"
    line += f"  u {run.var.mean():5.2f}  lambda {run.multiplier.mean():6.4f}"
    due = (
        run.epoch % options.evaluation_interval == 0
        and run.epoch >= options.evaluation_start * options.epochs
    )
    if due or last:
        evaluation = evaluate(run, options.validation_scenarios, options.validation_seed)
        _remember(run, evaluation)
        for seed, row in enumerate(rows):
            row.update({f"validation_{name}": value for name, value in evaluation.metrics(seed).items()})
        best = max(run.candidates, key=lambda candidate: candidate.score)
        line += "  validation " + " ".join(f"{rate:.1%}" for rate in evaluation.success.mean(axis=1))
        line += f"  (best: seed {best.seed}, epoch {best.epoch})"
    run.log.write()
    if run.epoch % options.checkpoint_interval == 0 or last:
        save_checkpoint(run, directory / "checkpoints" / f"epoch_{run.epoch:04d}.pt")
    progress.say(line)


def evaluate(run: TrainingRun, count: int, seed: int) -> Evaluation:
    """Drive the current policies of all seeds on `count` random scenarios."""
    scenarios = random_scenarios(run.world_map, count, seed)
    command = actor_command(run.actor, run.collector.scaling, run.var)
    options = run.configuration
    return drive(
        command, run.world_map, scenarios, policies=options.seeds, horizon=options.horizon, seed=seed
    )


def _remember(run: TrainingRun, evaluation: Evaluation) -> None:
    """Keep the best candidates so far; with equal scores the later one."""
    for seed, score in enumerate(evaluation.score()):
        weights = select_seed(run.actor, seed)
        run.candidates.append(Candidate(seed, run.epoch, float(score), float(run.var[seed]), weights))
    run.candidates.sort(key=lambda candidate: (-candidate.score, -candidate.epoch, candidate.seed))
    del run.candidates[run.configuration.finalists :]


def save_checkpoint(run: TrainingRun, path: Path) -> None:
    """Write the networks of all seeds, u and lambda; `export_checkpoint` makes a policy of it."""
    agent = run.learner.agent
    write_checkpoint(
        path,
        {
            "configuration": run.configuration.model_dump_json(),
            "epoch": run.epoch,
            "var": torch.from_numpy(run.var.copy()),
            "multiplier": torch.from_numpy(run.multiplier.copy()),
            "networks": {
                name: getattr(agent, name).state() for name in ("actor", "task_critics", "cost_critic")
            },
            "validation_success": [
                float(row.get("validation_success_rate", float("nan")))
                for row in run.log.rows[-run.configuration.seeds :]
            ],
        },
    )


def choose(run: TrainingRun) -> Candidate:
    """Compare the finalists on further scenarios, none of them used before nor in the test."""
    options = run.configuration
    if len(run.candidates) == 1:
        return run.candidates[0]
    scenarios = random_scenarios(run.world_map, options.final_scenarios, options.validation_seed + 1)
    joint = Weights(run.actor.sizes, len(run.candidates), run.actor.activation)
    for index, candidate in enumerate(run.candidates):
        for every, own in zip(joint.layers, candidate.weights.layers, strict=True):
            every.detach()[index] = own.detach()[0]
    budget = np.array([candidate.var for candidate in run.candidates])
    command = actor_command(joint, run.collector.scaling, budget)
    outcome = drive(command, run.world_map, scenarios, policies=len(run.candidates), horizon=options.horizon)
    return run.candidates[int(np.argmax(outcome.score()))]


def _finish(run: TrainingRun, directory: Path, progress: Progress, started: float) -> TrainingResult:
    """Choose, export and test."""
    options = run.configuration
    progress.advance(1.0, "choosing")
    chosen = choose(run)
    training = training_record(options, chosen.seed, chosen.epoch)
    specification = make_specification(run.world_map.robot, chosen.var, training)
    path = directory / "policy.onnx"
    policy = export_actor(chosen.weights, run.collector.scaling, specification, path)
    progress.advance(1.0, "testing")
    evaluation = test_policy(policy, run.world_map, options)
    seconds = time.perf_counter() - started
    record: dict[str, Any] = {"seed": chosen.seed, "epoch": chosen.epoch, "seconds": round(seconds, 1)}
    write_json(directory / "evaluation.json", record | evaluation)
    return TrainingResult(directory, path, policy, chosen.seed, chosen.epoch, evaluation, seconds)


def test_policy(
    policy: Policy, world_map: WorldMap, configuration: TrainingConfiguration
) -> dict[str, dict[str, float]]:
    """Drive an exported policy on the map's fixed scenarios and on held-out random ones."""
    assert policy.spec is not None
    command = policy_command(policy, float(policy.spec.channel("budget").value or 0.0))
    sets: dict[str, tuple[Scenario, ...]] = {"fixed": world_map.scenarios}
    if world_map.generator is not None:
        sets["held_out"] = world_map.generator.draw(configuration.test_scenarios, configuration.test_seed)
    evaluation = {}
    for name, scenarios in sets.items():
        if scenarios:
            outcome = drive(
                command, world_map, scenarios, horizon=configuration.horizon, seed=configuration.test_seed
            )
            evaluation[name] = {"episodes": float(len(scenarios)), **outcome.metrics(0)}
    return evaluation
