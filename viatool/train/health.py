"""A run that goes wrong: what its metrics say before it has ended."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from viatool.arrays import Floats
from viatool.train.configuration import TrainingConfiguration
from viatool.world import Robot

EARLY = 0.25
"""Share of the epochs after which a policy should arrive now and then."""
RECENT = 5  # epochs over which that is judged
ARRIVES = 0.02  # of the episodes
SATURATED = 0.9  # of the outputs
PLAUSIBLE = 2.0  # so many times what all rewards of an episode come to may be predicted

Row = Mapping[str, float]


def largest_return(options: TrainingConfiguration, robot: Robot) -> float:
    """Return what the discounted rewards of any episode stay below in size, in the units that are learnt."""
    metres = robot.max_linear * robot.control_interval
    if options.shaping_path == "around":
        metres = robot.control_interval * float(
            np.hypot(robot.max_linear, options.shaping_lookahead * robot.max_angular)
        )
    step = (
        options.shaping * metres
        + options.turn_penalty * robot.max_angular
        + options.proximity_penalty * options.proximity_range
        + options.steering_penalty * 2 * robot.max_angular
        + options.standing_penalty
    )
    once = max(options.success_reward, options.collision_penalty)
    return options.reward_scale * (once + step / (1.0 - options.discount))


def complaints(rows: Sequence[Row], options: TrainingConfiguration, largest: float) -> dict[str, str]:
    """Return what is wrong with a run, in words, by what is wrong.

    Parameters
    ----------
    rows : sequence of dict
        Metrics of the finished epochs, those of all seeds of an epoch beside each other.
    options : TrainingConfiguration
        Of the run.
    largest : float
        See `largest_return`.

    Returns
    -------
    dict
        ``flat``: no seed arrives; ``saturated``: the outputs of some seeds are at their ends nearly everywhere;
        ``values``: some critics predict more than all rewards come to.
    """
    found: dict[str, str] = {}
    epoch = len(rows) // options.seeds
    recent = rows[-RECENT * options.seeds :]
    success = _by_seed(recent, "success_rate", options.seeds)
    if epoch >= max(RECENT, EARLY * options.epochs) and np.nanmax(success, initial=0.0) < ARRIVES:
        found["flat"] = (
            f"after {epoch} epochs no seed arrives in more than {ARRIVES:.0%} of its episodes: look whether the map "
            "leaves a way, whether the goals are near enough to begin with (curriculum_start), and at learning_rate"
        )
    share = _by_seed(rows[-options.seeds :], "saturated_share", options.seeds)
    if (share > SATURATED).any():
        found["saturated"] = (
            f"{_seeds(share > SATURATED)} commands the ends of its range nearly everywhere, where it learns no more: "
            "raise saturation_penalty, or lower learning_rate"
        )
    value = np.abs(_by_seed(rows[-options.seeds :], "task_value", options.seeds))
    if (value > PLAUSIBLE * largest).any():
        found["values"] = (
            f"the critics of {_seeds(value > PLAUSIBLE * largest)} predict {np.nanmax(value):.3g}, but all rewards of "
            f"an episode come to {largest:.3g} at most: lower learning_rate or target_rate"
        )
    return found


def _by_seed(rows: Sequence[Row], name: str, seeds: int) -> Floats:
    """Return the mean of a metric over the epochs of the rows, (S,); NaN where it was not measured."""
    table = np.array([row.get(name, np.nan) for row in rows], dtype=np.float64).reshape(-1, seeds)
    counts = np.isfinite(table).sum(axis=0)
    mean: Floats = np.full(seeds, np.nan)
    np.divide(np.nansum(table, axis=0), counts, out=mean, where=counts > 0)
    return mean


def _seeds(which: np.ndarray) -> str:
    numbers = np.flatnonzero(which).tolist()
    return (
        f"seed {', '.join(map(str, numbers))}"
        if len(numbers) == 1
        else f"seeds {', '.join(map(str, numbers))}"
    )
