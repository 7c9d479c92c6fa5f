"""Verdicts about robots with motors and timing of their own: without terms as for ideal ones, with more no better."""

from __future__ import annotations

import numpy as np
import pytest

from tests.safety.brute_force import FOOTPRINTS, random_world
from tests.safety.cases import make_cases
from viatool.safety import find_contested
from viatool.safety.judgement import prove
from viatool.setting.rules import Rules
from viatool.uncertainty import ErrorModel

NEARLY = 2e-3
"""Metres by which bounds of different profiles may differ beside what they bound."""

LARGER = {
    "acceleration": ("actuation", lambda share: {"linear": {"acceleration": 1.0 / (0.5 + 2.0 * share)}}),
    "lag": ("actuation", lambda share: {"angular": {"lag": [0.02, 0.02 + 0.2 * share]}}),
    "relative": ("actuation", lambda share: {"linear": {"relative": 0.3 * share}}),
    "absolute": ("actuation", lambda share: {"angular": {"absolute": 0.5 * share}}),
    "slip": ("actuation", lambda share: {"slip": 0.3 * share}),
    "interval": ("timing", lambda share: {"interval": [0.2, 0.25 + 0.1 * share]}),
    "delay": ("timing", lambda share: {"delay": [0.05, 0.06 + 0.2 * share]}),
    "sensing": ("timing", lambda share: {"delay": [0.05, 0.06], "sensing": 0.1 * share + 0.01}),
}


def proved(section, terms, criterion, threshold, name, seed=0):
    """Which of some states just around the distance that counts are proved with terms."""
    world = random_world(seed, FOOTPRINTS[name], control_interval=0.25)
    errors = ErrorModel.model_validate({section: terms})
    case, lower, upper = make_cases(world, criterion, seed, errors=errors, reach=0.4)
    # the same commands and velocities before, however many of them count
    case.under_way[:] = np.clip([0.4, 0.2], case.rules.lower, case.rules.upper)
    return prove(case, lower, upper, threshold).proved


@pytest.mark.parametrize("name", ["circle", "square"])
@pytest.mark.parametrize("term", LARGER)
def test_a_larger_error_proves_no_more(term, name):
    section, terms = LARGER[term]
    counts = []
    for criterion in ("swept", "braking"):
        for small, large in ((0.0, 0.5), (0.5, 1.0)):
            less = proved(section, terms(large), criterion, 0.1 + NEARLY, name)
            more = proved(section, terms(small), criterion, 0.1, name)
            assert not (less & ~more).any()
            counts.append((int(more.sum()), int(less.sum())))
    most, least = np.sum(counts, axis=0)
    assert most > least > 0  # so that there was something to lose


def test_terms_that_say_what_is_so_anyway_change_nothing():
    world = random_world(1)
    stated = {"interval": [0.1, 0.1], "delay": [0.3, 0.3]}
    rules = Rules.of(world, errors=ErrorModel.model_validate({"timing": stated}))
    assert (rules.machine, rules.delay, rules.commands_before) == (None, 0.3, 3)
    assert Rules.of(world, errors=ErrorModel()).to_json() == Rules.of(world).to_json()


@pytest.mark.parametrize("criterion", ["swept", "braking"])
def test_terms_near_nothing_prove_nearly_what_is_proved_without_any(criterion):
    world = random_world(2, FOOTPRINTS["circle"])
    plain, lower, upper = make_cases(world, criterion, 3, reach=0.3)
    terms = {"actuation": {"linear": {"relative": 1e-9}}}
    varied, *_ = make_cases(world, criterion, 3, reach=0.3, errors=ErrorModel.model_validate(terms))
    ideal, nearly = (prove(case, lower, upper, 0.1).proved for case in (plain, varied))
    assert not (nearly & ~prove(plain, lower, upper, 0.1 - 1e-6).proved).any()
    assert nearly.sum() >= (1.0 if criterion == "swept" else 0.8) * ideal.sum() - 1
    assert not (find_contested(plain).collision & ~find_contested(varied).collision).any()
