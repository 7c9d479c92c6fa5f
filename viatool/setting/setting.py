"""What is asked: specification, robot, map, rules and errors, put together and checked in one place, for every job."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from viatool.arrays import Floats, Indices
from viatool.channels import Inputs, Quantities, View
from viatool.channels.drift import Drift, observes_its_pose, require_present, seen_from_elsewhere
from viatool.channels.reading_errors import ReadingErrors
from viatool.errors import ConfigurationError, PolicyError
from viatool.motion.law import Axis
from viatool.policy import ActionChannel, Policy, PolicySpecification
from viatool.policy.command_map import Chosen, CommandMap, command_map
from viatool.policy.network import Network
from viatool.policy.overrides import Overrides
from viatool.policy.runtime import Runtime
from viatool.policy.specified import Specified, name_of, specification_of
from viatool.sets.forms import PoseBoxes
from viatool.setting.driven import DrivenPolicy
from viatool.setting.motors import check_motors
from viatool.setting.moving import check_moving
from viatool.setting.premises import Premise
from viatool.setting.reconcile import Parties, reconcile
from viatool.setting.rules import Rules
from viatool.setting.scanned import check_scans, scan_views
from viatool.setting.sensor_errors import Eps, SensorErrors
from viatool.setting.wishes import Wishes
from viatool.uncertainty import ErrorModel
from viatool.uncertainty.error_model import ObstacleTerms
from viatool.uncertainty.supported import SUPPORTED
from viatool.world import Robot, Scenario, Scenes, WorldMap
from viatool.world.scenario import require_plain


class Described(Specified, Protocol):
    """A policy as far as a setting needs it: what its numbers mean, and in what precision it is given them."""

    @property
    def network(self) -> Network:
        """The function that is verified."""

    @property
    def runtime(self) -> Runtime:
        """The program of which a verdict is true."""


@dataclass(frozen=True)
class ActionName:
    """Name and unit of one action."""

    name: str
    unit: str


@dataclass(frozen=True, eq=False)
class Setting:
    """What is asked of a policy; every check between its parts has been made. Made by `Setting.of`.

    Parameters
    ----------
    spec : PolicySpecification
        n observation entries and A actions, as they count.
    world_map : WorldMap
        With the robot and the clearances as they count.
    rules : Rules
        What every state must fulfil.
    errors : SensorErrors
        How far observations may be off.
    command_map : CommandMap
        How the robot is commanded by the actions of the policy.
    overrides : Overrides
        The rules that its software wraps around the policy.
    scenarios : tuple of Scenario
        What is asked about, where that is known beforehand; recorded states bring their own.
    number : type
        The floating-point type in which the program receives an observation.
    premises : tuple of Premise
        Everything that took effect, and who said so.
    uncertainty : ErrorModel
        What is bounded about the robot; its absolute sensor errors are in `errors`.
    """

    spec: PolicySpecification
    world_map: WorldMap
    rules: Rules
    errors: SensorErrors
    command_map: CommandMap
    overrides: Overrides
    scenarios: tuple[Scenario, ...] = ()
    number: type = np.float32
    premises: tuple[Premise, ...] = field(default=(), repr=False)
    uncertainty: ErrorModel = field(default_factory=ErrorModel)

    @classmethod
    def of(
        cls,
        policy: Described,
        world_map: WorldMap,
        eps: Eps = None,
        wishes: Wishes | None = None,
        scenarios: Sequence[Scenario] | None = None,
        *,
        job: str = "",
    ) -> Setting:
        """Put together what is asked of an exported policy.

        Parameters
        ----------
        policy : Policy
            With a specification.
        world_map : WorldMap
            Where.
        eps : float or mapping or None
            Sensor error: one radius for every channel, or radii by channel (``""``: all others); channels that are
            given none take the specification's.
        wishes : Wishes, optional
            What counts instead of what policy and map say.
        scenarios : sequence of Scenario, optional
            What is asked about; None is the map's fixed ones.
        job : str
            Who asks, as in `SUPPORTED`: terms of the error model that it does not take into account are refused.

        Raises
        ------
        PolicyError
            If the policy has no specification, one of another size, or none of a linear and an angular action.
        ConfigurationError
            If policy and map contradict each other and the wishes do not say which counts, a radius or a wish is out of
            its range, or a goal lies in an obstacle.
        """
        spec = specification_of(policy)
        sizes = (policy.network.input_size, policy.network.output_size)
        if sizes != (spec.observation_size, spec.action_size):
            raise PolicyError(
                f"{name_of(policy)} takes {sizes[0]} numbers and gives {sizes[1]}, "
                f"its specification names {spec.observation_size} and {spec.action_size}",
                "correct the channels of the specification",
            )
        made = cls.of_specification(spec, world_map, eps, wishes, scenarios, name=name_of(policy), job=job)
        runtime = Premise("runtime", policy.runtime.words, "what is installed")
        made = replace(made, premises=(*made.premises, runtime))
        double = policy.network.nodes[0].precision == "float64"
        return replace(made, number=np.float64) if double else made

    @classmethod
    def of_specification(
        cls,
        spec: PolicySpecification,
        world_map: WorldMap,
        eps: Eps = None,
        wishes: Wishes | None = None,
        scenarios: Sequence[Scenario] | None = None,
        *,
        name: str = "the policy",
        job: str = "",
    ) -> Setting:
        """Put together what is asked of a policy of which only the specification exists yet; as `of`."""
        wishes = wishes or Wishes()
        wishes.errors.require(job or "this job", SUPPORTED.get(job, frozenset()))
        world_map = world_map.with_clearance(wishes.clearance, wishes.danger)
        spec, robot, premises = reconcile(Parties(spec, name, world_map, wishes))
        world_map = world_map.with_robot(robot)
        rules = Rules.of(world_map, wishes.criterion, delay=wishes.delay, errors=wishes.errors)
        check_motors(rules.command_errors, wishes.errors, job)
        commands = command_map(spec, rules.kinematics, robot, name)
        errors = SensorErrors.of(spec, eps, wishes.errors)
        check_moving(wishes.errors, spec, world_map)
        check_scans(wishes.errors, world_map, job)
        chosen = world_map.scenarios if scenarios is None else tuple(scenarios)
        if job != "mission":
            require_plain(chosen)
        premises += _premises(world_map, rules, wishes) + errors.premises() + _stated(wishes.errors, errors)
        setting = cls(
            spec,
            world_map,
            rules,
            errors,
            commands,
            Overrides.of(spec, commands),
            chosen,
            premises=premises,
            uncertainty=wishes.errors,
        )
        _ = setting.reading_errors  # refuses what a channel does not have
        if setting.pose_radii.any():
            require_present(setting.quantities, wishes.errors.source)
        if scenarios is not None:  # those of a map were looked at when it was read
            _check_goals(setting)
        return setting

    @property
    def driving_premises(self) -> tuple[Premise, ...]:
        """Return what took effect of a drive, in which errors are drawn: those of a model, within its bounds."""
        drawn = self.uncertainty.source
        return tuple(
            premise
            for premise in self.premises
            if not premise.name.startswith("eps of ") or premise.source == drawn
        )

    @property
    def radii(self) -> Floats:
        """Return the uncertainty of every observation entry, (n,)."""
        return self.errors.radii

    @property
    def memory_words(self) -> str:
        """Return what is assumed of what the policy remembers, for a report."""
        by_channel = self.errors.by_channel
        parts = [
            f"{channel.name} {channel.size}"
            + (f" within {by_channel[channel.name]:g}" if by_channel[channel.name] else "")
            for channel in self.spec.remembered
        ]
        return (
            f"as it was in each state ({', '.join(parts)}): what earlier sensor errors would have made of it is not "
            "asked about"
        )

    @cached_property
    def inputs(self) -> Inputs:
        """Where readings stand in an observation, and how they are encoded."""
        return self.spec.inputs

    @cached_property
    def fixed(self) -> Floats:
        """The numbers of an observation that the specification fixes, (n,); NaN where it fixes none."""
        return self.spec.fixed_values()

    @cached_property
    def quantities(self) -> Quantities:
        """What the policy observes."""
        return Quantities.of(self.spec.observation, self.robot, self.spec.frames)

    @cached_property
    def reading_errors(self) -> ReadingErrors:
        """How every reading errs: within the radii, and by the other terms of the error model."""
        model = self.uncertainty
        return ReadingErrors.of(self.quantities, self.radii, model.sensor, model.source)

    @cached_property
    def moves(self) -> bool:
        """Whether the error model says that anything moves."""
        return self.uncertainty.obstacles != ObstacleTerms()

    @cached_property
    def pose_radii(self) -> Floats:
        """Return how far the pose that localisation gives may be from the true one, (3,) metres and radians."""
        pose = self.uncertainty.pose
        return np.array([pose.x or 0.0, pose.y or 0.0, pose.theta or 0.0])

    @property
    def believes(self) -> bool:
        """Tell whether anything that is observed changes with the pose that localisation gives."""
        return bool(self.pose_radii.any()) and observes_its_pose(self.quantities)

    def goals(self, scenarios: Sequence[Scenario | None]) -> Floats:
        """Return the goals of S scenarios, (S, 2); ConfigurationError if one is not known."""
        if None in scenarios:
            raise ConfigurationError(
                "a pose error moves the goal as the robot sees it, but an episode has no goal",
                "give the trajectory its scenario, a bag its --goal, or leave out the pose error",
            )
        return np.array([scenario.goal for scenario in scenarios if scenario is not None], dtype=np.float64)

    def drift(self, poses: Floats, scenarios: Sequence[Scenario | None], episode: Indices) -> Drift | None:
        """Return what other believed poses and scans change at recorded poses (B, 3); None if nothing errs."""
        radii, scans = self.pose_radii, bool(self.reading_errors.scans)
        if not (len(poses) and (self.believes or scans)):
            return None
        needed = self.believes and "goal" in self.quantities.needs
        goals = self.goals(scenarios) if needed else np.zeros((len(scenarios), 2))
        scale = 1.0 + float(max(np.abs(end).max(initial=0.0) for end in (self.world_map.arena, poses, goals)))
        axes, rows, parts = len(self.rules.kinematics.axes), [], []
        alike = np.column_stack([goals[episode], episode * scans])
        for key in np.unique(alike, axis=0):
            same, goal = np.flatnonzero((alike == key).all(axis=1)), key[:2]
            boxes = PoseBoxes(poses[same], np.broadcast_to(radii, (len(same), 3)))
            views = scan_views(self, scenarios[int(key[2])], boxes) if scans else ((slice(None), None),)
            for some, seen in views:
                rows.append(same[some])
                parts.append(Drift.of(self.quantities, boxes.select(some), goal, scale, axes, seen))
        return Drift.join(parts, np.argsort(np.concatenate(rows), kind="stable"))

    def drifted(
        self, scenes: Scenes, scene: Indices, poses: Floats, believed: Floats, goals: Floats
    ) -> Floats:
        """Return by how much readings differ, (B, n), where robots at poses (B, 3) believe others."""
        still = np.zeros((len(poses), len(self.rules.kinematics.axes)))
        return seen_from_elsewhere(
            self.quantities, View(scenes, poses, scene, goals, still, believed=believed)
        )

    def observed(
        self, observations: Floats, drift: Drift | None = None, errors: ReadingErrors | None = None
    ) -> tuple[Floats, Floats]:
        """Return the least and the largest number (B, n) that the network may take around recorded ones (B, n).

        Observations may have other errors than those of the setting, each its own.

        Notes
        -----
        Sound: yes, also where the errors are no box; rounding is counted.
        """
        errors = errors or self.reading_errors
        if errors.is_box and drift is None:
            return self.inputs.box(observations, errors.absolute)
        return errors.sets(observations, drift).hull

    def uncertain(self, observations: Floats, radii: Floats | None = None) -> tuple[Floats, Floats]:
        """Return where the network's input lies around recorded ones (B, n): centres, and radii (n,) or (B, n).

        Readings err within the radii of the setting, or within others, (n,) or (B, n).

        Notes
        -----
        Sound: yes, see `Inputs.box`; rounding is counted.
        """
        inputs, radii = self.inputs, self.radii if radii is None else radii
        if inputs.is_plain:
            return observations, radii
        lower, upper = inputs.box(observations, radii)
        middle = 0.5 * (lower + upper)
        return middle, np.nextafter(np.maximum(upper - middle, middle - lower), np.inf)

    @property
    def robot(self) -> Robot:
        """Return the robot that counts."""
        return self.world_map.robot

    @property
    def commands(self) -> tuple[ActionName, ...]:
        """Return names and units of the entries of a command: as the policy calls them, else as its robot does."""
        called: dict[str, ActionChannel | Axis] = {action.kind: action for action in self.spec.action}
        named = [called.get(axis.kind, axis) for axis in self.rules.kinematics.axes]
        return tuple(ActionName(one.name, one.unit) for one in named)

    def commanding(self, policy: Policy) -> Policy:
        """Return the policy with the robot's command as what it gives; one that chooses keeps what it compares."""
        if self.choice is not None or self.command_map.changes_nothing:
            return policy
        return policy.commanding(self.command_map)

    @property
    def choice(self) -> Chosen | None:
        """Return the table of commands among which the policy chooses; None if it gives the numbers of a command."""
        return self.command_map if isinstance(self.command_map, Chosen) else None

    def driven(self, policy: Policy) -> DrivenPolicy:
        """Return what the robot really does with a policy, choice and rules included."""
        return DrivenPolicy(self.commanding(policy), self.choice, self.overrides)

    def sent(self, observations: Floats, actions: Floats) -> Floats:
        """Return the commands (B, A) that are sent after observations (B, n) and actions (B, O) of the policy."""
        return self.overrides.apply(observations, self.command_map(actions))

    def bare(self) -> Setting:
        """Return the same without scenarios and generator, for workers whose states bring their own."""
        return replace(self, scenarios=(), world_map=replace(self.world_map, scenarios=(), generator=None))


