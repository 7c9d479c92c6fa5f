"""What the numbers of a policy are, how uncertain they are, and the states in those terms."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from viatool.arrays import Floats
from viatool.errors import ConfigurationError, EmptyEvaluationError, PolicyError, TrajectoryError
from viatool.policy import Policy, PolicySpecification
from viatool.policy.specification import ObservationKind
from viatool.setting.rules import Rules
from viatool.trajectory import Trajectory

_PREVIOUS: tuple[ObservationKind, ...] = ("previous_linear", "previous_angular")
_ROWS = 65536  # states that are converted together, so that no second copy of all exists


@dataclass(frozen=True)
class ActionName:
    """Name and unit of one action."""

    name: str
    unit: str


@dataclass(frozen=True, eq=False)
class Layout:
    """The meaning of observations and actions.

    Parameters
    ----------
    spec : PolicySpecification
        n observation entries, A actions.
    columns : list of int
        Which actions are v and omega.
    radii : ndarray
        (n,) uncertainty of every observation entry.
    number : type
        The floating-point type in which the program receives an observation.
    """

    spec: PolicySpecification
    columns: list[int]
    radii: Floats
    number: type = np.float32

    @classmethod
    def of(cls, policy: Policy, eps: float | Mapping[str, float]) -> Layout:
        """Return the layout of a policy.

        Raises
        ------
        PolicyError
            If the policy has no specification, one of another size, or none of a linear and an angular
            action.
        ConfigurationError
            If a radius is out of range, missing, or of a channel that does not exist.
        """
        spec = policy.spec
        if spec is None:
            raise PolicyError(
                f"policy '{policy.path}' has no specification, so its numbers have no meaning",
                "describe it with --spec robot.yaml",
            )
        sizes = (policy.input_size, policy.output_size)
        if sizes != (spec.observation_size, spec.action_size):
            raise PolicyError(
                f"policy '{policy.path}' takes {sizes[0]} numbers and gives {sizes[1]}, "
                f"its specification names {spec.observation_size} and {spec.action_size}",
                "correct the channels of the specification",
            )
        kinds = [channel.kind for channel in spec.action]
        for kind in ("linear", "angular"):
            if kind not in kinds:
                raise PolicyError(
                    f"no action of policy '{policy.path}' is of kind '{kind}'",
                    "name the kinds of the actions in the specification",
                )
        number = np.float64 if policy.network.nodes[0].precision == "float64" else np.float32
        return cls(spec, [kinds.index("linear"), kinds.index("angular")], spec.radii(eps), number)

    @property
    def actions(self) -> tuple[ActionName, ...]:
        """Return names and units of the actions."""
        return tuple(ActionName(action.name, action.unit) for action in self.spec.action)

    def as_received(self, trajectory: Trajectory) -> Trajectory:
        """Return a trajectory whose observations are the numbers that the program receives, mostly float32.

        Channels that the specification fixes take their value, whatever was recorded (the paper's budget).

        Raises
        ------
        EmptyEvaluationError
            If there is no state.
        TrajectoryError
            If the observations have another size than the policy's.
        """
        size, expected = trajectory.observations.shape[1], self.spec.observation_size
        if len(trajectory) == 0:
            raise EmptyEvaluationError("the trajectory has no states", "record or drive at least one step")
        if size != expected:
            raise TrajectoryError(
                f"the trajectory has {size} observation entries, the policy takes {expected}",
                "verify with the policy that drove, or give the trajectory the columns of this one",
            )
        fixed = self.spec.fixed_values()
        received = np.empty(trajectory.observations.shape)
        for start in range(0, len(trajectory), _ROWS):
            rows = slice(start, start + _ROWS)
            named = np.where(np.isnan(fixed), trajectory.observations[rows], fixed)
            received[rows] = named.astype(self.number)
        return replace(trajectory, observations=received)

    def previous(self, trajectory: Trajectory, rules: Rules, *, followed: bool = False) -> Floats | None:
        """Return the command (N, 2) before each state; None where it is of no consequence.

        It goes on for the dead time, and the first observation of a horizon may hold it.

        Raises
        ------
        ConfigurationError
            If it matters, but is neither observed nor recorded.
        """
        observed = any(
            channel.kind in _PREVIOUS and channel.value is None for channel in self.spec.observation
        )
        if rules.delay or (followed and observed):
            return rules.clip(_previous(trajectory, self))
        return np.zeros((len(trajectory), 2)) if followed else None


def _previous(trajectory: Trajectory, layout: Layout) -> Floats:
    """Return the command before each state, (N, 2): as observed, else as recorded; 0 before the first."""
    names = {channel.kind: channel.name for channel in layout.spec.observation}
    if set(_PREVIOUS) <= names.keys():
        columns = [layout.spec.columns(names[kind]).start for kind in _PREVIOUS]
        return trajectory.observations[:, columns]
    if trajectory.actions.shape[1] == len(layout.spec.action):
        previous = np.zeros((len(trajectory), 2))
        same = trajectory.episode[1:] == trajectory.episode[:-1]
        previous[1:][same] = trajectory.actions[:-1][same][:, layout.columns]
        return previous
    raise ConfigurationError(
        "a delay or a horizon needs the previous command, which is neither observed nor recorded",
        "record the actions, or verify without --delay and --horizon",
    )
