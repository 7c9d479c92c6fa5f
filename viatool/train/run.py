"""The state of a training run: how it begins, what is saved, and how a saved run goes on bit for bit."""

from __future__ import annotations

from dataclasses import dataclass, field
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from viatool.arrays import Floats
from viatool.errors import ConfigurationError
from viatool.train.agent import ACTIONS, Learner, make_agent
from viatool.train.configuration import TrainingConfiguration
from viatool.train.constraint import initial_var
from viatool.train.evaluation import actor_commands, drive_on_maps
from viatool.train.feedback import Feedback
from viatool.train.fleet import Fleet
from viatool.train.maps import TrainingMaps, load_maps
from viatool.train.methods import METHODS
from viatool.train.networks import Weights
from viatool.train.observation import UnitScaling, make_scaling, training_setting
from viatool.train.replay import PrioritisedReplay, ReplayBuffer
from viatool.train.returns import NStepReturns
from viatool.train.selection import Candidate
from viatool.train.td7 import Td7Learner
from viatool.world import Lidar, WorldMap


@dataclass(eq=False)
class TrainingRun:
    """All that changes while a run goes on, and what it needs for that.

    Parameters
    ----------
    configuration : TrainingConfiguration
        Does not change.
    maps : TrainingMaps
        Of the training.
    scaling : UnitScaling
        Of its robot.
    learner : Learner
        Networks, optimisers, replay buffer and their random numbers.
    var, multiplier : ndarray
        ``(S,)`` u and lambda.
    epoch, steps : int
        Finished epochs, and steps of every robot.
    candidates : list of Candidate
        The best so far.
    rows : list of dict
        Metrics of the finished epochs.
    feedback : list of Feedback, optional
        For each map, where episodes begin again.
    complained : set of str
        What has been said to go wrong, see `viatool.train.health`.
    due : Fraction
        Updates that are due; a part of one is left over where they go by episodes.
    fleet, returns : Fleet and NStepReturns, or None
        The robots on their way; None when they are to be set down anew.
    """

    configuration: TrainingConfiguration
    maps: TrainingMaps
    scaling: UnitScaling
    learner: Learner
    var: Floats
    multiplier: Floats
    epoch: int = 0
    steps: int = 0
    candidates: list[Candidate] = field(default_factory=list)
    rows: list[dict[str, float]] = field(default_factory=list)
    feedback: list[Feedback] | None = None
    complained: set[str] = field(default_factory=set)
    due: Fraction = Fraction(0)
    fleet: Fleet | None = None
    returns: NStepReturns | None = None

    @property
    def actor(self) -> Weights:
        """Return the policies that are evaluated and exported: the slowly moving target of the actor."""
        return self.learner.agent.actor.target

    def robots(self) -> tuple[Fleet, NStepReturns]:
        """Return the robots on their way; set them down first where a saved run would begin again.

        The robots start anew after every epoch whose state is saved, also in a run that is never interrupted:
        so a resumed run, which has no robots on their way, does exactly the same.
        """
        if self.fleet is None or self.returns is None:
            options = self.configuration
            self.fleet = Fleet(
                options,
                self.maps.each(partial(with_margin, margin=options.clearance_margin)),
                self.scaling,
                self.learner.method,
                self.var,
                self.epoch,
                self.feedback,
            )
            self.returns = NStepReturns(options.return_steps, options.discount)
        return self.fleet, self.returns

    def take_away_robots(self) -> None:
        """Let the next epoch set down the robots anew."""
        if self.fleet is not None:
            self.fleet.close()
        self.fleet = self.returns = None


def begin_run(configuration: TrainingConfiguration, maps: TrainingMaps | None = None) -> TrainingRun:
    """Draw the networks, and measure u0 with the initial policies; read the maps if they are not given.

    Raises
    ------
    ConfigurationError
        If a map cannot be trained on, see `TrainingMaps`.
    """
    maps = load_maps(configuration) if maps is None else maps
    if configuration.select_on == "fixed" and not maps.fixed():
        raise ConfigurationError(
            f"{', '.join(configuration.maps)} has no scenarios of its own, on which select_on: fixed chooses",
            "add some, or set select_on to random",
        )
    for world_map in maps.maps:
        if configuration.mission_feedback and world_map.generator is None:
            raise ConfigurationError(
                f"map {world_map.path} has no generator, of whose scenarios mission_feedback tries missions",
                "add one, or set mission_feedback to 0",
            )
    maps = maps.each(lambda world_map: training_setting(world_map).world_map)
    _check_lidar(configuration, maps.robot.lidar)
    scaling = make_scaling(maps.robot, configuration.budget_limit, configuration.layout)
    generator = torch.Generator().manual_seed(configuration.seed)
    method = METHODS[configuration.method](configuration)
    agent = make_agent(configuration, method, scaling, generator)
    kind, ring = (Td7Learner, PrioritisedReplay) if method.embedded else (Learner, ReplayBuffer)
    replay = ring(configuration.seeds, configuration.replay_capacity, len(scaling.offset), ACTIONS)
    learner = kind(configuration, method, agent, replay, scaling, generator)
    var = np.zeros(configuration.seeds)
    if method.budgeted and configuration.warmup_episodes:
        var = _warm_up(configuration, maps, scaling, agent.actor.weights)
    multiplier = np.full(configuration.seeds, configuration.multiplier_initial if method.constrained else 0.0)
    return TrainingRun(configuration, maps, scaling, learner, var, multiplier)


