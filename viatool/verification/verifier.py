"""One state at a time, inside a control loop or a test: everything is prepared once, then asked again and again."""

from __future__ import annotations

import copy
import os
from collections.abc import Mapping, Sequence
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from viatool.arrays import Floats
from viatool.errors import ConfigurationError
from viatool.policy import Policy, PolicySpecification, as_policy
from viatool.policy.given import row
from viatool.safety import ScenePoses
from viatool.setting.begun import states_begun
from viatool.setting.premises import Premise
from viatool.setting.received import check_people, numbers_received, velocities_measured
from viatool.setting.setting import Setting
from viatool.setting.wishes import Wishes
from viatool.taylor import Arithmetic, Refinement
from viatool.taylor.approximation import Approximation
from viatool.uncertainty import ErrorModel, as_error_model
from viatool.verification.examination import StateExamination
from viatool.verification.findings import StateFindings
from viatool.verification.states import States
from viatool.world import Footprint, Scenario, WorldMap, as_map

StrPath = str | os.PathLike[str]
_NOBODY: Floats = np.zeros((0, 5))


class StateVerdict:
    """What is known of one state. Made by a `Verifier`; what is not asked for is not computed.

    Attributes
    ----------
    verdict : str
        ``safe`` (proved), ``unsafe`` (an observation within the errors makes the deployed program fail) or ``unknown``.
    safe, danger, sampled : bool
        Whether the criterion holds at d_col, and at d_danger; whether the paper's nine commands pass at d_col, which
        proves nothing.
    contested : bool
        Whether some admissible command of the robot could make the state fail. Else nothing depends on the policy.
    lower, upper : ndarray
        (A,) bounds of what the policy can command; NaN where that was left out, as nothing depends on it.
    witness : ndarray or None
        (n,) the observation of an unsafe state.
    """

    def __init__(self, setting: Setting, states: States, placed: ScenePoses, findings: StateFindings) -> None:
        self._setting, self._states, self._placed, self._findings = setting, states, placed, findings

    def __repr__(self) -> str:
        """Return the verdict and the commands that it speaks of."""
        named = zip(self._setting.commands, self.lower.tolist(), self.upper.tolist(), strict=True)
        commands = ", ".join(f"{one.name} {low:g} to {high:g} {one.unit}" for one, low, high in named)
        return f"<{self.verdict}: {commands}>"

    @property
    def verdict(self) -> str:
        """Return the verdict in a word."""
        if len(self._findings.witnesses):
            return "unsafe"
        return "safe" if self.safe else "unknown"

    @property
    def safe(self) -> bool:
        """Tell whether the state is proved safe."""
        return bool(self._findings.judgement.safe[0])

    @property
    def danger(self) -> bool:
        """Tell whether the criterion holds at d_danger, too."""
        return bool(self._findings.judgement.danger[0])

    @property
    def sampled(self) -> bool:
        """Tell whether the paper's nine commands pass; not a proof."""
        return bool(self._findings.judgement.sampled[0])

    @property
    def contested(self) -> bool:
        """Tell whether some admissible command could make the state fail."""
        return bool(self._findings.contested.collision[0])

    @property
    def lower(self) -> Floats:
        """Return the least that the policy can command, (A,)."""
        return np.asarray(self._findings.reachable.lower[0])

    @property
    def upper(self) -> Floats:
        """Return the most that the policy can command, (A,)."""
        return np.asarray(self._findings.reachable.upper[0])

    @property
    def commands(self) -> tuple[Floats, Floats]:
        """Return the ends of the commands as the robot carries them out, (A,) twice."""
        return self._setting.rules.clip(self.lower), self._setting.rules.clip(self.upper)

    @cached_property
    def observed(self) -> tuple[Floats, Floats]:
        """Return the least and the largest number that the network may take, (n,) twice."""
        states = self._states
        drift = self._setting.drift(states.poses, states.scenarios, states.episode)
        lower, upper = self._setting.observed(states.observations, drift)
        return lower[0], upper[0]

    @cached_property
    def clearance(self) -> float:
        """Return the distance of the footprint, at the pose that was given, from the nearest obstacle, in metres."""
        found = self._placed.footprint_clearance(self._setting.rules.footprint, np.zeros(1))
        return float(found[0][0])

    @property
    def margin(self) -> float:
        """Return by how much the robot may come nearer until it counts as collided, in metres."""
        return self.clearance - self._setting.rules.clearance.collision

    @property
    def witness(self) -> Floats | None:
        """Return the observation of an unsafe state, (n,)."""
        found = self._findings.witnesses
        return found.observation[0] if len(found) else None


