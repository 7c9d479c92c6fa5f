"""The recorded states of any number of episodes, as arrays."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Booleans, Floats, Indices
from viatool.errors import TrajectoryError

if TYPE_CHECKING:
    from viatool.world import Scenario


OUTCOMES = ("success", "collision", "timeout", "unknown")


@dataclass(frozen=True, eq=False)
class Trajectory:
    """N states in which an action was taken, of E episodes; terminal states are not among them.

    Parameters
    ----------
    poses : ndarray
        (N, 3) x, y, theta in the map frame; metres and radians.
    observations : ndarray
        (N, n) what the policy saw, in the units of its specification.
    actions : ndarray
        (N, A) what the policy commanded; (N, 0) when it was not recorded.
    episode : ndarray
        (N,) index of the episode in 0..E-1; the states of an episode stand in the order of time.
    time : ndarray
        (N,) seconds since the start of the episode.
    outcomes : ndarray
        (E,) one of `OUTCOMES`.
    costs : ndarray
        (E,) steps that the episode spent within the danger distance, NaN when it was not recorded.
    scenarios : tuple
        E entries: what the episode added to the map (start, goal, obstacles of its own), or None.
    notes : tuple of str
        What was assumed or left out when the states were made, in words, for the report.
    connected : bool
        Whether the states of an episode follow one another; False for poses that were picked.
    from_rest : bool
        Whether the robot is known to have stood still before the first state of every episode, as in a simulation.
    commanded : ndarray, optional
        (N,) bool: whether the command before each state was recorded, and not assumed; None if nothing was assumed.
    clocked : bool
        Whether `time` was recorded; without a clock nobody knows which rows follow one another.
    steps : ndarray, optional
        (N,) control intervals since the beginning of each state's episode, where frames that reach farther back are
        known to repeat its first reading; None where nothing tells.
    people : ndarray
        (N, P, 5) people around each state: x, y, velocity along x and y, and radius, in the map frame, in m and m/s;
        NaN for nobody. By default (N, 0, 5).
    motion : mapping
        What the robot had in each state besides its pose, by name, as far as it is known: (N,) each, `v` in m/s,
        `omega` in rad/s, `steering` in rad.
    began : int, optional
        When `time` was 0, by the clock of a recording of one episode, in nanoseconds; None where nothing tells.

    Raises
    ------
    TrajectoryError
        If shapes contradict each other, a number is not finite, a pose is not a place on a map, an episode index has no
        outcome, or the clock of an episode goes back.
    """

    poses: Floats
    observations: Floats
    actions: Floats
    episode: Indices
    time: Floats
    outcomes: NDArray[np.str_]
    costs: Floats
    scenarios: tuple[Scenario | None, ...]
    notes: tuple[str, ...] = ()
    connected: bool = True
    from_rest: bool = False
    commanded: Booleans | None = None
    clocked: bool = True
    steps: Indices | None = None
    people: Floats = field(default_factory=lambda: np.zeros((0, 0, 5)))
    motion: Mapping[str, Floats] = field(default_factory=dict)
    began: int | None = None

    def __post_init__(self) -> None:
        if np.shape(self.people)[1:] == (0, 5):
            object.__setattr__(self, "people", np.zeros((len(self.poses), 0, 5)))
        for name, kind in _KINDS.items():
            object.__setattr__(self, name, np.asarray(getattr(self, name), dtype=kind))
        object.__setattr__(self, "outcomes", np.asarray(self.outcomes, dtype=np.str_))
        object.__setattr__(self, "scenarios", tuple(self.scenarios))
        object.__setattr__(
            self, "motion", {name: np.asarray(own, dtype=np.float64) for name, own in self.motion.items()}
        )
        _check_shapes(self)
        _check_finite(self)
        _check_people(self)
        _check_places(self)
        _check_episodes(self)
        _check_steps(self)

    def __len__(self) -> int:
        """Return the number of states."""
        return int(self.poses.shape[0])

    @property
    def episodes(self) -> int:
        """Return the number of episodes."""
        return int(self.outcomes.shape[0])

    def name_of(self, episode: int) -> str:
        """Return the name of an episode's scenario, or its number."""
        scenario = self.scenarios[episode]
        return f"episode {episode}" if scenario is None else scenario.name

    def select(self, states: NDArray[Any]) -> Trajectory:
        """Return the trajectory of some states, with every episode kept.

        Parameters
        ----------
        states : ndarray
            (N,) bool, or indices in increasing order.
        """
        chosen = {name: getattr(self, name)[states] for name in _BY_STATE}
        for name in ("commanded", "steps"):
            if getattr(self, name) is not None:
                chosen[name] = getattr(self, name)[states]
        motion = {name: own[states] for name, own in self.motion.items()}
        return replace(self, **chosen, motion=motion)

    def repeated(self) -> int:
        """Return the number of states that are the same as the one before in their episode: time, pose, observation."""
        order = np.argsort(self.episode, kind="stable")
        same = np.diff(self.episode[order]) == 0
        for values in (self.time[:, None], self.poses, self.observations):
            same &= (values[order[1:]] == values[order[:-1]]).all(axis=1)
        return int(same.sum())


_FARTHEST = 1e6  # metres or radians, as for maps
_BY_STATE = ("poses", "observations", "actions", "episode", "time", "people")
_KINDS: dict[str, type] = {
    "poses": np.float64,
    "observations": np.float64,
    "actions": np.float64,
    "episode": np.int64,
    "time": np.float64,
    "costs": np.float64,
    "people": np.float64,
}


