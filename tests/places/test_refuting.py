"""Counterexamples of cells: what is cheap comes first, and finds what much more would find."""

from __future__ import annotations

import numpy as np

from viatool import load_map, load_policy
from viatool.loop import refuting
from viatool.places import SearchBudget, certify
from viatool.places.findings import REFUTED


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
