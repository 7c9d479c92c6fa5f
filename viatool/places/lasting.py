"""What is asked of the time after the next action, and what was found: by cells, and in shares of what is free."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Booleans, Floats
from viatool.errors import ConfigurationError
from viatool.places.findings import BLOCKED
from viatool.places.forever import FOR_EVER
from viatool.places.mesh import Mesh
from viatool.places.passages import STILL
from viatool.places.tree import AXES
from viatool.simulate.task import NavigationTask


@dataclass(frozen=True)
class Lookahead:
    """What is asked of the time after the next action.

    Parameters
    ----------
    steps : int
        K, up to which number of control intervals cells are counted; 0 asks for none.
    for_ever : bool
        Whether to look for the set that is left only towards the goal.
    arrive : bool
        Whether to look for the cells from which every run reaches the goal, and in the set that is left only towards
        it for those from which no run stands still.
    intervals : int
        For how many intervals a cell is followed as it is before it has to lie in other cells.
    goal_radius : float
        Metres within which the goal is reached, and the run over.
    coarser : int
        How often less than the smallest cells those are halved of which the sets consist: a cell is safe if all the
        leaves in it are, so that what is undecided may be cut further than where the loop leads.
    finer : int
        How often those of these cells are halved along x, y and theta that lead nearly into cells that arrive.
    """

    steps: int = 0
    for_ever: bool = False
    intervals: int = 4
    goal_radius: float = NavigationTask.goal_radius
    coarser: int = 0
    arrive: bool = False
    finer: int = 0

    def __post_init__(self) -> None:
        if not 0 <= self.steps < FOR_EVER:
            raise ConfigurationError(
                f"{self.steps} steps cannot be counted", f"give a number from 1 to {FOR_EVER - 1}"
            )
        if not 1 <= self.intervals <= 64:
            raise ConfigurationError(
                f"cells cannot be followed for {self.intervals} intervals", "give a number from 1 to 64"
            )
        if not 0 <= self.coarser <= 3:
            raise ConfigurationError(
                f"cells cannot be {self.coarser} times coarser than the smallest", "give a number from 0 to 3"
            )
        if not 0 <= self.finer <= (3 if self.arrive else 0):
            raise ConfigurationError(
                f"cells of the set that arrives cannot be halved {self.finer} times",
                "give a number from 0 to 3" if self.arrive else "ask which cells arrive: --arrive",
            )
        if not 0.0 <= self.goal_radius < math.inf:
            raise ConfigurationError(
                f"the goal's radius is {self.goal_radius} m", "give a length of 0 m or more"
            )

    @property
    def asked(self) -> bool:
        """Tell whether anything is asked."""
        return self.lasts or self.steps > 0

    @property
    def lasts(self) -> bool:
        """Tell whether the set that is left only towards the goal is asked for; cells that arrive are part of it."""
        return self.for_ever or self.arrive

    @property
    def rounds(self) -> tuple[int, ...]:
        """Return for how many intervals open cells are followed, round by round: 1, 2, 4, ...

        Hardly a cell arrives after one or two, so where that is asked, all are followed as far as they may at once.
        """
        if self.arrive:
            return (self.intervals,)
        doubling = (2**power for power in range(self.intervals.bit_length()))
        return (*(number for number in doubling if number < self.intervals), self.intervals)


@dataclass(frozen=True)
class Round:
    """How cells were followed, and what it gave.

    Parameters
    ----------
    intervals : int
        For how long.
    followed, held, arrived : int
        Cells that were followed, and cells that were then known to hold for ever, and to arrive.
    seconds : float
        Processor time of this process, or wall time if others did the work.
    """

    intervals: int
    followed: int
    held: int
    arrived: int
    seconds: float


@dataclass(frozen=True, eq=False)
class LastingCells:
    """What holds over time, by cells of one size.

    Parameters
    ----------
    mesh : Mesh
        N cells.
    status : ndarray
        (N,) of the next action; -1 where nothing was examined.
    goal : ndarray
        (N,) bool: all free poses have reached the goal.
    intervals : ndarray
        (N,) int16: for how many intervals a cell is certified, `FOR_EVER` if it is left only towards the goal.
    lookahead : Lookahead
        What was asked.
    rounds : sequence of Round
        How it was found.
    arrives : ndarray
        (N,) int16: within how many intervals every run has reached the goal; 0 where that is not known.
    moves : ndarray
        (N,) bool: of the cells that hold for ever and may not arrive, those from which no run ever stands still.
    """

    mesh: Mesh
    status: NDArray[np.int8]
    goal: Booleans
    intervals: NDArray[np.int16]
    lookahead: Lookahead
    rounds: Sequence[Round]
    arrives: NDArray[np.int16]
    moves: Booleans

    @cached_property
    def free(self) -> Booleans:
        """Return the cells with a free pose from which the goal is yet to be reached, (N,)."""
        return np.asarray((self.status > BLOCKED) & ~self.goal)

    @property
    def for_ever(self) -> Booleans:
        """Return the cells that the loop leaves only towards the goal, (N,)."""
        return np.asarray(self.free & (self.intervals == FOR_EVER))

    @property
    def arriving(self) -> Booleans:
        """Return the cells from which every run reaches the goal, (N,)."""
        return np.asarray(self.free & (self.arrives > 0))

    @property
    def moving(self) -> Booleans:
        """Return the cells that hold for ever, that may not arrive, and from which no run stands still, (N,)."""
        return np.asarray(self.for_ever & self.moves & ~self.arriving)

    @property
    def standing(self) -> Booleans:
        """Return the other cells that hold for ever and may not arrive, (N,)."""
        return np.asarray(self.for_ever & ~self.moves & ~self.arriving)

    def by_steps(self) -> list[tuple[int, int]]:
        """Return k and the number of cells that stay certified for k intervals, for k from 1 on."""
        counted = self.intervals[self.free]
        return [(k, int((counted >= k).sum())) for k in range(1, self.lookahead.steps + 1)]

    def share_by_place(self, members: Booleans) -> Floats:
        """Return the share of each place that is in a set (N,), (X, Y); nan if none is free."""
        shape = tuple(self.mesh.count)
        free, held = (part.reshape(shape).sum(axis=(2, 3, 4)) for part in (self.free, members))
        return np.asarray(np.where(free > 0, held / np.maximum(free, 1), np.nan))

    @property
    def unit(self) -> float:
        """Return the volume of a cell in m^2 rad, times its share of the commands' range."""
        return float(np.prod(self.mesh.size[:3]) / np.prod(self.mesh.count[3:]))

    def to_json(self) -> dict[str, Any]:
        """Return it as plain data."""
        unit, asked = self.unit, self.lookahead
        total = int(self.free.sum())
        parts = {
            "forever": int(self.for_ever.sum()) if asked.lasts else None,
            **{
                name: int(cells.sum()) if asked.arrive else None
                for name, cells in (
                    ("arrive", self.arriving),
                    ("moving", self.moving),
                    ("standing", self.standing),
                )
            },
        }
        return {
            "goal_radius": asked.goal_radius,
            "lookahead": asked.intervals,
            "finer": asked.finer,
            "cell": dict(zip(AXES, self.mesh.size.tolist(), strict=True)),
            **{name: None if part is None else _share(part, total) for name, part in parts.items()},
            "arrive_within": int(self.arrives.max(initial=0)) if asked.arrive else None,
            "still": STILL if asked.arrive else None,
            "volume": {
                "free": total * unit,
                **{name: None if part is None else part * unit for name, part in parts.items()},
                "goal": int(self.goal.sum()) * unit,
            },
            "steps": [{"steps": k, **_share(part, total)} for k, part in self.by_steps()],
            "rounds": [
                {
                    "intervals": each.intervals,
                    "followed": each.followed,
                    "forever": each.held,
                    "arrive": each.arrived,
                    "seconds": each.seconds,
                }
                for each in self.rounds
            ],
        }

    def cell_table(self) -> dict[str, NDArray[Any]]:
        """Return the cells that are certified for at least one interval, for other programs; -1 is for ever.

        Where it was asked which cells arrive, also within how many intervals, 0 for those that may not, and of which
        no run stands still before it reaches the goal or a cell that arrives.
        """
        chosen = np.flatnonzero(self.free & (self.intervals > 0))
        lower, upper = self.mesh.bounds(chosen)
        steps = self.intervals[chosen].astype(np.int32)
        arrival = {"steps_arrive": self.arrives[chosen].astype(np.int32), "steps_moving": self.moving[chosen]}
        return {
            "steps_lower": lower,
            "steps_upper": upper,
            "steps": np.where(steps == FOR_EVER, -1, steps),
            **(arrival if self.lookahead.arrive else {}),
        }


def _share(part: int, total: int) -> dict[str, int | float | None]:
    return {"part": part, "total": total, "rate": part / total if total else None}
