"""Speed of the trainer: updates and robot-steps per second of S seeds in one batch, beside one seed at a
time.

    OMP_NUM_THREADS=1 python tests/benchmarks/train.py [--preset paper] [--seeds 5] [--updates 400]

An update is one step of all networks of all seeds. "one at a time" trains S runs of one seed each after the
other, so its updates of S seeds per second are those of one seed divided by S. Seconds are those of the
processor, the best of several rounds, so that other programs disturb little.

The last column is what the schedule of `--preset paper` takes at most: every one of its episodes, 70 in each of
100 epochs and seed, as long as the horizon of 300 steps.
"""

from __future__ import annotations

import argparse
import os
import time

os.environ.setdefault("OMP_NUM_THREADS", "1")

import torch

from viatool.train import TrainingConfiguration, make_configuration
from viatool.train.methods import METHODS
from viatool.train.run import TrainingRun, begin_run

ROUNDS = 8


def minutes_of_schedule(updates: float, steps: float, seeds: int) -> float:
    """Return how long the paper's schedule takes at most, at these updates and robot-steps per second."""
    paper = make_configuration("paper")
    assert paper.epoch_episodes is not None
    robot_steps = paper.epochs * paper.epoch_episodes * paper.horizon  # of one seed
    learning = robot_steps / paper.robots * paper.updates_per_step / updates
    return (learning + robot_steps * seeds / steps) / 60


def prepare(configuration: TrainingConfiguration) -> TrainingRun:
    """Begin a run and fill its replay buffer with some steps."""
    run = begin_run(configuration)
    collector, returns = run.robots()
    while run.learner.replay.size < 20 * configuration.batch_size:
        transition, _ = collector.step(run.learner.agent.actor.weights, run.var)
        batch = returns.push(transition)
        if batch is not None:
            run.learner.replay.add(batch)
    return run


def updates_per_second(run: TrainingRun, updates: int) -> float:
    """Return updates of all networks per second, lambda positive so that the cost critic counts."""
    multiplier = torch.full((run.configuration.seeds,), 0.1)
    for _ in range(20):
        run.learner.update(multiplier, 1e-4)
    rounds = []
    for _ in range(ROUNDS):
        start = time.process_time()
        for _ in range(updates // ROUNDS):
            run.learner.update(multiplier, 1e-4)
        rounds.append(time.process_time() - start)
    return (updates // ROUNDS) / min(rounds)


def steps_per_second(run: TrainingRun, steps: int) -> float:
    """Return robot-steps per second of collection: policy, noise, simulation, n-step returns, replay."""
    collector, returns = run.robots()
    start = time.process_time()
    for _ in range(steps):
        transition, _ = collector.step(run.learner.agent.actor.weights, run.var)
        batch = returns.push(transition)
        if batch is not None:
            run.learner.replay.add(batch)
    return steps * run.configuration.seeds * run.configuration.robots / (time.process_time() - start)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--preset", default="paper")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--updates", type=int, default=400)
    parser.add_argument("--map", default="maps/lab.yaml")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    torch.set_flush_denormal(True)
    print(
        f"{'method':<10} {'S':>2} {'updates/s':>10} {'one at a time':>14} {'gain':>5} {'robot-steps/s':>14} "
        f"{'schedule':>9}"
    )
    for method in METHODS:
        rates = []
        for seeds in (arguments.seeds, 1):
            options = make_configuration(
                arguments.preset, method=method, seeds=seeds, map=arguments.map, warmup_episodes=0
            )
            run = prepare(options)
            rates.append((updates_per_second(run, arguments.updates), steps_per_second(run, 100)))
        (batched, steps), (single, _) = rates
        alone = single / arguments.seeds
        bound = ""
        if arguments.preset == "paper":
            bound = f"{minutes_of_schedule(batched, steps, arguments.seeds):>5.0f} min"
        print(
            f"{method:<10} {arguments.seeds:>2} {batched:>10.0f} {alone:>14.0f} {batched / alone:>5.2f} "
            f"{steps:>14.0f} {bound:>9}"
        )


if __name__ == "__main__":
    main()