def _check_shapes(trajectory: Trajectory) -> None:
    """Refuse arrays whose shapes do not belong together."""
    states = trajectory.poses.shape[0] if trajectory.poses.ndim else 0
    expected: dict[str, tuple[int | None, ...]] = {
        "poses": (states, 3),
        "observations": (states, None),
        "actions": (states, None),
    }
    expected |= {"episode": (states,), "time": (states,), "people": (states, None, 5)}
    expected |= {"outcomes": (len(trajectory.scenarios),), "costs": (len(trajectory.scenarios),)}
    arrays = {name: getattr(trajectory, name) for name in expected}
    if trajectory.steps is not None:
        arrays["steps"], expected["steps"] = trajectory.steps, (states,)
    for name, own in trajectory.motion.items():
        arrays[f"motion_{name}"], expected[f"motion_{name}"] = own, (states,)
    for name, shape in expected.items():
        found = arrays[name].shape
        if len(found) != len(shape) or any(w not in (None, f) for f, w in zip(found, shape, strict=True)):
            wanted = "(" + ", ".join("any" if size is None else str(size) for size in shape) + ")"
            raise TrajectoryError(
                f"trajectory array '{name}' has shape {found}, expected {wanted}",
                "give one row for every state and one outcome, cost and scenario for every episode",
            )


def _check_finite(trajectory: Trajectory) -> None:
    """Refuse numbers that are not finite, naming the first one."""
    arrays = {name: getattr(trajectory, name) for name in ("poses", "observations", "actions", "time")}
    arrays |= {f"motion_{name}": own for name, own in trajectory.motion.items()}
    for name, values in arrays.items():
        if not np.isfinite(values).all():
            bad = np.argwhere(~np.isfinite(values))
            row, *column = bad[0].tolist()
            place = f"row {row}" + (f", column {column[0]}" if column else "")
            raise TrajectoryError(
                f"trajectory array '{name}' holds {values[tuple(bad[0])]} in {place}, which is not finite",
                "leave out states that were not observed, and replace infinite ranges by the maximum range",
            )


def _check_people(trajectory: Trajectory) -> None:
    """Refuse people of whom only a part is known, or who have a negative radius."""
    people = trajectory.people
    nobody = np.isnan(people).all(axis=2)
    wrong = np.argwhere(~nobody & ~(np.isfinite(people).all(axis=2) & (people[:, :, 4] >= 0.0)))
    if len(wrong):
        row, person = wrong[0].tolist()
        raise TrajectoryError(
            f"trajectory has person {person} as {people[row, person].tolist()} in row {row}, expected finite x, y, vx, "
            "vy and a radius of 0 or more",
            "give all five numbers, or NaN for all of them where nobody is",
        )


def _check_places(trajectory: Trajectory) -> None:
    """Refuse poses that no map reaches, such as those in degrees of latitude times a million."""
    far = np.argwhere(np.abs(trajectory.poses) > _FARTHEST)
    if len(far):
        row = int(far[0, 0])
        raise TrajectoryError(
            f"trajectory has the pose {trajectory.poses[row].tolist()} in row {row}, expected at most {_FARTHEST:g}",
            "give poses in metres and radians, in the frame of the map",
        )


def _check_steps(trajectory: Trajectory) -> None:
    """Refuse numbers of control intervals that are none."""
    steps = trajectory.steps
    if steps is None:
        return
    wrong = np.flatnonzero(steps < 0) if steps.dtype.kind in "iu" else np.arange(len(steps))[:1]
    if len(wrong):
        row = int(wrong[0])
        raise TrajectoryError(
            f"trajectory array 'steps' holds {steps[row]} in row {row}, expected whole numbers of at least 0",
            "count the control intervals since the beginning of the episode, or leave the array out",
        )
    if not trajectory.connected:
        return
    order = np.argsort(trajectory.episode, kind="stable")
    later = (np.diff(trajectory.time[order]) > 0) & (np.diff(trajectory.episode[order]) == 0)
    stands = np.flatnonzero(later & (np.diff(steps[order].astype(np.int64)) < 1))
    if len(stands):
        row = int(order[1 + stands[0]])
        raise TrajectoryError(
            f"trajectory array 'steps' holds {steps[row]} in row {row}, no more than in the row before of its episode",
            "count the control intervals since the beginning of the episode, or leave the array out",
        )


def _check_episodes(trajectory: Trajectory) -> None:
    """Refuse episode indices without an outcome, unknown outcomes, and clocks that go back."""
    episode, count = trajectory.episode, trajectory.episodes
    if episode.size and (episode.min() < 0 or episode.max() >= count):
        raise TrajectoryError(
            f"trajectory names episodes {episode.min()} to {episode.max()}, but has {count} outcomes",
            "number the episodes from 0 and give each one an outcome",
        )
    for outcome in np.unique(trajectory.outcomes):
        if outcome not in OUTCOMES:
            raise TrajectoryError(
                f"trajectory has the outcome '{outcome}', expected one of {', '.join(OUTCOMES)}",
                "write 'unknown' where the outcome was not recorded",
            )
    order = np.argsort(episode, kind="stable")
    back = (np.diff(trajectory.time[order]) < 0) & (np.diff(episode[order]) == 0)
    if back.any():
        row = int(order[1:][back][0])
        raise TrajectoryError(
            f"the clock of episode {int(episode[row])} goes back in row {row}, to {trajectory.time[row]} s",
            "sort the rows of every episode by time",
        )
