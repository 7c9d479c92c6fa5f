"""Close places: poses beside a driven path at which it is up to the policy whether the robot comes too near."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np

from viatool.arrays import Booleans, Floats, Indices
from viatool.channels import View
from viatool.errors import ConfigurationError, EmptyEvaluationError, InputError, PolicyError
from viatool.safety import JudgedStates, ScenePoses, settle
from viatool.setting.received import as_received
from viatool.setting.setting import Setting
from viatool.trajectory import Trajectory
from viatool.verification.observing import BlockSensors
from viatool.verification.states import states_of
from viatool.world import Scenes

_log = logging.getLogger(__name__)

CLOSE = 300
"""Places beside the driven path that are examined unless another number is asked for."""
MOST = 100_000  # places; more is a slip of the keyboard
_NEAR = (0.5, 1.0, 2.0, 4.0)
"""Metres around driven states within which places are drawn: farther only where too few are found nearer."""
_TRIES = 8
"""Batches within each of these distances, for each thousand places that are asked for."""
_BATCH = 4096
"""Places of a batch, or as many as fit; part of what a seed means."""
_MOST_FLOATS = 2**23
_INSTANTS = np.linspace(0.0, 1.0, 9)


def close_places(setting: Setting, trajectory: Trajectory, count: int, *, seed: int = 0) -> Trajectory:
    """Return states at places beside driven ones, where it is up to the policy whether the robot comes too near.

    Parameters
    ----------
    setting : Setting
        The map, what is observed, and the criterion by which places are contested.
    trajectory : Trajectory
        N driven or recorded states, as the program received them.
    count : int
        How many places.
    seed : int
        Of the places.

    Returns
    -------
    Trajectory
        At most `count` states of the episodes of the given ones, in their order; they do not follow one another. Each
        is free (its footprint keeps the collision distance), contested (some command endangers it, and some other one
        does not) and in sight of the driven state that it is beside. Headings are drawn from all round. What sensors
        observe of the surroundings and of the goal is computed from the map, without noise; what tells how the robot
        came there (commands before, velocities, outputs before, the time left) is that of the driven state, and so are
        the state of its motion and the time.

    Raises
    ------
    ConfigurationError
        If `count` is not between 1 and 100,000, or it is not known what is observed at a place.
    PolicyError
        If the policy observes what is not known of a place, such as its own memory.
    EmptyEvaluationError
        If no place is found.
    """
    if not 0 < count <= MOST:
        raise ConfigurationError(f"{count} close places", f"ask for 1 to {MOST:,}")
    _require_known(setting, trajectory)
    beside = _Beside(setting, trajectory)
    rng = np.random.default_rng([seed, _BATCH])
    rows, poses = np.zeros(0, np.int64), np.zeros((0, 3))
    for near in np.repeat(_NEAR, _TRIES * -(-count // 1000)):
        drawn = beside.drawn(float(near), rng)
        rows, poses = np.concatenate([rows, drawn[0]])[:count], np.concatenate([poses, drawn[1]])[:count]
        if len(rows) == count:
            break
    if not len(rows):
        raise EmptyEvaluationError(
            f"no place within {_NEAR[-1]:g} m of the states is free and contested",
            "drive closer to obstacles, or look at places all over the map with --poses random:N",
        )
    _log.info("close places: %d of %d found, within %g m of the path", len(rows), count, near)
    order = np.argsort(rows, kind="stable")
    found = beside.at(rows[order], poses[order])
    return as_received(setting, replace(found, observations=_observed(setting, found)))


def places_beside(
    setting: Setting, trajectory: Trajectory, count: int, *, seed: int = 0
) -> tuple[Trajectory | None, str]:
    """Return `close_places`, or in words why there are none."""
    if not trajectory.connected:
        return None, "the states are places that were picked, beside which there is no path"
    try:
        return close_places(setting, trajectory, count, seed=seed), ""
    except (InputError, EmptyEvaluationError) as error:
        return None, error.message


def joined(driven: Trajectory, close: Trajectory) -> Trajectory:
    """Return driven states and behind them close places, in episodes of their own, named for the driven ones."""
    named = (one if one is None else replace(one, name=f"beside {one.name}") for one in close.scenarios)
    arrays: dict[str, Any] = {
        name: np.concatenate([getattr(driven, name), getattr(close, name)])
        for name in ("poses", "observations", "time", "outcomes", "costs")
    }
    count = len(driven) + len(close)
    return replace(
        driven,
        **arrays,
        actions=np.zeros((count, 0)),
        episode=np.concatenate([driven.episode, close.episode + driven.episodes]),
        scenarios=(*driven.scenarios, *named),
        commanded=None,
        steps=None,
        people=np.zeros((count, 0, 5)),
        motion={},
    )


@dataclass(frozen=True, eq=False)
class _Beside:
    """Places beside the states of a trajectory."""

    setting: Setting
    trajectory: Trajectory

    @cached_property
    def around(self) -> ScenePoses:
        """The driven poses among what stands there."""
        driven = self.trajectory
        return ScenePoses.of(self.setting.world_map, driven.scenarios, driven.poses, driven.episode)

    def at(self, rows: Indices, poses: Floats) -> Trajectory:
        """Return driven states (B,), ascending, as if they were at other poses (B, 3)."""
        driven = self.trajectory.select(rows)
        note = "drawn beside the driven states, contested; perfect sensors, commands before as in the driven state"
        return replace(
            driven, poses=poses, actions=np.zeros((len(rows), 0)), connected=False, from_rest=False, steps=None,
            notes=(note,),
        )  # fmt: skip

    def drawn(self, near: float, rng: np.random.Generator) -> tuple[Indices, Floats]:
        """Draw some places, and return those that count: the states (B,) that they are beside, and poses (B, 3)."""
        rules, driven = self.setting.rules, self.trajectory
        size = min(_BATCH, max(1, _MOST_FLOATS // driven.observations.shape[1]))
        rows = np.sort(rng.integers(len(driven), size=size))
        away, towards, heading = rng.random((3, size))
        steps = near * np.sqrt(away) * np.exp(2j * np.pi * towards)
        moved = driven.poses[rows, :2] + np.stack([steps.real, steps.imag], axis=1)
        poses = np.column_stack([moved, 2.0 * np.pi * heading - np.pi])
        clearance = self.around.still.footprint_clearance(poses, rules.footprint, driven.episode[rows])
        free = clearance > rules.clearance.collision
        rows, poses = rows[free], poses[free]
        states, exact = states_of(self.setting, self.at(rows, poses)), self.around.select(rows).moved(poses)
        judged = BlockSensors(self.setting, states, exact).judged
        some = np.flatnonzero(~judged.out_of_reach & judged.known)
        some = some[~settle(judged.select(some), rules.clearance.collision)]
        some = some[_avoidable(judged.select(some))]
        seen = self.around.still.segment_clearance(
            driven.poses[rows[some], :2], poses[some, :2], driven.episode[rows[some]]
        )
        kept = rng.permutation(some[seen > 0.0])
        return rows[kept], poses[kept]


def _avoidable(judged: JudgedStates) -> Booleans:
    """Tell in which of B states some command of the robot keeps the collision distance, (B,).

    Notes
    -----
    Sound: no; it looks at some commands at some instants.
    """
    lower, upper = judged.rules.lower, judged.rules.upper
    shares = np.array(list(product((0.0, 0.5, 1.0), repeat=len(lower))))
    found = np.zeros(len(judged), dtype=bool)
    for commands in (judged.rules.clip(np.zeros((1, len(lower)))), lower + shares * (upper - lower)):
        rows = np.flatnonzero(~found)
        asked = np.broadcast_to(commands, (len(rows), *commands.shape))
        clearance = judged.select(rows).clearance(asked, _INSTANTS)
        found[rows] = np.any(np.all(clearance > judged.rules.clearance.collision, axis=2), axis=1)
    return found


def _require_known(setting: Setting, trajectory: Trajectory) -> None:
    """Refuse states beside which it is not known what a policy would observe."""
    setting.quantities.require("measure")
    if setting.inputs.memory:
        raise PolicyError(
            f"the policy observes readings of up to {setting.inputs.memory} control intervals before, "
            "which a place does not tell",
            "look at driven or recorded states alone",
        )
    if setting.moves:
        raise ConfigurationError(
            "things move, and where they are is known of the states alone",
            "leave the terms about obstacles out",
        )
    if "goal" in setting.quantities.needs and None in trajectory.scenarios:
        raise ConfigurationError(
            "an episode has no goal, which the policy observes",
            "give the trajectory its scenario, or a bag its --goal",
        )


def _observed(setting: Setting, places: Trajectory) -> Floats:
    """Return what the policy observes at places whose observations are of the driven states, (B, n)."""
    count, quantities = len(places), setting.quantities
    goals = np.array([(0.0, 0.0) if one is None else one.goal for one in places.scenarios], dtype=np.float64)
    view = View(
        Scenes.of(setting.world_map, places.scenarios),
        places.poses,
        places.episode,
        goals[places.episode],
        np.zeros((count, len(setting.rules.kinematics.axes))),
        velocity=np.zeros((count, 3)),
    )
    placed = np.array([one.placed for one in quantities])[quantities.inputs.channel]
    return np.where(placed, quantities.measure(view), places.observations)
