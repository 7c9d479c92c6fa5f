"""What each term of the error model costs a certificate: the cells that are certified without it, and not with it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from viatool.arrays import Booleans
from viatool.loop.certifying import prove_cells
from viatool.loop.closed_loop import ClosedLoop
from viatool.places.findings import REFUTED, CellFindings
from viatool.places.tree import Lattice, Nodes
from viatool.schedule import NEVER, Campaign, Deadline, EvenWork, Progress, Span, digest_of, ignore
from viatool.setting.error_costs import MOST, Alternatives, ErrorCosts
from viatool.setting.setting import Setting

Loop = Callable[[Setting], ClosedLoop]
"""Asks of a cell what a setting asks."""


def cost_of_cells(
    findings: CellFindings,
    lattice: Lattice,
    without: Alternatives,
    loop_of: Loop,
    campaign: Campaign,
    tell: Progress = ignore,
    *,
    seed: int = 0,
    until: Deadline = NEVER,
) -> ErrorCosts:
    """Judge the contested cells that are not certified again without each term.

    Parameters
    ----------
    findings : CellFindings
        The leaves; those that are not certified are smallest cells.
    lattice : Lattice
        How they are cut.
    without : Alternatives
        What is asked without each of T terms.
    loop_of : callable
        Makes the closed loop of a setting.
    campaign : Campaign
        Who does the work, and where it is kept.
    tell : Progress
        Told how many cells are done.
    seed : int
        Of the order in which cells are judged, of which there may be too many for all of them or for the time.
    until : Deadline
        When to stop.

    Returns
    -------
    ErrorCosts
        Its rows are leaves. The same for every scheduler, if there was time enough.
    """
    lost = np.flatnonzero(findings.status >= REFUTED)
    rows = np.random.default_rng(seed).permutation(lost)[:MOST]
    count = len(without.settings)
    if not (len(rows) and count):
        none = np.zeros((0, count + 1), dtype=bool)
        return ErrorCosts.ranked(without, rows[:0], len(lost), none[:, :count], none[:, count])
    loops = tuple(loop_of(setting) for setting in (*without.settings, without.bare))
    work = RejudgedCells(Rejudgement(loops, lattice), findings.nodes.select(rows), without.terms)
    found = campaign.within(f"explain-{digest_of(work.describe())[:16]}").carry_out(work, tell, until=until)
    return ErrorCosts.ranked(
        without, rows[: found.units], len(lost), found.part[:, :count], found.part[:, count]
    )


@dataclass(frozen=True, eq=False)
class Rejudgement:
    """What happens to some cells; a pure function that workers can be sent.

    Parameters
    ----------
    loops : tuple of ClosedLoop
        L questions.
    lattice : Lattice
        How cells are cut.
    """

    loops: tuple[ClosedLoop, ...]
    lattice: Lattice

    def __call__(self, nodes: Nodes) -> Booleans:
        """Tell which questions are proved of cells, (C, L)."""
        cells = self.lattice.cells(nodes)
        return np.stack([prove_cells(loop, cells).holds for loop in self.loops], axis=1)


@dataclass(frozen=True, eq=False)
class RejudgedCells(EvenWork[Nodes, Booleans]):
    """Cells that are judged again, in random order.

    Parameters
    ----------
    judgement : Rejudgement
        What happens to a piece.
    nodes : Nodes
        C cells.
    terms : tuple
        Names and values of the terms of which each question has one less.
    """

    judgement: Rejudgement
    nodes: Nodes
    terms: tuple[tuple[str, str], ...]
    stage = "cells judged again"
    piece = 128  # sums of floating-point numbers depend on what is computed together

    def __len__(self) -> int:
        """Return C."""
        return len(self.nodes)

    @property
    def function(self) -> Rejudgement:
        """Return what happens to a piece."""
        return self.judgement

    def content(self, span: Span) -> Nodes:
        """Return some cells."""
        return self.nodes.select(slice(span.first, span.last))

    def describe(self) -> dict[str, str]:
        """Return everything that the answers depend on beside the search, in whose folder they are kept."""
        return {"cells": digest_of(self.nodes), "terms": digest_of(self.terms)}

    def to_arrays(self, part: Booleans) -> dict[str, NDArray[Any]]:
        """Return answers as arrays."""
        return {"proved": part}

    def from_arrays(self, arrays: Mapping[str, NDArray[Any]]) -> Booleans:
        """Return answers."""
        return arrays["proved"]

    def join(self, parts: Sequence[Booleans]) -> Booleans:
        """Return all answers as one."""
        none = np.zeros((0, len(self.judgement.loops)), dtype=bool)
        return np.concatenate([none, *parts])
