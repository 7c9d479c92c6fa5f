"""States beyond the driven ones: poses all over the free space, with what the policy would see there."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from viatool.arrays import Floats, Indices, Reals
from viatool.channels import Fan, Quantities, View, see
from viatool.errors import ConfigurationError, EmptyEvaluationError
from viatool.motion.changing import ChangingTwist
from viatool.motion.law import Kinematics
from viatool.setting.setting import Setting
from viatool.simulate.roll_out import RunnablePolicy
from viatool.trajectory import Trajectory
from viatool.world import Footprint, Scenes, WorldMap

_MOST = 5_000_000  # poses; more is a slip of the keyboard
_BATCH = 4096  # poses drawn together; part of what a seed means
_OBSERVED = 16_384  # poses observed together, so that memory stays flat
_BARREN = 50  # batches without a free place after which a map counts as full


@dataclass(frozen=True)
class Places:
    """Which poses are looked at: a grid, a number of random ones, or some beside driven states.

    Parameters
    ----------
    spacing : float, optional
        Of a grid, in metres.
    count : int, optional
        Number of random poses, shared evenly among the scenarios.
    headings : int
        Evenly spread headings at each place of a grid.
    near : int, optional
        Number of close places beside the driven, or recorded, states.
    """

    spacing: float | None = None
    count: int | None = None
    headings: int = 8
    near: int | None = None

    def __post_init__(self) -> None:
        if sum(given is not None for given in (self.spacing, self.count, self.near)) != 1:
            raise ConfigurationError(
                "places are a grid, random ones or near driven states", "give one of spacing, count and near"
            )
        if self.spacing is not None and not 0.0 < self.spacing < np.inf:
            raise ConfigurationError(f"the grid's spacing is {self.spacing} m", "give a positive distance")
        if self.count is not None and not 0 < self.count <= _MOST:
            raise ConfigurationError(f"{self.count} random poses", f"ask for 1 to {_MOST:,}")
        if self.headings < 1:
            raise ConfigurationError(f"{self.headings} headings", "ask for at least one")


def observe_places(policy: RunnablePolicy, setting: Setting, places: Places, *, seed: int = 0) -> Trajectory:
    """Return states at poses spread over the free space, one episode for each scenario of a setting.

    Parameters
    ----------
    policy : Policy
        Its `run` gives the previous commands.
    setting : Setting
        Where, and what is observed; a place is free when the footprint keeps the collision distance. Its scenarios give
        the goals, and the obstacles that stand there besides the map's.
    places : Places
        Which poses.
    seed : int
        Of random poses.

    Returns
    -------
    Trajectory
        N states that do not follow one another. Observations have no sensor noise, and the previous command is
        what the policy commands at the same pose after standing still. The state of the motion, if there is one, is
        drawn from its whole range.

    Raises
    ------
    ConfigurationError
        If there is no scenario, the grid is too fine, or nothing limits the state of the motion.
    EmptyEvaluationError
        If there is no free place.
    PolicyError
        If the policy observes what is not known of a place, such as its own memory.
    """
    world_map, scenarios = setting.world_map, setting.scenarios
    _quantities(setting)  # refuses what is not known of places before anything is drawn
    if not scenarios:
        raise ConfigurationError(f"map '{world_map.path}' has no scenarios", "give a goal with --goal X,Y")
    scenes, outline = Scenes.of(world_map, scenarios), setting.rules.footprint
    if places.count is not None:
        poses, scene = _random(world_map, scenes, places, outline, seed)
    else:
        poses, scene = _grid(world_map, len(scenarios), places)
        free = scenes.footprint_clearance(poses, outline, scene) > world_map.clearance.collision
        poses, scene = poses[free], scene[free]
    if not len(poses):
        raise EmptyEvaluationError("there is no free place", "lower the clearance or the grid's spacing")
    goals = np.array([scenario.goal for scenario in scenarios])[scene]
    motion = _draw_motion(setting.rules.kinematics, len(poses), seed)
    axes, state = len(setting.rules.kinematics.axes), setting.rules.kinematics.state
    observations = np.empty((len(poses), setting.spec.observation_size))
    for start in range(0, len(poses), _OBSERVED):
        rows = slice(start, start + _OBSERVED)
        before = motion[rows] if motion.shape[1] else np.zeros((len(motion[rows]), axes))
        standing, velocity = setting.rules.kinematics.recalled(before)
        here = View(scenes, poses[rows], scene[rows], goals[rows], standing, velocity=velocity)
        observations[rows] = _observe(policy, setting, here, motion[rows])
    return Trajectory(
        poses=poses,
        observations=observations,
        actions=np.zeros((len(poses), 0)),
        episode=scene,
        time=np.zeros(len(poses)),
        outcomes=np.full(len(scenarios), "unknown"),
        costs=np.full(len(scenarios), np.nan),
        scenarios=scenarios,
        notes=(
            "only poses that keep the collision distance",
            "previous command: the policy's own at the same pose after standing still",
            "no sensor noise",
            *(f"{axis.name} drawn at random from its range" for axis in state),
        ),
        connected=False,
        steps=np.zeros(len(poses), np.int64),
        motion=dict(zip([axis.name for axis in state], motion.T, strict=True)),
    )


def _quantities(setting: Setting) -> Quantities:
    return Quantities.of(setting.spec.observation, setting.robot, setting.spec.frames).require("measure")


def _grid(world_map: WorldMap, scenarios: int, places: Places) -> tuple[Floats, Indices]:
    """Return all poses of a grid, the centres of its cells, for every scenario."""
    spacing = float(places.spacing or 0.0)
    x_min, y_min, x_max, y_max = world_map.bounds
    cells = (x_max - x_min) / spacing * (y_max - y_min) / spacing
    if cells * places.headings * scenarios > _MOST:
        raise ConfigurationError(
            f"a grid of {spacing:g} m has {cells * places.headings * scenarios:,.0f} poses in {scenarios} "
            f"scenarios, more than {_MOST:,}",
            "widen the spacing",
        )
    x = np.arange(x_min + 0.5 * spacing, x_max, spacing)
    y = np.arange(y_min + 0.5 * spacing, y_max, spacing)
    theta = 2.0 * np.pi * np.arange(places.headings) / places.headings
    poses = np.stack(np.meshgrid(x, y, theta, indexing="ij"), axis=-1).reshape(-1, 3)
    return np.tile(poses, (scenarios, 1)), np.repeat(np.arange(scenarios), len(poses))


def _random(
    world_map: WorldMap, scenes: Scenes, places: Places, footprint: Footprint, seed: int
) -> tuple[Floats, Indices]:
    """Return free poses at random, evenly shared among the scenarios."""
    share = np.bincount(np.arange(int(places.count or 0)) % len(scenes), minlength=len(scenes))
    found = []
    for scene, wanted in enumerate(share.tolist()):
        rng = np.random.default_rng([seed, scene])
        kept, barren = np.zeros((0, 3)), 0
        while len(kept) < wanted:
            x_min, y_min, x_max, y_max = world_map.bounds
            drawn = rng.uniform((x_min, y_min, -np.pi), (x_max, y_max, np.pi), (_BATCH, 3))
            clearance = scenes.footprint_clearance(drawn, footprint, np.full(_BATCH, scene))
            free = drawn[clearance > world_map.clearance.collision]
            barren = 0 if len(free) else barren + 1
            if barren >= _BARREN:
                raise EmptyEvaluationError(
                    "there is no free place", "lower the clearance or give another map"
                )
            kept = np.concatenate([kept, free])
        found.append(kept[:wanted])
    return np.concatenate(found), np.repeat(np.arange(len(scenes)), share)


def _draw_motion(kinematics: Kinematics, count: int, seed: int) -> Floats:
    """Return states of the motion at random, (N, S), each from its whole range."""
    lower, upper = kinematics.state_range
    for axis, low, high in zip(kinematics.state, lower, upper, strict=True):
        if not (np.isfinite(low) and np.isfinite(high)):
            raise ConfigurationError(
                f"nothing limits the {axis.name} of the robot, so poses alone do not say how it moves",
                "give the map's robot its limits, or drive it through scenarios",
            )
    return np.random.default_rng([seed, len(kinematics.axes)]).uniform(lower, upper, (count, len(lower)))


def _observe(policy: RunnablePolicy, setting: Setting, view: View, motion: Floats) -> Floats:
    """Return what the policy observes: first after standing still, then after its own command."""
    quantities = _quantities(setting)
    seen: dict[Fan, Reals] = {}

    def eyes(fan: Fan, now: View) -> Reals:
        if fan not in seen:  # rays are the same whatever the command before was
            seen[fan] = see(fan, now)
        return seen[fan]

    view = replace(view, eyes=eyes)
    standing = quantities.measure(view)
    actions = np.asarray(policy.run(standing), dtype=np.float64)
    previous = setting.rules.clip(setting.sent(standing, actions))
    velocity, kinematics = view.velocity, setting.rules.kinematics
    if isinstance(kinematics, ChangingTwist):
        velocity = kinematics.velocity(np.concatenate([previous, motion], axis=1))
    raw = np.asarray(policy.outputs(standing)) if quantities.outputs else None
    return quantities.measure(replace(view, previous=previous, velocity=velocity, raw=raw))
