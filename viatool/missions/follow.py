"""One mission: the set of all runs from the box of starts, interval by interval, until every run has arrived.

The parts of the set hold the state (pose and previous command) of every run that has not arrived at the beginning of
an interval, whatever its sensors err in each interval anew. `successor.step` encloses where the runs of a part are at
its end, and `CellSides.divide` cuts and joins that to the parts of the next interval. A run arrives where an interval
ends nearer to the goal than the goal's radius; so a part in which every pose is that near goes no further. When no
part is left, every run has arrived.

*Clearance.* During an interval the runs of a part drive from any pose of a box under any command of a box, which
`safety.enclosure` bounds, and `ClosedLoop.holds` decides where that does not suffice. Every run of a mission keeps the
collision distance at its start, which is checked first, and by induction in each interval up to the first one that is
not proved, with which the mission ends as unknown.

*Cells.* Cells that are too coarse let a set grow, and a small set can afford fine ones: so the cells of each interval
are sized by how many parts there were before. Beside boxes, parts are bounded along `directions` that follow the loop.
Parts whose commands are far apart are cut in eight for their interval. Where the set still comes too near, does not
arrive, has too many parts, or is wide of what driven runs attain, the mission is begun again with cells sized for four
times as many parts, and by the command before as well where policies answer to it; what was found before is not needed.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from viatool.arrays import Booleans, Floats, Indices
from viatool.errors import ConfigurationError
from viatool.loop.closed_loop import ClosedLoop
from viatool.loop.destination import Destination, NearPlace
from viatool.loop.elapsed import loop_after
from viatool.loop.keeping import begins_clear, clearance_kept
from viatool.loop.sectors import TubeParts
from viatool.loop.successor import LoopStep, join_steps, states_of, step
from viatool.loop.told import Told
from viatool.missions.cells import CellSides
from viatool.missions.directions import BoundedParts, PoseDirections
from viatool.missions.families import directions_of
from viatool.schedule import TimeUp, check_time
from viatool.sets.states import StateBoxes

_log = logging.getLogger(__name__)

SMALLEST_CELL = 1e-6
"""Metres, and radians."""


@dataclass(frozen=True)
class MissionLimits:
    """How far a mission is followed, and in how many parts.

    Parameters
    ----------
    steps : int
        Control intervals within which every run has to arrive.
    parts : int
        Most parts of a set.
    position, heading : float
        Sides of the largest cells, in metres and radians.
    finer : int
        How often a mission that is not proved, or whose sets are wide of what runs attain, is begun again in cells for
        four times as many parts.
    """

    steps: int
    parts: int = 4000
    position: float = 0.075
    heading: float = 0.025
    finer: int = 2

    def __post_init__(self) -> None:
        if self.steps < 0 or self.parts < 1 or self.finer < 0:
            raise ConfigurationError(
                f"a mission cannot be followed for {self.steps} steps, in {self.parts} parts, begun again {self.finer} "
                "times",
                "give at least 0 steps (0: those of the time limit), 1 part and 0 times",
            )
        if not (self.position >= SMALLEST_CELL and self.heading >= SMALLEST_CELL):
            raise ConfigurationError(
                f"the largest cells are {self.position:g} m and {self.heading:g} rad long, expected at least "
                f"{SMALLEST_CELL:g} each",
                "give metres and radians, such as 0.06,0.04",
            )


@dataclass(frozen=True, eq=False)
class MissionTube:
    """What is known of all runs of a mission.

    Parameters
    ----------
    step : ndarray
        (P,) the interval, counted from 1, at whose end the part holds runs.
    lower, upper : ndarray
        (P, 3 + A) ends of x, y, theta and the command that was held; theta is not wrapped.
    """

    step: Indices
    lower: Floats
    upper: Floats


@dataclass(frozen=True, eq=False)
class MissionProof:
    """What following a mission found.

    Parameters
    ----------
    proved : bool
        Every run arrives, and keeps its clearance until then.
    steps : int
        Intervals that were followed; of a proved mission, those after which every run has arrived.
    earliest : int
        Intervals before whose end no run has arrived.
    clearance : float
        Metres that every run keeps in the intervals that were followed.
    most_parts, start_parts : int
        Parts of the set at most, and of the box of starts.
    reason : str
        Why it is not proved: what happened, in which interval, and where.
    tube : MissionTube
        Of the intervals that were followed.
    """

    proved: bool
    steps: int
    earliest: int
    clearance: float
    most_parts: int
    start_parts: int
    reason: str
    tube: MissionTube


@dataclass(frozen=True, eq=False)
class MissionFollower:
    """Follows the closed loop of one scenario to its goal.

    Parameters
    ----------
    loop : ClosedLoop
        Policy, sensors, obstacles and what is to hold.
    goal_radius : float
        A run has arrived when it is nearer to its goal than this at the end of an interval, in metres.
    limits : MissionLimits
        How far.
    elsewhere : Destination, optional
        Where a run arrives instead.
    refuted : bool
        Whether a run is known that collides or does not arrive: then one interval is followed, and nothing is proved.
    attained : ndarray
        (K, 3) extents of driven runs in x, y and theta after each interval until the first arrives, if any were driven.
    """

    loop: ClosedLoop
    goal_radius: float
    limits: MissionLimits
    elsewhere: Destination | None = None
    refuted: bool = False
    attained: Floats = field(default_factory=lambda: np.zeros((0, 3)))

    @property
    def destination(self) -> Destination:
        """Return where a run arrives, at the end of an interval."""
        return self.elsewhere or NearPlace(False, self.loop.sensors.goal, self.goal_radius)

    def prove(self, lower: Floats, upper: Floats) -> MissionProof:
        """Follow every run from a box of states (3 + A,), in more parts where the first do not suffice.

        Notes
        -----
        Sound: yes, see the module. Cost: one step of the closed loop for each part and interval.
        """
        return best(self.attempts(lower, upper))

    def attempts(self, lower: Floats, upper: Floats) -> Iterator[MissionProof]:
        """Yield what following every run finds, in finer cells each time, until narrow sets prove it."""
        directions = (PoseDirections.none(),) if self.refuted else directions_of(self, lower, upper)
        for sides, aim in self._ways():
            found = self._follow(lower, upper, sides, aim, directions)
            told = "proved" if found.proved else f"not proved, as {found.reason}"
            _log.info("cells for %d parts: %d intervals followed, %s", aim, found.steps, told)
            yield found
            if not found.steps or (found.proved and not self._is_wide(found.tube)):
                return

    def _is_wide(self, tube: MissionTube) -> bool:
        """Tell whether sets are wide of what driven runs attain, and of cells, at the median over the intervals."""
        largest = np.array([self.limits.position, self.limits.position, self.limits.heading])
        ratios = []
        for k, attained in enumerate(self.attained, start=1):
            part = tube.step == k
            if part.any():
                extent = (tube.upper[part].max(axis=0) - tube.lower[part].min(axis=0))[:3]
                ratios.append((extent / np.maximum(attained, largest)).max())
        return bool(ratios and np.median(ratios) > _WIDE)

    def _ways(self) -> Iterator[tuple[CellSides, int]]:
        """Yield the sides of the largest cells, and for how many parts they are sized; later ones cut commands too."""
        limits, rules, before = self.limits, self.loop.rules, 0
        pose = np.array([limits.position, limits.position, limits.heading])
        for finer in range(limits.finer + 1):
            behind = np.full(len(rules.carried), np.inf)
            if finer and self.loop.setting.quantities.answer_to_before:
                behind[: len(rules.lower)] = (rules.upper - rules.lower) * _COMMAND_SHARE
            aim = max(min(max(limits.parts // _AIM, 1) * 4**finer, limits.parts // 2), 1)
            if finer > 1 and aim == before:
                return
            yield CellSides(np.concatenate([pose, behind])), aim
            before = aim

    def _follow(
        self, lower: Floats, upper: Floats, sides: CellSides, aim: int, directions: Sequence[PoseDirections]
    ) -> MissionProof:
        """Follow every run with cells that are sized for some number of parts."""
        share, here = _FIRST_SHARE, directions[0]
        begin = TubeParts(np.zeros(1, np.int64), lower[None], upper[None]).cells
        parts = sides.scaled(share).divide(
            states_of(begin), here.beside_boxes(lower[None], upper[None]), here
        )
        trace = Trace(len(parts))
        if not self._begins_clear(parts.boxes).all():
            return trace.ended(0, f"{TOO_NEAR} at the start")
        for k in range(1, self.limits.steps + 1):
            check_time()
            now = replace(self, loop=loop_after(self.loop, k - 1))
            share = _next_share(share, len(parts), aim)
            parts, after = now._stepped(parts, k)
            clearance, clear = now._clearance_of_each(parts.boxes, after)
            trace.clearance = min(trace.clearance, float(clearance.min(initial=np.inf)))
            if not clear.all():
                return trace.ended(
                    k, f"{TOO_NEAR} in {place_words(parts.boxes.select(after.origin[~clear]))}"
                )
            there = directions[min(k, len(directions) - 1)]
            parts = sides.scaled(share).divide(after.states, there.after(parts, after), there)
            boxes = parts.boxes
            if k == self.limits.steps or not self.destination.deadline_only:
                if trace.earliest == 0 and self.destination.possibly(boxes.lower, boxes.upper).any():
                    trace.earliest = k
                parts = parts.select(~self.destination.surely(boxes.lower, boxes.upper))
            trace.note(k, parts.boxes)
            if self.refuted:
                return trace.ended(k, REFUTED)
            if not len(parts):
                return trace.arrived(k)
            if len(parts) > self.limits.parts:
                return trace.ended(
                    k,
                    f"{TOO_MANY}: {len(parts):,} of at most {self.limits.parts:,}, {place_words(parts.boxes)}",
                )
        return trace.ended(self.limits.steps, f"runs may still be on their way, {place_words(parts.boxes)}")

    def _stepped(self, parts: BoundedParts, k: int) -> tuple[BoundedParts, LoopStep]:
        """Follow parts through interval k, cut in eight where commands would be far apart."""
        after = step(self.loop, states_of(parts.cells), self.told(len(parts)).after(k - 1))
        apart = (after.upper - after.lower) > _FAR * (self.loop.rules.upper - self.loop.rules.lower)
        wide = np.unique(after.origin[apart.any(axis=1)])
        if not len(wide):
            return parts, after
        smaller = parts.select(wide).halved()
        again = step(self.loop, states_of(smaller.cells), self.told(len(smaller)).after(k - 1))
        kept = after.select(~np.isin(after.origin, wide))
        return parts.beside(smaller), join_steps([kept, again], [0, len(parts)])

    def told(self, count: int) -> Told:
        """Return what is known of sets of states at the start: the episode is the mission."""
        episode = self.loop.sensors.recollection.episode
        return Told(None if episode is None else np.full((count, 2), float(episode)))

    def _begins_clear(self, parts: TubeParts) -> Booleans:
        """Tell in which parts every pose keeps the collision distance, (P,)."""
        return begins_clear(self.loop, parts.cells.poses)

    def _clearance_of_each(self, parts: TubeParts, after: LoopStep) -> tuple[Floats, Booleans]:
        """Return what the runs of pieces keep during an interval, in metres, and of which that suffices, (P,)."""
        return self.clearance_of(parts.select(after.origin), after.start, after.lower, after.upper)

    def clearance_of(
        self, parts: TubeParts, start: StateBoxes, lower: Floats, upper: Floats
    ) -> tuple[Floats, Booleans]:
        """Return the same of boxes of states under boxes of commands (P, A); `start` holds them as well."""
        least, proved = clearance_kept(self.loop, parts.cells, start, lower, upper)
        return np.where(proved, np.maximum(least, self.loop.rules.clearance.collision), least), proved


def best(proofs: Iterable[MissionProof]) -> MissionProof:
    """Return the last proof, or what was found last if there is none; what was proved before its time is up counts."""
    found: MissionProof | None = None
    try:
        for one in proofs:
            found = one if found is None or one.proved or not found.proved else found
    except TimeUp:
        if found is None or not found.proved:
            raise
    assert found is not None
    return found


TOO_MANY = "too many parts"
TOO_NEAR = "the clearance is not proved"
REFUTED = "a run refutes it"
_COMMAND_SHARE = 0.15
"""Of the range of a command, that a cell spans where commands are cut."""
_AIM = 32
"""Cells are sized for so many times less parts than there may be, at first."""
_WIDE = 5.0
"""Times as wide as what driven runs attain, who are few, beyond which a proved set is followed again in finer cells."""
_FAR = 0.25
"""Of the range of a command, over which those of a part are far apart."""
_FIRST_SHARE, _SMALLEST_SHARE = 0.5, 1 / 16
"""Of the largest sides: those of the first cells, and of the smallest."""
_QUICKEST = 1.25
"""By how much cells grow or shrink from one interval to the next at most."""


def _next_share(share: float, parts: int, aim: int) -> float:
    """Return the share of the largest sides that cells have next, where so many parts came of this one."""
    growth = min(max(math.exp(math.log(parts / aim) / 3.0), 1.0 / _QUICKEST), _QUICKEST)
    return min(max(share * growth, _SMALLEST_SHARE), 1.0)


@dataclass(eq=False)
class Trace:
    """What was found so far."""

    start_parts: int
    clearance: float = np.inf
    earliest: int = 0
    most: int = field(init=False)
    tubes: list[tuple[int, TubeParts]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.most = self.start_parts

    def note(self, k: int, parts: TubeParts) -> None:
        """Note the parts that have not arrived at the end of interval k."""
        self.most = max(self.most, len(parts))
        self.tubes.append((k, parts))

    def take(self, tubes: Sequence[tuple[int, TubeParts]], clearance: float) -> None:
        """Take over sets of parts at the ends of intervals, and the metres that their runs keep."""
        self.tubes.extend(tubes)
        self.tubes.sort(key=lambda tube: tube[0])
        self.clearance = min(self.clearance, clearance)

    def arrived(self, k: int) -> MissionProof:
        """Return what was found when every run has arrived."""
        return self._found(k, "")

    def ended(self, k: int, reason: str) -> MissionProof:
        """Return what was found when the mission could not be followed further, and why."""
        return self._found(k, reason)

    def _found(self, k: int, reason: str) -> MissionProof:
        none = np.zeros((0, 0))
        tube = MissionTube(
            np.repeat([step for step, _ in self.tubes], [len(parts) for _, parts in self.tubes]).astype(
                np.int64
            ),
            _joined([parts.lower for _, parts in self.tubes], none),
            _joined([parts.upper for _, parts in self.tubes], none),
        )
        where = f"interval {k}: {reason}" if reason and k else reason
        return MissionProof(
            not reason, k, self.earliest, self.clearance, self.most, self.start_parts, where, tube
        )


def _joined(rows: Sequence[Floats], none: Floats) -> Floats:
    return np.concatenate(rows) if rows else none


def place_words(parts: TubeParts) -> str:
    """Say in words where parts are, and how far they reach."""
    low, high = parts.lower.min(axis=0), parts.upper.max(axis=0)
    middle = 0.5 * (low + high)
    return (
        f"x {middle[0]:.2f} m, y {middle[1]:.2f} m, heading {middle[2]:.2f} rad, "
        f"within {high[0] - low[0]:.2g} m, {high[1] - low[1]:.2g} m and {high[2] - low[2]:.2g} rad"
    )
