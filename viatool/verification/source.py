"""Where the states of a verification come from: a recording, a simulated drive, or poses all over the map."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace

from viatool.errors import ConfigurationError, TrajectoryError
from viatool.policy import Policy
from viatool.setting.recalled import recalled
from viatool.setting.received import as_received
from viatool.setting.setting import Setting
from viatool.simulate import Agreement, Conditions, Places, compare_with_map, drive, observe_places
from viatool.trajectory import BagSettings, Trajectory, load_trajectory
from viatool.uncertainty import ErrorModel
from viatool.verification.close import close_places

StrPath = str | os.PathLike[str]


@dataclass(frozen=True, eq=False)
class Source:
    """Where the states come from; a drive through the scenarios of the setting if nothing else is given.

    Parameters
    ----------
    trajectory : Trajectory or path, optional
        Recorded states.
    bag : BagSettings, optional
        How to read a ROS bag.
    places : Places, optional
        Poses spread over the free space.
    noise : float, optional
        Of the simulated sensor, in metres; None is the map's.
    seed : int
        Of the simulated sensor, of random poses and of the search for counterexamples.

    Raises
    ------
    ConfigurationError
        If states are given and poses are to be sampled.
    """

    trajectory: Trajectory | StrPath | None = None
    bag: BagSettings | None = None
    places: Places | None = None
    noise: float | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        if self.places is not None and self.places.near is None and self.trajectory is not None:
            raise ConfigurationError("states are given and poses are to be sampled", "leave one of them out")

    def states(self, policy: Policy, setting: Setting) -> Trajectory:
        """Return the states."""
        if self.places is None:
            return self._driven(policy, setting)
        if self.places.near is None:
            return observe_places(policy, setting, self.places, seed=self.seed)
        driven = as_received(setting, self._driven(policy, setting))
        return close_places(setting, driven, self.places.near, seed=self.seed)

    def _driven(self, policy: Policy, setting: Setting) -> Trajectory:
        if self.trajectory is None:
            conditions = Conditions(noise=self.noise, delay=setting.rules.delay)
            motors = _motors(setting)
            return drive(policy, setting, conditions=conditions, errors=motors, seed=self.seed).trajectory
        if isinstance(self.trajectory, Trajectory):
            return recalled(policy, setting, self.trajectory)
        recorded = load_trajectory(self.trajectory, setting.spec, self.bag)
        _require_on_map(recorded, setting, self.trajectory)
        return recalled(policy, setting, recorded)

    def compared(self, setting: Setting, states: Trajectory) -> tuple[Agreement, ...]:
        """Return how the LiDAR readings of recorded states agree with the map; nothing of states that are simulated."""
        if self.trajectory is None or self.places is not None:
            return ()
        return compare_with_map(
            setting.spec.observation,
            states,
            setting.world_map,
            setting.radii,
            setting.spec.frames,
            setting.uncertainty,
        )

    def words(self, setting: Setting) -> str:
        """Return in words where the states come from, and the seed."""
        seed = self.seed
        if self.places is not None:
            if self.places.near is not None:
                driven = replace(self, places=None).words(setting)
                return f"{self.places.near:,} close places beside states that are {driven}"
            if self.places.count is not None:
                return f"{self.places.count:,} random poses, seed {seed}"
            grid = f"a grid of {self.places.spacing:g} m with {self.places.headings} headings"
            return f"{grid}, seed {seed} of the search"
        if self.trajectory is None:
            sensor = "the map's sensor noise" if self.noise is None else f"sensor noise {self.noise:g} m"
            motors = _motors(setting)
            drawn = f", motors and timing drawn within {motors.source}" if motors else ""
            return f"simulated, {sensor}{drawn}, seed {seed}"
        given = isinstance(self.trajectory, Trajectory)
        source = "given as arrays" if given else f"read from {os.fspath(self.trajectory)}"  # type: ignore[arg-type]
        return f"{source}, seed {seed} of the search"


def _motors(setting: Setting) -> ErrorModel:
    """Return how motors and clocks of a simulated drive err: as the error model says.

    The errors of sensors and of the pose are counted around what was observed, and what moves counts from where the map
    shows it; so neither is drawn.
    """
    return setting.uncertainty.only("actuation", "timing")


def _require_on_map(recorded: Trajectory, setting: Setting, path: StrPath) -> None:
    """Refuse a recording of which every pose lies off the map: it is in another frame, and no verdict is about it.

    Raises
    ------
    TrajectoryError
        Says where the poses are, and where the map is.
    """
    if not len(recorded):
        return
    x_min, y_min, x_max, y_max = setting.world_map.bounds
    x, y = recorded.poses[:, 0], recorded.poses[:, 1]
    if ((x_min <= x) & (x <= x_max) & (y_min <= y) & (y <= y_max)).any():
        return
    raise TrajectoryError(
        f"{os.fspath(path)}: every pose lies off the map '{setting.world_map.path}': x {x.min():.4g} to {x.max():.4g} "
        f"m, y {y.min():.4g} to {y.max():.4g} m, and the map is x {x_min:.4g} to {x_max:.4g} m, y {y_min:.4g} to "
        f"{y_max:.4g} m",
        "give poses in the frame of the map, or the map that the robot was on",
    )
