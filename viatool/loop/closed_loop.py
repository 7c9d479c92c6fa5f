"""What is known of a batch of cells: blocked, settled by geometry, certified by the policy's commands, or open."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from viatool.arrays import Booleans, Floats
from viatool.channels import Sightings
from viatool.loop.command_bounds import CommandBounds, SentReach
from viatool.loop.knowable import require_known_over_poses
from viatool.loop.observation import Sensors
from viatool.loop.retreat import keep_away
from viatool.loop.told import Recollection
from viatool.loop.told_apart import as_far_as_told_apart
from viatool.loop.vicinity import Vicinity, check_roaming
from viatool.loop.waiting import after_waiting
from viatool.motion.actuated import ActuatedMotion, Machine
from viatool.motion.manoeuvre import Manoeuvre
from viatool.policy import Policy
from viatool.policy.network import Network
from viatool.rounding import SIGHT_ROUNDING
from viatool.safety import ScenePoses
from viatool.safety.pieces import CommandPieces
from viatool.safety.proof import ProofEffort, prove_clearance
from viatool.schedule import check_time
from viatool.sets.bounds import require_ordered
from viatool.sets.forms import PoseBoxes
from viatool.sets.observations import ObservationSets
from viatool.sets.states import StateBoxes
from viatool.setting.driven import DrivenPolicy
from viatool.setting.rules import Rules
from viatool.setting.setting import Setting
from viatool.sight.shapes import Shapes
from viatool.taylor import ReachableSet
from viatool.taylor.choices import chosen_by, differences, excluded_by, require_not_excluded
from viatool.taylor.correlated import (
    CorrelatedReach,
    LinearReach,
    input_model,
    reach_linear,
)
from viatool.taylor.observed import MOST_CHOICES, reach_sets
from viatool.taylor.reach import Arithmetic, networks_of
from viatool.taylor.watch import require_program_within
from viatool.world import Scenario

_CHUNK = 1024
_CHUNK_PAIRS = 400_000
"""Cells, and cells times shapes, that are enclosed together, so that the arrays stay in the cache."""
_CHUNK_NUMBERS = 8_000_000
"""Coefficients of the inputs of a network, n for each of its n inputs, that are kept together."""
_EFFORT = ProofEffort(levels=8, cells=64, tolerance=1e-4)


@dataclass(frozen=True, eq=False)
class ClosedLoop:
    """What is asked of a cell: that this policy, towards this goal, keeps its clearance from every pose.

    Parameters
    ----------
    policy : Policy
        The program; it gives commands, or what is compared to choose one.
    setting : Setting
        The meaning of its numbers with their uncertainty, and what is to hold.
    sensors : Sensors
        What it observes.
    around : Vicinity
        What is around the robot in the scenario.
    scenario : Scenario
        Which.
    arithmetic : str
        Contract of the bounds.
    """

    policy: Policy
    setting: Setting
    sensors: Sensors
    around: Vicinity
    scenario: Scenario
    arithmetic: Arithmetic = "float32"

    @classmethod
    def of(
        cls,
        policy: Policy,
        setting: Setting,
        scenario: Scenario,
        arithmetic: Arithmetic = "float32",
        *,
        episode: int | None = None,
    ) -> ClosedLoop:
        """Ask about a scenario of a map, in an episode of so many control intervals, if that is known."""
        world_map, observed = setting.world_map, require_known_over_poses(setting)
        around, roams = (
            Vicinity.of(world_map, scenario, setting.uncertainty),
            setting.uncertainty.obstacles.roams,
        )
        errors = setting.reading_errors.over_sets(setting.pose_radii)
        check_roaming((lidar for lidar, _ in observed.lidars), setting.uncertainty)
        sensors = Sensors(
            as_far_as_told_apart(observed, policy, setting, errors, arithmetic),
            Shapes.of(world_map, scenario, roams, measured=setting.reading_errors.passes),
            around.everything.still,
            np.array(scenario.goal),
            setting.rules.footprint.holds_origin(setting.rules.clearance.collision),
            errors,
            setting.rules.kinematics,
            around.loose,
            Recollection.of(policy, setting, episode),
        )
        return cls(setting.commanding(policy), setting, sensors, around, scenario, arithmetic)

    @property
    def geometry(self) -> ScenePoses:
        """Return what stands; the poses are not used."""
        return self.around.standing

    @property
    def rules(self) -> Rules:
        """Return what is to hold."""
        return self.setting.rules

    def at(self, boxes: PoseBoxes) -> ScenePoses:
        """Return boxes of poses as states of the scenario, among what stands."""
        return self.geometry.throughout(boxes.centre, boxes.radius)

    def among_all(self, boxes: PoseBoxes) -> ScenePoses:
        """Return boxes of poses as states of the scenario, among what stands and what moves."""
        return self.around.everything.throughout(boxes.centre, boxes.radius)

    def blocked(self, boxes: PoseBoxes) -> Booleans:
        """Tell which boxes hold no pose that keeps the collision distance, (C,). **Sound:** yes."""
        footprint, scene = self.rules.footprint, np.zeros(len(boxes), np.int64)
        distance = self.geometry.still.footprint_clearance(boxes.checked().centre, footprint, scene)
        moved = boxes.extent + self.rules.footprint.reach * boxes.turn * (
            self.rules.footprint.kind == "polygon"
        )
        slack = SIGHT_ROUNDING * (self.geometry.scale + np.abs(boxes.centre).sum(axis=1))
        most = distance + moved
        if footprint.kind != "polygon":
            within = self.geometry.still.farthest_within(boxes.corners, scene) - footprint.radius
            most = np.minimum(most, within)
        return np.asarray(most + slack <= self.rules.clearance.collision)

    def settled(self, boxes: PoseBoxes) -> Booleans:
        """Tell in which boxes no admissible commands, before and next, endanger a free pose, (C,). **Sound:** yes."""
        lower, upper = self.any_commands(len(boxes))
        before = lower, upper
        if self.rules.kinematics.state:
            least, most = self.rules.kinematics.state_range
            shape = (len(boxes), len(least))
            before = np.broadcast_to(least, shape), np.broadcast_to(most, shape)
        return self.holds(StateBoxes(boxes, *before), lower, upper)

    def holds(self, cells: StateBoxes, lower: Floats, upper: Floats) -> Booleans:
        """Tell in which cells every command of a box (C, 2) keeps every free pose clear, (C,). **Sound:** yes.

        With a dead time the command before goes on from the pose, and the next one acts where that has led. Of the
        commands that were given before that one nothing is known: each may be any that the robot carries out. Where the
        motion has a state, a command is given in any of those that the cell holds.
        """
        cells.checked()
        require_ordered("commands", lower, upper)
        if self.rules.machine is not None:
            return self._holds_for(self.rules.machine, cells, lower, upper)
        if self.rules.command_errors is not None:
            return self._holds_astray(cells, lower, upper)
        rules, boxes, count = self.rules, cells.poses, len(cells)
        kept = np.ones(count, dtype=bool)
        for index, manoeuvre in enumerate(rules.waiting, start=1):
            newest = index == rules.dead_time.commands
            held = (cells.previous_lower, cells.previous_upper) if newest else self.any_commands(count)
            some = np.flatnonzero(kept)
            kept[some] = self._keep_clear(boxes.select(some), manoeuvre, held[0][some], held[1][some])
            boxes = after_waiting(boxes, manoeuvre, *held)
        some = np.flatnonzero(kept)
        lower, upper = self.given_in(cells, lower, upper)
        kept[some] = self._keep_clear(boxes.select(some), rules.manoeuvre, lower[some], upper[some])
        return kept

    def given_in(self, cells: StateBoxes, lower: Floats, upper: Floats) -> tuple[Floats, Floats]:
        """Return boxes of commands (C, A) with the states of the motion of cells behind them, if it has one."""
        if not self.rules.kinematics.state:
            return lower, upper
        begun = np.stack([cells.previous_lower, cells.previous_upper], axis=1)
        return self.rules.begun(lower, upper, begun)

    def all_hold(self, cells: StateBoxes, pieces: CommandPieces) -> Booleans:
        """Tell in which cells every piece of the commands keeps every free pose clear, (C,). **Sound:** yes."""
        return pieces.everywhere(self.holds(cells.select(pieces.state), pieces.lower, pieces.upper))

    def _holds_for(self, machine: Machine, cells: StateBoxes, lower: Floats, upper: Floats) -> Booleans:
        """Tell in which cells a robot with motors and timing of its own keeps every pose clear, (C,). **Sound:** yes.

        Of its velocity is known what the command before tells, and what the robot can have.
        """
        rules, count = self.rules, len(cells)
        before = np.full((2, count, rules.commands_before, len(rules.lower)), np.nan)
        if rules.commands_before:
            before[0, :, -1], before[1, :, -1] = cells.previous_lower, cells.previous_upper
        return self.keeps(ActuatedMotion(machine, (before[0], before[1])), cells.poses, lower, upper)

    def keeps(self, motion: ActuatedMotion, boxes: PoseBoxes, lower: Floats, upper: Floats) -> Booleans:
        """Tell in which boxes robots that move so keep every pose clear, (C,). **Sound:** yes.

        Boxes of which a part is not free are not settled.
        """
        kept, rules = np.zeros(len(boxes), dtype=bool), self.rules
        for some in self._chunks(len(boxes), 4 * _CHUNK):
            check_time()
            kept[some] = prove_clearance(
                self.among_all(boxes.select(some)),
                lower[some],
                upper[some],
                rules.clearance.collision,
                motion.select(np.arange(len(boxes))[some]),
                rules.footprint,
                _EFFORT,
            ).proved
        return kept

    def _holds_astray(self, cells: StateBoxes, lower: Floats, upper: Floats) -> Booleans:
        """Tell in which cells a robot whose commands err keeps every pose clear, (C,). **Sound:** yes.

        Cells of which a part is not free are not settled.
        """
        rules, held = self.rules, self.given_in(cells, lower, upper)
        strayed = rules.strayed(*held)
        assert strayed is not None
        nearer = strayed.nearer(rules.footprint.reach).max(initial=0.0)
        return prove_clearance(
            self.among_all(cells.poses),
            *held,
            rules.clearance.collision + float(nearer),
            rules.manoeuvre,
            rules.footprint,
            _EFFORT,
        ).proved

    def any_commands(self, count: int) -> tuple[Floats, Floats]:
        """Return the ends (C, A) of all commands that the robot carries out."""
        lower, upper = (
            np.broadcast_to(end, (count, len(end))) for end in (self.rules.lower, self.rules.upper)
        )
        return lower, upper

    def _keep_clear(self, boxes: PoseBoxes, manoeuvre: Manoeuvre, lower: Floats, upper: Floats) -> Booleans:
        """Tell in which boxes every command of a box keeps every free pose clear on its path, (C,).

        Of what moves all poses of the box have to stay clear.
        """
        shapes, rules, moving = self.sensors.shapes.certain, self.rules, self.around.moving
        kept = np.zeros(len(boxes), dtype=bool)
        for some in self._chunks(len(boxes), 4 * _CHUNK):
            check_time()
            kept[some] = keep_away(boxes.select(some), shapes, rules, manoeuvre, lower[some], upper[some])
        rest = np.flatnonzero(~kept)
        check_time()
        here, least = self.at(boxes.select(rest)), rules.clearance.collision
        kept[rest] = prove_clearance(
            here, lower[rest], upper[rest], least, manoeuvre, rules.footprint, _EFFORT
        ).proved
        if moving is not None:
            rest = np.flatnonzero(kept)
            here = moving.throughout(boxes.centre[rest], boxes.radius[rest])
            kept[rest] = prove_clearance(
                here, lower[rest], upper[rest], least, manoeuvre, rules.footprint, _EFFORT
            ).proved
        return kept

    @property
    def loses_rays(self) -> bool:
        """Tell whether rays may return nothing, so that bounds of the commands cost more."""
        return bool(self.setting.reading_errors.missing)

    def commands(self, cells: StateBoxes, *, complete: bool = True) -> CommandBounds:
        """Bound what the policy commands anywhere in cells, whatever the sensors err. **Sound:** yes, if complete.

        Else all rays return; choices of those that do not cost as many passes.
        """
        cells.checked()
        found = [self._commands(cells.select(some), complete) for some in self.chunks(len(cells))]
        return CommandBounds(
            CommandPieces.join([part.pieces for part in found]),
            np.concatenate([part.influence for part in found]),
        )

    def chunks(self, count: int) -> list[slice]:
        """Cut cells so that what the network's inputs need stays small."""
        size = len(self.setting.radii)
        return self._chunks(count, int(np.clip(_CHUNK_NUMBERS // (size * size), 1, _CHUNK)))

    def watch(self, observations: Floats, reached: CorrelatedReach | LinearReach) -> None:
        """Run the deployed program on an observation (C, n) of each set.

        Raises
        ------
        SelfCheckError
            If it leaves the bounds of its set.
        """
        if self.arithmetic == "float32":
            require_program_within(self.policy, observations[None], reached.lower, reached.upper)

    def _chunks(self, count: int, most: int) -> list[slice]:
        """Cut cells so that the arrays over cells and shapes stay small, however many shapes there are."""
        step = int(np.clip(_CHUNK_PAIRS // len(self.sensors.shapes), min(8, most), most))
        return [slice(start, min(start + step, count)) for start in range(0, count, step)]

    def _commands(self, cells: StateBoxes, complete: bool) -> CommandBounds:
        check_time()
        sightings = self.sensors.enclose(cells)
        if not complete:
            sightings = replace(sightings, few=())
        return self.bounds_of(sightings, self.reached(sightings.sets, MOST_CHOICES), len(cells))

    def reached(self, sets: ObservationSets, choices: int) -> CorrelatedReach:
        """Bound what the network gives over sets (R, n) of observations, so many choices of lost rays one by one."""
        return CorrelatedReach.hull(
            [reach_sets(network, sets, choices, arithmetic=self.arithmetic) for network in self._networks()]
        )

    def bounds_of(self, sightings: Sightings, reached: CorrelatedReach, count: int) -> CommandBounds:
        """Return what may be sent in C cells, of bounds (R, ...) of what the network gives. **Sound:** yes."""
        if self.driven.choice is None:
            self.watch(sightings.forms.centre, reached)
        pieces = self._sent(sightings, reached.lower, reached.upper, count)
        influence = reached.influence
        if len(sightings.cell) > count:
            influence = influence[:count].copy()
            np.maximum.at(influence, sightings.cell, reached.influence)
        each = np.moveaxis(influence, 2, 0)  # (A, C, 3 + A + n)
        moved = np.maximum.reduce([one / np.maximum(one.sum(axis=1, keepdims=True), 1e-12) for one in each])
        pose, before = moved.sum(axis=1), []
        for axis in range(len(self.rules.kinematics.before)):
            before.append(moved[:, [3 + axis, *self._told_of(axis, moved.shape[1])]].sum(axis=1))
            pose = pose - before[-1]
        return CommandBounds(pieces, np.stack([pose, *before], axis=1))

    @cached_property
    def driven(self) -> DrivenPolicy:
        """What the robot does with the policy: its choice, and the rules around it."""
        return self.setting.driven(self.policy)

    def _networks(self) -> list[Network]:
        """Return the networks whose bounds tell the commands: of a choice, the differences of what is compared."""
        networks = networks_of(self.policy, self.arithmetic)
        return [network if self.driven.choice is None else differences(network) for network in networks]

    def _sent(self, sightings: Sightings, lower: Floats, upper: Floats, count: int) -> CommandPieces:
        """Return what may be sent in C cells, of bounds (R, ...) of `_networks`. **Sound:** yes."""
        require_ordered("commands", lower, upper)
        seen, choice = sightings.forms, self.driven.choice
        least, most = sightings.sets.hull
        known = ReachableSet(lower, upper, lower, upper, lower)
        if choice is not None:
            excluded = excluded_by(lower, upper, choice.actions)
            if self.arithmetic == "float32":
                require_not_excluded(chosen_by(self.policy.run, seen.centre, choice.actions), excluded)
            known = replace(known, possible=~excluded)
        parts = CommandPieces.of(self.driven, known, least, most)
        limits = self.rules.lower, self.rules.upper
        pieces = CommandPieces.of_parts(parts, sightings.cell, count, limits)
        require_ordered("commands", pieces.lower, pieces.upper)
        return pieces

    def commands_of_sets(
        self, sightings: Sightings, common: int, count: int, *, apart: bool = True
    ) -> SentReach:
        """Bound what is sent in C sets as forms of their `common` symbols, apart or joined for each. **Sound:** yes.

        What is observed in several parts of a set gives a piece for each, or one that holds them all. Each command that
        a policy may choose, or a rule may send, is a piece of its own, of all parts, which does not vary.
        """
        found: list[LinearReach] = []
        for seen in sightings.choices(MOST_CHOICES):
            inputs = input_model(seen.centre, seen.slope, seen.rest)
            each = (
                reach_linear(network, inputs, common, arithmetic=self.arithmetic)
                for network in self._networks()
            )
            found = [LinearReach.hull([*found, *each])]
        linear = found[0]
        if self.driven.choice is None:
            self.watch(sightings.forms.centre, linear)
        if self.driven.is_plain and not apart:
            return SentReach(np.arange(count), linear.joined(sightings.cell, count))
        if self.driven.is_plain:
            order = np.argsort(sightings.cell, kind="stable")
            return SentReach(sightings.cell[order], linear.select(order))
        pieces = self._sent(sightings, linear.lower, linear.upper, count)
        constant = LinearReach.constant(pieces.lower, pieces.upper, common)
        if self.driven.choice is not None:
            return SentReach(pieces.state, constant)
        varies = np.asarray((pieces.lower < pieces.upper).any(axis=1))
        of_policy = linear.joined(sightings.cell, count).select(pieces.state)
        return SentReach(pieces.state, LinearReach.choose(varies, of_policy, constant))

    def _told_of(self, axis: int, symbols: int) -> list[int]:
        """Return the columns of an influence in which the previous command of an axis errs as the policy is told it."""
        if self.rules.kinematics.state:
            return []
        quantities, first = self.sensors.quantities, symbols - len(self.setting.radii)
        outputs, told = self.sensors.recollection.outputs, []
        made = np.zeros(0, np.int64) if outputs is None else outputs.entry
        for quantity, place in zip(quantities, quantities.columns, strict=True):
            told += (first + place.start + quantity.told_of(axis, made)).tolist()
        return told
