from __future__ import annotations

import numpy as np
import pytest

from tests.safety.brute_force import FOOTPRINTS, random_world
from tests.safety.cases import make_cases, worst_found
from viatool.safety import JudgedStates, ScenePoses, prove, sample, settle
from viatool.safety.proof import ProofEffort, prove_clearance
from viatool.setting.rules import Rules


def cases(seed, footprint, criterion, **options):
    world = random_world(seed, footprint)
    return world, *make_cases(world, criterion, seed, **options)


@pytest.mark.parametrize("delay", [0.0, 0.15])
@pytest.mark.parametrize("criterion", ["swept", "braking"])
@pytest.mark.parametrize("name", FOOTPRINTS)
def test_no_brute_force_violation_in_a_state_that_is_proved(name, criterion, delay):
    world, case, lower, upper = cases(7, FOOTPRINTS[name], criterion, delay=delay)
    limit = world.clearance.collision
    proof = prove(case, lower, upper, limit)
    worst, _ = worst_found(world, case, lower, upper)
    assert not (proof.proved & proof.refuted).any()
    assert (worst[proof.proved] > limit).all()
    assert proof.proved.sum() >= 5
    assert proof.refuted.sum() >= 5
    assert (worst[proof.refuted] < limit + 0.02).all()  # the grid comes near whatever fails
    assert (~proof.proved & ~proof.refuted).sum() <= 1


@pytest.mark.parametrize("name", ["point", "square"])
def test_no_admissible_command_endangers_a_settled_state(name):
    world, case, lower, upper = cases(3, FOOTPRINTS[name], "swept", reach=0.4)
    limit = world.clearance.collision
    settled = settle(case, limit)
    lower, upper = (np.broadcast_to(end, (len(case), 2)) for end in (case.rules.lower, case.rules.upper))
    worst, _ = worst_found(world, case, lower, upper)
    assert (worst[settled] > limit).all()
    assert (worst[~settled] < limit + 0.05).all()
    assert 1 <= settled.sum() < len(case)


def test_what_is_proved_also_passes_the_nine_actions():
    for name, footprint in FOOTPRINTS.items():
        _, case, lower, upper = cases(5, footprint, "swept")
        proved, sampled = (judge(case, lower, upper, 0.1) for judge in (prove, sample))
        assert not (proved.proved & ~sampled).any(), name


def test_a_larger_clearance_is_never_easier():
    _, case, lower, upper = cases(11, FOOTPRINTS["point"], "swept")
    assert not (~prove(case, lower, upper, 0.05).proved & prove(case, lower, upper, 0.1).proved).any()


def test_an_obstacle_within_the_footprint_fails_though_the_outline_is_clear():
    world, _, _, _ = cases(0, FOOTPRINTS["point"], "swept")
    x, y, _ = world.obstacles.circles[0]
    placed = ScenePoses.of(world, [None], np.array([[x, y, 0.0]]), np.zeros(1, dtype=np.int64))
    rules = Rules.of(
        world.with_clearance(0.0, 0.0), footprint=[[-2.9, -2.9], [2.9, -2.9], [2.9, 2.9], [-2.9, 2.9]]
    )
    assert not prove(JudgedStates(rules, placed), np.zeros((1, 2)), np.zeros((1, 2)), 0.0).proved[0]


@pytest.mark.parametrize(
    "effort", [ProofEffort(levels=0), ProofEffort(levels=2), ProofEffort(cells=1), ProofEffort(tolerance=1.0)]
)
def test_less_effort_proves_and_refutes_less(effort):
    """What is given up, for whatever reason, is neither proved nor refuted."""
    _, case, lower, upper = cases(7, FOOTPRINTS["point"], "swept")
    rules = case.rules
    asked = case.observing, rules.clip(lower), rules.clip(upper), 0.1, rules.manoeuvre, rules.footprint
    whole, less = prove_clearance(*asked), prove_clearance(*asked, effort)
    assert (less.proved <= whole.proved).all()
    assert (less.refuted <= whole.refuted).all()
    assert 0 < less.proved.sum() < whole.proved.sum() + whole.refuted.sum()