def with_margin(world_map: WorldMap, margin: float) -> WorldMap:
    """Return a map whose clearances are larger by a margin, in metres."""
    asked = world_map.clearance
    return world_map.with_clearance(asked.collision + margin, asked.danger + margin)


def _check_lidar(options: TrainingConfiguration, lidar: Lidar) -> None:
    """Refuse options that the robot's LiDAR has no use for.

    Raises
    ------
    ConfigurationError
        Names the option.
    """
    reach = options.lidar_range
    if reach is not None and not lidar.minimum_range < reach < lidar.maximum_range:
        raise ConfigurationError(
            f"lidar_range is {reach:g} m, but the LiDAR reads {lidar.minimum_range:g} to "
            f"{lidar.maximum_range:g} m",
            "give a range in between, or null for all of it",
        )
    if options.jump_penalty and lidar.bins < 2:
        raise ConfigurationError(
            f"jump_penalty compares neighbouring bins, but the LiDAR has {lidar.bins}",
            "set jump_penalty to 0",
        )


def _warm_up(
    options: TrainingConfiguration, maps: TrainingMaps, scaling: UnitScaling, actor: Weights
) -> Floats:
    """Return u0 ``(S,)``: the alpha-quantile of episode costs of the initial policies, kept below b."""
    drawn = maps.draw(options.warmup_episodes, options.seed)
    commands = actor_commands(actor, scaling, np.zeros(options.seeds))
    outcome = drive_on_maps(commands, drawn, options)
    return np.minimum(initial_var(outcome.cost, options.alpha), var_ceiling(options))


def var_ceiling(options: TrainingConfiguration) -> float:
    """Return the largest u: below b, and a budget that is not clipped."""
    return min(options.var_ceiling * options.cost_limit, options.budget_limit)


def checkpoint(run: TrainingRun) -> dict[str, Any]:
    """Return the networks of all seeds, u and lambda; `export_checkpoint` makes a policy of them."""
    rows = run.rows[-run.configuration.seeds :]
    return {
        "configuration": run.configuration.model_dump_json(),
        "epoch": run.epoch,
        "var": torch.from_numpy(run.var.copy()),
        "multiplier": torch.from_numpy(run.multiplier.copy()),
        "networks": {name: network.state() for name, network in run.learner.agent.networks().items()},
        "validation_success": [float(row.get("validation_success_rate", float("nan"))) for row in rows],
    }


def run_state(run: TrainingRun) -> dict[str, Any]:
    """Return all that `resume_run` needs, as tensors and plain values."""
    candidates = [
        {
            "seed": one.seed,
            "epoch": one.epoch,
            "score": one.score,
            "var": one.var,
            "safety": one.safety,
            "weights": one.weights.flat,
        }
        for one in run.candidates
    ]
    return checkpoint(run) | {
        "map_sha256": run.maps.sha256,
        "steps": run.steps,
        "updates": run.learner.updates,
        "due": str(run.due),
        "generator": run.learner.generator.get_state(),
        "replay": run.learner.replay.state(),
        "value_range": run.learner.agent.value_range,
        "candidates": candidates,
        "rows": run.rows,
        "feedback": None if run.feedback is None else [found.state() for found in run.feedback],
    }


def resume_run(state: dict[str, Any], where: Path, maps: TrainingMaps | None = None) -> TrainingRun:
    """Build the run that `run_state` described.

    Raises
    ------
    ConfigurationError
        If a map has changed since.
    """
    configuration = TrainingConfiguration.model_validate_json(state["configuration"])
    run = begin_run(configuration.model_copy(update={"warmup_episodes": 0}), maps)
    run.configuration = configuration
    if run.maps.sha256 != state["map_sha256"]:
        raise ConfigurationError(
            f"{', '.join(configuration.maps)}: not as when the run in {where} began",
            "restore the map, or start a new run",
        )
    run.epoch, run.steps, run.rows = state["epoch"], state["steps"], state["rows"]
    if state.get("feedback") is not None:
        kept = state["feedback"]  # of a map alone in states that were saved before there were several
        run.feedback = [Feedback.of_state(found) for found in (kept if isinstance(kept, list) else [kept])]
    run.due = Fraction(state.get("due", "0"))
    run.var, run.multiplier = state["var"].numpy(), state["multiplier"].numpy()
    for name, network in run.learner.agent.networks().items():
        network.restore(state["networks"][name])
    learner = run.learner
    learner.updates = state["updates"]
    learner.generator.set_state(state["generator"])
    learner.replay.restore(state["replay"])
    learner.agent.value_range.copy_(state["value_range"])
    for one in state["candidates"]:
        weights = run.actor.one(0)
        weights.flat.copy_(one["weights"])
        kept = one["seed"], one["epoch"], one["score"], one["var"], weights, tuple(one["safety"])
        run.candidates.append(Candidate(*kept))
    return run
