"""Counterexamples for cells: a pose, an observation that its sensors may give, and the command that fails."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from viatool.arrays import Floats, Indices
from viatool.channels.views import Eyes, SharedEyes
from viatool.loop.closed_loop import ClosedLoop
from viatool.loop.command_bounds import CommandBounds
from viatool.loop.deceived import Deceptions, known_readings
from viatool.rounding import AS_RECEIVED
from viatool.safety import JudgedStates, Witnesses, search_witnesses
from viatool.safety.witness import confirm
from viatool.schedule import check_time
from viatool.sets.forms import PoseBoxes
from viatool.sets.states import StateBoxes
from viatool.setting.admissible import AdmissibleSets, KnownReadings
from viatool.setting.explanation import explain_known
from viatool.setting.rules import Rules
from viatool.taylor.propagation import Box

_CORNERS = np.array([(x, y) for x in (-1.0, 0.0, 1.0) for y in (-1.0, 0.0, 1.0)])
_TURNS = np.array([-1.0, 0.0, 1.0])
_INSIDE = 1.0 - 1e-6
_INSTANTS = 10
_BISECTIONS = 20
_WAYS = 8
"""In which sensors err as a whole, the first of which is not at all, of which the worst is searched."""
_FREE = 1e-6
"""Metres by which the pose of a counterexample keeps the collision distance."""
_NEARLY = 5e-3
"""Metres that the instants at which a nominal command was looked at may leave more than those at which it is run."""


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

    def among(self, rows: Indices) -> Refutations:
        """Return the same of cells (R,) of which those that were asked about are some, by number."""
        return replace(self, witnesses=replace(self.witnesses, state=rows[self.witnesses.state]))

    @classmethod
    def join(cls, parts: Sequence[Refutations]) -> Refutations:
        """Return the counterexamples of different cells, ordered by cell."""
        sizes = parts[0].witnesses.observation.shape[1], parts[0].previous.shape[1]
        order = np.argsort(np.concatenate([part.witnesses.state for part in parts]), kind="stable")
        poses, previous = (
            np.concatenate([getattr(part, name) for part in parts])[order] for name in ("poses", "previous")
        )
        return cls(poses, previous, Witnesses.join([part.witnesses for part in parts], *sizes))


@dataclass(frozen=True, eq=False)
class Suspects:
    """W robots, each at the free pose of a cell that is nearest to an obstacle, and what they may observe there.

    Parameters
    ----------
    loop : ClosedLoop
        What is asked.
    cell : ndarray
        (W,) in which cell each stands; cells without a free pose have none.
    poses, previous : ndarray
        (W, 3) and (W, A): poses, and the commands of the step before.
    observations : ndarray
        (W, n) float32 numbers that programs receive where nothing errs by itself.
    box : Box or AdmissibleSets
        (W, n) what else they may receive.
    deceived : Deceptions
        (W,) in which way sensors err as a whole: the one in which the nominal command is worst.
    left : ndarray
        (W,) metres that the nominal command leaves, about: where that is much, it is not run.
    known : KnownReadings, optional
        (W,) what explains an observation; None where every reading errs by itself.
    """

    loop: ClosedLoop
    cell: Indices
    poses: Floats
    previous: Floats
    observations: Floats
    box: Box | AdmissibleSets
    deceived: Deceptions
    left: Floats
    known: KnownReadings | None = None

    @classmethod
    def of(cls, loop: ClosedLoop, cells: StateBoxes, *, seed: int = 0) -> Suspects:
        """Place a robot in every cell (C,) with a free pose.

        Parameters
        ----------
        loop : ClosedLoop
            What is asked.
        cells : StateBoxes
            C cells.
        seed : int
            Of the ways in which sensors err as a whole.
        """
        boxes, which = cells.poses.distinct()
        row, place = _nearest_places(loop, boxes)
        check_time()
        stands = np.full(len(boxes), -1)
        stands[row] = np.arange(len(row))
        cell = np.flatnonzero(stands[which] >= 0)
        previous = (0.5 * (cells.previous_lower + cells.previous_upper))[cell]
        if not len(cell):
            return cls._none(loop, previous)
        may = _at_headings(boxes.select(row), place)
        eyes = SharedEyes(loop.sensors.scenes, may.reshape(-1, 3))
        heading, left = _worst_headings(loop, may, stands[which[cell]], previous, eyes)
        at = len(_TURNS) * stands[which[cell]] + heading
        poses = may.reshape(-1, 3)[at]
        setting = loop.setting
        errors, deceived = setting.reading_errors, Deceptions.none(setting, poses)
        if errors.scans or setting.believes:
            deceived = _worst_deceptions(loop, poses, previous, np.random.default_rng(seed))
            left = np.full(len(cell), -np.inf)
        elif errors.is_box:
            within = _within_eps(loop, poses, previous, eyes.of(at))
            return cls(loop, cell, poses, previous, *within, deceived, left)
        known = known_readings(loop, poses, previous, deceived)
        sets = AdmissibleSets.of(errors, known)
        return cls(loop, cell, poses, previous, _received(sets), sets, deceived, left, known)

    @classmethod
    def _none(cls, loop: ClosedLoop, previous: Floats) -> Suspects:
        """Return no robot, where no cell has a free pose."""
        poses, nothing = np.zeros((0, 3)), np.zeros((0, len(loop.setting.radii)))
        deceived = Deceptions.none(loop.setting, poses)
        return cls(
            loop,
            np.zeros(0, np.int64),
            poses,
            previous,
            nothing,
            Box(nothing, nothing),
            deceived,
            np.zeros(0),
        )

    def __len__(self) -> int:
        """Return W."""
        return len(self.cell)

    def as_received(self) -> Refutations:
        """Return the counterexamples among what is observed where nothing errs by itself, as `elsewhere`."""
        check_time()
        near = np.flatnonzero(~(self.left > self.loop.rules.clearance.collision + _NEARLY))
        found = confirm(self.loop.driven, self._judged.select(near), self.observations[near][:, None])
        return self._explained(replace(found, state=near[found.state]))

    def elsewhere(self, which: Indices, commands: CommandBounds, *, seed: int = 0) -> Refutations:
        """Look for counterexamples among what else may be observed.

        Parameters
        ----------
        which : ndarray
            (R,) the robots that are looked at.
        commands : CommandBounds
            What the policy can command in their cells, which says where to aim.
        seed : int
            Of random observations.

        Returns
        -------
        Refutations
            In some of the cells.

        Notes
        -----
        Sound: yes. The pose lies in the cell and keeps the collision distance by `_FREE`; the observation is one that
        sensors may make there within the error model, rounded to float32; the command comes from onnxruntime, and
        fails.
        """
        check_time()
        if not len(which):
            return self._refutations(Witnesses.none(*self._sizes))
        judged = self._judged
        lower, upper = np.full((2, len(self), len(self.loop.rules.lower)), np.nan)
        lower[which], upper[which] = commands.ends
        found = search_witnesses(
            self.loop.driven, judged, which, self.observations, self.box, lower, upper, seed=seed,
            aims=judged.nominal, thorough=False, received=False,
        )  # fmt: skip
        return self._explained(found)

    @property
    def _sizes(self) -> tuple[int, int]:
        return len(self.loop.setting.radii), len(self.loop.rules.lower)

    @property
    def _judged(self) -> JudgedStates:
        """Return what is asked of them."""
        placed = self.loop.around.everything.throughout(self.poses)
        under_way, begun = _state_before(self.loop.rules, self.previous)
        return JudgedStates(self.loop.rules, placed, under_way, begun=begun)

    def _explained(self, found: Witnesses) -> Refutations:
        """Return those that the error model explains, with how sensors err in them."""
        so = self.deceived.select(found.state)
        found = replace(found, believed=so.believed, turn=so.turn, passed=so.passed)
        if self.known is None:
            return self._refutations(found)
        errors = self.loop.setting.reading_errors
        kept = [
            explain_known(errors, self.known, state, seen) is not None
            for state, seen in zip(found.state.tolist(), found.observation, strict=True)
        ]
        return self._refutations(found.select(np.flatnonzero(kept)))

    def _refutations(self, found: Witnesses) -> Refutations:
        row = found.state
        return Refutations(self.poses[row], self.previous[row], replace(found, state=self.cell[row]))


def _worst_deceptions(
    loop: ClosedLoop, poses: Floats, previous: Floats, generator: np.random.Generator
) -> Deceptions:
    """Return of some ways in which sensors err as a whole the one whose command comes nearest, for each robot (W,)."""
    setting = loop.setting
    ways = [Deceptions.none(setting, poses)]
    ways += [Deceptions.drawn(setting, poses, generator) for _ in range(1, _WAYS)]
    under_way, begun = _state_before(loop.rules, previous)
    judged = JudgedStates(
        loop.rules, loop.around.everything.throughout(poses), under_way, begun=begun
    ).nominal
    left = []
    for deceived in ways:
        check_time()
        known = known_readings(loop, poses, previous, deceived, lossless=True)
        actions = loop.rules.clip(loop.driven(_received(AdmissibleSets.of(setting.reading_errors, known))))
        left.append(judged.least_clearance(actions[:, None], _INSTANTS)[:, 0])
    return Deceptions.choose(np.argmin(left, axis=0), ways)


def _within_eps(loop: ClosedLoop, poses: Floats, previous: Floats, eyes: Eyes) -> tuple[Floats, Box]:
    """Return observations, and the boxes around them where every reading errs by itself."""
    setting = loop.setting
    readings = loop.sensors.read(poses, previous, eyes=eyes)
    observations = loop.sensors.encode(readings).astype(setting.number).astype(np.float64)
    radii = np.maximum(setting.radii - AS_RECEIVED * (1.0 + np.abs(readings).max(axis=0, initial=0.0)), 0.0)
    return observations, Box(*loop.sensors.quantities.inputs.around(readings, radii, within=True))


def _received(sets: AdmissibleSets) -> Floats:
    """Return what programs receive of sensors that err by nothing of their own, (B, n)."""
    return sets.nearest(sets.recorded_inputs).astype(np.float32).astype(np.float64)


def _state_before(rules: Rules, before: Floats) -> tuple[Floats | None, Floats | None]:
    """Return the commands under way and the ends of the state of the motion, one of both by what stands before."""
    if rules.kinematics.state:
        return None, np.stack([before, before], axis=1)
    return rules.queue(before), None


def _at_headings(boxes: PoseBoxes, place: Floats) -> Floats:
    """Return poses at a place (D, 2) of each box, at its ends and middle, (D, 3, 3)."""
    places = np.repeat(place[:, None], len(_TURNS), axis=1)
    heading = boxes.centre[:, 2, None] + _INSIDE * _TURNS * boxes.radius[:, 2, None]
    return np.concatenate([places, heading[:, :, None]], axis=2)


def _worst_headings(
    loop: ClosedLoop, poses: Floats, at: Indices, previous: Floats, eyes: SharedEyes
) -> tuple[Indices, Floats]:
    """Return the free pose of those (D, 3, 3) at a place whose nominal command comes nearest, and how near, about.

    Of W robots that were given other commands before, each at one of the places (W,): which of three, and metres.
    """
    rules, turns = loop.rules, np.arange(len(_TURNS))
    which = (len(turns) * at[:, None] + turns).ravel()
    flat = poses.reshape(-1, 3)[which]
    before = np.repeat(previous, len(turns), axis=0)
    actions = rules.clip(loop.driven(loop.sensors.measure(flat, before, eyes=eyes.of(which))))
    under_way, begun = _state_before(rules, before)
    judged = JudgedStates(rules, loop.around.everything.throughout(flat), under_way, begun=begun)
    left = judged.nominal.least_clearance(actions[:, None], _INSTANTS).reshape(-1, len(turns))
    free = _clearance(loop, poses) > rules.clearance.collision + _FREE  # corners may be nearer when turned
    least = np.where(free[at], left, np.inf)
    worst = least.argmin(axis=1)
    exact = rules.machine is None
    return worst, least[np.arange(len(at)), worst] if exact else np.full(len(at), -np.inf)


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