def _premises(world_map: WorldMap, rules: Rules, wishes: Wishes) -> tuple[Premise, ...]:
    """Return what else took effect."""
    clearance, file = world_map.clearance, f"map '{world_map.path}'"
    return (
        Premise("criterion", rules.criterion, "--criterion, or its default"),
        Premise(
            "collision distance", f"{clearance.collision:g} m", "--clearance" if wishes.clearance else file
        ),
        Premise(
            "danger distance",
            f"{clearance.danger:g} m",
            "--danger"
            if wishes.danger is not None
            else file
            if wishes.clearance is None
            else "map and --clearance",
        ),
        _delay_premise(rules, wishes),
    )


def _delay_premise(rules: Rules, wishes: Wishes) -> Premise:
    """Return the dead time; of an error model that states it, both of its ends."""
    if wishes.errors.timing.delay is not None:
        least, most = wishes.errors.timing.delay
        return Premise("delay", f"{least:g} to {most:g} s", wishes.errors.source)
    return Premise("delay", f"{rules.delay:g} s", "--delay" if rules.delay else "default")


def _stated(model: ErrorModel, errors: SensorErrors) -> tuple[Premise, ...]:
    """Return the terms of an error model; absolute sensor errors are named as eps."""
    told = []
    for place, words in model.premises():
        sensor, _, term = place.removeprefix("sensor.").rpartition(".")
        if not place.startswith("sensor."):
            told.append(Premise(place, words, model.source))
        elif term != "absolute":
            value = words.replace("the channel's unit", errors.units[sensor]).rstrip()
            told.append(Premise(place, value, model.source))
    return tuple(told)


def _check_goals(setting: Setting) -> None:
    """Refuse a goal within an obstacle or outside of the arena."""
    if not setting.scenarios:
        return
    scenes = Scenes.of(setting.world_map, setting.scenarios)
    goals = np.array([scenario.goal for scenario in setting.scenarios])
    places = np.array([scenario.region is None for scenario in setting.scenarios])
    blocked = np.flatnonzero(places & scenes.blocked(goals, np.arange(len(goals))))
    if blocked.size:
        x, y = goals[blocked[0]]
        raise ConfigurationError(f"the goal ({x:g}, {y:g}) lies in an obstacle or off the map", "move it")
