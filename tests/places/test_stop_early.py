"""A certificate that stops early ends as the whole one does, and says what was left out."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from viatool.places.findings import CERTIFIED, REFUTED, SETTLED, UNKNOWN, CellFindings
from viatool.places.so_far import CellCount, CellsKnown
from viatool.places.tree import Lattice
from viatool.report import Gate, Threshold, evaluate
from viatool.report.gate import is_certain
from viatool.report.places.so_far import PlacesSoFar
from viatool.report.ruling import Ruling

LATTICE = Lattice(
    origin=np.zeros(5),
    size=np.ones(5),
    count=np.array([3, 2, 2, 1, 1]),
    grain=np.zeros(5, dtype=np.int64),
    deepest=np.array([1, 1, 0, 1, 0]),
)
"""Twelve roots of eight smallest cells."""

LEAST = st.sampled_from([Fraction(0), Fraction(1, 3), Fraction(1, 2), Fraction(9, 10), Fraction(1)])
THRESHOLDS = st.lists(st.builds(Threshold, st.sampled_from(["contested", "overall"]), LEAST), max_size=2)
LIMIT = st.none() | st.sampled_from([0, 3, 20, 90])
GATES = st.builds(Gate, THRESHOLDS.map(tuple), max_unsafe=LIMIT, max_unknown=LIMIT, exit_zero=st.booleans())


def parts_of(generator: np.random.Generator) -> list[CellFindings]:
    """Return the leaves of each root in some order: the root itself, its halves or smallest cells."""
    roots, chances = LATTICE.roots(), generator.dirichlet(np.full(5, 0.4))
    parts = []
    for root in generator.permutation(len(roots)):
        nodes = roots.select(np.array([root]))
        for axis in (0, 1, 3)[: generator.integers(0, 4)]:
            nodes = nodes.halved(np.full(len(nodes), axis))
        parts.append(CellFindings.of(nodes, generator.choice(5, size=len(nodes), p=chances)))
    return parts


def outcome_of(gate: Gate, found: CellsKnown) -> str:
    return Ruling(evaluate(gate, PlacesSoFar(found))).outcome


@settings(max_examples=150, deadline=None)
@given(gate=GATES, seed=st.integers(0, 2**32))
def test_no_later_root_changes_how_a_gate_ends_that_is_certain(gate: Gate, seed: int) -> None:
    parts = parts_of(np.random.default_rng(seed))
    everything = CellCount(LATTICE, lambda known: False)
    everything(parts)
    assert everything.known.unjudged == 0
    if not everything.known.free[1]:
        return  # refused before there is a report
    watch = CellCount(LATTICE, lambda known: is_certain(evaluate(gate, PlacesSoFar(known))))
    judged = next((n for n in range(1, len(parts) + 1) if watch(parts[:n])), len(parts))
    assert watch.known.unjudged == 8 * (len(parts) - judged)
    assert outcome_of(gate, watch.known) == outcome_of(gate, everything.known)


@pytest.mark.parametrize(
    ("gate", "statuses", "certain"),
    [
        (Gate((Threshold("contested", Fraction(1, 2)),)), {CERTIFIED: 6}, True),
        (Gate((Threshold("contested", Fraction(1, 2)),)), {CERTIFIED: 5, SETTLED: 1}, False),
        (Gate((Threshold("contested", Fraction(1, 2)),)), {UNKNOWN: 7}, True),
        (Gate((Threshold("contested", Fraction(0)),)), {SETTLED: 11}, False),  # nothing may be contested: exit 5
        (Gate((Threshold("overall", Fraction(1, 2)),)), {SETTLED: 6}, True),
        (Gate((Threshold("overall", Fraction(1)),)), {SETTLED: 1, REFUTED: 1}, True),
        (Gate(max_unsafe=0), {SETTLED: 11}, False),
        (Gate(max_unsafe=7), {SETTLED: 11}, False),  # a root holds eight smallest cells
        (Gate(max_unsafe=8), {SETTLED: 11}, True),
        (Gate(max_unsafe=96), {}, False),  # no place may be free: exit 5
    ],
)  # fmt: skip
def test_cells_are_certain_when_nothing_can_change_the_gate(
    gate: Gate, statuses: dict[int, int], certain: bool
) -> None:
    """Of so many whole roots; all others are open."""
    status = np.repeat([*statuses, 0], [*statuses.values(), 0 if statuses else 3])
    part = CellFindings.of(LATTICE.roots().select(slice(len(status))), status)
    watch = CellCount(LATTICE, lambda known: is_certain(evaluate(gate, PlacesSoFar(known))))
    assert watch([part]) is certain
