"""The tasks of a comparison: train a variant with all its seeds, evaluate and verify the policy of each seed."""

from __future__ import annotations

import csv
import json
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from viatool.errors import ConfigurationError
from viatool.schedule import Progress
from viatool.studies.study import Options
from viatool.studies.tasks import Task, digest, record_path
from viatool.studies.variants import ALPHAS, TrainingSetting, Variant

if TYPE_CHECKING:
    from viatool.train import TrainingConfiguration
    from viatool.verification.result import Result
    from viatool.world import Scenario, WorldMap

CURVES = (
    "success_rate",
    "collision_rate",
    "episode_cost",
    "cvar",
    "slack",
    "var",
    "multiplier",
    "validation_success_rate",
    "validation_collision_rate",
)
_UPDATES_PER_SECOND = 180.0  # of five seeds; only ratios to the evaluations matter
_EVALUATION_SECONDS = 4.0


@dataclass(frozen=True)
class TrainVariant(Task):
    """Train all seeds of a variant as one batch; goes on with a training that was interrupted.

    Parameters
    ----------
    folder : str
        ``SETTING/VARIANT`` below the output folder.
    configuration : TrainingConfiguration
        Of the trainer.
    world_map : WorldMap
        Its map, which a worker need not see as a file.
    """

    folder: str
    configuration: TrainingConfiguration
    world_map: WorldMap

    @classmethod
    def of(cls, setting: TrainingSetting, variant: Variant, options: Options) -> TrainVariant:
        """Build the training of a variant in a setting."""
        from viatool.train import make_configuration
        from viatool.train.maps import load_maps

        configuration = make_configuration(
            options.preset,
            None,
            (*setting.settings, *options.settings),
            method=variant.method,
            alpha=variant.alpha,
            seeds=options.seeds,
            seed=options.seed,
            tensorboard=False,
            finalists=1,  # every seed is evaluated; none is chosen over the others
        )
        every = {"checkpoint_interval": configuration.evaluation_interval}
        world_map = load_maps(configuration).maps[0]
        return cls(f"{setting.name}/{variant.name}", configuration.model_copy(update=every), world_map)

    @property
    def name(self) -> str:
        """Return ``SETTING/VARIANT/train``."""
        return f"{self.folder}/train"

    @property
    def work(self) -> float:
        """Estimate by the number of updates."""
        options = self.configuration
        steps = options.epoch_steps or 1_000
        return options.epochs * steps * options.updates_per_step * options.seeds / 5 / _UPDATES_PER_SECOND

    def parameters(self) -> dict[str, Any]:
        """Return the configuration and the digest of its map."""
        return self.configuration.model_dump(mode="json") | {"map_sha256": self.world_map.sha256}

    def reads(self, output: Path) -> list[Path]:
        """Return the run directory, in case it was begun elsewhere."""
        return [Path(self.folder, "run")]

    def run(self, output: Path, progress: Progress) -> dict[str, Any]:
        """Train, or resume; return the curves of all seeds and the epoch that is best for each."""
        from viatool.train import TrainingMaps, complete
        from viatool.train.records import installed_versions

        directory = output / self.folder / "run"
        complete(self.configuration, directory, progress, maps=TrainingMaps((self.world_map,)))
        with (directory / "metrics.csv").open(newline="", encoding="utf-8") as stream:
            rows = list(csv.DictReader(stream))
        seeds = self.configuration.seeds
        return {
            "chosen": choose_epochs(rows, seeds),
            "curves": curves_of(rows, seeds),
            "versions": installed_versions(),
        }


def choose_epochs(rows: Sequence[Mapping[str, str]], seeds: int) -> list[int]:
    """Return the epoch of each seed with the best validation score, success minus collisions; the later of equals.

    Every evaluated epoch has a checkpoint. The scenarios of the validation are not those of the evaluation.
    """
    best: dict[int, tuple[float, int]] = {}
    for row in rows:
        if row.get("validation_success_rate"):
            score = round(float(row["validation_success_rate"]) - float(row["validation_collision_rate"]), 9)
            seed, candidate = int(row["seed"]), (score, int(row["epoch"]))
            best[seed] = max(best.get(seed, candidate), candidate)
    return [best[seed][1] for seed in range(seeds)]


def curves_of(rows: Sequence[Mapping[str, str]], seeds: int) -> dict[str, list[list[float | None]]]:
    """Return each metric as a list over the epochs of lists over the seeds; None where it was not measured."""
    curves: dict[str, dict[int, list[float | None]]] = {
        name: defaultdict(lambda: [None] * seeds) for name in CURVES
    }
    for row in rows:
        for name, epochs in curves.items():
            value = float(row.get(name) or "nan")
            epochs[int(row["epoch"])][int(row["seed"])] = value if np.isfinite(value) else None
    return {name: [epochs[epoch] for epoch in sorted(epochs)] for name, epochs in curves.items()}


