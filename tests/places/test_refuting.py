"""Counterexamples of cells: what is cheap comes first, and finds what much more would find."""

from __future__ import annotations

import numpy as np

from viatool import load_map, load_policy
from viatool.loop import refuting
from viatool.loop.closed_loop import ClosedLoop
from viatool.places import SearchBudget, certify
from viatool.places import search as searching
from viatool.places.findings import REFUTED, CellFindings
from viatool.places.tree import Nodes


def refuted_cells(**options):
    policy, world = load_policy("policies/via.onnx"), load_map("maps/lab.yaml")
    found = certify(policy, world, 0, eps=0.01, budget=SearchBudget(share=0.0005), **options)
    return int((found.findings.status == REFUTED).sum())


def test_one_climb_refutes_nearly_all_cells_that_many_refute(monkeypatch):
    cheap, search = refuted_cells(), refuting.search_witnesses
    monkeypatch.setattr(
        refuting,
        "search_witnesses",
        lambda *given, thorough, **options: search(*given, thorough=True, **options),
    )
    many = refuted_cells()
    assert many > 400
    assert 0.998 * many <= cheap <= many


def test_a_climb_finds_what_the_nominal_command_does_not(monkeypatch):
    with_climbs = refuted_cells()
    monkeypatch.setattr(
        "viatool.safety.witness.climb", lambda network, box, seed, start, **_: (start, np.zeros(len(start)))
    )
    assert refuted_cells() < with_climbs


def test_what_is_observed_without_an_error_refutes_the_same_cells_before_bounds_and_after(monkeypatch):
    before, search = refuted_cells(), refuting.search_witnesses
    nothing = refuting.confirm
    monkeypatch.setattr(
        refuting, "confirm", lambda policy, states, points: nothing(policy, states, points[:0])
    )
    monkeypatch.setattr(
        refuting,
        "search_witnesses",
        lambda *given, received, **options: search(*given, received=True, **options),
    )
    assert refuted_cells() == before


def lab_cells():
    policy, world = load_policy("policies/via.onnx"), load_map("maps/lab.yaml")
    found = certify(policy, world, 0, eps=0.01, budget=SearchBudget(share=0.0005))
    return found, ClosedLoop.of(policy, found.setting, found.scenario, episode=300)


def test_cells_of_which_all_fail_without_an_error_need_no_bounds(monkeypatch):
    found, loop = lab_cells()
    refuted = found.findings.nodes.select(found.findings.status == REFUTED)
    easily = refuting.Suspects.of(loop, found.lattice.cells(refuted)).as_received().witnesses.state
    assert len(easily) > 0.9 * len(refuted)
    monkeypatch.setattr(searching, "prove_cells", None)
    again = searching._decide(loop, found.lattice, refuted.select(easily), 0)
    assert (again.status == REFUTED).all()


def test_what_is_halved_several_times_keeps_its_volume_until_an_even_number_is_left():
    found, loop = lab_cells()
    lattice, levels = found.lattice, found.findings.level
    coarse = Nodes(np.minimum(levels, lattice.grain).astype(np.int8), found.findings.index)
    index = found.findings.index >> (levels - coarse.level)
    nodes = Nodes(coarse.level, index.astype(np.int32)).select(slice(0, 300))
    left = np.full(len(nodes), 2)
    parts, blocked = searching._halved(loop, lattice, nodes, np.ones((len(nodes), 3)), left)
    everything = CellFindings.join(blocked).nodes
    assert (lattice.halvings(parts) == 2).all()
    volume = lattice.volumes(parts).sum() + lattice.volumes(everything).sum()
    np.testing.assert_allclose(volume, lattice.volumes(nodes).sum())
