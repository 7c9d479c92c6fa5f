"""Missions that are not proved, fed back: robots begin again at their starts, and where their proofs ended."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from viatool.arrays import Floats, Indices
from viatool.missions import Mission
from viatool.train.configuration import TrainingConfiguration
from viatool.train.networks import Weights
from viatool.train.observation import UnitScaling
from viatool.train.scoring import exported, try_missions
from viatool.world import ScenarioBatch, Scenes, WorldMap

EACH = 16
"""Entries of a mission that is not proved: at most half of them places where its proof ended, the others its start."""


LAST = 20  # intervals of a run that refutes a mission


@dataclass(frozen=True, eq=False)
class Feedback:
    """Where episodes begin again.

    Parameters
    ----------
    batch : ScenarioBatch
        All entries, those of the first seed first.
    counts : ndarray
        (S,) entries of each seed.
    """

    batch: ScenarioBatch
    counts: Indices

    def state(self) -> dict[str, torch.Tensor]:
        """Return all of it as tensors by name."""
        arrays = {**vars(self.batch), "counts": self.counts}
        return {name: torch.from_numpy(np.ascontiguousarray(array)) for name, array in arrays.items()}

    @staticmethod
    def of_state(state: dict[str, torch.Tensor]) -> Feedback:
        """Return what `state` was called on."""
        arrays = {name: tensor.numpy() for name, tensor in state.items()}
        counts = arrays.pop("counts")
        return Feedback(ScenarioBatch(**arrays), counts)


def find_feedback(
    actor: Weights,
    var: Floats,
    world_map: WorldMap,
    scaling: UnitScaling,
    options: TrainingConfiguration,
    epoch: int,
    count: int,
    number: int = 0,
) -> tuple[Feedback, Floats]:
    """Try to prove fresh missions for the policy of every seed on one map, as ``viatool mission`` does.

    Parameters
    ----------
    actor : Weights
        Of S seeds.
    var : ndarray
        ``(S,)`` u, to which the budget channel is fixed.
    world_map, scaling, options : WorldMap, UnitScaling, TrainingConfiguration
        Of the training; the map has a generator.
    epoch : int
        Part of the seed of the scenarios, which are the same for all seeds.
    count : int
        Missions that are tried.
    number : int
        Of the map among those of the training; part of the seed.

    Returns
    -------
    tuple
        What is fed back, and ``(S,)`` the shares of proved missions.
    """
    assert world_map.generator is not None
    lot = [options.seed, epoch, 2, *([number] if number else [])]
    drawn = world_map.generator.draw_arrays(count, np.random.default_rng(lot))
    scenarios = [drawn.scenario(row, f"feedback-{epoch}-{row}") for row in range(len(drawn))]
    entries, counts, shares = drawn[:0], [], []
    for seed in range(actor.seeds):
        with exported(actor.one(seed), float(var[seed]), world_map.robot, scaling) as policy:
            found = try_missions(policy, world_map, options, scenarios)
        failed = [row for row, one in enumerate(found) if one.verdict != "proved"]
        for row in failed:
            asked = options.clearance_margin, found.goal_radius
            entries += begin_again(found.missions[row], drawn[row : row + 1], world_map, *asked)
        counts.append(EACH * len(failed))
        shares.append(found.counts["proved"] / len(found))
    return Feedback(entries, np.array(counts)), np.array(shares)


def begin_again(
    mission: Mission, drawn: ScenarioBatch, world_map: WorldMap, margin: float, radius: float
) -> ScenarioBatch:
    """Return `EACH` entries of a mission that is not proved.

    Parameters
    ----------
    mission : Mission
        Refuted or unknown.
    drawn : ScenarioBatch
        Its scenario alone.
    world_map : WorldMap
        Whose collision clearance all entries keep.
    margin, radius : float
        What they keep beside that, and how far from the goal they are at least, in metres.
    """
    places = _ended(mission)
    scenes = Scenes(world_map.arena, world_map.obstacles, drawn.circles, drawn.edges())
    kept = scenes.footprint_clearance(places, world_map.robot.footprint, np.zeros(len(places), np.int64))
    away = np.hypot(*(places[:, :2] - drawn.goals[0]).T)
    places = places[(kept > world_map.clearance.collision + margin) & (away > radius)]
    some = (
        places[np.unique(np.linspace(0, len(places) - 1, EACH // 2).astype(np.int64))]
        if len(places)
        else places
    )
    entries = drawn[np.zeros(EACH, np.int64)]
    entries.starts[: len(some)] = some
    return entries


def _ended(mission: Mission) -> Floats:
    """Return the poses (P, 3) where a proof ended: middles of its last parts, or the end of a run that refutes it."""
    for run in (mission.crashes, mission.late):
        if len(run):
            end = int(run.step[0]) + 1
            return np.asarray(run.poses[0, max(end - LAST, 0) : end])
    tube = mission.proof.tube
    last = tube.step == tube.step.max(initial=0)
    return np.asarray(0.5 * (tube.lower[last, :3] + tube.upper[last, :3]))