def policy_path(output: Path, folder: str, seed: int) -> Path:
    """Return where `EvaluateSeed` puts the policy of a seed."""
    return output / folder / "policies" / f"seed-{seed}.onnx"


@dataclass(frozen=True)
class EvaluateSeed(Task):
    """Export the policy of one seed, drive it on fixed and on held-out scenarios, and verify the visited states.

    Parameters
    ----------
    training : TrainVariant
        Where it comes from.
    seed : int
        Which of the seeds.
    scenarios : int
        Held-out random scenarios.
    eps : float
        Sensor error.
    footprint : float
        Radius in metres of the disc from which it is verified; 0 is the map's footprint.
    """

    training: TrainVariant
    seed: int
    scenarios: int
    eps: float
    footprint: float = 0.0

    @property
    def name(self) -> str:
        """Return ``SETTING/VARIANT/seed-N``."""
        return f"{self.training.folder}/seed-{self.seed}"

    @property
    def needs(self) -> tuple[str, ...]:
        """Return the training."""
        return (self.training.name,)

    @property
    def work(self) -> float:
        """Return some seconds, in proportion to the scenarios."""
        return _EVALUATION_SECONDS * self.scenarios / 500

    def parameters(self) -> dict[str, Any]:
        """Return everything, the training as its digest."""
        training = digest(self.training.parameters())
        return {"training": training, "seed": self.seed, "scenarios": self.scenarios, "eps": self.eps} | (
            {"footprint": self.footprint} if self.footprint else {}
        )

    def reads(self, output: Path) -> list[Path]:
        """Return the record of the training, and the checkpoint that is chosen there."""
        chosen = self._checkpoint(self._epoch(output))
        return [record_path(output, self.training.name).relative_to(output), chosen]

    def _epoch(self, output: Path) -> int:
        trained = json.loads(record_path(output, self.training.name).read_text(encoding="utf-8"))
        return int(trained["result"]["chosen"][self.seed])

    def _checkpoint(self, epoch: int) -> Path:
        return Path(self.training.folder, "run", "checkpoints", f"epoch_{epoch:04d}.pt")

    def run(self, output: Path, progress: Progress) -> dict[str, Any]:
        """Return the report of either set of scenarios, the costs of the episodes and the fixed paths."""
        from viatool.train import export_checkpoint

        options, world_map = self.training.configuration, self.training.world_map
        epoch = self._epoch(output)
        checkpoint = output / self._checkpoint(epoch)
        target = policy_path(output, self.training.folder, self.seed)
        target.parent.mkdir(parents=True, exist_ok=True)
        policy = export_checkpoint(checkpoint, target, seed=self.seed, map_path=world_map)
        if world_map.generator is None:
            raise ConfigurationError(f"map {options.map} has no generator", "add one, as maps/lab.yaml has")
        held_out = world_map.generator.draw(self.scenarios, options.test_seed)
        found: dict[str, Any] = {"seed": self.seed, "epoch": epoch, "sha256": policy.sha256}
        progress("fixed scenarios", 0.1, 1.0)
        fixed = self._verify(policy, world_map, world_map.scenarios)
        progress("held-out scenarios", 0.3, 1.0)
        random = self._verify(policy, world_map, held_out, only_contested=True)
        return found | {"fixed": report(fixed), "held_out": report(random), "paths": paths(fixed)}

    def _verify(
        self, policy: Any, world_map: WorldMap, scenarios: Sequence[Scenario], **settings: Any
    ) -> Result:
        from viatool.simulate import roll_out
        from viatool.verification import verify

        options = self.training.configuration
        trajectory = roll_out(policy, world_map, scenarios, horizon=options.horizon, seed=options.test_seed)
        if self.footprint:
            settings["footprint"] = self.footprint
        return verify(
            policy, world_map, eps=self.eps, trajectory=trajectory, seed=options.test_seed, **settings
        )


def report(result: Result) -> dict[str, Any]:
    """Return what the tables need of a result: the report's counts, and the costs of the episodes and their CVaR."""
    from viatool.train.constraint import empirical_cvar

    document = result.to_json()
    kept = ("states", "verdicts", "safety_rate", "sampled_safety_rate", "danger_rate", "contested_rate")
    rows = {name: document[name] for name in (*kept, "task", "reachable_width")}
    costs = result.trajectory.costs
    tails = {str(variant.alpha): empirical_cvar(costs, variant.alpha) for variant in ALPHAS}
    return rows | {"costs": costs.tolist(), "cvar": tails}


def paths(result: Result) -> list[dict[str, Any]]:
    """Return every episode as its outcome, poses and ends of the commands, to the millimetre."""
    lower, upper = result.commands
    table = np.round(np.concatenate([result.poses, lower, upper], axis=1), 3)
    episodes = []
    for episode, outcome in enumerate(result.outcomes):
        chosen = result.episode == episode
        episodes.append({"outcome": str(outcome), "states": table[chosen].tolist()})
    return episodes
