"""No action leaves the bounds: random networks against exact arithmetic, float32 programs and onnxruntime."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests import runtimes
from tests.strategies import (
    ACTIVATIONS,
    SCALES,
    TOPOLOGIES,
    BoxPlan,
    NetworkPlan,
    network_and_boxes,
)
from tests.taylor.containment import Floats, escape_of_exact_values, escape_of_programs
from viatool.errors import EnclosureError
from viatool.policy.activations import ActivationFunction, activation
from viatool.policy.network import Activation, Affine, Input, Network, Node, Precision

SETTINGS = [
    {"refine": "none"},
    {"refine": "monotone"},
    {"refine": "split", "most_parts": 12},
    {"order": 2, "refine": "none"},
    {"order": 2, "refine": "monotone"},
    {"order": 3, "refine": "none"},
    {"refine": "none", "approximation": "bernstein"},
    {"order": 2, "refine": "monotone", "approximation": "bernstein"},
    {"refine": "none", "approximation": "taylor"},
    {"order": 3, "refine": "monotone", "approximation": "taylor"},
]
"""Every order, approximation and refinement."""


def described(options: dict[str, object]) -> str:
    return "-".join(str(value) for value in options.values())


def named(function: ActivationFunction) -> str:
    return "-".join([function.name, *(f"{value:g}" for _, value in function.parameters)])


def quickly(examples: int) -> settings:
    return settings(
        max_examples=examples,
        deadline=None,
        derandomize=True,
        database=None,
        suppress_health_check=[HealthCheck.too_slow],
    )


NETWORKS = {"plans": network_and_boxes(most_width=24, most_inputs=4), "options": st.sampled_from(SETTINGS)}


def together(boxes: list[tuple[Floats, Floats]]) -> tuple[Floats, Floats]:
    """Return boxes of all sizes as one batch, centres and radii (B, n): a program is held to every one of them."""
    centres, radii = zip(*boxes, strict=True)
    return np.concatenate(centres), np.concatenate(radii)


@quickly(25)
@given(**NETWORKS)
def test_exact_values_stay_inside(plans: tuple[NetworkPlan, BoxPlan], options: dict[str, object]) -> None:
    assert_exact_values_inside(*plans, options)


@quickly(20)
@given(**NETWORKS)
def test_float32_programs_stay_inside(plans: tuple[NetworkPlan, BoxPlan], options: dict[str, object]) -> None:
    assert_programs_inside(*plans, options)


@pytest.mark.slow
@quickly(120)
@given(**NETWORKS)
def test_nothing_leaves_the_bounds_of_many_networks(
    plans: tuple[NetworkPlan, BoxPlan], options: dict[str, object]
) -> None:
    assert_exact_values_inside(*plans, options)
    assert_programs_inside(*plans, options)


def assert_exact_values_inside(plan: NetworkPlan, box: BoxPlan, options: dict[str, object]) -> None:
    network = plan.build()
    with suppress(EnclosureError):  # an honest refusal: a value may overflow, or a logarithm may meet 0
        assert escape_of_exact_values(network, *box.build(plan.inputs), **options) == 0


def assert_programs_inside(plan: NetworkPlan, box: BoxPlan, options: dict[str, object]) -> None:
    network = plan.build()
    with suppress(EnclosureError):
        assert escape_of_programs(network, *box.build(plan.inputs), **options) <= 0


@pytest.mark.parametrize("function", ACTIVATIONS, ids=named)
def test_every_activation_is_enclosed_without_refusal(function: ActivationFunction) -> None:
    plan = NetworkPlan(3, inputs=3, width=5, actions=2, activations=(function, function))
    network = plan.build()
    boxes = [
        BoxPlan(k, batch=3, radius=radius, spread=0.5, fixed=False).build(3)
        for k, radius in enumerate((0.0, 1e-6, 0.05, 0.5))
    ]
    for centre, eps in boxes:
        for options in (SETTINGS[1], SETTINGS[3]):
            assert escape_of_exact_values(network, centre, eps, samples=40, **options) == 0
    assert escape_of_programs(network, *together(boxes), samples=20, refine="monotone") <= 0


@pytest.mark.parametrize("options", SETTINGS, ids=described)
@pytest.mark.parametrize("topology", TOPOLOGIES)
def test_every_topology_in_every_setting(topology: str, options: dict[str, object]) -> None:
    functions = tuple(activation(name) for name in ("Relu", "Tanh", "Silu"))
    network = NetworkPlan(11, 3, 6, 2, functions, topology).build()
    boxes = [
        BoxPlan(5, batch=4, radius=radius, spread=1.0, fixed=radius < 0.1).build(3) for radius in (0.02, 0.3)
    ]
    for centre, eps in boxes:
        assert escape_of_exact_values(network, centre, eps, samples=60, **options) == 0
    assert escape_of_programs(network, *together(boxes), samples=20, **options) <= 0


@pytest.mark.parametrize("scale", SCALES)
def test_deep_and_wide_networks(scale: str) -> None:
    functions = tuple(activation(name) for name in ("Relu", "Tanh", "Relu", "Sigmoid", "Relu", "Tanh"))
    network = NetworkPlan(21, inputs=8, width=64, actions=2, activations=functions, scale=scale).build()
    centre, eps = BoxPlan(9, batch=2, radius=0.01, spread=1.0, fixed=False).build(8)
    for options in ({"refine": "none"}, {"refine": "monotone"}, {"refine": "split", "most_parts": 8}):
        assert escape_of_exact_values(network, centre, eps, samples=30, **options) == 0
        assert escape_of_programs(network, centre, eps, samples=10, **options) <= 0


def in_precision(network: Network, precision: Precision) -> Network:
    """Return a network whose program computes in a precision, weights rounded to it."""
    kind = runtimes.number_type(precision)
    nodes: list[Node] = []
    for node in network.nodes:
        if isinstance(node, Affine):
            weights = tuple(weight.astype(kind).astype(np.float64) for weight in node.weights)
            node = replace(node, weights=weights, bias=node.bias.astype(kind).astype(np.float64))
        nodes.append(replace(node, precision=precision))
    return Network(tuple(nodes))


@pytest.mark.parametrize("topology", TOPOLOGIES)
@pytest.mark.parametrize("precision", ["bfloat16", "float16", "float64"])
def test_programs_in_other_precisions_stay_inside(precision: Precision, topology: str) -> None:
    functions = tuple(activation(name) for name in ("Relu", "Tanh"))
    for seed in range(3):
        plan = NetworkPlan(seed, inputs=3, width=8, actions=2, activations=functions, topology=topology)
        network = in_precision(plan.build(), precision)
        boxes = [
            BoxPlan(seed, batch=3, radius=radius, spread=1.0, fixed=False).build(3) for radius in (0.0, 0.05)
        ]
        assert escape_of_programs(network, *together(boxes), refine="monotone") <= 0


# --- traps of the literature -----------------------------------------------------------------------------


def affine(source: int, weight: object, bias: object) -> Affine:
    return Affine((source,), (np.array(weight, dtype=np.float64),), np.array(bias, dtype=np.float64))


def absorbing(large: float) -> Network:
    """Add a large number and take it away again: what is left depends on the order and precision (Jia, Rinard)."""
    relu = activation("Relu")
    return Network(
        (
            Input(2),
            affine(0, [[1.0, 0.0], [0.0, 1.0]], [large, large]),
            Activation(1, relu, 2),
            affine(2, [[1.0, -1.0], [1.0, 1.0]], [0.0, -2 * large]),
            Activation(3, relu, 2),
            affine(4, [[1.0, 0.5]], [-0.25]),
        )
    )


def backdoor(large: float) -> Network:
    """Switch the output by a value that only rounding makes nonzero (Zombori et al.)."""
    relu = activation("Relu")
    return Network(
        (
            Input(1),
            affine(0, [[1.0], [-1.0]], [large, large]),
            affine(1, [[1.0, 1.0]], [-2 * large]),  # exactly 0
            affine(2, [[2.0**10], [-(2.0**10)]], [0.5, 0.5]),
            Activation(3, relu, 2),
            affine(4, [[1.0, -1.0]], [0.0]),
        )
    )


@pytest.mark.parametrize("refine", ["none", "monotone", "split"])
@pytest.mark.parametrize("build", [absorbing, backdoor])
@pytest.mark.parametrize("large", [2.0**20, 2.0**24, 2.0**30, 2.0**53, 2.0**60])
def test_cancellation_is_counted(build: object, large: float, refine: str) -> None:
    network = build(large)  # type: ignore[operator]
    rng = np.random.default_rng(1)
    centre = rng.normal(size=(6, network.input_size))
    for radius in (0.0, 1e-9, 0.1):
        eps = np.full(centre.shape, radius)
        assert escape_of_exact_values(network, centre, eps, refine=refine, most_parts=12) == 0
        assert escape_of_programs(network, centre, eps, refine=refine, most_parts=12) <= 0


@pytest.mark.parametrize("scale", [5e-324, 1e-320, 1e-308, 1e-45, 1e-39, 1e-30])
def test_subnormal_weights_and_inputs(scale: float) -> None:
    rng = np.random.default_rng(2)
    first = rng.normal(size=(4, 3))
    for weight, data in ((1.0, scale), (scale, 1.0), (scale, scale)):
        stored = (
            np.asarray(first * weight, dtype=np.float32).astype(np.float64)
            if scale > 1e-46
            else first * weight
        )
        network = Network(
            (
                Input(3),
                Affine((0,), (stored,), np.zeros(4)),
                Activation(1, activation("LeakyRelu", alpha=0.125), 4),
                Affine((2,), (np.ones((1, 4)),), np.zeros(1)),
            )
        )
        centre, eps = rng.normal(size=(5, 3)) * data, np.full((5, 3), 0.3 * data)
        for refine in ("none", "monotone"):
            assert escape_of_exact_values(network, centre, eps, refine=refine) == 0
        if scale > 1e-46:
            assert escape_of_programs(network, centre, eps) <= 0


def test_saturated_tanh_of_the_runtime_may_exceed_one() -> None:
    network = Network((Input(1), affine(0, [[1.0]], [0.0]), Activation(1, activation("Tanh"), 1)))
    centre = np.linspace(7, 20, 400)[:, None]
    assert escape_of_programs(network, centre, np.full((400, 1), 0.01), samples=200) <= 0