class Verifier:
    """Verdicts of single states, with all that does not depend on the state prepared once.

    Parameters
    ----------
    policy : Policy or path
        An ONNX policy; its network is checked against onnxruntime when it is loaded.
    world_map : WorldMap or path
        The map, its robot and clearances.
    scenario : Scenario, optional
        What the episode adds to the map: obstacles of its own, and the goal.
    eps, errors, spec, criterion, order, approximation, refine, arithmetic
        As for `viatool.verify`, with the same meanings, premises and refusals.
    clearance, danger, interval, footprint, delay, robot, prefer
        As for `viatool.verify`.
    search : bool
        Whether a counterexample is looked for where nothing is proved, which takes some milliseconds. Without it a
        state that is not safe is unknown.
    seed : int
        Of that search.

    Raises
    ------
    PolicyError, MapError, ConfigurationError
        As `viatool.verify`.

    Notes
    -----
    Sound: yes, under the assumptions of `viatool.verify`. It is the examination that `viatool.verify` makes of a batch,
    made of one state: the verdict of a state is the one that it has there.
    """

    def __init__(
        self,
        policy: Policy | StrPath,
        world_map: WorldMap | StrPath,
        *,
        scenario: Scenario | None = None,
        eps: float | Mapping[str, float] | None = None,
        errors: ErrorModel | StrPath | None = None,
        spec: PolicySpecification | StrPath | None = None,
        criterion: str = "swept",
        order: int = 1,
        approximation: Approximation = "chebyshev",
        refine: Refinement = "monotone",
        arithmetic: Arithmetic = "float32",
        clearance: float | None = None,
        danger: float | None = None,
        interval: float | None = None,
        footprint: Footprint | str | float | Sequence[Sequence[float]] | None = None,
        delay: float = 0.0,
        robot: str | None = None,
        prefer: Mapping[str, str] | None = None,
        search: bool = True,
        seed: int = 0,
    ) -> None:
        wishes = Wishes(
            criterion,
            clearance,
            danger,
            interval,
            footprint,
            delay,
            robot=robot,
            prefer=prefer or {},
            errors=as_error_model(errors),
        )
        policy = as_policy(policy, spec)
        world_map = as_map(world_map)
        asked = () if scenario is None else (scenario,)
        self._setting = Setting.of(policy, world_map, eps, wishes, asked, job="verify")
        engine = {"order": order, "approximation": approximation, "refine": refine, "arithmetic": arithmetic}
        self._examination = StateExamination.of(
            self._setting.commanding(policy), self._setting, engine, seed=seed, search=search
        )
        self._enter(scenario)

    def _enter(self, scenario: Scenario | None) -> None:
        setting = self._setting
        if setting.pose_radii.any() and "goal" in setting.quantities.needs:
            setting.goals((scenario,))  # refuses a scenario without one
        self._scenario = scenario
        self._around = ScenePoses.of(setting.world_map, (scenario,), np.zeros((1, 3)), np.zeros(1, np.int64))

    @property
    def setting(self) -> Setting:
        """Return what is asked, as it took effect."""
        return self._setting

    @property
    def premises(self) -> tuple[Premise, ...]:
        """Return everything that took effect, and who said so."""
        return self._setting.premises

    def within(self, scenario: Scenario | None) -> Verifier:
        """Return the same verifier in another scenario: other obstacles on the map, another goal."""
        other = copy.copy(self)
        other._enter(scenario)  # its own
        return other

    def __call__(
        self,
        pose: ArrayLike,
        observation: ArrayLike,
        *,
        before: ArrayLike | None = None,
        motion: Mapping[str, float] | None = None,
        people: ArrayLike | None = None,
        step: int | None = None,
    ) -> StateVerdict:
        """Return the verdict of one state.

        Parameters
        ----------
        pose : array_like
            (3,) x, y, theta in the map frame; metres and radians. With a pose error that of localisation.
        observation : array_like
            (n,) what the policy received, its memory behind it if it has one.
        before : array_like, optional
            (W, A) commands before that still count, the oldest first: with a `delay` those on their way to the motors,
            with motors or timing of an error model those that tell of the robot's velocity. (A,) if that is one.
        motion : mapping, optional
            The state of the motion by the names of its axes, of a robot that goes on from the motion it has; what the
            policy measures of it need not be given.
        people : array_like, optional
            (P, 5) x, y, velocity along x and y, and radius of people, where the error model speaks of them.
        step : int, optional
            Control intervals since the beginning, if frames that reach farther back are known to repeat the first one.

        Raises
        ------
        ConfigurationError
            If something that counts is missing or has another shape, or the observation is not finite.

        Notes
        -----
        Sound: yes. Commands on their way that are NaN are not known, and with a delay nothing is proved then.
        """
        setting = self._setting
        poses = row("a pose", pose, 3)
        observations = numbers_received(
            setting, row("an observation", observation, setting.spec.observation_size)
        )
        told = _NOBODY if people is None else np.asarray(people, dtype=np.float64)
        check_people(setting, told=len(told) > 0)
        recorded = {name: np.array([value], dtype=np.float64) for name, value in (motion or {}).items()}
        velocity = velocities_measured(setting, observations)
        states = States(
            first=0,
            poses=poses,
            observations=observations,
            episode=np.zeros(1, np.int64),
            scenarios=(self._scenario,),
            previous=None,
            under_way=self._before(before),
            rows=np.zeros(1, np.int64),
            steps=np.array([np.nan if step is None else float(step)]),
            people=told[None],
            begun=states_begun(setting, observations, recorded),
            velocity=None if velocity is None else np.stack(velocity, axis=1),
        )
        placed = self._around.moved(poses)
        return StateVerdict(setting, states, placed, self._examination.examine(states, placed))

    def _before(self, before: ArrayLike | None) -> Floats:
        """Return the commands that count, as the robot carries them out, (1, W, A)."""
        rules = self._setting.rules
        count, axes = rules.commands_before, len(rules.lower)
        if before is None:
            if count and rules.machine is None:
                raise ConfigurationError(
                    f"the delay of {rules.delay:g} s leaves {count} commands on their way, and none is given",
                    f"give `before`, {count} commands of {axes} numbers, the oldest first",
                )
            return np.full((1, count, axes), np.nan)
        given = np.asarray(before, dtype=np.float64)
        given = given[None] if given.ndim == 1 else given
        if given.ndim != 2 or len(given) < count or given.shape[1] != axes:
            raise ConfigurationError(
                f"the commands before have shape {given.shape}, expected ({count}, {axes})",
                "give the commands that still count, the oldest first",
            )
        return rules.clip(given[len(given) - count :])[None]
