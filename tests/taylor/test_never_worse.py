"""A setting that costs more is never worse: order k than the orders below it, `split` than `monotone` than `none`."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.strategies import BoxPlan, NetworkPlan, box_plans, network_plans
from tests.taylor.containment import Bare
from viatool.errors import EnclosureError
from viatool.policy.activations import activation
from viatool.policy.network import Network
from viatool.taylor import ReachableSet, reach

REFINEMENTS = ("none", "monotone", "split")
RULES = ("chebyshev", "bernstein", "taylor")


def bounds(network: Network, boxes: BoxPlan, **options: Any) -> ReachableSet | None:
    """Bounds over boxes, None where nothing finite is known."""
    centre, eps = boxes.build(network.input_size)
    try:
        return reach(Bare(network), centre, eps, **{"arithmetic": "real", "most_parts": 12, **options})
    except EnclosureError:
        return None


def assert_no_worse(dearer: ReachableSet | None, cheaper: ReachableSet | None) -> None:
    """Each bound of the dearer setting is within 1e-9 of the other's width and size, or inside."""
    if cheaper is None:
        return
    assert dearer is not None, "nothing finite is known where the cheaper setting knows bounds"
    size = np.maximum(np.abs(cheaper.lower), np.abs(cheaper.upper))
    slack = 1e-9 * cheaper.width + 1e-13 * size + 1e-300
    assert (dearer.upper <= cheaper.upper + slack).all()
    assert (dearer.lower >= cheaper.lower - slack).all()


@given(
    network_plans(most_inputs=5, most_layers=3, most_width=16),
    box_plans(most_batch=3),
    st.sampled_from(RULES),
    st.sampled_from(REFINEMENTS),
)
@settings(max_examples=30, deadline=None, suppress_health_check=list(HealthCheck))
def test_a_higher_order_is_never_worse(plan: NetworkPlan, boxes: BoxPlan, rule: str, refine: str) -> None:
    network = plan.build()
    found = [bounds(network, boxes, order=k, approximation=rule, refine=refine) for k in (1, 2, 3)]
    for cheaper, dearer in pairwise(found):
        assert_no_worse(dearer, cheaper)


@given(
    network_plans(most_inputs=6, most_layers=3, most_width=24),
    box_plans(most_batch=3),
    st.sampled_from(RULES),
    st.sampled_from((1, 2)),
)
@settings(max_examples=30, deadline=None, suppress_health_check=list(HealthCheck))
def test_more_refinement_is_never_worse(plan: NetworkPlan, boxes: BoxPlan, rule: str, order: int) -> None:
    network = plan.build()
    found = [bounds(network, boxes, order=order, approximation=rule, refine=refine) for refine in REFINEMENTS]
    for cheaper, dearer in pairwise(found):
        assert_no_worse(dearer, cheaper)


@pytest.mark.parametrize("functions", [("Relu", "Relu"), ("Relu", "Tanh"), ("Elu", "Elu")])
def test_more_refinement_of_a_wide_network_is_never_worse(functions: tuple[str, ...]) -> None:
    layers = tuple(activation(name) for name in functions)
    network = NetworkPlan(3, inputs=20, width=140, actions=2, activations=layers).build()
    boxes = BoxPlan(5, batch=3, radius=0.05, spread=1.0, fixed=False)
    found = [bounds(network, boxes, refine=refine) for refine in REFINEMENTS]
    for cheaper, dearer in pairwise(found):
        assert_no_worse(dearer, cheaper)


@pytest.mark.parametrize("refine", REFINEMENTS)
def test_a_split_that_stops_early_is_still_no_worse_than_monotone(refine: str) -> None:
    network = NetworkPlan(11, inputs=8, width=20, actions=2, activations=(activation("Relu"),) * 2).build()
    boxes = BoxPlan(5, batch=6, radius=0.3, spread=1.0, fixed=False)
    lazy = bounds(network, boxes, refine="split", tolerance=0.5, most_parts=1)
    assert_no_worse(lazy, bounds(network, boxes, refine=refine if refine != "split" else "monotone"))


@pytest.mark.parametrize("refine", REFINEMENTS)
def test_a_piecewise_linear_network_does_not_pay_for_a_higher_order(refine: str, monkeypatch: Any) -> None:
    network = NetworkPlan(2, inputs=6, width=12, actions=2, activations=(activation("Relu"),) * 2).build()
    boxes = BoxPlan(5, batch=4, radius=0.1, spread=1.0, fixed=False)
    first = bounds(network, boxes, refine=refine)

    def refuse(*_: Any) -> None:
        raise AssertionError("monomials were asked for")

    monkeypatch.setattr("viatool.taylor.propagation.monomial_basis", refuse)
    second = bounds(network, boxes, refine=refine, order=2)
    assert first is not None
    assert second is not None
    assert (first.lower == second.lower).all()
    assert (first.upper == second.upper).all()
