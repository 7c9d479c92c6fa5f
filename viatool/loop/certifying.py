"""In which cells the policy's commands keep every free pose clear; with rays that return nothing, the cheapest way.

Which rays return nothing is a choice of many, and each costs a pass through the network. So cells meet, in this order,
what settles or drops most of them for least: bounds with every ray returned, of which those with less are a part; the
commands of a few observations with lost rays, which bounds would have to hold as well; every command that the robot
carries out; one pass in which any of the rays may be lost; and the choices one by one, those of the rays that count
most first, until the cell is lost or no choice is left.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from viatool.arrays import Booleans, Floats, Indices
from viatool.channels import Sightings
from viatool.loop.closed_loop import ClosedLoop
from viatool.loop.command_bounds import CommandBounds
from viatool.schedule import check_time
from viatool.sets.states import StateBoxes
from viatool.taylor.correlated import CorrelatedReach

_MOST_CHOICES = 32
"""Choices of entries, or of blocks of them, that are bounded one by one for each cell."""


@dataclass(frozen=True, eq=False)
class CellProofs:
    """What is proved of C cells.

    Parameters
    ----------
    holds : ndarray
        (C,) bool: the policy's commands keep every free pose clear, whatever the sensors err.
    commands : CommandBounds
        Where every ray returns.
    """

    holds: Booleans
    commands: CommandBounds


def prove_cells(loop: ClosedLoop, cells: StateBoxes) -> CellProofs:
    """Prove of cells (C,) that the policy's commands keep every free pose clear.

    Notes
    -----
    **Sound:** yes; what holds, holds for every choice of rays that return nothing.
    """
    commands = loop.commands(cells, complete=False)
    holds = loop.all_hold(cells, commands.pieces)
    if loop.loses_rays and holds.any():
        rows = np.flatnonzero(holds)
        holds[rows] = _whatever_is_lost(loop, cells.select(rows), commands.select(rows))
    return CellProofs(holds, commands)


def _whatever_is_lost(loop: ClosedLoop, cells: StateBoxes, commands: CommandBounds) -> Booleans:
    """Tell which cells (C,) hold for every choice of lost rays, of those that hold without. **Sound:** yes."""
    holds = loop.holds(cells, *loop.any_commands(len(cells)))
    for some in loop.chunks(len(cells)):
        rows = np.arange(len(cells))[some][~holds[some]]
        if not len(rows):
            continue
        check_time()
        part, seen = cells.select(rows), loop.sensors.enclose(cells.select(rows))
        may = np.flatnonzero(_may_hold(loop, part, commands.select(rows), seen))
        if len(may):
            holds[rows[may]] = _every_choice(loop, part.select(may), seen.of_sets(may, len(part)))
    return holds


def _may_hold(loop: ClosedLoop, cells: StateBoxes, commands: CommandBounds, seen: Sightings) -> Booleans:
    """Tell which cells hold for their bounds and what is commanded at the middle with lost rays, (C,); no proof.

    Each bin is lost by itself, and together those that move a command most to either side.
    """
    if not loop.driven.is_plain:  # a hull of what is chosen says little
        return np.ones(len(cells), dtype=bool)
    count = len(cells)
    lower, upper = (end.copy() for end in commands.ends)
    middle = seen.forms.centre[:count]
    sent = loop.rules.clip(loop.driven(middle))
    for few in seen.few:
        columns, ends = few.columns, np.stack([few.lower[:count], few.upper[:count]])  # (2, C, E)
        alone = np.broadcast_to(middle, (2, len(columns), *middle.shape)).copy()
        for number, column in enumerate(columns.tolist()):
            alone[:, number, :, column] = ends[:, :, number]
        found = loop.rules.clip(loop.driven(alone.reshape(-1, middle.shape[1])))
        found = found.reshape(2, len(columns), count, -1)
        lower = np.minimum(lower, found.min(axis=(0, 1)))
        upper = np.maximum(upper, found.max(axis=(0, 1)))
        if few.count > 1:
            for joint in _jointly(middle, found - sent, ends, columns, few.count):
                sent_then = loop.rules.clip(loop.driven(joint))
                lower, upper = np.minimum(lower, sent_then), np.maximum(upper, sent_then)
    return loop.holds(cells, lower, upper)


def _jointly(middle: Floats, moved: Floats, ends: Floats, columns: Indices, count: int) -> list[Floats]:
    """Return observations (C, n) in which those entries are elsewhere that move a command most, to either side.

    Of what each entry moves, (2, E, C, A), at either of its ends (2, C, E).
    """
    found, rows = [], np.arange(len(middle))[:, None]
    for axis in range(moved.shape[3]):
        for sign in (-1.0, 1.0):
            gain = sign * moved[..., axis].transpose(0, 2, 1)  # (2, C, E)
            at, size = gain.argmax(axis=0), gain.max(axis=0)
            most = np.argsort(-size, axis=1)[:, :count]
            seen = middle.copy()
            chosen = at[rows, most]
            better = size[rows, most] > 0.0
            seen[rows, columns[most]] = np.where(
                better, ends[chosen, rows, most], middle[rows, columns[most]]
            )
            found.append(seen)
    return found


def _every_choice(loop: ClosedLoop, cells: StateBoxes, seen: Sightings) -> Booleans:
    """Tell which cells (C,) hold whatever is lost, by one pass or by one for each choice. **Sound:** yes."""
    coarse = loop.reached(seen.sets, 1)
    holds = loop.all_hold(cells, loop.bounds_of(seen, coarse, len(cells)).pieces)
    left = np.flatnonzero(~holds)
    if not len(left):
        return holds
    first = seen.forms.slope.shape[1]
    weight = coarse.influence[:, first:].max(axis=2).mean(axis=0)  # (n,)
    of_left = seen.of_sets(left, len(cells))
    rows, found = seen.parts_of(left, len(cells)), None
    for number, chosen in enumerate(seen.sets.choices(_MOST_CHOICES, weight)):
        check_time()
        reached = loop.reached(chosen.select(rows), 1)
        found = reached if found is None else CorrelatedReach.hull([found, reached])
        if number & (number - 1) == 0:
            kept = _hold_so_far(loop, cells.select(left), of_left, found)
            if kept.all():
                continue
            within = of_left.parts_of(np.flatnonzero(kept), len(left))
            of_left = of_left.of_sets(np.flatnonzero(kept), len(left))
            rows, found, left = rows[within], found.select(within), left[kept]
            if not len(left):
                return holds
    assert found is not None
    holds[left] = _hold_so_far(loop, cells.select(left), of_left, found)
    return holds


def _hold_so_far(loop: ClosedLoop, cells: StateBoxes, seen: Sightings, found: CorrelatedReach) -> Booleans:
    """Tell which cells hold for the choices that were bounded, (C,)."""
    return loop.all_hold(cells, loop.bounds_of(seen, found, len(cells)).pieces)
