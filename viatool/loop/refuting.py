"""Counterexamples for cells: a pose, an observation that its sensors may give, and the command that fails."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from viatool.arrays import Floats, Indices
from viatool.loop.closed_loop import ClosedLoop
from viatool.loop.command_bounds import CommandBounds
from viatool.loop.deceived import Deceptions, known_readings
from viatool.rounding import AS_RECEIVED
from viatool.safety import JudgedStates, Witnesses, search_witnesses
from viatool.schedule import check_time
from viatool.sets.forms import PoseBoxes
from viatool.sets.states import StateBoxes
from viatool.setting.admissible import AdmissibleSets
from viatool.setting.explanation import explain_known
from viatool.setting.rules import Rules
from viatool.taylor.propagation import Box

_CORNERS = np.array([(x, y) for x in (-1.0, 0.0, 1.0) for y in (-1.0, 0.0, 1.0)])
_TURNS = np.array([-1.0, 0.0, 1.0])
_INSIDE = 1.0 - 1e-6
_FRACTIONS = np.linspace(0.0, 1.0, 11)
_BISECTIONS = 20
_WAYS = 8
"""In which sensors err as a whole, the first of which is not at all, of which the worst is searched."""
_FREE = 1e-6
"""Metres by which the pose of a counterexample keeps the collision distance."""


@dataclass(frozen=True, eq=False)
class Refutations:
    """W cells with counterexamples.

    Parameters
    ----------
    poses, previous : ndarray
        (W, 3) and (W, 2): the pose in the cell, and the command of the step before.
    witnesses : Witnesses
        W of them; `state` is the index of the cell.
    """

    poses: Floats
    previous: Floats
    witnesses: Witnesses

    def __len__(self) -> int:
        """Return the number of refuted cells."""
        return len(self.witnesses)


def refute(loop: ClosedLoop, cells: StateBoxes, commands: CommandBounds, *, seed: int = 0) -> Refutations:
    """Look for a counterexample in every cell.

    Parameters
    ----------
    loop : ClosedLoop
        What is asked.
    cells : StateBoxes
        C cells.
    commands : CommandBounds
        What the policy can command there, which says where to aim.
    seed : int
        Of random observations.

    Returns
    -------
    Refutations
        Of some of the cells.

    Notes
    -----
    Sound: yes. The pose lies in the cell and keeps the collision distance by `_FREE`; the observation is one that
    sensors may make there within the error model, rounded to float32; the command comes from onnxruntime, and fails.
    """
    previous = 0.5 * (cells.previous_lower + cells.previous_upper)
    row, place = _nearest_places(loop, cells.poses)
    check_time()
    poses = _worst_poses(loop, cells.poses.select(row), place, previous[row])
    found = _Placed(loop, poses, previous[row], commands.select(row)).search(seed)
    return Refutations(poses[found.state], previous[row][found.state], replace(found, state=row[found.state]))


@dataclass(frozen=True, eq=False)
class _Placed:
    """W robots that observe: their poses (W, 3), the commands before (W, A), and bounds of what they are commanded."""

    loop: ClosedLoop
    poses: Floats
    previous: Floats
    commands: CommandBounds

    def search(self, seed: int) -> Witnesses:
        """Look for counterexamples, in the way of sensors that err as a whole in which the nominal command is worst."""
        setting, count = self.loop.setting, len(self.poses)
        errors, deceived = setting.reading_errors, Deceptions.none(setting, self.poses)
        if not count:
            return Witnesses.none(len(setting.radii), len(self.loop.rules.lower))
        if errors.scans or setting.believes:
            deceived = self._worst(np.random.default_rng(seed))
        elif errors.is_box:
            return self._search(*self._within_eps(), deceived, seed)
        known = known_readings(self.loop, self.poses, self.previous, deceived)
        sets = AdmissibleSets.of(errors, known)
        found = self._search(_received(sets), sets, deceived, seed)
        kept = [
            explain_known(errors, known, state, seen) is not None
            for state, seen in zip(found.state.tolist(), found.observation, strict=True)
        ]
        return found.select(np.flatnonzero(kept))

    @property
    def judged(self) -> JudgedStates:
        """Return what is asked of them."""
        placed = self.loop.around.everything.throughout(self.poses)
        under_way, begun = _known(self.loop.rules, self.previous)
        return JudgedStates(self.loop.rules, placed, under_way, begun=begun)

    def _worst(self, generator: np.random.Generator) -> Deceptions:
        """Return of some ways in which sensors err as a whole the one whose command comes nearest, for each."""
        loop, setting, judged = self.loop, self.loop.setting, self.judged.nominal
        ways = [Deceptions.none(setting, self.poses)]
        ways += [Deceptions.drawn(setting, self.poses, generator) for _ in range(1, _WAYS)]
        left = []
        for deceived in ways:
            check_time()
            known = known_readings(loop, self.poses, self.previous, deceived, lossless=True)
            actions = loop.rules.clip(
                loop.driven(_received(AdmissibleSets.of(setting.reading_errors, known)))
            )
            left.append(judged.clearance(actions[:, None], _FRACTIONS).min(axis=(1, 2)))
        return Deceptions.choose(np.argmin(left, axis=0), ways)

    def _within_eps(self) -> tuple[Floats, Box]:
        """Return observations, and the boxes around them where every reading errs by itself."""
        loop, setting = self.loop, self.loop.setting
        readings = loop.sensors.read(self.poses, self.previous)
        observations = loop.sensors.encode(readings).astype(setting.number).astype(np.float64)
        radii = np.maximum(setting.radii - AS_RECEIVED * (1.0 + np.abs(readings).max(axis=0)), 0.0)
        return observations, Box(*loop.sensors.quantities.inputs.around(readings, radii, within=True))

    def _search(
        self, observations: Floats, box: Box | AdmissibleSets, deceived: Deceptions, seed: int
    ) -> Witnesses:
        """Look for counterexamples among observations."""
        check_time()
        commands, judged = self.commands, self.judged
        found = search_witnesses(
            self.loop.driven, judged, np.arange(len(self.poses)), observations, box, commands.lower,
            commands.upper, seed=seed, aims=judged.nominal, thorough=False,
        )  # fmt: skip
        so = deceived.select(found.state)
        return replace(found, believed=so.believed, turn=so.turn, passed=so.passed)


def _received(sets: AdmissibleSets) -> Floats:
    """Return what programs receive of sensors that err by nothing of their own, (B, n)."""
    return sets.nearest(sets.recorded_inputs).astype(np.float32).astype(np.float64)


def _known(rules: Rules, before: Floats) -> tuple[Floats | None, Floats | None]:
    """Return the commands under way and the ends of the state of the motion, one of both by what stands before."""
    if rules.kinematics.state:
        return None, np.stack([before, before], axis=1)
    return rules.queue(before), None


def observe(loop: ClosedLoop, poses: Floats, previous: Floats) -> Floats:
    """Return what perfect sensors read at poses (B, 3) after commands (B, 2), (B, n) in float64 rays."""
    return loop.sensors.measure(poses, previous)


def _worst_poses(loop: ClosedLoop, boxes: PoseBoxes, place: Floats, previous: Floats) -> Floats:
    """Return the free pose at a place (W, 2) of each box whose nominal command comes nearest, (W, 3)."""
    if not len(boxes):
        return np.zeros((0, 3))
    rules, count = loop.rules, len(boxes)
    places = np.repeat(place[:, None], len(_TURNS), axis=1)
    heading = boxes.centre[:, 2, None] + _INSIDE * _TURNS * boxes.radius[:, 2, None]
    poses = np.concatenate([places, heading[:, :, None]], axis=2)  # (W, 3, 3)
    flat = poses.reshape(-1, 3)
    before = np.repeat(previous, len(_TURNS), axis=0)
    actions = rules.clip(loop.driven(observe(loop, flat, before)))
    placed = loop.around.everything.throughout(flat)
    under_way, begun = _known(rules, before)
    judged = JudgedStates(rules, placed, under_way, begun=begun).nominal
    left = judged.clearance(actions[:, None], _FRACTIONS).reshape(count, len(_TURNS), -1)
    free = _clearance(loop, poses) > rules.clearance.collision + _FREE  # corners may be nearer when turned
    least = np.where(free, left.min(axis=2), np.inf)
    return np.asarray(poses[np.arange(count), least.argmin(axis=1)])


def _nearest_places(loop: ClosedLoop, boxes: PoseBoxes) -> tuple[Indices, Floats]:
    """Return the free place of each box that is nearest to an obstacle: the boxes (W,) and places (W, 2).

    At the rim of the free space it is found by bisection between a free and a blocked place.
    """
    least = loop.rules.clearance.collision + _FREE
    headings = np.broadcast_to(boxes.centre[:, None, 2:], (len(boxes), len(_CORNERS), 1))
    places = boxes.centre[:, None, :2] + _INSIDE * _CORNERS * boxes.radius[:, None, :2]
    left = _clearance(loop, np.concatenate([places, headings], axis=2))
    row = np.flatnonzero((left > least).any(axis=1))
    left, places, index = left[row], places[row], np.arange(len(row))
    free = places[index, np.where(left > least, left, np.inf).argmin(axis=1)]
    blocked = places[index, left.argmin(axis=1)]
    rim = np.flatnonzero(left.min(axis=1) <= least)
    inner, outer, turn = free[rim], blocked[rim], boxes.centre[row[rim], 2:]
    for _ in range(_BISECTIONS):
        middle = 0.5 * (inner + outer)
        there = _clearance(loop, np.concatenate([middle, turn], axis=1)) > least
        inner, outer = np.where(there[:, None], middle, inner), np.where(there[:, None], outer, middle)
    free[rim] = inner
    return row, free


def _clearance(loop: ClosedLoop, poses: Floats) -> Floats:
    """Return the clearance of the footprint at poses (..., 3)."""
    flat = poses.reshape(-1, 3)
    scene = np.zeros(len(flat), np.int64)
    found = loop.around.everything.still.footprint_clearance(flat, loop.rules.footprint, scene)
    return np.asarray(found.reshape(poses.shape[:-1]))
