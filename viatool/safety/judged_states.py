"""States together with what is asked of them, and the exact paths and clearances of commands."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Booleans, Floats
from viatool.motion.actuated import ActuatedMotion
from viatool.motion.corner_runs import CORNER_MARGIN, drive_corners
from viatool.motion.manoeuvre import Manoeuvre
from viatool.rounding import SIGHT_ROUNDING
from viatool.safety.compiled import PackedQuestion, nearest, question_of
from viatool.safety.proof import Proof, prove_clearance
from viatool.safety.scene_poses import ScenePoses
from viatool.setting.rules import Rules
from viatool.world import Nearest

DENSE_FRACTIONS = np.linspace(0.0, 1.0, 65)


@dataclass(frozen=True, eq=False)
class JudgedStates:
    """B states and what is asked of them.

    Parameters
    ----------
    rules : Rules
        What is asked.
    observing : ScenePoses
        Where the robot stands when the policy observes.
    under_way : ndarray or None
        (B, W, 2) commands that act one after the other before the new one does, the oldest first; NaN where a
        command is not known. Needed when the rules have a dead time. A robot with motors and timing of its own takes
        older ones as well, which tell of its velocity (`Rules.commands_before`).
    velocity : tuple of ndarray or None
        (B, 3) ends of the velocity that the robot was measured to have; NaN where it was not.
        command is not known. Needed when the rules have a dead time.
    begun : ndarray or None
        (B, 2, S) ends of the state of the motion when the policy observes; NaN where it is not known. Needed when the
        kinematics has one.
    """

    rules: Rules
    observing: ScenePoses
    under_way: Floats | None = None
    velocity: tuple[Floats, Floats] | None = None
    begun: Floats | None = None

    def __post_init__(self) -> None:
        expected = self.rules.commands_before
        found = 0 if self.under_way is None else self.under_way.shape[1]
        if expected and (found < expected if self.rules.varies else found != expected):
            raise ValueError(f"{found} commands are on their way or before, {expected} count")
        size = len(self.rules.kinematics.state)
        if size and (self.begun is None or self.begun.shape != (len(self), 2, size)):
            raise ValueError(f"the state of the motion is not given by {size} numbers and their ends")

    def __len__(self) -> int:
        """Return the number of states."""
        return len(self.observing)

    def select(self, which: NDArray[Any]) -> JudgedStates:
        """Return some of the states."""
        under_way = None if self.under_way is None else self.under_way[which]
        velocity = None if self.velocity is None else (self.velocity[0][which], self.velocity[1][which])
        begun = None if self.begun is None else self.begun[which]
        found = replace(
            self, observing=self.observing.select(which), under_way=under_way, velocity=velocity, begun=begun
        )
        if self.motion is not None:
            vars(found)["motion"] = self.motion.select(which)
        return found

    def among_near(self) -> JudgedStates:
        """Return the same states without what moves too far away to count, whatever they are commanded.

        Notes
        -----
        Sound: yes. No point of the footprint gets farther from where the robot observes than the way of its longest
        path and its own reach, so what stays farther from there than that and the distance that counts is never too
        near.
        """
        if not self.observing.movers:
            return self
        found = replace(self, observing=self.observing.among_near(*self._range))
        if self.motion is not None:
            vars(found)["motion"] = self.motion
        return found

    @cached_property
    def _range(self) -> tuple[Floats, Floats]:
        """How near to where the robot observes something has to come to count, (B,) metres; and until when, (B,) s."""
        rules, at = self.rules, self.observing
        if self.motion is not None:
            way, latest = self.motion.longest, self.motion.stands
        elif not rules.kinematics.state:
            way, latest = (np.full(len(self), value) for value in rules.longest_way)
        else:  # commands do not wait
            lower, upper = (np.broadcast_to(end, (len(self), len(end))) for end in (rules.lower, rules.upper))
            boxes, once = self.boxes(lower, upper), np.ones(len(self))
            way = rules.manoeuvre.longest(*boxes)
            latest = rules.manoeuvre.counted_between(boxes[0], *boxes, once, once)[1]
        limit = rules.clearance.danger + way + rules.footprint.reach + at.extent
        return limit + 1e-6 * (at.scale + at.fastest * latest), latest

    @property
    def out_of_reach(self) -> Booleans:
        """Tell around which states nothing is so near that it could count, whatever is commanded, (B,).

        Notes
        -----
        Sound: yes, by the argument of `among_near`, and at both distances, of which danger is never the smaller one.
        """
        limit, latest = self._range
        return np.asarray(self.provable & (self.observing.clearance(latest)[0] > limit))

    def boxes(self, lower: Floats, upper: Floats) -> tuple[Floats, Floats]:
        """Return boxes of commands (B, A) with the state of the motion in which they are given, (B, A + S)."""
        return (lower, upper) if self.begun is None else self.rules.begun(lower, upper, self.begun)

    def held(self, actions: Floats) -> Floats:
        """Return commands (B, K, A) with the middle of the state of the motion in which they are given."""
        if self.begun is None:
            return actions
        own = np.broadcast_to(
            self.begun.mean(axis=1)[:, None], (*actions.shape[:2], len(self.rules.kinematics.state))
        )
        return np.concatenate([actions, own], axis=2)

    @cached_property
    def motion(self) -> ActuatedMotion | None:
        """What the robots may do; None for those that have the velocity they are told to have."""
        machine = self.rules.machine
        if machine is None:
            return None
        before = self._before
        return ActuatedMotion(machine, (before, before), self.velocity)

    @property
    def nominal(self) -> JudgedStates:
        """Return the same of robots that have the velocities they are told to have: cheap to aim with, no verdict."""
        if self.motion is None:
            return self
        rules = self.rules.nominal
        before = None if self.under_way is None else self.under_way[:, -rules.commands_before :]
        return JudgedStates(
            rules, self.observing, before if rules.commands_before else None, begun=self.begun
        )

    @property
    def _before(self) -> Floats:
        """Return the commands before that count, (B, W, A)."""
        count, axes = self.rules.commands_before, len(self.rules.lower)
        if self.under_way is None or not count:
            return np.zeros((len(self), 0, axes))
        return self.under_way[:, -count:]

    @cached_property
    def waits(self) -> tuple[tuple[float, ScenePoses, Floats], ...]:
        """Return the W waits before the new command acts: seconds, where each begins, and the command (B, 2) held."""
        found, here = [], self.observing
        durations = self.rules.dead_time.durations
        each = zip(range(len(durations), 0, -1), durations, self.rules.waiting, strict=True)
        for back, seconds, waiting in each:
            assert self.under_way is not None
            held = self.under_way[:, -back]
            found.append((seconds, here, held))
            here = self._after(here, held, seconds, waiting)
        return tuple(found)

    @cached_property
    def acting(self) -> ScenePoses:
        """Where the robot stands when the new command begins to act."""
        if not self.waits:
            return self.observing
        seconds, here, held = self.waits[-1]
        return self._after(here, held, seconds, self.rules.waiting[-1])

    def _after(self, here: ScenePoses, held: Floats, seconds: float, waiting: Manoeuvre) -> ScenePoses:
        """Return where commands (B, A) that are held lead; a turned box leads aside by the way times its turn."""
        moved = here.moved(self.rules.kinematics.advance(here.poses, held, seconds))
        if here.radii is None:
            return moved
        aside = self.rules.kinematics.from_elsewhere(here.radii, waiting.extent(held)[0], 0.0)[1]
        slack = SIGHT_ROUNDING * (here.scale + np.abs(moved.poses).sum(axis=1))
        wider = np.stack([aside + slack, aside + slack, slack], axis=1)
        return replace(moved, radii=here.radii + wider)

    @cached_property
    def known(self) -> Booleans:
        """Tell of which states commands on their way and the motion are known, (B,); nothing is refuted of the others.

        Of a robot with motors and timing of its own those that are not known may be any, and proofs hold for all.
        """
        machine = self.rules.machine
        count = self.rules.dead_time.commands if machine is None else machine.timing.commands
        known = np.ones(len(self), dtype=bool)
        if count and self.under_way is not None:
            known &= np.isfinite(self.under_way[:, -count:]).all(axis=(1, 2))
        if self.begun is not None:
            known &= np.isfinite(self.begun).all(axis=(1, 2))
        return known

    @property
    def provable(self) -> Booleans:
        """Tell of which states something can be proved, (B,)."""
        return self.known if self.motion is None else np.ones(len(self), dtype=bool)

    @property
    def margin(self) -> float:
        """Return by how many metres a run has to fail so that it fails for certain."""
        return 0.0 if self.motion is None else CORNER_MARGIN

    def prove_waiting(self, threshold: float) -> Proof:
        """Decide whether the footprint keeps its clearance during the dead time, for B states."""
        proof = Proof(self.known.copy(), np.zeros(len(self), dtype=bool))
        for manoeuvre, (_, here, held) in zip(self.rules.waiting, self.waits, strict=True):
            wait = prove_clearance(here, held, held, threshold, manoeuvre, self.rules.footprint)
            proof = Proof(proof.proved & wait.proved, proof.refuted | wait.refuted)
        return proof

    def paths(self, actions: Floats, fractions: Floats) -> Floats:
        """Return the poses of commands over the whole time that is judged.

        Parameters
        ----------
        actions : ndarray
            (B, A, 2) commands of each state, as the robot carries them out.
        fractions : ndarray
            (F,) of the path, and of each of the W waits before it.

        Returns
        -------
        ndarray
            (B, A, (W + 1) F, 3), the waits first. Of robots with motors and timing of their own (B, A, R F', 3), the R
            runs of `viatool.motion.corner_runs`, at no more than F instants each, or at all of them if F is large.
        """
        if self.motion is not None:
            return self._corners(actions, len(fractions))[0]
        held = self.held(actions)[:, :, None]
        acting = self.rules.manoeuvre.path(self.acting.poses[:, None, None], held, fractions)
        waits = [
            manoeuvre.path(here.poses[:, None, None], held[:, None, None], fractions)
            for manoeuvre, (_, here, held) in zip(self.rules.waiting, self.waits, strict=True)
        ]
        return np.concatenate([*(np.broadcast_to(wait, acting.shape) for wait in waits), acting], axis=2)

    def _corners(self, actions: Floats, most: int) -> tuple[Floats, Floats]:
        """Return poses (B, A, R F, 3) and seconds (B, A, R F) of runs at the corners of the model."""
        assert self.motion is not None
        runs = drive_corners(self.motion, self.observing.poses, actions)
        count = runs.seconds.shape[3]
        some = np.unique(np.linspace(0, count - 1, min(most, count)).round().astype(int))
        poses, seconds = runs.poses[:, :, :, some], runs.seconds[:, :, :, some]
        shape = (*actions.shape[:2], seconds.shape[2] * len(some))
        return poses.reshape(*shape, 3), seconds.reshape(shape)

    def clearance(self, actions: Floats, fractions: Floats) -> Floats:
        """Return the exact clearance of the footprint at the poses of `paths`, (B, A, (W + 1) F) metres, at least 0.

        What moves has gone straight at the robot then, for as long as that counts.
        """
        paths = self.paths(actions, fractions)
        return self._clearance(paths, self._counted(paths, actions, fractions))

    def least_clearance(self, actions: Floats, steps: int) -> Floats:
        """Return the least of `clearance` at the ends of equal steps of each path, (B, A) metres: to aim with."""
        question = self._question
        if question is None:
            return np.asarray(self.clearance(actions, np.linspace(0.0, 1.0, steps + 1)).min(axis=2))
        return nearest(question, self.observing, actions, steps)[0]

    @property
    def _question(self) -> PackedQuestion | None:
        """Return what the compiled engine is asked about paths; None where numpy follows them."""
        if self.motion is not None or self.waits or self.begun is not None:
            return None
        return question_of(self.observing, self.rules.manoeuvre, self.rules.footprint)

    def _counted(self, paths: Floats, actions: Floats, fractions: Floats) -> Floats:
        """Return for how long things have moved at poses of `paths`, where that counts, (B, A, T) seconds.

        Of robots with motors and timing of their own it is not known when they stand: things are where they were, so
        that no run is said to fail by what moves.
        """
        if self.motion is not None:
            return np.zeros(paths.shape[:-1])
        return self._instants(actions, fractions, "counted")

    def _clearance(self, paths: Floats, seconds: Floats) -> Floats:
        """Return the clearance at poses (B, A, T, 3) when things have moved for so many seconds (B, A, T)."""
        shape, at = paths.shape[:-1], self.observing
        rows = np.repeat(np.arange(len(self)), int(np.prod(shape[1:], dtype=np.int64)))
        there = replace(at.select(rows), poses=paths.reshape(-1, 3), radii=None)
        found = there.footprint_clearance(self.rules.footprint, seconds.ravel())[0]
        return np.fmax(found.reshape(shape), 0.0)

    def closest_approach(self, actions: Floats) -> tuple[Floats, Floats, Floats]:
        """Find where commands come nearest to an obstacle.

        Parameters
        ----------
        actions : ndarray
            (B, A, 2) commands, as the robot carries them out.

        Returns
        -------
        tuple of ndarray
            Clearance (B, A) in metres, seconds since the observation (B, A), and pose (B, A, 3) at that
            instant.

        Notes
        -----
        Sound: as an upper bound of the least clearance, under rounding only; the instant is found by
        sampling.
        """
        question = self._question
        if (
            question is not None
        ):  # which of the instants is told apart in no time; how near it is, is then measured
            step = nearest(question, self.observing, actions, len(DENSE_FRACTIONS) - 1)[1]
            fractions, move = DENSE_FRACTIONS[step], self.rules.manoeuvre
            poses = move.path(self.observing.poses[:, None], actions, fractions)
            left = self._clearance(poses[:, :, None], np.zeros((*step.shape, 1)))[:, :, 0]
            return left, move.begins + move.clock(actions, fractions), poses
        if self.motion is None:
            paths = self.paths(actions, DENSE_FRACTIONS)
            clock = self._instants(actions, DENSE_FRACTIONS, "clock")
        else:
            paths, clock = self._corners(actions, len(DENSE_FRACTIONS))
        clearances = self._clearance(paths, self._counted(paths, actions, DENSE_FRACTIONS))
        at = clearances.argmin(axis=2)[..., None]
        seconds = np.take_along_axis(clock, at, axis=2)[..., 0]
        poses = np.take_along_axis(paths, at[..., None], axis=2)[:, :, 0]
        return np.take_along_axis(clearances, at, axis=2)[..., 0], seconds, poses

    def nearest_movers(self, actions: Floats) -> Nearest:
        """Return what moves that is nearest at the closest approach of commands (B, A), and how it has gone."""
        paths = self.paths(actions[:, None], DENSE_FRACTIONS)
        counted = self._counted(paths, actions[:, None], DENSE_FRACTIONS)
        at, rows = self._clearance(paths, counted)[:, 0].argmin(axis=1), np.arange(len(self))
        there = replace(self.observing, poses=paths[rows, 0, at], radii=None)
        return there.nearest_mover(self.rules.footprint, counted[rows, 0, at])

    def _instants(self, actions: Floats, fractions: Floats, kind: Literal["clock", "counted"]) -> Floats:
        """Return the seconds since the observation at the poses of `paths`, (B, A, (W + 1) F).

        Parameters
        ----------
        actions, fractions : ndarray
            As for `paths`.
        kind : str
            "clock", or "counted" for what moves: see `Manoeuvre.counted`.
        """
        rules, shape = self.rules, (*actions.shape[:2], len(fractions))

        def instants(manoeuvre: Manoeuvre, held: Floats) -> Floats:
            if kind == "counted":
                return manoeuvre.counted(held, fractions)
            return manoeuvre.begins + manoeuvre.clock(held, fractions)

        acting = instants(rules.manoeuvre, self.held(actions)[:, :, None])
        waits = [
            instants(manoeuvre, held[:, None, None])
            for manoeuvre, (_, _, held) in zip(rules.waiting, self.waits, strict=True)
        ]
        return np.concatenate([np.broadcast_to(part, shape) for part in (*waits, acting)], axis=2)
